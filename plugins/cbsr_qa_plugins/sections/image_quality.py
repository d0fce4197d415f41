"""Figures of merit of images, sizes from areas of regions, and the regularisation parameter."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.sizes import FLAT, SizeResponse
from cbsr_qa.plugin import (
    Block,
    Figure,
    LinearReconstruction,
    LoadObservation,
    Measurement,
    Paragraph,
    ParameterChoice,
    ParameterCurve,
    Role,
    RunObservation,
    RunResult,
    Table,
)
from cbsr_qa.report.draw.metrics import SizeSeries, size_figure
from cbsr_qa.report.draw.parameter import ParameterMark, parameter_figure, value_text
from cbsr_qa.report.section import ObservedSection
from cbsr_qa.report.select import Measured, group_by_label, loads_of, spread_text
from cbsr_qa.report.tables import capital, format_or_dash, number, plural, sign_of_bound, text_table
from cbsr_qa_plugins.metrics.images import describe_separation

#: Measurement, column.
_COLUMNS: Final = (
    ("amplitude_response", "AR"),
    ("position_error", "PE [mm]"),
    ("resolution", "RES"),
    ("shape_deformation", "Deformation"),
    ("ringing", "RNG"),
    ("false_regions", "False regions"),
)


class ImageQuality(ObservedSection):
    """Section of GREIT's figures of merit and other values that do not depend on a mask."""

    title = "Image quality"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return what is seen apart and what was missed in words, then the figures of merit by location."""
        yield from (Paragraph(words) for words in _describe_resolution(result.measurements, run) if words)
        loads = loads_of(run, Role.GRID) or run.loads
        measured = Measured(result.measurements)
        if any(measured.values(name, loads) for name, _ in _COLUMNS):
            yield _table(loads, measured)


def _describe_resolution(measurements: Sequence[Measurement], run: RunObservation) -> tuple[str, str]:
    apart = [m for m in measurements if m.name == "two_touch_resolution" and m.value is not None]
    ways = [
        f"{sign_of_bound([m])}{number(m.value or 0.0, 3)} mm ({describe_separation(m.qualifier, run)})" for m in apart
    ]
    two = f"Two equal loads show as two regions from a distance of {' or '.join(ways)};"
    two += " linearised model, without noise."
    counts = {m.name: m.value for m in measurements if m.name in ("missed_loads", "merged_loads") and m.value}
    fates = " and ".join(f"{plural(int(count), 'load')} {name.partition('_')[0]}" for name, count in counts.items())
    return two if ways else "", f"At the main mask {fates}." if fates else ""


def _table(loads: Sequence[LoadObservation], measured: Measured) -> Table:
    rows = [
        [label, *(spread_text(measured.values(name, members)) for name, _ in _COLUMNS)]
        for label, members in group_by_label(loads).items()
    ]
    caption = (
        "Figures of merit of Adler et al. 2009. AR: integral of the image over head area × change expected by the"
        " material file. PE: distance by which the image is too near to the centre. RES: √(area above a quarter of"
        " the maximum over area of the sheet). Deformation: share of that area outside a circle of equal area."
        " RNG: integral of the opposite sign outside the circle over the integral inside. False regions: at the"
        " main mask, without a load."
    )
    columns = ["Location", *(title for _, title in _COLUMNS)]
    return text_table(caption, columns, rows, tuple(range(1, len(columns))))


class SizeResponses(ObservedSection):
    """Section of the size response, if the recipe measures it."""

    title = "Size response"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return the answer in words, a figure where any size was seen, and the table."""
        responses = _collect_responses(result.measurements)
        if not responses:
            return
        words = describe_sizes(responses)
        yield Paragraph(words, "note" if any(response.flat for response in responses) else "plain")
        series: list[SizeSeries] = []
        for response in responses:
            if response.slope is not None:
                sizes = zip(response.diameters_mm, response.areas_mm2, strict=True)
                targets, areas = zip(*((size, area) for size, area in sizes if area is not None), strict=True)
                diameters = tuple(float(2 * np.sqrt(area / np.pi)) for area in areas)
                series.append(SizeSeries(response.place, targets, diameters))
        if series:
            caption = (
                f"Diameter of a circle with the region's area (mask {100 * run.main_mask:g} %) against the diameter"
                " of the target, without noise. Dashed: regions as large as their targets."
            )
            yield Figure(caption, words, size_figure(series, run.record.indenter.diameter_mm))
        yield _table_size_response(responses)


def _table_size_response(responses: Sequence[SizeResponse]) -> Table:
    columns = ("Place", *(f"{diameter:.3g} mm" for diameter in responses[0].diameters_mm), "Slope")
    rows = [
        [
            response.place,
            *(format_or_dash(area, number) for area in response.areas_mm2),
            format_or_dash(response.slope, lambda slope: number(slope, 2)),
        ]
        for response in responses
    ]
    caption = (
        "Area of the region [mm²] for round targets of these diameters. Slope: log area of the region against log"
        f" area of the target; 1 is proportional, below {FLAT:g} is flat."
    )
    return text_table(caption, columns, rows, tuple(range(1, len(columns))))


