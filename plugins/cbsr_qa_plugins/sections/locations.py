"""The grid of locations: where each load was seen, and the percentage masks side by side."""

from collections.abc import Iterator, Sequence
from statistics import fmean

from cbsr_qa.eit.imaging.shape import overlap_grade
from cbsr_qa.plugin import (
    Block,
    Cell,
    Figure,
    LoadObservation,
    MetricTimeline,
    Paragraph,
    Role,
    RunObservation,
    RunResult,
    Table,
    worst,
)
from cbsr_qa.report.draw.loads import arrow_scale, location_map_figure
from cbsr_qa.report.draw.metrics import mask_timeline_figure
from cbsr_qa.report.section import ObservedSection
from cbsr_qa.report.select import (
    SPATIAL,
    Measured,
    group_by_label,
    join_loads,
    list_holds,
    loads_of,
    spatial_spreads,
    spread_text,
)
from cbsr_qa.report.tables import number, place_text, plural, text_table, unit_column, value_cell, with_uncertainty

#: Standard errors above which a shift, a rotation or a scale of all locations is more than scatter. Without any, one
#: of the three exceeds this in 5 % of runs of nine presses.
_CLEAR = 3.0


class NineLocations(ObservedSection):
    """Section of the loads of phases that press a grid of places."""

    title = "Locations"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return what all locations share, then a map and tables for each phase."""
        loads = loads_of(run, Role.GRID)
        if not loads:
            return
        measured = Measured(result.measurements)
        presses = plural(len(loads), "press", "presses")
        yield Paragraph(
            f"{presses} at {plural(len(group_by_label(loads)), 'location')}; {_describe_errors(loads, measured)}"
        )
        yield from _registration(result, measured.values("registered_centre_of_mass_error", loads))
        phases = list(dict.fromkeys(load.phase for load in loads))
        for phase in phases:
            members = [load for load in loads if load.phase == phase]
            yield _figure(members, run, measured, f"Phase {phase}. " if len(phases) > 1 else "")
            yield from (*_strain_table(members, measured), _table(members, run, result, measured))


def _figure(loads: Sequence[LoadObservation], run: RunObservation, measured: Measured, phase: str) -> Figure:
    seen = join_loads(loads, run, measured)
    scale = arrow_scale(seen)
    cross = "was not detected" if _has_places(loads, measured) else "was not measured"
    longer = f"drawn {scale} times longer" if scale > 1 else "drawn to scale"
    return Figure(
        f"{phase}Where the loads were and where they were seen (mask {100 * run.main_mask:g} %). Dashed: the"
        " indenter. Blue: outline of the sensed blob. Arrows: from the indenter's centre to the blob's centre of"
        f" mass, {longer}. Right: every press; dashed lines are limits, a diamond is"
        f" outside, a cross {cross}.",
        _describe_errors(loads, measured),
        location_map_figure(seen, run.record.sensor_type),
    )


def _strain_table(loads: Sequence[LoadObservation], measured: Measured) -> list[Block]:
    """One row per strain over all locations; nothing with one strain."""
    strains = sorted({round(load.record.load.strain, 9) for load in loads})
    if len(strains) < 2:
        return []
    rows: list[list[str]] = []
    for strain in strains:
        members = [load for load in loads if round(load.record.load.strain, 9) == strain]
        *spreads, seen = spatial_spreads(measured, members)
        rows.append([f"{100 * strain:g}", *spreads, _force(members), seen])
    columns = ("Strain [%]", *(unit_column(name, unit) for _, name, unit in SPATIAL), "Force [N]", "Loads seen")
    caption = "Each strain: mean ± standard deviation over all locations and trials."
    return [text_table(caption, columns, rows, tuple(range(len(columns))))]


def _has_places(loads: Sequence[LoadObservation], measured: Measured) -> bool:
    """Whether the recipe locates presses; one that was not seen then has a reason."""
    return any(measured.find("centre_of_mass_error", load) is not None for load in loads)


def _describe_errors(loads: Sequence[LoadObservation], measured: Measured) -> str:
    errors = measured.values("centre_of_mass_error", loads)
    if not _has_places(loads, measured):
        return "the recipe does not measure how far from the presses they are seen."
    if not errors:
        return "none of the presses was seen in the image."
    largest = max(errors)
    lost = len(loads) - len(errors)
    unseen = "" if not lost else f" {plural(lost, 'press was', 'presses were')} not detected."
    return f"mean error {number(fmean(errors), 2)} mm, largest {number(largest, 2)} mm.{unseen}"


def _registration(result: RunResult, left_mm: Sequence[float]) -> tuple[Paragraph, ...]:
    """Offset shared by all places, and the residual; nothing if not measured."""
    whole = {m.name: m for m in result.measurements if m.name.startswith("registration_")}
    shift, rotation, scale = (whole.get(f"registration_{part}") for part in ("shift", "rotation", "scale"))
    if shift is None or rotation is None or scale is None or not left_mm:
        return ()
    if shift.value is None or rotation.value is None or scale.value is None:
        return ()
    moved = (
        f"shifted by {with_uncertainty(shift.value, shift.uncertainty)} mm, rotated by"
        f" {with_uncertainty(rotation.value, rotation.uncertainty)}° and scaled by"
        f" {with_uncertainty(scale.value, scale.uncertainty)}"
    )
    parts = ((shift, 0.0), (rotation, 0.0), (scale, 1.0))
    clear = any(abs((m.value or 0.0) - none) > _CLEAR * (m.uncertainty or 0.0) for m, none in parts)
    whose = "a systematic error of the station" if clear else "no more than random scatter explains"
    left = f"mean error {number(fmean(left_mm), 2)} mm, largest {number(max(left_mm), 2)} mm"
    return (Paragraph(f"The images show all locations together {moved}: {whose}. Corrected for that: {left}."),)


def _table(loads: Sequence[LoadObservation], run: RunObservation, result: RunResult, measured: Measured) -> Table:
    baseline = {b.location: b for b in result.calibration.baseline} if result.calibration else {}
    places = group_by_label(loads)
    several = any(len(members) > 1 for members in places.values())
    columns = ["Location", "x, y [mm]", *(["Presses"] if several else []), "E_CoM [mm]", "A_OL [%]", "Band"]
    columns += ["Shape deviation [mm²]", "Force [N]", *(["ρ̄₀"] if baseline else [])]
    rows = []
    for label, members in places.items():
        place, known = members[0].record.load, baseline.get(label)
        error, overlap, deviation = (_cell(name, members, measured) for name, _, _ in SPATIAL)
        row: list[str | Cell] = [label, place_text(place.x_mm, place.y_mm), *([str(len(members))] if several else [])]
        row += [error, overlap, _bands(members, run, measured), deviation, _force(members)]
        if baseline:
            row.append("–" if known is None or known.value is None else with_uncertainty(known.value, known.stderr))
        rows.append(row)
    caption = (
        "Each location: error of the centre of mass (E_CoM), mutual overlap (A_OL) with its band, shape deviation of"
        " the outline, force. Over several presses: mean ± standard deviation."
    )
    numeric = [k for k, column in enumerate(columns) if column not in ("Location", "Band")]
    return text_table(caption, columns, rows, numeric)


def _cell(name: str, members: Sequence[LoadObservation], measured: Measured) -> Cell:
    if len(members) == 1:
        return value_cell(measured.find(name, members[0]))
    measurements = [measured.find(name, load) for load in members]
    outcomes = [m.outcome for m in measurements if m is not None and m.limit is not None]
    return Cell(spread_text(measured.values(name, members)), worst(outcomes) if outcomes else None)


def _bands(members: Sequence[LoadObservation], run: RunObservation, measured: Measured) -> str:
    """Return the bands of the loads' overlaps, with counts if they differ."""
    bands, sizes = run.settings.overlap_bands, run.settings.size_ratio
    names = []
    for load in members:
        overlap, view = measured.find("area_overlap", load), load.mask(run.main_mask)
        if overlap is not None and overlap.value is not None and view is not None and view.region is not None:
            ratio = view.region.area_mm2 / load.indenter.area_mm2
            names.append(overlap_grade(overlap.value, ratio, bands=bands, size_ratio=sizes))
    counts = {name: names.count(name) for name in dict.fromkeys(names)}
    if len(counts) == 1:
        return next(iter(counts))
    return ", ".join(f"{count} × {name}" for name, count in counts.items()) or "–"


