"""The data sheet of a sensor, and its baseline conductance ρ̄₀ at each location."""

from collections.abc import Iterator, Sequence
from typing import Final

from cbsr_qa.calibration.fits.estimates import FEWEST_POINTS, best_straight_line
from cbsr_qa.calibration.fits.hysteresis_fit import loop_curve
from cbsr_qa.calibration.sheet.characteristic import (
    characteristics,
    data_sheet_loads,
    mean_characteristic,
    repeatability,
)
from cbsr_qa.calibration.sheet.data_sheet import place_responses
from cbsr_qa.plugin import (
    BaselineConductance,
    Block,
    Calibration,
    Cell,
    Figure,
    Measurement,
    NumericsError,
    Paragraph,
    RunObservation,
    RunResult,
    Table,
)
from cbsr_qa.report.draw.data_sheet import PlaceMap, PlaceValue, characteristic_figure, loop_figure, place_maps_figure
from cbsr_qa.report.draw.maps import baseline_figure
from cbsr_qa.report.section import ObservedSection, RunSection
from cbsr_qa.report.select import mean_deviation
from cbsr_qa.report.tables import number, parameter_text, place_text, plural, text_table, value_cell, with_uncertainty


class BaselineConductanceMap(RunSection):
    """Section of ρ̄₀ as issued in the calibration (paper: Eq 7), if one was issued."""

    title = "Baseline conductance"

    def blocks(self, result: RunResult) -> Iterator[Block]:
        """Return map and table of ρ̄₀, the model used with it, and what reduces its validity."""
        calibration = result.calibration
        if calibration is None or not calibration.baseline:
            return
        words = _describe_baseline(calibration.baseline)
        yield Paragraph(words)
        if any(place.value is not None for place in calibration.baseline):
            yield Figure(
                "Baseline conductance ρ̄₀ where loads were calibrated: the apparent response of the place, relative"
                " image units. Right: the same with its uncertainty (one standard deviation).",
                words,
                baseline_figure(calibration.baseline, calibration.sensor_type, calibration.indenter),
            )
        yield from (_places(calibration.baseline), _model(calibration))
        if calibration.assumed:
            names = ", ".join(calibration.assumed)
            yield Paragraph(f"Assumed from the material file and not measured on this sensor: {names}.", "note")
        for why in calibration.validity.reduced:
            yield Paragraph(f"Reduced validity: {why}.", "warning")


def _describe_baseline(places: tuple[BaselineConductance, ...]) -> str:
    values = [place.value for place in places if place.value is not None]
    summary = mean_deviation(values)
    if summary is None:
        return "No load determines the baseline conductance."
    mean, deviation = summary
    spread = f", a spread of {100 * deviation / abs(mean):.2g} % over the sheet" if deviation and mean else ""
    missing = "" if len(values) == len(places) else f"; {len(places) - len(values)} without a value"
    return f"Mean {number(mean)} over {len(values)} of {len(places)} locations{spread}{missing}."


def _places(places: tuple[BaselineConductance, ...]) -> Table:
    rows = []
    for place in places:
        value = "none" if place.value is None else with_uncertainty(place.value, place.stderr)
        rows.append([place.location, place_text(place.x_mm, place.y_mm), value, str(place.loads), place.why])
    columns = ("Location", "x, y [mm]", "ρ̄₀ [relative]", "Loads", "Remark")
    return text_table("ρ̄₀ per location.", columns, rows, (1, 2, 3))


def _model(calibration: Calibration) -> Table:
    stress, strain = calibration.against_stress, calibration.against_strain
    parameters = (
        ("α against stress", stress.slope, "1/kPa"),
        ("β against stress", stress.intercept, "relative"),
        ("α against strain", strain.slope, "relative per unit strain"),
        ("β against strain", strain.intercept, "relative"),
    )
    rows = [[name, parameter_text(parameter), unit, parameter.source] for name, parameter, unit in parameters]
    caption = "Quasi-static model Δρ/ρ₀ = α · x + β used with ρ̄₀, and where each parameter comes from."
    return text_table(caption, ("Parameter", "Value", "Unit", "Source"), rows, (1,))


