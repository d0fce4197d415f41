"""Places of loads, places found, and their images."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle

from cbsr_qa.domain.geometry.footprints import Footprint
from cbsr_qa.domain.geometry.outlines import SheetOutline
from cbsr_qa.domain.imaging import Image, Region
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.draw.sheet import (
    Raster,
    add_scale,
    draw_circles,
    draw_heads,
    draw_outlines,
    draw_sheet,
    fit_sheet,
    head_path,
    reach,
    region_path,
    sheet_axes,
    sheet_patch,
)
from cbsr_qa.report.draw.style import (
    BLUE,
    CHANGE_MAP,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    WIDTH_IN,
    annotate,
    bare,
    canvas,
    change_norm,
    dots,
    draw_svg,
    name_rows,
    plot,
    spread_labels,
)

_GRID: Final = "#dcdcdc"
#: A limit beyond this many times the largest error is not drawn: the errors would all lie on the axis.
_MOST_EMPTY: Final = 4.0
#: Arrows are drawn this many times longer than the error, so that a typical one is about a third of the head.
_ARROW_SCALES: Final = (1, 2, 5, 10, 20, 50)


@dataclass(frozen=True, slots=True, eq=False)
class SeenLoad:
    """A press for figures.

    Parameters
    ----------
    label, title : short name; name with strain or trial.
    x_mm, y_mm, radius_mm, strain : place, radius and strain of the press; the radius of a head that is not round is
        that of its area.
    pressed : the head's outline there.
    image : un-subtracted.
    sensed : region of the main mask; None where nothing was seen.
    error_mm, overlap_percent : None where not measured.
    outcome, overlap_outcome : outcomes of the centre-of-mass error and of the overlap.
    error_limits_mm, overlap_limits_percent : bounds of their limits; none without a limit.
    group : heading it stands under, e.g. the phase.
    """

    label: str
    title: str
    x_mm: float
    y_mm: float
    radius_mm: float
    pressed: Footprint
    strain: float
    image: Image
    sensed: Region | None
    error_mm: float | None
    overlap_percent: float | None
    outcome: Outcome
    overlap_outcome: Outcome
    group: str
    error_limits_mm: tuple[float, ...] = ()
    overlap_limits_percent: tuple[float, ...] = ()


@draw_svg
def load_images_figure(loads: Sequence[SeenLoad], sensor: SensorType, *, columns: int = 6) -> Canvas:
    """Draw every load's image with the indenter over the outline of the sensed blob, by group."""
    rows, sheet = ceil(len(loads) / columns), sensor.outline
    low_x, high_x, low_y, high_y = sheet.extent_mm
    radius, middle = reach(sheet), ((low_x + high_x) / 2, (low_y + high_y) / 2)
    cell_x, cell_y = high_x - low_x + 0.12 * radius, high_y - low_y + 0.86 * radius
    scale_in = WIDTH_IN / (columns * cell_x)
    body_in = rows * cell_y * scale_in
    height_in = body_in + 0.62
    figure = canvas(height_in)
    axes = figure.add_axes((0, 0.62 / height_in, 1, body_in / height_in))
    bare(axes)
    raster = Raster(loads[0].image.mesh, sheet, 200)
    largest = max(float(np.abs(load.image.values).max()) for load in loads)
    group, heads = "", []
    for index, load in enumerate(loads):
        row, column = divmod(index, columns)
        centre = (column + 0.5) * cell_x, -(row + 0.5) * cell_y - 0.16 * radius
        shift = centre[0] - middle[0], centre[1] - middle[1]
        _draw_small(axes, load, raster, shift, largest)
        _write_small(axes, load, centre, (high_y - low_y) / 2, radius)
        draw_sheet(axes, sheet, shift)
        if load.group != group:
            place = shift[0] + low_x, shift[1] + high_y + 0.3 * radius
            axes.text(*place, load.group, fontsize=7, fontweight="bold")
            group = load.group
        heads.append(head_path(load.pressed, shift))
    draw_heads(axes, heads, color=VERMILION)
    axes.set_xlim(0, columns * cell_x)
    axes.set_ylim(-rows * cell_y, 0)
    whole_axes = figure.add_axes((0, 0, 1, 1))
    whole_axes.set_axis_off()
    label = "conductance change Δγ/γ₀ [%]"
    add_scale(figure, whole_axes, change_norm(100 * largest), CHANGE_MAP, label=label, place="bottom")
    return figure


