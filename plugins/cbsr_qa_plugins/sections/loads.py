"""Loads at a glance; their images, random loads, and loads estimated from their readings."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import atan2, degrees, hypot
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.estimates import EstimatedLoad, estimate_loads
from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import (
    Block,
    Cell,
    Figure,
    LoadEstimate,
    LoadFinding,
    LoadObservation,
    Paragraph,
    Role,
    RunObservation,
    RunResult,
    Table,
)
from cbsr_qa.report.draw.estimates import PlacedLoad, error_scale, estimates_figure
from cbsr_qa.report.draw.loads import arrow_scale, load_images_figure, location_map_figure, random_loads_figure
from cbsr_qa.report.section import ObservedSection
from cbsr_qa.report.select import Measured, join_loads, loads_of, spread_text
from cbsr_qa.report.tables import (
    format_or_dash,
    number,
    parameter_text,
    plural,
    text_table,
    value_cell,
    with_uncertainty,
)
from cbsr_qa_plugins.sections.force import draw_known_places

#: Images in the one row of the overview.
_AT_A_GLANCE: Final = 9
#: A longer table is folded.
_MAX_ROWS: Final = 60
_COLUMNS = (
    "Load", "Strain [%]", "Image [mm]", "Readings [mm]", "Contrast c [%]", "Radius [mm]", "A·c [mm²]", "d′",
)  # fmt: skip


class Overview(ObservedSection):
    """The second page of a run's report: places, images, and force against truth."""

    title = "What was measured"
    leaf = 2

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return the figures that the run's loads allow."""
        measured = Measured(result.measurements)
        loads = loads_of(run, Role.GRID) or tuple(run.loads)
        if not loads:
            return
        seen = join_loads(loads, run, measured)
        scale = arrow_scale(seen)
        errors_mm = [load.error_mm for load in seen if load.error_mm is not None]
        yield Figure(
            "Where the loads were (dashed) and where they were seen (blue); arrows are the errors"
            f"{f', {scale} times longer' if scale > 1 else ''}. Right: every press;"
            " dashed lines are limits, a diamond is outside.",
            f"{plural(len(seen), 'load')}; error {spread_text(errors_mm, 'mm')}.",
            location_map_figure(seen, run.record.sensor_type),
        )
        firsts = list({load.label: load for load in reversed(seen)}.values())[::-1][:_AT_A_GLANCE]
        yield Figure(
            f"Image of the first press at {plural(len(firsts), 'place')}, on one scale.",
            f"{plural(len(firsts), 'image')}.",
            load_images_figure(firsts, run.record.sensor_type, columns=_AT_A_GLANCE),
        )
        if (forces := draw_known_places(run)) is not None:
            yield forces


