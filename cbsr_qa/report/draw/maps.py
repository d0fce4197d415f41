"""Response of each place of the sheet: baseline conductance at loads, and the response map."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import BaselineConductance
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.draw.sheet import (
    add_scale,
    draw_circles,
    draw_electrodes,
    draw_sheet,
    fit_sheet,
    head_path,
    sheet_axes,
    sheet_patch,
)
from cbsr_qa.report.draw.style import (
    AMOUNT_MAP,
    BLUE,
    CHANGE_MAP,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    bare,
    canvas,
    dots,
    draw_svg,
    name_rows,
    plot,
)
from cbsr_qa.report.tables import with_uncertainty


@draw_svg
def baseline_figure(places: Sequence[BaselineConductance], sensor: SensorType, indenter: Indenter) -> Canvas:
    """Draw ρ̄₀ at its places on the sheet, and the same values with error bars around their mean."""
    figure = canvas(3.5)
    values = [place.value for place in places if place.value is not None]
    low, high = min(values), max(values)
    room = 0.25 * (high - low) or 0.1 * abs(high) or 1e-6
    norm = Normalize(low - room, high + room)
    axes = sheet_axes(figure, (0.0, 0.01, 0.5, 0.98), sensor)
    for place in places:
        _draw_head(
            axes, place, head_path(indenter.footprint_at(place.x_mm, place.y_mm)), norm, 0.02 * sensor.radius_mm
        )
    add_scale(figure, axes, norm, AMOUNT_MAP, label="ρ̄₀ [relative]", place="right")
    side = plot(figure, (0.685, 0.13, 0.3, 0.78), "ρ̄₀ ± its uncertainty; line: mean", grid="x")
    _draw_values(side, places, sum(values) / len(values))
    return figure


def _draw_head(axes: Axes, place: BaselineConductance, head: Path, norm: Normalize, gap_mm: float) -> None:
    """Fill the head's outline with the colour of its value; write its name and value."""
    face: str | tuple[float, float, float, float] = "white"
    edge, text, colour = VERMILION, "no value", INK
    if place.value is not None:
        shade = float(norm(place.value))
        face, edge, text = AMOUNT_MAP(shade), QUIET, with_uncertainty(place.value, place.stderr)
        colour = "white" if shade > 0.55 else INK
    axes.add_patch(PathPatch(head, facecolor=face, edgecolor=edge, linewidth=0.7, zorder=4))
    below = float(head.get_extents().ymin) - gap_mm
    axes.text(place.x_mm, below, text, ha="center", va="top", fontsize=6.5, zorder=6)
    name = axes.text(place.x_mm, place.y_mm, place.location, color=colour, zorder=6)
    name.set(ha="center", va="center", fontsize=7, fontweight="bold")


def _draw_values(axes: Axes, places: Sequence[BaselineConductance], mean: float) -> None:
    known_rows = [
        (row, place.value, place.stderr or 0.0) for row, place in enumerate(places) if place.value is not None
    ]
    rows, values, errors = zip(*known_rows, strict=True)
    dots(axes, values, rows, BLUE, size=3.5, xerr=errors)
    axes.axvline(mean, color=INK, linewidth=0.8)
    name_rows(axes, [place.location for place in places])


#: Steps of a scale: as many as a reader tells apart.
_STEPS: Final = 9


@dataclass(frozen=True, slots=True, eq=False)
class SheetField:
    """A quantity over the sheet, on a rectangular grid that covers it.

    Parameters
    ----------
    title, unit : texts over the map and at its scale.
    x_mm, y_mm, values : (n,), (m,) and (m, n).
    about : centre of a scale in two colours; None for one from zero up.
    least_reach : least reach of that scale to both sides, so that an even sheet is not drawn as an uneven one.
    """

    title: str
    unit: str
    x_mm: Array
    y_mm: Array
    values: Array
    about: float | None = None
    least_reach: float = 1e-3


@draw_svg
def force_map_figure(
    fields: Sequence[SheetField], sensor: SensorType, *, used_mm: Array, refused_mm: Array, radius_mm: float
) -> Canvas:
    """Draw fields beside each other in steps, each step's edge a line with its value.

    Parameters
    ----------
    fields : one or two.
    used_mm, refused_mm : (n, 2) places of the loads.
    radius_mm : radius of the calibrated area [mm], dashed.
    """
    figure = canvas(3.35)
    for number, field in enumerate(fields):
        axes = figure.add_axes((0.5 * number, 0.005, 0.42, 0.9))
        levels, colours = _scale(field, _inside(field, sensor))
        _draw_field(axes, field, sensor, levels, colours)
        draw_circles(axes, np.zeros((1, 2)), radius_mm, color=INK, width=0.7, dashed=True)
        axes.plot(*used_mm.T, "o", markersize=3.0, color="white", markeredgecolor=INK, markeredgewidth=0.7, zorder=7)
        axes.plot(*refused_mm.T, "x", markersize=4.5, color=VERMILION, markeredgewidth=1.2, zorder=8)
        fit_sheet(axes, sensor.outline)
        axes.set_title(field.title, fontweight="normal")
        _draw_scale(figure, axes, levels, colours, field.unit)
    return figure