@draw_svg
def location_map_figure(loads: Sequence[SeenLoad], sensor: SensorType) -> Canvas:
    """Draw the sheet with indenter (dashed), blob outlines, error arrows, and each location's metrics beside it.

    Trials of a location share a label. Arrows are lengthened by :func:`arrow_scale`.
    """
    figure = canvas(3.75)
    axes = sheet_axes(figure, (0.0, 0.01, 0.545, 0.98), sensor)
    _draw_places(axes, loads, arrow_scale(loads))
    firsts = {load.label: load for load in reversed(loads)}
    for label, load in firsts.items():
        above = load.y_mm + load.radius_mm + 0.03 * reach(sensor.outline)
        axes.text(load.x_mm, above, label, ha="center", va="bottom", fontsize=7, fontweight="bold", zorder=9)
    order = list(dict.fromkeys(load.label for load in loads))
    errors = plot(figure, (0.62, 0.115, 0.165, 0.8), "error E_CoM [mm]", grid="x")
    overlaps = plot(figure, (0.825, 0.115, 0.165, 0.8), "overlap A_OL [%]", grid="x")
    _draw_dots(errors, order, [(load.label, load.error_mm, load.outcome) for load in loads])
    _draw_dots(overlaps, order, [(load.label, load.overlap_percent, load.overlap_outcome) for load in loads])
    largest_mm = max((load.error_mm for load in loads if load.error_mm is not None), default=1.0)
    limits_mm = sorted({limit for load in loads for limit in load.error_limits_mm})
    near_mm = [limit for limit in limits_mm if limit <= _MOST_EMPTY * largest_mm]
    errors.set_xlim(0, 1.05 * max(largest_mm, *near_mm, 0.0) or 1.0)
    _draw_limits(errors, limits_mm)
    overlaps.set(xlim=(0, 104), xticks=[0, 50, 100])
    _draw_limits(overlaps, sorted({limit for load in loads for limit in load.overlap_limits_percent}))
    overlaps.tick_params(labelleft=False)
    return figure


@draw_svg
def random_loads_figure(loads: Sequence[SeenLoad], sensor: SensorType) -> Canvas:
    """Draw random loads on a polar plot, discs growing with strain, and the error against strain beside it (Fig 11).

    Places are true to scale, on lines of x and y where the sheet is no disc; crosses mark where the load was seen.
    """
    figure = canvas(3.6)
    axes = figure.add_axes((0.0, 0.02, 0.54, 0.96))
    _draw_polar(axes, loads, sensor)
    side = plot(figure, (0.66, 0.14, 0.31, 0.74), "error E_CoM [mm]", x="compressive strain [%]")
    for load in loads:
        strain_and_error = (100 * load.strain, load.error_mm or 0.0)
        if load.error_mm is None:
            side.plot(*strain_and_error, marker="x", color=VERMILION, clip_on=False, zorder=4)
        else:
            dots(side, *strain_and_error, BLUE)
            annotate(side, load.label, strain_and_error, (3.5, 2.5), QUIET, fontsize=6.5)
    largest_mm = max([load.error_mm for load in loads if load.error_mm is not None], default=0.0)
    side.set_xlim(0, max(32.0, 105 * max(load.strain for load in loads)))
    side.set_ylim(0, 1.2 * largest_mm or 1.0)
    return figure