def _force(members: Sequence[LoadObservation]) -> str:
    forces = [load.force_N for load in members if load.force_N is not None]
    if len(forces) == 1 and len(members) == 1:
        return with_uncertainty(forces[0], members[0].force_stderr_N)
    return spread_text(forces)


class MaskComparison(ObservedSection):
    """Section that compares the masks on the grid of locations (paper: Table 3, Figs 10 and E.23)."""

    title = "Masks compared"

    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterator[Block]:
        """Return the table and a figure for each grid; nothing where no grid was pressed or one mask was used."""
        if len(run.settings.masks) > 1 and loads_of(run, Role.GRID):
            yield _table_mask_comparison(result, run)
            yield from (_figure_mask_comparison(timeline, run) for timeline in run.timelines)


def _table_mask_comparison(result: RunResult, run: RunObservation) -> Table:
    loads, measured = loads_of(run, Role.GRID), Measured(result.measurements)
    rows = []
    for fraction in run.settings.masks:
        qualifier = run.mask_qualifier(fraction)
        decides = "" if qualifier else " (decides)"
        rows.append([f"{100 * fraction:g} %{decides}", *spatial_spreads(measured, loads, qualifier)])
    columns = ["Mask", *(unit_column(name, unit) for _, name, unit in SPATIAL), "Loads seen"]
    caption = (
        "Mean ± standard deviation over all locations and trials of the steady images, for each percentage mask."
    )
    return text_table(caption, columns, rows, (1, 2, 3, 4))


def _figure_mask_comparison(timeline: MetricTimeline, run: RunObservation) -> Figure:
    behind = " The force is drawn behind in light orange." if timeline.force is not None else ""
    return Figure(
        f"Phase {timeline.phase}: spatial metrics of every frame taken while a load was held, for each mask.{behind}"
        " A line that is missing for a hold means that no blob was seen.",
        f"Three panels against time, one line for each of {len(timeline.masks)} masks.",
        mask_timeline_figure(timeline, list_holds(run, timeline.phase)),
    )