def _inside(field: SheetField, sensor: SensorType) -> Array:
    """Values on the sheet: the scale covers them and nothing beyond."""
    x, y = np.meshgrid(field.x_mm, field.y_mm)
    on = sensor.outline.clearance_mm(np.column_stack([x.ravel(), y.ravel()])) >= 0
    finite_values: Array = field.values.ravel()[on & np.isfinite(field.values.ravel())]
    return finite_values if len(finite_values) else np.array([field.about or 0.0])


def _scale(field: SheetField, values: Array) -> tuple[Array, Colormap]:
    """Levels and one colour for each step between them; steps are round numbers."""
    if field.about is None:
        levels = round_levels(float(values.min()), float(values.max()))
        return levels, ListedColormap(AMOUNT_MAP(np.linspace(0.0, 0.85, len(levels) - 1)))
    reach = max(float(np.abs(values - field.about).max()), field.least_reach)
    steps = MaxNLocator(_STEPS, steps=[1, 2, 2.5, 5, 10])
    levels = np.asarray(steps.tick_values(field.about - reach, field.about + reach), dtype=np.float64)
    middle = (levels[:-1] + levels[1:]) / 2
    farthest = max(levels[-1] - field.about, field.about - levels[0])
    # Two thirds of the range: text and marks on it stay readable.
    return levels, ListedColormap(CHANGE_MAP(0.5 + 0.36 * (middle - field.about) / farthest))


def round_levels(least: float, most: float) -> Array:
    """Zero and the numbers 1, 2, 5 × 10ⁿ from below the least value to above the most, at most three decades.

    Errors vary by orders of magnitude: even steps would only resolve the sheet's rim.
    """
    most = max(most, 1e-9)
    least = max(least, most / 1e3)
    powers = range(int(np.floor(np.log10(least))) - 1, int(np.floor(np.log10(most))) + 2)
    series = np.array([step * 10.0**power for power in powers for step in (1.0, 2.0, 5.0)])
    first = int(np.searchsorted(series, least, side="right")) - 1
    last = int(np.searchsorted(series, most, side="left"))
    return np.concatenate([[0.0], series[first : last + 1]])


def _draw_field(axes: Axes, field: SheetField, sensor: SensorType, levels: Array, colours: Colormap) -> None:
    bare(axes)
    edge = sheet_patch(sensor.outline)
    axes.add_patch(edge)
    norm = BoundaryNorm(levels, colours.N)
    filled = axes.contourf(field.x_mm, field.y_mm, field.values, levels, cmap=colours, norm=norm, zorder=1)
    lines = axes.contour(
        field.x_mm, field.y_mm, field.values, levels, colors=QUIET, linewidths=0.5, linestyles="solid", zorder=2
    )
    for drawn_part in (filled, lines):
        drawn_part.set_clip_path(edge)
    for name in axes.clabel(lines, fontsize=6, inline=True, inline_spacing=2, fmt=_level_text):
        name.set_clip_path(edge)
        name.set_color(INK)
    draw_sheet(axes, sensor.outline)
    draw_electrodes(axes, sensor.electrodes, sensor.outline)


def _draw_scale(figure: Canvas, axes: Axes, levels: Array, colours: Colormap, label: str) -> None:
    box = axes.get_position()
    slot = figure.add_axes((box.x1 - 0.012, box.y0 + 0.15 * box.height, 0.013, 0.7 * box.height))
    steps = np.arange(len(levels) - 1)
    slot.imshow(steps[:, None], cmap=colours, aspect="auto", origin="lower", extent=(0, 1, 0, len(steps)),
                vmin=-0.5, vmax=len(steps) - 0.5)  # fmt: skip
    slot.set_xticks([])
    slot.yaxis.tick_right()
    slot.yaxis.set_label_position("right")
    every = max(len(levels) // 8, 1)
    slot.set_yticks(range(0, len(levels), every), [_level_text(level) for level in levels[::every]])
    slot.tick_params(length=2, color=FAINT)
    slot.set_ylabel(label)
    for side in slot.spines.values():
        side.set_visible(False)


def _level_text(level: float) -> str:
    return f"{level:.4g}".replace("-", "\N{MINUS SIGN}") if abs(level) > 1e-12 else "0"