def arrow_scale(loads: Sequence[SeenLoad]) -> int:
    """Return by how much error arrows are lengthened: a typical one then spans about a third of the head."""
    errors = [load.error_mm for load in loads if load.error_mm]
    if not errors:
        return 1
    wanted_scale = 0.7 * loads[0].radius_mm / float(np.median(errors))
    return max((scale for scale in _ARROW_SCALES if scale <= wanted_scale), default=1)


def _draw_small(axes: Axes, load: SeenLoad, raster: Raster, shift: tuple[float, float], largest: float) -> None:
    left, right, bottom, top = raster.extent
    extent = (left + shift[0], right + shift[0], bottom + shift[1], top + shift[1])
    picture, norm = raster.picture(load.image.values), change_norm(largest)
    axes.imshow(picture, origin="lower", extent=extent, cmap=CHANGE_MAP, norm=norm)
    if load.sensed is not None:
        draw_outlines(axes, [region_path(load.sensed, shift)], width=0.9)


def _write_small(axes: Axes, load: SeenLoad, centre: tuple[float, float], half: float, radius: float) -> None:
    """Write the title above a small picture of this half height, and the findings below it."""
    x, y = centre
    axes.text(x, y + half + 0.03 * radius, load.title, ha="center", va="bottom", fontsize=6.5)
    note = "not detected" if load.error_mm is None else f"error {load.error_mm:.1f} mm"
    colour = VERMILION if load.error_mm is None or load.outcome is Outcome.FAIL else QUIET
    axes.text(x, y - half - 0.04 * radius, note, ha="center", va="top", fontsize=6.5, color=colour)


def _draw_places(axes: Axes, loads: Sequence[SeenLoad], scale: int) -> None:
    heads = {(load.x_mm, load.y_mm): head_path(load.pressed) for load in loads}
    draw_heads(axes, list(heads.values()), color=QUIET, dashed=True)
    loads_and_regions = [(load, load.sensed) for load in loads if load.sensed is not None]
    draw_outlines(axes, [region_path(region) for _, region in loads_and_regions], color=BLUE, face="#0072b218")
    if loads_and_regions:
        start = np.array([load.pressed.centre_mm for load, _ in loads_and_regions])
        error = np.array([region.centre_mm() for _, region in loads_and_regions]) - start
        shape: dict[str, Any] = {
            "width": 0.005,
            "headwidth": 4,
            "headlength": 4.5,
            "headaxislength": 4,
            "minlength": 0.1,
        }
        units: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1}
        axes.quiver(*start.T, *(scale * error).T, color=INK, zorder=8, **units, **shape)
    for load in loads:
        if load.sensed is None:
            axes.plot([load.x_mm], [load.y_mm], marker="x", color=VERMILION, markersize=8, zorder=8)


def _draw_dots(axes: Axes, order: list[str], values: list[tuple[str, float | None, Outcome]]) -> None:
    rank = {label: place for place, label in enumerate(order)}
    for label, value, outcome in values:
        if value is None:
            axes.plot([0], [rank[label]], marker="x", color=VERMILION, clip_on=False, zorder=4)
            continue
        failed = outcome in (Outcome.FAIL, Outcome.NOT_MEASURED)
        dots(axes, value, rank[label], VERMILION if failed else BLUE, fmt="D" if failed else "o", clip_on=False)
    for label in order:
        label_values = [value for name, value, _ in values if name == label and value is not None]
        if len(label_values) > 1:
            axes.plot([min(label_values), max(label_values)], [rank[label]] * 2, color=FAINT, linewidth=1.4, zorder=2)
    name_rows(axes, order)


def _draw_limits(axes: Axes, limits: Sequence[float]) -> None:
    """Draw limits as dashed lines with their values below the axis; those beyond the values are written only."""
    largest = axes.get_xlim()[1]
    shown = [limit for limit in limits if 0 <= limit <= largest]
    free = [x for x in axes.get_xticks() if 0 <= x <= largest and all(abs(x - y) > 0.12 * largest for y in shown)]
    axes.set_xticks(free)
    for limit in shown:
        axes.axvline(limit, color=INK, linewidth=0.9, linestyle=(0, (3, 2)), zorder=2)
    axes.set_xticks(shown, [f"{limit:g}" for limit in shown], minor=True, fontweight="bold")
    beyond = [f"{limit:g}" for limit in limits if limit > largest]
    if beyond:
        axes.set_xlabel(f"limit {' and '.join(beyond)}, not shown", fontsize=6.5)


