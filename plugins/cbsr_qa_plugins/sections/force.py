"""Force: the map of the sheet's response, and estimates of loads it was not learned from against the load cell."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.force import HELD_OUT, TRIAL_LEFT_OUT, ForceTest, RunForce, run_force
from cbsr_qa.analysis.run.force_quality import (
    ForceErrors,
    calibration_radius_mm,
    errors_of,
    global_errors,
    map_quality,
    places_mm,
    tests_of,
)
from cbsr_qa.analysis.run.place import run_place
from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.learning import LearnedForce
from cbsr_qa.calibration.force.sheet_pose import SheetPose
from cbsr_qa.calibration.force.validity import batch_words, prediction_words
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import describe_force_error
from cbsr_qa.plugin import Block, Cell, Figure, Paragraph, RunObservation, RunResult
from cbsr_qa.report.draw.force import (
    ForcePanel,
    RatioPoints,
    force_figure,
    force_overview_figure,
    ratio_figure,
)
from cbsr_qa.report.draw.maps import SheetField, force_map_figure
from cbsr_qa.report.section import ObservedSection
from cbsr_qa.report.tables import (
    capital,
    number,
    parameter_text,
    place_text,
    plural,
    text_table,
    value_cell,
    with_uncertainty,
)

#: Cells of the maps across the sheet.
_ACROSS: Final = 61
#: Rows of the table of results: what is added to the qualifier, and how the report calls it.
_KINDS: Final = (
    ("place known", "place known"),
    ("place estimated", "place estimated"),
    ("place known, trial left out", "each trial left out, place known"),
    ("place estimated, trial left out", "each trial left out, place estimated"),
)


class Force(ObservedSection):
    """Section of the force model, if the recipe measures ``force-error``."""

    title = "Force"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return the force model, its held-out errors, and their limits."""
        if not any(m.name == "force_error_sd" for m in result.measurements):
            return
        force = run_force(run)
        learned = force.learned
        if learned is None:
            yield Paragraph(f"This sensor has no force model: {force.why}.", "warning")
            return
        tests = tests_of(run, force, HELD_OUT)
        yield Paragraph(_describe_model(run, force, learned))
        yield Paragraph(_describe_error(result), "note")
        if force.sheet_pose.moved:
            yield Paragraph(_sheet_pose_words(force.sheet_pose), "note")
        if run.settings.learn_place:
            yield Paragraph(f"{run_place(run).words}.", "note")
        yield from _prediction_blocks(run, learned)
        if (batch := learned.model.batch) is not None:
            yield Paragraph(f"{capital(batch_words(batch))}.", "note" if batch.alike else "warning")
        yield from (Paragraph(words) for words in _describe_tests(tests))
        yield from (_map(run, force, learned), Paragraph(_map_words(run, force, learned)))
        yield from (*_scatter(force, tests), *_results(result))
        yield from (_ratios(run, force, learned), Paragraph(_describe_assumptions(learned), "note"))
        yield from (Paragraph(words, "warning") for words in _list_caveats(run, force, learned, tests))
        yield from _refusal_blocks(force, learned)


def _describe_error(result: RunResult) -> str:
    if result.calibration is None:
        return "Standard errors in this section include scatter only, against the station's own load cell."
    included = describe_force_error(result.calibration.standards)
    return (
        "Standard errors in this section include scatter only, against the station's own load cell. Standard errors"
        f" that the calibration states of a force include {included}."
    )


def _describe_model(run: RunObservation, force: RunForce, learned: LearnedForce) -> str:
    used = [load for load, why in zip(force.used, learned.refused, strict=True) if not why]
    phases = " and ".join(dict.fromkeys(load.phase for load in used))
    low, high = (stress * run.record.indenter.area_mm2 / 1e3 for stress in learned.model.stress_kPa)
    return (
        "The force of a head follows from the readings, a map of the response by place, and a line of change against"
        f" stress. Map and line were learned from {len(used)} of {plural(len(force.used), 'load')}"
        f" ({phases}), {_format_range(low, high)}, up to {calibration_radius_mm(force):.0f} mm from the centre."
    )