class LoadEstimates(ObservedSection):
    """Section of the load estimates with their 68 % regions, if the recipe measures them."""

    title = "Load estimates"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return the answer in words, a figure and a table; nothing where no load was estimated."""
        measured = Measured(result.measurements)
        loads = (*loads_of(run, Role.GRID), *loads_of(run, Role.RANDOM))
        loads = tuple(load for load in loads if measured.find("detectability", load) is not None)
        if not loads:
            return
        estimates = estimate_loads(run, run.settings.reference)
        pairs = [(load, estimates[(load.phase, load.record.index)]) for load in loads]
        placed = [_place_load(load, estimate, run) for load, estimate in pairs]
        words, scale = _describe_accuracy(pairs, placed), error_scale(placed)
        longer = f"drawn {scale} times longer" if scale > 1 else "drawn to scale"
        yield Paragraph(words)
        yield Figure(
            "Places of loads, estimated from their readings (dot with 68 % ellipse, radius of the indenter given) and"
            f" from their images (cross: centre of mass); errors and ellipses {longer}. Dashed: the indenter. Right:"
            " both errors; bar: one standard error; red tick: refused.",
            words,
            estimates_figure(placed, run.record.sensor_type),
        )
        yield _table(pairs, measured)


def _choose_estimate(estimate: EstimatedLoad) -> LoadEstimate | None:
    return estimate.indenter or estimate.size


def _place_load(load: LoadObservation, estimate: EstimatedLoad, run: RunObservation) -> PlacedLoad:
    view, chosen = load.mask(run.main_mask), _choose_estimate(estimate)
    region = None if view is None else view.region
    nominal = load.record.load
    place = None if chosen is None or chosen.place_mm is None else np.array(chosen.place_mm)
    return PlacedLoad(
        nominal.label,
        load.indenter.footprint_at(nominal.x_mm, nominal.y_mm),
        None if region is None else np.asarray(region.centre_mm()),
        place,
        None if chosen is None else chosen.place_covariance_mm2,
    )


def _describe_accuracy(pairs: Sequence[tuple[LoadObservation, EstimatedLoad]], placed: Sequence[PlacedLoad]) -> str:
    """Say how well the loads were located, and what was refused or contradicts the model."""
    chosen = [estimate for _, pair in pairs if (estimate := _choose_estimate(pair)) is not None]
    words = _errors_in_words(pairs, placed)
    if any(p.estimated_error is not None for p in placed):
        refused = Counter(estimate.finding for estimate in chosen)
        counts = {finding: refused[finding] for finding in LoadFinding if finding is not LoadFinding.LOCATED}
        words += "".join(f" {plural(count, 'load')} {finding}." for finding, count in counts.items() if count)
        wrong = [estimate.misfit for estimate in chosen if estimate.inflation > 1]
        if wrong:
            words += (
                f" In {plural(len(wrong), 'load')} the readings contradict a round load on an even sheet"
                f" (residuals up to {number(max(wrong), 2)} of the noise); their uncertainties are widened"
                " accordingly."
            )
    if chosen:
        explained = np.median([estimate.explained for estimate in chosen])
        words += f" A load on the modelled sheet explains {explained:.1%} of a signal (median)."
    return words


def _errors_in_words(pairs: Sequence[tuple[LoadObservation, EstimatedLoad]], placed: Sequence[PlacedLoad]) -> str:
    errors = [p.estimated_error for p in placed if p.estimated_error is not None]
    if not errors:
        why = next((e.why or (c.why if (c := _choose_estimate(e)) else "") for _, e in pairs), "")
        return f"None of {plural(len(pairs), 'load')} could be located from its readings: {why}."
    imaged = [p.imaged_error for p in placed if p.imaged_error is not None]
    words = f"{plural(len(errors), 'load')} located to {_rms_text(errors)} mm (root mean square)"
    words += f", from their images to {_rms_text(imaged)} mm" if imaged else ""
    return f"{words}; {sum(p.covered for p in placed)} of {len(errors)} are inside their 68 % ellipse."


def _rms_text(errors_mm: Sequence[Array]) -> str:
    return number(float(np.sqrt(np.mean(np.sum(np.square(errors_mm), axis=1)))), 2)


def _table(pairs: Sequence[tuple[LoadObservation, EstimatedLoad]], measured: Measured) -> Table:
    rows: list[list[str | Cell]] = []
    for load, estimate in pairs:
        chosen, size = _choose_estimate(estimate), estimate.size
        error = value_cell(measured.find("estimated_place_error", load))
        if chosen is None or chosen.finding is not LoadFinding.LOCATED:
            error = Cell(str(chosen.finding) if chosen else "not estimated")
        rows.append(
            [
                load.record.load.label,
                f"{100 * load.record.load.strain:.3g}",
                value_cell(measured.find("centre_of_mass_error", load)),
                error,
                parameter_text(None if chosen is None else chosen.contrast, 100),
                parameter_text(None if size is None else size.radius_mm),
                parameter_text(None if size is None else size.area_contrast_mm2),
                format_or_dash(chosen, lambda estimate: f"{estimate.detectability:.0f}"),
            ]
        )
    caption = (
        "Error of the place from the image (E_CoM) and from the readings, ± one standard error along an axis."
        " Contrast c: with the head's radius given; radius and area × contrast A·c: without it. A dash: the"
        " readings do not determine the radius. d′: detectability."
    )
    table = text_table(caption, _COLUMNS, rows, tuple(range(1, len(_COLUMNS))))
    return replace(table, folded=len(rows) > _MAX_ROWS)


#: More images than this are not printed; they are in the store.
_MAX_IMAGES: Final = 48


class LoadImages(ObservedSection):
    """Section of small images, one per press."""

    title = "Images"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return the images, and the number of presses without one."""
        if not run.loads:
            return
        # First trials come first if there are too many: they cover every place and strain.
        chosen = sorted(run.loads, key=lambda load: load.record.load.trial)[:_MAX_IMAGES]
        printed = [load for load in run.loads if any(load is chosen_load for chosen_load in chosen)]
        seen = join_loads(printed, run, Measured(result.measurements))
        lost = sum(load.error_mm is None for load in seen)
        conducts = "more" if run.response.value == "increase" else "less"
        words = f"Pressed places conduct {conducts} ({run.response_how})."
        omitted = len(run.loads) - len(printed)
        if omitted:
            words += f" {plural(omitted, 'press is', 'presses are')} not printed here; every frame is in the store."
        yield Paragraph(words)
        yield Figure(
            "Steady image of each press, as reconstructed (no noise floor subtracted), all on one scale. Orange: the"
            f" indenter. Black: outline of the sensed blob at the {100 * run.main_mask:g} % mask.",
            f"{plural(len(seen), 'image')}, {plural(lost, 'load')} not detected.",
            load_images_figure(seen, run.record.sensor_type),
        )


class RandomLoads(ObservedSection):
    """Section of random loads (paper: Fig 11, Table 5), if there are any."""

    title = "Random loads"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        loads = loads_of(run, Role.RANDOM)
        if not loads:
            return
        measured = Measured(result.measurements)
        seen = join_loads(loads, run, measured)
        mean = spread_text([load.error_mm for load in seen if load.error_mm is not None], "mm")
        yield Figure(
            "Random loads where they were pressed; discs grow with strain. Crosses: where the centre of mass was"
            " seen. Right: error against strain; a weak press is harder to place.",
            f"{len(seen)} random loads; error {mean} mm (mean ± standard deviation).",
            random_loads_figure(seen, run.record.sensor_type),
        )
        rows: list[list[str | Cell]] = []
        for load in loads:
            nominal = load.record.load
            polar = (
                f"{hypot(nominal.x_mm, nominal.y_mm):.1f}, {degrees(atan2(nominal.y_mm, nominal.x_mm)) % 360:.0f}°"
            )
            force = "–" if load.force_N is None else with_uncertainty(load.force_N, load.force_stderr_N)
            error = value_cell(measured.find("centre_of_mass_error", load))
            overlap = value_cell(measured.find("area_overlap", load))
            rows.append([nominal.label, polar, f"{100 * nominal.strain:.1f}", force, error, overlap])
        columns = ("Load", "r [mm], θ", "Strain [%]", "Force [N]", "E_CoM [mm]", "A_OL [%]")
        yield text_table(f"Random loads: error {mean} mm over all.", columns, rows, (1, 2, 3, 4, 5))
