"""Report of the frontier: the recommended setting, the station's plot, and one table per series."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from cbsr_qa.domain.results.report import Banner, Block, CommandOutcome, Figure, Page, Paragraph, Section
from cbsr_qa.report.tables import plural, text_table, unit_column
from cbsr_qa.studies.frontier.point import Accuracy, Knob, Point, TimeBasis
from cbsr_qa.studies.frontier.study import Frontier

_NONE: Final = "–"
_READING: Final = (
    "Each point is one way to calibrate a sensor or to compute an image. Lower is more accurate, further left is "
    "faster. A filled point is worth its time: no other setting tried is as accurate in less time. A hollow point "
    "is not: a filled one takes less time and is as accurate, within the errors.",
    "Station time is the time a sensor occupies the rig, including rests, travel and finding the surface. Accuracy "
    "is measured against the truth, which only a simulation knows: sensors whose response varies by 20 % over the "
    "sheet, with noise, relaxation, and a residue of earlier presses. The force error of a sensor is the root mean "
    "square over thirty random loads of 5 to 30 % strain (0.9 to 5.3 N), held for a minute after a minute's rest, "
    "that the calibration has not seen. Errors are means over the sensors everywhere on this page; ± and bars are "
    "one standard error of that mean. All settings were tried on the same sensors, and are compared by the "
    "differences of their force errors on each.",
    "Transients averaged: the mean of the last frames of a hold is used. Transients predicted: the value at the end "
    "of a long hold is predicted from a short one, with the sensor's own relaxation, measured in three long holds.",
)
_OF_COMPUTER: Final = (
    "Computer time is that of one core for a new conductance, an image, or a frame. Voltages are compared with "
    "exact solutions (multipoles, Fourier series): without load, with an inclusion in the sheet, and the change "
    "caused by a load, from which images are made.",
    "Images show simulated sensors pressed at nine known places. E_CoM is the distance from the centre of the "
    "region found to the centre of the head; A_OL is the overlap of the two areas (100 %: the head's own outline); "
    "SD is the area by which their shapes differ; missed is the share of loads without a region. Relative smoothing "
    "is the regularisation parameter divided by the one that the method chooses itself.",
)
_NAMES: Final[Mapping[str, str]] = {
    "force_error": "force error, place known",
    "force_error_found": "force error, place found",
    "force_error_change": "change of the force error",
    "map_error": "map",
    "gauge_factor_error": "gauge factor",
    "settling_error": "settling time",
    "voltage_error_inclusion": "voltage error, inclusion",
    "load_signal_error": "error of a load's signal",
    "image_error": "error of the image",
    "smoothing_over_own": "relative smoothing",
}
#: Units at the end of knobs' names.
_UNITS: Final = ("s", "mm")

# Sentences, in reading order.
_SETTING: Final = (
    "{places} places at {strains} % strain, {trials}, held {hold_s:g} s, rested {rest_s:g} s, transients {transients}"
)
_PLOT: Final = (
    "Force error on loads the calibration has not seen, against station time. Filled: worth its time. Squares: "
    "transients predicted. Ring: the setting named above, on the same sensors as all others."
)
_PLOT_ALTERNATIVE: Final = "Force errors against station time; the tables below have the numbers."
_SERIES: Final = "{repetitions}. •: no other setting is as accurate in less time."
_ONE_SENSOR: Final = (
    "One simulated sensor: others may differ. •: on this one, no other setting is as accurate in less time."
)
#: Of the quick sweep, without and with settings of the station.
_QUICK: Final = ("quick: few settings", "quick: few settings, one sensor, which shows no scatter")
_ALIKE: Final = "The same in all rows: {knobs}."


def lay_out_frontier(frontier: Frontier) -> CommandOutcome[Frontier]:
    """Lay a frontier out."""
    series = dict.fromkeys((point.clock, point.series) for point in frontier.points)
    sections = (
        Section("How to read this page", tuple(_explain_reading(frontier)), page_only=True),
        *(Section(f"{clock.capitalize()}: {name}", tuple(_series(frontier, clock, name))) for clock, name in series),
    )
    return CommandOutcome(frontier, _page(frontier), sections)


def _page(frontier: Frontier) -> Page:
    recommended, points = frontier.recommended, frontier.points
    banner = Banner("plain", _NONE, "No setting recommended", recommended.why)
    facts = []
    if recommended.way is not None and recommended.accuracy is not None:
        force, minutes = _format_accuracy(recommended.accuracy["force_error"]), (recommended.station_s or 0) / 60
        banner = Banner("pass", "✓", f"{force} in {minutes:.0f} min", recommended.why)
        if recommended.seeds < 2:
            banner = Banner("plain", _NONE, "No setting recommended from one sensor", recommended.why)
        setting = recommended.way
        strains = ", ".join(f"{percent:g}" for percent in setting.strains_percent)
        words = setting.knobs | {"strains": strains, "trials": plural(setting.trials, "time")}
        facts = [("Recommended" if recommended.seeds > 1 else "Setting to look at", _SETTING.format_map(words))]
    counts = {clock: sum(point.clock is clock for point in points) for clock in TimeBasis}
    facts += [
        ("Settings of the station", str(counts[TimeBasis.STATION])),
        ("Settings of the computer", str(counts[TimeBasis.COMPUTER])),
        ("Worth their time", str(sum(bool(point.pareto) for point in points))),
        ("Sweep", _QUICK[bool(counts[TimeBasis.STATION])] if frontier.quick else "whole"),
    ]
    simulated = ("sensors, station and readings",) if counts[TimeBasis.STATION] else ()
    return Page("Frontier", "What accuracy costs in time", banner, tuple(facts), simulated, ())


def _explain_reading(frontier: Frontier) -> Iterator[Block]:
    clocks = {point.clock for point in frontier.points}
    yield from map(Paragraph, _READING if TimeBasis.STATION in clocks else _READING[:1])
    yield from map(Paragraph, _OF_COMPUTER if TimeBasis.COMPUTER in clocks else ())
    if any("force_error" in point.accuracy for point in frontier.points):

        def draw() -> str:
            from cbsr_qa.studies.frontier.figures import draw_station  # loads matplotlib

            return draw_station(frontier.points, frontier.recommended)

        yield Figure(_PLOT, _PLOT_ALTERNATIVE, draw)


def _series(frontier: Frontier, clock: TimeBasis, series: str) -> Iterator[Block]:
    points = [point for point in frontier.points if point.clock is clock and point.series == series]
    columns, rows = tabulate_points(points)
    texts = {knob for knob in points[0].knobs if any(isinstance(point.knobs.get(knob), str) for point in points)}
    first = sum(knob in texts for knob in _varying_knobs(points)[:1])  # names are left-aligned
    yield text_table(_caption(clock, points[0].seeds), columns, rows, range(first, len(columns) - 1))
    if alike := describe_common_knobs(points, frontier.points):
        yield Paragraph(_ALIKE.format(knobs=alike), "note")
    yield from (Paragraph(f"{note}.", "note") for note in list_notes(points))


def _caption(clock: TimeBasis, seeds: int) -> str:
    if clock is TimeBasis.STATION and seeds < 2:
        return _ONE_SENSOR
    means = f"Means of {seeds} sensors"
    return _SERIES.format(
        repetitions=means if clock is TimeBasis.STATION else plural(seeds, "repetition").capitalize()
    )


def tabulate_points(points: Sequence[Point]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Columns and rows of one series: differing knobs, values, cost, and whether it is worth it."""
    knobs = _varying_knobs(points)
    values = list(dict.fromkeys(name for point in points for name in point.accuracy))
    rows = [
        (
            *(_knob(point.knobs.get(name)) for name in knobs),
            *(_format_accuracy(point.accuracy[name]) if name in point.accuracy else _NONE for name in values),
            _cost(point),
            "•" if point.pareto else "",
        )
        for point in points
    ]
    names = [*(unit_column(*_name_knob(name)) for name in knobs), *map(_words, values)]
    return [*names, "time", "worth it"], rows