def _prediction_blocks(run: RunObservation, learned: LearnedForce) -> list[Block]:
    """How loads of short holds were used; nothing where all count as they were seen."""
    words = prediction_words(learned)
    if words:
        source = "" if all(learned.predicted) else ", with the relaxation of the longest holds"
        return [Paragraph(f"{words}{source} (transients = predicted).", "note")]
    if run.settings.transients == "predicted":
        return [Paragraph("No hold of the calibration was predicted: all were held about as long.", "note")]
    return []


def _sheet_pose_words(pose: SheetPose) -> str:
    return (
        "The loads show that the sheet was not where the station expected it: the station's centre is"
        f" ({pose.shift_mm[0]:+.1f}, {pose.shift_mm[1]:+.1f}) ± {pose.shift_stderr_mm:.1f} mm from the sheet's, and"
        f" its x axis is rotated by {pose.rotation_deg:+.1f} ± {pose.rotation_stderr_deg:.1f}°. The places of the"
        " loads are corrected for this. It is a fault of the station, not of the sensor."
    ).replace("-", "−")


def _format_range(low_N: float, high_N: float) -> str:
    low, high = number(low_N, 2), number(high_N, 2)
    return f"about {high} N" if low == high else f"{low} to {high} N"


def _describe_tests(tests: Sequence[ForceTest]) -> list[str]:
    """What loads that were not used say; how few they are is part of it."""
    if not tests:
        return ["No load was held out, so the error of the force is unknown."]
    known, estimated, flat = errors_of(tests, known=True), errors_of(tests, known=False), global_errors(tests)
    if len(known.error_N) < 2:
        return [f"One load was held out; with its place known it is {number(known.error_N[0], 2)} N off."]
    phases = " and ".join(dict.fromkeys(test.load.phase for test in tests))
    words = (
        f"On {len(tests)} held-out loads ({phases}) the standard deviation of the force error is {_error(known)} with"
    )
    words += f" the place known (bias {parameter_text(known.bias())} N)"
    if len(estimated.error_N) > 1:
        words += f", {_error(estimated)} with the place estimated from the same readings"
    words += f", and {_error(flat)} with one response for the whole sheet."
    words += f" {plural(estimated.missed, 'load was', 'loads were')} not detected." if estimated.missed else ""
    return [words, _describe_coverage(known)]


def _error(errors: ForceErrors) -> str:
    return f"{parameter_text(errors.deviation())} N"


def _describe_coverage(errors: ForceErrors) -> str:
    count = len(errors.error_N)
    words = (
        f"{errors.inside(1.0)} of {count} errors are within one stated standard error and {errors.inside(1.96)}"
        f" within 1.96; if the stated errors are right, {number(0.6827 * count, 2)} and {number(0.95 * count, 2)}"
        " are expected"
    )
    slack = np.sqrt(0.6827 * 0.3173 * count)
    return f"{words} (chance alone changes the first by ± {number(slack, 1)})."


def _map(run: RunObservation, force: RunForce, learned: LearnedForce) -> Figure:
    low_x, high_x, low_y, high_y = run.record.sensor_type.outline.extent_mm
    x, y = np.linspace(low_x, high_x, _ACROSS), np.linspace(low_y, high_y, _ACROSS)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    mean, variance = learned.response.predict(grid)
    response, stderr = (values.reshape(_ACROSS, _ACROSS) for values in (np.exp(mean), 100 * np.sqrt(variance)))
    fields = [
        SheetField("relative response S", "relative to the nominal material", x, y, response, 1.0, 0.15),
        SheetField("standard error of S", "%", x, y, stderr),
    ]
    used = np.array([not why for why in learned.refused])
    places = places_mm(force.used)
    return Figure(
        "Response of each place relative to the nominal material (left; brown less, blue more) and its standard error"
        " (right). White dots: loads that it was learned from; red crosses: refused loads. Dashed: the calibrated"
        " area, beyond which the map returns to its mean.",
        _map_words(run, force, learned),
        force_map_figure(
            fields,
            run.record.sensor_type,
            used_mm=places[used],
            refused_mm=places[~used],
            radius_mm=calibration_radius_mm(force),
        ),
    )


