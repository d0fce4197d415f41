"""The panels of a gauge study, six of a crossed and five of a nested one (AIAG MSA 4th edition, chapter III)."""

from collections.abc import Sequence
from math import ceil, sqrt
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.numbers import Array
from cbsr_qa.report.draw.style import BLUE, CYCLE, FAINT, QUIET, VERMILION, canvas, draw_svg, light_grid
from cbsr_qa.report.tables import unit_column
from cbsr_qa.stats.gauge.crossed_study import Components, Study
from cbsr_qa.stats.gauge.nested import NestedStudy
from cbsr_qa.stats.nelson import d2_d3

#: Number of names that fit side by side along an axis.
_MAX_NAMES: Final = 12
#: Names per row of a legend, and the height of a row [in].
_LEGEND_COLUMNS: Final = 3
_LEGEND_ROW_IN: Final = 0.15


@draw_svg
def draw_panels(study: Study | NestedStudy, components: Components, unit: str) -> Canvas:
    """Draw components, values by part and appraiser, interaction, and charts of ranges and means (``<svg>``)."""
    has_legend = isinstance(study, Study) and len(study.stations) <= _MAX_NAMES
    legend_rows = ceil(len(study.stations) / _LEGEND_COLUMNS) if has_legend else 0
    figure, axes = _panels(_LEGEND_ROW_IN * legend_rows)
    appraiser, values = study.appraiser, study.values
    if isinstance(study, Study):
        part, names, by_part = "sensor", study.sensors, values
        _interaction(axes[5], study)
    else:
        part, names, by_part = study.part, study.parts, values.swapaxes(0, 1)
        axes[5].remove()
        axes = axes[:5]
    _components(axes[0], components, "batches" if part == "batch" else "sensors")
    axes[1].set_title(f"by {part}")
    _dots(axes[1], by_part, names)
    _ranges(axes[2], study)
    axes[3].set_title(f"by {appraiser}")
    _dots(axes[3], values.swapaxes(0, 1), study.stations)
    _means(axes[4], study)
    names_of_values = ("share", "each run", "range", "each run", "mean", "mean")
    for panel, name in zip(axes, names_of_values[: len(axes)], strict=True):
        panel.set_ylabel(unit_column(name, "%" if name == "share" else unit))
    return figure


def _panels(below: float) -> tuple[Canvas, list[Axes]]:
    """Six axes, row by row, with space [in] for the legend below the last."""
    height = 7.7 + below
    figure = canvas(height)
    bottom, top = (0.55 + below) / height, 1 - 0.25 / height
    grid = figure.add_gridspec(3, 2, left=0.09, right=0.985, bottom=bottom, top=top, hspace=0.55, wspace=0.24)
    return figure, [figure.add_subplot(grid[row, column]) for row in range(3) for column in range(2)]


def _components(axes: Axes, components: Components, parts: str) -> None:
    shares = (components.gauge, components.repeatability, components.reproducibility, components.sensor)
    bars = [("of the variance", [share.percent_contribution for share in shares])]
    bars.append(("of study variation", [share.percent_study for share in shares]))
    if components.gauge.percent_tolerance is not None:
        bars.append(("of the tolerance", [share.percent_tolerance or 0.0 for share in shares]))
    width = 0.8 / len(bars)
    light_grid(axes)
    for row, (name, heights) in enumerate(bars):
        x_positions = np.arange(len(shares)) + (row - (len(bars) - 1) / 2) * width
        axes.bar(x_positions, heights, 0.92 * width, color=CYCLE[row], label=name)
    axes.set_xticks(range(len(shares)), ["gauge R&R", "repeat.", "reprod.", parts])
    axes.set_title("components")
    _legend_below(axes, 0.24)


def _dots(axes: Axes, values: Array, names: Sequence[str]) -> None:
    """Draw the values of each name, (n, …), and their means."""
    light_grid(axes)
    groups = values.reshape(len(names), -1)
    for place, group in enumerate(groups):
        axes.plot(np.full(len(group), place), group, "o", color=FAINT, markersize=2.4)
    axes.plot(range(len(groups)), groups.mean(axis=1), "o-", color=BLUE, markersize=3.4)
    _names(axes, names)