def describe_common_knobs(members: Sequence[Point], points: Sequence[Point]) -> str:
    """Knobs left out of a series' table because they are constant in it, though other series vary them."""
    varying = _varying_knobs(members)
    constant_knobs = {
        name: value
        for name, value in members[0].knobs.items()
        if name not in varying
        and any(p.clock is members[0].clock and p.knobs.get(name, value) != value for p in points)
    }
    return _knobs(constant_knobs)


def list_notes(members: Sequence[Point]) -> list[str]:
    """Notes on rows of one table, each with the knobs that name its row; only once if all share it."""
    if len({point.note for point in members}) == 1:
        return [members[0].note] if members[0].note else []
    varying = _varying_knobs(members)
    return [
        f"{_knobs({name: point.knobs.get(name) for name in varying})}: {point.note}"
        for point in members
        if point.note
    ]


def _varying_knobs(points: Sequence[Point]) -> list[str]:
    """Knobs that differ between points, or else the first one."""
    knobs = [name for name in points[0].knobs if len({point.knobs.get(name) for point in points}) > 1]
    return knobs or list(points[0].knobs)[:1]


def _knobs(knobs: Mapping[str, Knob | None]) -> str:
    named = ((*_name_knob(name), _knob(value)) for name, value in knobs.items())
    return ", ".join(f"{name} {value} {unit}".rstrip() for name, unit, value in named)


def _name_knob(knob: str) -> tuple[str, str]:
    """Name of a knob in words, and its unit; empty without one."""
    name, _, last = knob.rpartition("_")
    stem, unit = (name, last) if name and last in _UNITS else (knob, "")
    return _words(stem), unit


def _words(name: str) -> str:
    """A name in words; those of the paper's quantities, such as A_OL, are written as there."""
    return _NAMES.get(name, name if name[0].isupper() else name.replace("_", " "))


def _knob(value: object) -> str:
    if value is None:  # of another method's knob
        return _NONE
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _format_accuracy(accuracy: Accuracy) -> str:
    scale, unit = (
        (100, " %") if accuracy.unit == "1" and accuracy.value >= 1e-5 else (1, f" {accuracy.unit}".rstrip(" 1"))
    )
    stderr = "" if accuracy.stderr is None else f" ± {scale * accuracy.stderr:.2g}"
    return f"{scale * accuracy.value:.3g}{stderr}{unit}"


def _cost(point: Point) -> str:
    if point.station_s is not None:
        return f"{point.station_s / 60:.1f} min"
    seconds = point.compute_s or 0.0
    scale, unit = (1e6, "µs") if seconds < 1e-3 else (1e3, "ms") if seconds < 1 else (1, "s")
    return f"{scale * seconds:.3g} {unit}"
