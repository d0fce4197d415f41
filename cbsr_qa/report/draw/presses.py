"""Presses of a sheet that were left out: errors of place, and coverage of their regions."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Canvas
from scipy.stats import binom

from cbsr_qa.domain.numbers import Array
from cbsr_qa.report.draw.sheet import add_scale
from cbsr_qa.report.draw.style import AMOUNT_MAP, BLUE, HAIR, INK, QUIET, bare, canvas, dots, draw_svg, note, plot

#: Share of what chance does inside the band.
_BAND: Final = 0.95


@draw_svg
def cross_validation_figure(
    places_mm: Array,
    found_mm: Array,
    levels: Array,
    held: Array,
    *,
    edge_mm: Array | None = None,
    numbers_mm: Array | None = None,
) -> Canvas:
    """Draw presses with the way to where they were found, and the share that regions hold against what they state.

    Parameters
    ----------
    places_mm, found_mm : (n, 2).
    levels, held : (k,) shares that regions state, and those found.
    edge_mm, numbers_mm : (·, 2) edge of the sheet, and places of electrode numbers; None if its pose is unknown.
    """
    figure = canvas(3.3)
    axes = figure.add_axes((0.0, 0.02, 0.44, 0.94))
    bare(axes)
    if edge_mm is not None:
        axes.fill(*edge_mm.T, facecolor="#fbfbfb", edgecolor=QUIET, linewidth=0.7, zorder=0)
    for number, (x, y) in enumerate(() if numbers_mm is None else numbers_mm):
        axes.text(x, y, str(number), ha="center", va="center", fontsize=6, color=QUIET)
    _draw_errors(figure, axes, places_mm, found_mm)
    _coverage(plot(figure, (0.63, 0.14, 0.35, 0.78), x="stated [%]", y="found [%]"), levels, held, len(places_mm))
    return figure


def _draw_errors(figure: Canvas, axes: Axes, places_mm: Array, found_mm: Array) -> None:
    distance = np.linalg.norm(found_mm - places_mm, axis=1)
    norm = Normalize(0.0, max(float(np.quantile(distance, 0.98)), 1e-6))
    ways = LineCollection(list(np.stack([places_mm, found_mm], axis=1)), colors=INK, linewidths=0.5, zorder=2)
    axes.add_collection(ways)
    size = float(np.clip(2000 / len(places_mm), 4, 24))
    axes.scatter(
        places_mm[:, 0],
        places_mm[:, 1],
        s=size,
        c=distance,
        cmap=AMOUNT_MAP,
        norm=norm,
        edgecolors=QUIET,
        linewidths=0.3,
        zorder=3,
    )
    axes.autoscale_view()
    add_scale(figure, axes, norm, AMOUNT_MAP, label="missed by [mm]", place="right")


def _coverage(axes: Axes, levels: Array, held: Array, count: int) -> None:
    stated = np.linspace(0.0, 1.0, 101)
    low, high = (binom.ppf(level, count, stated) / count for level in (0.5 - _BAND / 2, 0.5 + _BAND / 2))
    axes.fill_between(100 * stated, 100 * low, 100 * high, color=HAIR, linewidth=0, zorder=1)
    axes.plot([0, 100], [0, 100], color=INK, linewidth=0.8, zorder=2)
    dots(axes, 100 * levels, 100 * held, BLUE, linestyle="none")
    note(axes, 0.98, 0.03, f"grey: {100 * _BAND:g} % of chance, {count} presses", QUIET, ha="right")
    axes.set_xlim(0, 101)
    axes.set_ylim(0, 103)