def _ranges(axes: Axes, study: Study | NestedStudy) -> None:
    ranges = np.ptp(study.values, axis=2)
    d2, d3 = d2_d3(study.shape[2])
    mean = float(ranges.mean())
    low, high = max(0.0, mean * (1 - 3 * d3 / d2)), mean * (1 + 3 * d3 / d2)
    axes.set_title(f"range of repeated runs, by {study.appraiser}")
    _cells(axes, ranges, study, mean, low, high)
    axes.set_ylim(bottom=0)


def _means(axes: Axes, study: Study | NestedStudy) -> None:
    means = study.values.mean(axis=2)
    d2, _ = d2_d3(study.shape[2])
    half_width = 3 * float(np.ptp(study.values, axis=2).mean()) / (d2 * sqrt(study.shape[2]))
    mean = float(means.mean())
    axes.set_title(f"mean of repeated runs, by {study.appraiser}")
    _cells(axes, means, study, mean, mean - half_width, mean + half_width)


def _cells(axes: Axes, table: np.ndarray, study: Study | NestedStudy, centre: float, low: float, high: float) -> None:
    """Draw one statistic of each cell, by appraiser and then sensor, with limits."""
    count = study.shape[0]
    for column, name in enumerate(study.stations):
        x_positions, values = column * count + np.arange(count), table[:, column]
        axes.plot(x_positions, values, "-", color=FAINT, linewidth=0.7)
        is_outside = (values < low) | (values > high)
        for flags, colour in ((~is_outside, BLUE), (is_outside, VERMILION)):
            axes.plot(x_positions[flags], values[flags], "o", color=colour, markersize=2.8)
        if column:
            axes.axvline(column * count - 0.5, color=FAINT, linewidth=0.5)
        if len(study.stations) <= _MAX_NAMES:
            place = (column + 0.5) / len(study.stations)
            axes.text(place, -0.05, name[:16], transform=axes.transAxes, ha="center", va="top", fontsize=6.5)
    for line, style in ((centre, "-"), (low, "--"), (high, "--")):
        axes.axhline(line, color=QUIET, linewidth=0.7, linestyle=style)
    axes.set_xticks([])


def _interaction(axes: Axes, study: Study) -> None:
    light_grid(axes)
    axes.set_title(f"sensor by {study.appraiser}")
    means = study.values.mean(axis=2)
    for column, name in enumerate(study.stations):
        colour, dashes = CYCLE[column % len(CYCLE)], ("-", "--", ":")[column // len(CYCLE) % 3]
        axes.plot(means[:, column], "o", linestyle=dashes, color=colour, markersize=2.6, label=name[:16])
    if len(study.stations) <= _MAX_NAMES:
        _legend_below(axes, 0.5)
    _names(axes, study.sensors)


def _legend_below(axes: Axes, gap_in: float) -> None:
    """Put the legend under the axes; ``gap_in`` is the space for tick labels [in]."""
    canvas_in = axes.figure.dpi_scale_trans.inverted()
    place = (0.5, -gap_in / axes.get_window_extent().transformed(canvas_in).height)
    small = {"fontsize": 6.5, "handlelength": 1.4, "columnspacing": 1.2, "borderaxespad": 0.0, "borderpad": 0.0}
    axes.legend(frameon=False, ncols=_LEGEND_COLUMNS, loc="upper center", bbox_to_anchor=place, **small)


def _names(axes: Axes, names: Sequence[str]) -> None:
    step = -(-len(names) // _MAX_NAMES)
    places = range(0, len(names), step)
    short = [names[place][:10] for place in places]
    turned = 30 if sum(map(len, short)) > 48 else 0
    axes.set_xticks(list(places), short, rotation=turned, ha="right" if turned else "center", fontsize=6.5)