#: Measurement, its qualifier, and what the data sheet calls it.
_ROWS: Final = (
    ("repeatability", "", "Repeatability"),
    ("nonlinearity", "", "Nonlinearity"),
    ("nonlinearity", "terminal-based", "– terminal-based"),
    ("hysteresis", "", "Hysteresis"),
    ("hysteresis", "as read", "– with creep, as read"),
    ("creep", "", "Creep"),
    ("creep", "conductance", "– of the conductance"),
    ("creep", "stress", "– of the stress"),
    ("zero_return", "", "Zero return"),
    ("uniformity", "", "Uniformity"),
    ("uniformity", "baseline conductance", "– of ρ̄₀ as imaged"),
    ("apparent_modulus", "", "Apparent modulus"),
    ("apparent_modulus", "slope", "– slope over strains"),
    ("preconditioning_cycles", "", "Preconditioning cycles"),
    ("preconditioning_change", "", "Change in the last cycle"),
    ("preconditioning_change", "stress", "– of the stress"),
)
_NO_LOOP: Final = (
    "the recipe does not measure it: it needs strains that are reached from below and from above (sequence"
    " hysteresis-loop)"
)


class DataSheet(ObservedSection):
    """Section of the values of a sensor's data sheet, if the recipe measures any of them."""

    title = "Data sheet of this sensor"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return the table, then figures of characteristic, loops and maps as far as they were measured."""
        whole = {(m.name, m.qualifier): m for m in result.measurements if not m.location and m.load is None}
        if any((name, qualifier) in whole for name, qualifier, _ in _ROWS):
            yield from (_table(whole), *_strain_table(result.measurements))
            yield from (*_characteristic(run), *_loops(run, whole), *_maps(run, result.measurements))


def _table(whole: dict[tuple[str, str], Measurement]) -> Table:
    rows: list[list[str | Cell]] = []
    for name, qualifier, title in _ROWS:
        measurement = whole.get((name, qualifier))
        if measurement is not None:
            value = value_cell(measurement, unit=True)
            if measurement.value is None:
                value = Cell("not determined")
            elif name == "preconditioning_cycles":
                value = Cell(f"{measurement.value:.0f}")
            rows.append([title, value, measurement.how])
    if ("hysteresis", "") not in whole:
        rows.append(["Hysteresis", "not determined", _NO_LOOP])
    caption = (
        "Values of the sensor at its nominal places and strains, value ± one standard deviation. Span: a location's"
        " change at the highest strain. Amplitudes are taken without subtracting the noise floor."
    )
    return text_table(caption, ("Quantity", "Value", "How"), rows, (1,))


def _strain_table(measurements: Sequence[Measurement]) -> list[Block]:
    strains = [(m.dimensions.strain, m) for m in measurements if m.name == "repeatability"]
    by_strain = {f"{100 * strain:g} %": value_cell(m) for strain, m in strains if strain is not None}
    if not by_strain:
        return []
    columns = ("Strain", *by_strain)
    rows: list[list[str | Cell]] = [["Repeatability [%]", *by_strain.values()]]
    return [text_table("Repeatability by strain, % of the span.", columns, rows, tuple(range(1, len(columns))))]


def _characteristic(run: RunObservation) -> Iterator[Figure]:
    """Figure of change against stress; nothing with too few strains, or without force."""
    loads = data_sheet_loads(run)
    curves = [
        curve
        for curve in characteristics(loads, run.main_mask)
        if len(curve.strain) >= FEWEST_POINTS and curve.stress_kPa is not None and curve.span > 0
    ]
    try:
        mean = mean_characteristic(curves)
        assert mean.stress_kPa is not None
        line = best_straight_line(mean.stress_kPa.tolist(), mean.change.tolist())
    except NumericsError:
        return
    try:
        scatter: float | None = repeatability(loads, run.main_mask).value
    except NumericsError:
        scatter = None
    bars = "" if scatter is None else "; bars: repeatability over the root of the number of presses"
    yield Figure(
        "Sensed change against relaxed stress. Grey: each location, in % of its own span. Blue: their mean. Red: its"
        f" best straight line. Right: deviations from it; shaded: the nonlinearity{bars}.",
        f"Change against stress at {plural(len(curves), 'location')}; the mean leaves its best straight line by at"
        f" most {number(100 * line.largest, 2)} % of the span.",
        characteristic_figure(curves, mean, line, scatter),
    )


def _loops(run: RunObservation, whole: dict[tuple[str, str], Measurement]) -> Iterator[Figure]:
    """Figure of the loops; nothing where hysteresis was not measured, or could not be."""
    hysteresis = whole.get(("hysteresis", ""))
    if hysteresis is None or hysteresis.value is None:
        return
    last_s = run.settings.steady_frames * run.frame_period_s
    try:
        curves = [loop_curve(loop, relaxed=True, last_s=last_s) for loop in run.loops]
    except NumericsError:
        return
    try:
        curves_as_read = [loop_curve(loop, relaxed=False, last_s=last_s) for loop in run.loops]
    except NumericsError:
        curves_as_read = []
    if curves:
        error = "" if hysteresis.uncertainty is None else f" ± {number(hysteresis.uncertainty, 2)}"
        yield Figure(
            "Output against relaxed stress through strains reached from below (blue, filled) and from above (red,"
            " open) without lifting the head, mean over the cycles of each location. Right: down less up at the same"
            " stress, with one standard error; grey crosses: as read at the end of each hold, creep included.",
            f"Loops at {plural(len(curves), 'location')}; the branches differ by at most"
            f" {number(hysteresis.value, 2)}{error} % of the span.",
            loop_figure(curves, curves_as_read),
        )


def _maps(run: RunObservation, measurements: Sequence[Measurement]) -> Iterator[Figure]:
    maps = [place_map for place_map in (_response_map(run), _modulus_map(run, measurements)) if place_map is not None]
    if maps:
        ranges = [(place_map, [place.value for place in place_map.places]) for place_map in maps]
        words = "; ".join(f"{s.title} {number(min(v))} to {number(max(v))} {s.unit}" for s, v in ranges)
        yield Figure(
            "By location. Response: ρ₀ relative to that of an even sheet imaged in the same way, as deviation from"
            " the mean. Modulus: relaxed stress over nominal strain.",
            f"Maps of the sheet: {words}.",
            place_maps_figure(maps, run.record.sensor_type),
        )


def _response_map(run: RunObservation) -> PlaceMap | None:
    try:
        places, strain = place_responses(run, data_sheet_loads(run))
    except NumericsError:
        return None
    mean = sum(place.response for place in places) / len(places)
    if not mean > 0:
        return None
    deviations = tuple(PlaceValue(p.location, p.x_mm, p.y_mm, 100 * (p.response / mean - 1)) for p in places)
    return PlaceMap(f"response at {100 * strain:g} % strain", "% off the mean", deviations, about=0.0)


def _modulus_map(run: RunObservation, measurements: Sequence[Measurement]) -> PlaceMap | None:
    load_by_label = {load.record.load.label: load.record.load for load in data_sheet_loads(run)}
    moduli = tuple(
        PlaceValue(m.location, load_by_label[m.location].x_mm, load_by_label[m.location].y_mm, m.value)
        for m in measurements
        if m.name == "apparent_modulus" and m.location in load_by_label and not m.qualifier and m.value is not None
    )
    return PlaceMap("apparent modulus", "kPa", moduli) if moduli else None