def _draw_polar(axes: Axes, loads: Sequence[SeenLoad], sensor: SensorType) -> None:
    bare(axes)
    draw_sheet(axes, sensor.outline, filled=True)
    if sensor.polygon is None:
        _draw_rays(axes, sensor.radius_mm)
    else:
        _draw_grid(axes, sensor.outline)
    strongest = max(load.strain for load in loads)
    for load in loads:
        size = load.radius_mm * max(load.strain / strongest, 0.05)
        place = (load.x_mm, load.y_mm)
        axes.add_patch(Circle(place, size, facecolor="#56b4e966", edgecolor=BLUE, linewidth=0.8, zorder=4))
        if load.sensed is not None:
            x_mm, y_mm = load.sensed.centre_mm()
            axes.plot([load.x_mm, x_mm], [load.y_mm, y_mm], color=INK, linewidth=0.8, zorder=6)
            axes.plot([x_mm], [y_mm], marker="x", markersize=4.5, color=INK, markeredgewidth=1.1, zorder=7)
    _label_polar(axes, loads, reach(sensor.outline))
    fit_sheet(axes, sensor.outline)


def _draw_rays(axes: Axes, radius: float) -> None:
    step = 10.0 if radius <= 60 else 25.0
    for ring in np.arange(step, radius, step):
        draw_circles(axes, np.zeros((1, 2)), float(ring), color=_GRID, width=0.5)
        axes.text(0.6, ring + 0.6, f"{ring:g} mm" if ring + step >= radius else f"{ring:g}", fontsize=6, color=QUIET)
    for degrees in range(0, 360, 30):
        x, y = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        axes.plot([0, radius * x], [0, radius * y], color=_GRID, linewidth=0.5, zorder=1)
        axes.text(
            1.09 * radius * x, 1.09 * radius * y, f"{degrees}°", ha="center", va="center", fontsize=6.5, color=QUIET
        )


def _draw_grid(axes: Axes, sheet: SheetOutline) -> None:
    """Lines of x and y of any other sheet, cut at its edge."""
    low_x, high_x, low_y, high_y = sheet.extent_mm
    step, label_gap_mm = (10.0 if reach(sheet) <= 60 else 25.0), 0.05 * reach(sheet)
    edge = sheet_patch(sheet)
    edge.set(facecolor="none", edgecolor="none")
    axes.add_patch(edge)
    for x in np.arange(np.ceil(low_x / step), np.floor(high_x / step) + 1) * step:
        axes.plot([x, x], [low_y, high_y], color=_GRID, linewidth=0.5, zorder=1, clip_path=edge)
        axes.text(x, low_y - label_gap_mm, f"{x:g}", ha="center", va="top", fontsize=6, color=QUIET)
    for y in np.arange(np.ceil(low_y / step), np.floor(high_y / step) + 1) * step:
        axes.plot([low_x, high_x], [y, y], color=_GRID, linewidth=0.5, zorder=1, clip_path=edge)
        axes.text(low_x - label_gap_mm, y, f"{y:g}", ha="right", va="center", fontsize=6, color=QUIET)


def _label_polar(axes: Axes, loads: Sequence[SeenLoad], radius: float) -> None:
    for side in (-1, 1):
        members = [load for load in loads if (load.x_mm < 0) == (side < 0)]
        heights = spread_labels([load.y_mm for load in members], 0.085 * radius)
        for load, height in zip(members, heights, strict=True):
            place = load.x_mm + side * 1.05 * load.radius_mm
            text = axes.text(place, height, load.label, va="center", fontsize=7, fontweight="bold", zorder=9)
            text.set_horizontalalignment("left" if side > 0 else "right")