def _map_words(run: RunObservation, force: RunForce, learned: LearnedForce) -> str:
    quality = map_quality(learned, calibration_radius_mm(force))
    low, high = (number(float(end), 2) for end in (quality.response.min(), quality.response.max()))
    x_mm, y_mm = quality.least_sure_mm
    where = f"({x_mm:.0f}, {y_mm:.0f}) mm".replace("-", "−")
    return (
        f"In the calibrated area the response is {low if low == high else f'{low} to {high}'} times the material's"
        f" and varies by {number(100 * quality.spread, 2)} %. Its standard error is"
        f" {number(100 * quality.rms_error, 2)} % (root mean square; largest at {where}:"
        f" {number(100 * float(quality.stderr.max()), 2)} %). Single loads scatter about the map by"
        f" {number(100 * learned.model.scatter, 2)} % beyond their noise."
    )


def _scatter(force: RunForce, tests: Sequence[ForceTest]) -> list[Block]:
    shown = [test for test in force.tests if test.how == HELD_OUT] or list(force.tests)
    if not shown:
        return []
    sampled = {id(test) for test in (tests or shown)}
    panels = [_panel("place known", shown, sampled, errors_of(shown, known=True))]
    if any(test.found_N is not None for test in shown):
        panels.append(_panel("place estimated", shown, sampled, errors_of(shown, known=False)))
    faint = _panel("", shown, {id(test) for test in shown}, global_errors(shown))
    which = "held out" if shown[0].how == HELD_OUT else "of each trial in turn, left out"
    return [
        Figure(
            f"Estimated against measured force of {plural(len(shown), 'load')} {which}; bars: stated standard error."
            " Open: repeated presses of one place, which the values in the text leave out."
            " Below: errors, with bands of one and two stated standard errors; diamonds: with one response for the"
            " whole sheet, place known (triangles: beyond the edge). Red cross: not detected.",
            " ".join(_describe_tests(tests)),
            force_figure(panels, faint),
        )
    ]


def draw_known_places(run: RunObservation) -> Figure | None:
    """Draw estimated against measured force of the loads that a run's force was not learned from, places known."""
    force = run_force(run)
    shown = [test for test in force.tests if test.how == HELD_OUT]
    if force.learned is None or not shown:
        return None
    tests = tests_of(run, force, HELD_OUT)
    panel = _panel("", shown, {id(test) for test in tests}, errors_of(shown, known=True))
    return Figure(
        f"Estimated against measured force of {plural(len(shown), 'load')} that the force was not learned from, and"
        " the errors with bands of one and two stated standard errors.",
        " ".join(_describe_tests(tests)),
        force_overview_figure(panel),
    )


def _panel(title: str, tests: Sequence[ForceTest], sampled: set[int], errors: ForceErrors) -> ForcePanel:
    estimated = {id(test) for test in errors.tests}
    measured = _collect_forces(errors.tests)
    return ForcePanel(
        title,
        measured,
        measured + errors.error_N,
        errors.stderr_N,
        np.array([id(test) in sampled for test in errors.tests], dtype=bool),
        _collect_forces([test for test in tests if id(test) not in estimated]),
    )


def _collect_forces(tests: Sequence[ForceTest]) -> Array:
    return np.array([test.measured_N for test in tests], dtype=np.float64)


def _results(result: RunResult) -> list[Block]:
    """The measured numbers and their outcomes."""
    measured = {(m.name, m.qualifier): m for m in result.measurements if m.value is not None}
    names = ("force_error_sd", "force_error_bias", "force_coverage_68", "force_coverage_95")
    rows: list[list[str | Cell]] = []
    for qualifier, title in _KINDS:
        row = [measured.get((name, qualifier)) for name in names]
        if any(row):
            rows.append([title, *map(value_cell, row)])
    for after in ("", f", {TRIAL_LEFT_OUT}"):
        flat = measured.get(("force_error_global_sd", f"place known{after}"))
        if flat is not None:
            rows.append([f"one response for the whole sheet{after}", value_cell(flat), "–", "–", "–"])
    if not rows:
        return []
    columns = ("Loads not used", "Standard deviation σ_F [N]", "Bias [N]", "Within 68 % [%]", "Within 95 % [%]")
    caption = (
        "Errors of force. ± of a coverage: the scatter of correct intervals over this number of loads. A dash: too"
        " few loads."
    )
    return [text_table(caption, columns, rows, (1, 2, 3, 4))]