def describe_sizes(responses: Sequence[SizeResponse]) -> str:
    """Describe the quality of an overlap."""
    seen = [response for response in responses if response.slope is not None]
    if not seen:
        return "No target, of any size, gives a region in the images of this reconstruction."
    flattest = min(seen, key=lambda response: response.slope or 0.0)
    first, last = flattest.diameters_mm[0], flattest.diameters_mm[-1]
    areas = [area for area in flattest.areas_mm2 if area is not None]
    expected, got = (last / first) ** 2, areas[-1] / areas[0]
    words = (
        f"From {first:.3g} to {last:.3g} mm the area of a load grows {number(expected, 2)} times, that of its region"
        f" ({flattest.place}) {number(got, 2)} times."
    )
    if any(response.flat for response in seen):
        return (
            f"{words} The response is flat: loads of every size give nearly the same region, so neither its area"
            " nor an overlap near 100 % shows how large a load is. The load estimate measures sizes."
        )
    return f"{words} Regions follow the size of the loads."


def _collect_responses(measurements: Sequence[Measurement]) -> list[SizeResponse]:
    """Collect the measurements place by place."""
    areas: dict[str, list[tuple[float, float | None]]] = {}
    for m in measurements:
        target = m.dimensions
        if m.name == "region_area" and target.target_mm is not None:
            areas.setdefault(target.words, []).append((target.target_mm, m.value))
    return [
        SizeResponse(place, tuple(diameter for diameter, _ in seen), tuple(area for _, area in seen))
        for place, seen in areas.items()
    ]


_TITLES: Final = {
    "noise-figure": "noise figure",
    "gcv": "cross-validation",
    "l-curve": "L-curve",
    "discrepancy": "discrepancy",
}
_APART: Final = 0.005  # noise figures of a sensor and of its type that differ less are shown as one


class RegularisationParameter(ObservedSection):
    """Section of the regularisation parameter and the values it was chosen from."""

    title = "Regularisation"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return the choice in words; figure and table if there is a curve."""
        choice = run.reconstruction.choice
        yield Paragraph(_describe_choice(run.reconstruction))
        if choice.curve is not None:
            marks = _marks(choice, choice.curve)
            yield from (_figure(choice, choice.curve, marks), _table_regularisation(choice, choice.curve, marks))


def _describe_choice(made: LinearReconstruction) -> str:
    choice, curve = made.choice, made.choice.curve
    figure = f"Its matrix has noise figure {number(choice.noise_figure)}."
    if choice.criterion == "none":
        return f"{made.method} has no regularisation parameter: {choice.how}. {figure}"
    discrete = curve is not None and curve.discrete
    value = f"{made.method} images with {choice.name} = {value_text(choice.value, discrete=discrete)}"
    if curve is None:
        note = "" if choice.criterion == "given" else " The method keeps no curve of its search."
        return f"{value}: {choice.how}.{note} {figure}"
    return f"{value}, chosen by {choice.how}.{_own_figure(made, curve)}"


def _own_figure(made: LinearReconstruction, curve: ParameterCurve) -> str:
    """State the noise figure of this sensor's matrix if it differs from that of the curve."""
    figure, of_type = made.choice.noise_figure, curve.noise_figure_at(made.choice.value)
    if of_type is not None and abs(figure / of_type - 1) <= _APART:
        return ""
    weights = "" if made.problem.noise_variance is None else " weighted by their noise"
    readings = f"{len(made.problem.reference)} readings{weights}"
    return f" The matrix of this sensor, from {readings}, has noise figure {number(figure)}."


def _marks(choice: ParameterChoice, curve: ParameterCurve) -> list[ParameterMark]:
    marks = []
    for answer in curve.answers:
        chosen = answer.criterion == choice.criterion
        # A sensor with readings left out may have to keep another number of components than its type.
        value = choice.value if chosen else answer.value
        figure = None if value is None else curve.noise_figure_at(value)
        figure = choice.noise_figure if chosen and figure is None else figure
        marks.append(ParameterMark(_TITLES.get(answer.criterion, answer.criterion), value, figure, chosen))
    return marks


def _figure(choice: ParameterChoice, curve: ParameterCurve, marks: list[ParameterMark]) -> Figure:
    smoother = "Fewer components smooth more" if curve.discrete else "Larger values smooth more"
    target = "" if curve.target is None else f" Dashed: noise figure {curve.target:g}, the target."
    others = " Open marks: choices of other criteria." if len(marks) > 1 else ""
    caption = (
        f"Noise figure (Adler et al. 2009) against {choice.name}. {smoother}: less noise, but loads near each other"
        f" merge. Filled mark and line: chosen.{others}{target}"
    )
    words = [
        f"{mark.title} {'chose' if mark.chosen else 'would take'} {value_text(mark.value, discrete=curve.discrete)}"
        for mark in marks
        if mark.value is not None
    ]
    alternative = f"Noise figure over {choice.name}: {', '.join(words)}."
    return Figure(caption, alternative, parameter_figure(curve, marks, choice.name))


def _table_regularisation(choice: ParameterChoice, curve: ParameterCurve, marks: list[ParameterMark]) -> Table:
    rows = [
        [
            f"{mark.title} (chosen)" if mark.chosen else mark.title,
            format_or_dash(mark.value, partial(value_text, discrete=curve.discrete)),
            format_or_dash(mark.noise_figure, number),
            answer.words,
        ]
        for mark, answer in zip(marks, curve.answers, strict=True)
    ]
    name = capital(choice.name) if len(choice.name) > 1 else choice.name
    caption = "Choice of each criterion, its noise figure, and the data it uses."
    return text_table(caption, ("Criterion", name, "Noise figure", "Uses"), rows, (1, 2))
