"""Figures of groups compared: distributions by group and station, and differences by place on the sheet."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle

from cbsr_qa.domain.numbers import Array
from cbsr_qa.report.draw.style import (
    CHANGE_MAP,
    CYCLE,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    bare,
    canvas,
    change_norm,
    draw_svg,
    light_grid,
    name_rows,
)
from cbsr_qa.report.tables import number, unit_column
from cbsr_qa.stats.fitted_capability import FamilyFit
from cbsr_qa.stats.fitted_families import FAMILIES
from cbsr_qa.stats.percentile_capability import SHARES
from cbsr_qa.studies.compare.differences import PlaceDifference

#: Sensors of a row drawn as points; more are drawn as an outline of their distribution.
_MOST_POINTS: Final = 150
_BINS: Final = 40
_POINTS: Final = 300  #: of a density
_MARK_IN: Final = 0.34
#: Width of the names beside rows.
_MOST_LETTERS: Final = 18
#: Space to the left of the longest name.
_LEAST_LEFT_IN: Final = 0.05


@draw_svg
def strips(label: str, samples: Sequence[tuple[str, str, Array]], groups: Sequence[str]) -> Canvas:
    """Draw sensors by group and station in rows as ``<svg>``: the mean as a line, quartiles as a bar.

    Parameters
    ----------
    samples : group, station, and one value per sensor.
    groups : names of the groups; their order determines the colours.
    """
    height = 0.55 + _MARK_IN * len(samples)
    figure = canvas(height)
    axes = figure.add_axes((0.22, 0.42 / height, 0.75, 1 - 0.5 / height))
    light_grid(axes, "x")
    for row, (group, _, values) in enumerate(samples):
        colour = CYCLE[list(groups).index(group) % len(CYCLE)]
        _row(axes, row, values, colour)
    names = [f"{_shorten(group)}, {_shorten(station)}  ({len(values)})" for group, station, values in samples]
    name_rows(axes, names, most=len(names))  # the figure is as high as the rows need
    axes.set_xlabel(label)
    box = axes.yaxis.get_tightbbox(None)
    lacking = 0.0 if box is None else (_LEAST_LEFT_IN * figure.dpi - box.x0) / figure.bbox.width
    if lacking > 0:
        axes.set_position((0.22 + lacking, 0.42 / height, 0.75 - lacking, 1 - 0.5 / height))
    return figure


@draw_svg
def draw_fit_histogram(label: str, values: Array, fit: FamilyFit, lower: float | None, upper: float | None) -> Canvas:
    """Draw values (n,), the density of the distribution fitted to them, and the limits as ``<svg>``."""
    figure = canvas(2.2)
    axes = figure.add_axes((0.1, 0.2, 0.88, 0.75))
    light_grid(axes)
    axes.hist(values, min(_BINS, max(8, round(2 * len(values) ** (1 / 3)))), density=True, color=FAINT)
    family = FAMILIES[fit.family]
    parameters = np.array(list(fit.parameters.values()))[:, None]
    ends = [float(family.quantile(parameters, share)[0]) for share in (SHARES[0], SHARES[-1])]
    points = np.linspace(min(ends[0], values.min()), max(ends[1], values.max()), _POINTS)
    share_below = family.share_below(parameters, points[None])[0]
    axes.plot(0.5 * (points[1:] + points[:-1]), np.diff(share_below) / np.diff(points), color=INK, linewidth=1.2)
    for limit in (lower, upper):
        if limit is not None:
            axes.axvline(limit, color=VERMILION, linewidth=1.0, linestyle="--")
    axes.set_xlabel(label)
    axes.set_ylabel("density")
    return figure


@draw_svg
def difference_map(unit: str, places: Sequence[tuple[float, float, PlaceDifference]], level: float) -> Canvas:
    """Draw differences (x and y [mm] of each) on the sheet as ``<svg>``, ringed where p is below the level."""
    figure = canvas(2.9)
    axes = figure.add_axes((0.2, 0.02, 0.4, 0.96))
    norm = change_norm(max(abs(place.difference) for *_, place in places))
    reach = 1.35 * max(float(np.hypot(x, y)) for x, y, _ in places) or 1.0
    axes.add_patch(Circle((0, 0), reach, fill=False, edgecolor=QUIET, linewidth=0.6))
    for x, y, place in places:
        edge, width = (INK, 1.6) if place.p < level else (FAINT, 0.5)
        colour = CHANGE_MAP(norm(place.difference))
        axes.plot(x, y, "o", markersize=19, color=colour, markeredgecolor=edge, markeredgewidth=width)
        text = f"{place.location} {number(place.difference, 2)}"
        axes.text(x, y - 0.17 * reach, text, ha="center", va="center", fontsize=6, color=INK)
    bare(axes)
    axes.set_xlim(-1.05 * reach, 1.05 * reach)
    axes.set_ylim(-1.05 * reach, 1.05 * reach)
    bar = figure.colorbar(ScalarMappable(norm, CHANGE_MAP), cax=figure.add_axes((0.64, 0.15, 0.016, 0.7)))
    bar.set_label(unit_column("difference", unit))
    return figure


def _shorten(name: str) -> str:
    """Shorten a long name in the middle to fit beside a row."""
    if len(name) <= _MOST_LETTERS:
        return name
    letters = _MOST_LETTERS - 1
    return f"{name[: letters - letters // 3].rstrip()}…{name[len(name) - letters // 3 :].lstrip()}"


def _row(axes: Axes, row: int, values: Array, colour: str) -> None:
    if len(values) > _MOST_POINTS:
        counts, edges = np.histogram(values, _BINS)
        half_heights = 0.38 * counts / counts.max()
        axes.fill_between(
            0.5 * (edges[1:] + edges[:-1]),
            row - half_heights,
            row + half_heights,
            color=colour,
            alpha=0.35,
            linewidth=0,
        )
    else:
        # Spread evenly over the row in order of the values, so that equal data give equal pictures.
        offsets = 0.22 * np.sin(2.4 * np.arange(len(values)))
        axes.plot(np.sort(values), row + offsets, "o", color=colour, markersize=2.6, alpha=0.6, markeredgewidth=0)
    if len(values) == 1:  # a single sensor's bar would hide it
        return
    low, high = np.quantile(values, (0.25, 0.75))
    axes.plot((low, high), (row, row), color=INK, linewidth=2.2)
    axes.plot((values.mean(), values.mean()), (row - 0.3, row + 0.3), color=INK, linewidth=1.2)