def _ratios(run: RunObservation, force: RunForce, learned: LearnedForce) -> Figure:
    used = np.isfinite(learned.ratio)
    loads = [load for load, yes in zip(force.used, used, strict=True) if yes]
    newtons = np.array([load.force_N or 0.0 for load in loads])
    mapped = np.exp(interpolate(learned.model, learned.model.log_response, places_mm(loads)))
    ratio, scatter = learned.ratio[used], learned.ratio_stderr[used] / mapped
    forces = np.linspace(0.97 * newtons.min(), 1.03 * newtons.max(), 40)
    stress, material = 1e3 * forces / run.record.indenter.area_mm2, run.record.material.against_stress
    nominal = material.slope.value * stress + material.intercept.value
    alpha, beta = learned.line.slope, learned.line.intercept
    line = (alpha.value * stress + beta.value) / nominal
    variance = ((alpha.stderr or 0.0) * stress) ** 2 + (beta.stderr or 0.0) ** 2
    variance += 2 * stress * (learned.line.covariance or 0.0)
    stderr = np.sqrt(np.maximum(variance, 0.0)) / np.abs(nominal)
    return Figure(
        "Change under the head relative to what the material's line predicts for its force. Diamonds: as measured."
        " Dots: divided by the map at their places, bars: noise of readings and load cell. Red: line of this sensor"
        " with its standard error. Right: residuals of single loads, after map and line.",
        _line_words(learned),
        ratio_figure(RatioPoints(newtons, ratio, ratio / mapped, scatter, forces, line, stderr)),
    )


def _line_words(learned: LearnedForce) -> str:
    beta = learned.line.intercept
    if not learned.fitted_intercept:
        return f"The intercept β_σ of the line is {number(beta.value, 2)}, {beta.source}."
    return f"The intercept β_σ of the line is ({parameter_text(beta, 1e3)}) × 10⁻³, {beta.source}."


def _describe_assumptions(learned: LearnedForce) -> str:
    alpha = learned.line.slope
    share, stderr = learned.model.residue_share, learned.model.residue_stderr
    return (
        f"Assumed: the slope α_σ = {number(alpha.value)} /kPa ({alpha.source}); the map absorbs its error."
        f" {_line_words(learned)} {with_uncertainty(share, stderr)} of the residue of earlier loads just before a"
        " press is assumed to remain in its steady frames. The model is for one known head, pressed flat and held."
        " The errors above include drift, temperature and hysteresis only as far as this run had them."
    )


def _list_caveats(
    run: RunObservation, force: RunForce, learned: LearnedForce, tests: Sequence[ForceTest]
) -> list[str]:
    """Caveats about the numbers."""
    words = []
    radius_mm = calibration_radius_mm(force)
    outside = sum(float(np.hypot(t.load.record.load.x_mm, t.load.record.load.y_mm)) > radius_mm for t in tests)
    if outside:
        words.append(
            f"{outside} of {plural(len(tests), 'held-out load')} lie beyond the calibrated {radius_mm:.0f} mm: there"
            " the force rests on the mean response. The errors above include these loads."
        )
    low, high = (stress * run.record.indenter.area_mm2 / 1e3 for stress in learned.model.stress_kPa)
    beside = sum(not low <= test.measured_N <= high for test in tests)
    if not learned.fitted_intercept:
        words.append(
            f"All loads of the calibration have the same force ({_format_range(low, high)}), so the line's intercept"
            f" is the material's, not this sensor's; {beside} of {plural(len(tests), 'held-out load')} have other"
            " forces. A calibrating phase with several strains would determine the intercept."
        )
    predicted = learned.predicted or (False,) * len(force.used)
    unsettled = sum(
        load.settled is False and not of_later for load, of_later in zip(force.used, predicted, strict=True)
    )
    if unsettled:
        words.append(
            f"{plural(unsettled, 'load')} of the calibration had not settled for 1.5 settling times: the remaining"
            " relaxation is in the error of loads that are held longer or shorter."
        )
    return words


def _refusal_blocks(force: RunForce, learned: LearnedForce) -> list[Block]:
    rows = []
    for load, why in zip(force.used, learned.refused, strict=True):
        if why:
            place = load.record.load
            place_words, newtons = place_text(place.x_mm, place.y_mm), number(load.force_N or 0.0, 2)
            rows.append([load.phase, place.label, place_words, f"{100 * place.strain:.3g}", newtons, why])
    if not rows:
        return []
    columns = ("Phase", "Load", "x, y [mm]", "Strain [%]", "Force [N]", "Why")
    return [text_table("Loads of the calibration that were not used.", columns, rows, (2, 3, 4))]
