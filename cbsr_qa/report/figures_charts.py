"""Control charts over runs: points, centre line and limits, the reference period, and what signals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import MaxNLocator

from cbsr_qa.domain.report import Figure
from cbsr_qa.report.numbers import unit_shown
from cbsr_qa.report.style import BLUE, FAINT, INK, QUIET, VERMILION, canvas, fit_left, light_grid
from cbsr_qa.report.svg import drawn
from cbsr_qa.stats.control_charts import Chart

#: Points that are drawn; of longer charts only the latest.
MOST_POINTS = 400


@dataclass(frozen=True, slots=True, eq=False)
class ChartPart:
    """A stretch of one chart.

    Parameters
    ----------
    ends : (points,) number of the run that each point belongs to.
    """

    chart: Chart
    ends: Sequence[int]


def control_figure(parts: Sequence[ChartPart], phase_1: int, unit: str, *, label: str) -> Figure:
    """Draw charts below each other: one row a name (individuals above their moving range), parts of it side by side.

    Parameters
    ----------
    parts : of the reference period and of the runs since.
    phase_1 : runs of the reference period.
    unit : of the points.
    label : what is charted.
    """
    rows = list(dict.fromkeys(part.chart.name for part in parts))
    first = max(0, max((part.ends[-1] for part in parts if len(part.ends)), default=0) + 1 - MOST_POINTS)
    shown = unit_shown(unit)

    def build() -> Canvas:
        height = 0.75 + 1.55 * len(rows)
        figure = canvas(height)
        grid = figure.add_gridspec(
            len(rows), 1, left=0.09, right=0.985, bottom=0.45 / height, top=1 - 0.25 / height, hspace=0.3
        )
        labelled = []
        for row, name in enumerate(rows):
            axes = figure.add_subplot(grid[row])
            for part in parts:
                if part.chart.name == name:
                    _draw(axes, part, first)
            if phase_1 > first:
                axes.axvspan(max(first, 0) + 0.5, phase_1 + 0.5, color=FAINT, alpha=0.25, linewidth=0)
            axes.set_ylabel(f"{name} [{shown}]" if shown else name)
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
            axes.tick_params(labelbottom=row == len(rows) - 1)
            labelled.append(axes)
        labelled[-1].set_xlabel("run, in the order they were made")
        fit_left(figure, grid, labelled)
        return figure

    cut = f" Only the latest {MOST_POINTS} runs are drawn." if first else ""
    return drawn(
        build,
        caption=f"{label}. Grey: the reference period that the limits (dashed) come from. "
        f"Orange: a rule speaks.{cut}",
        alternative=f"Control charts of {label}; the sentences above say which points signal.",
    )


def _draw(axes: Axes, part: ChartPart, first: int) -> None:
    chart, ends = part.chart, np.asarray(part.ends, dtype=np.intp)
    kept = ends >= first
    if not kept.any():
        return
    light_grid(axes)
    across = ends[kept] + 1
    flagged = np.zeros(len(ends), dtype=bool)
    flagged[[signal.index for signal in chart.signals]] = True
    axes.plot(across, chart.points[kept], "-", color=FAINT, linewidth=0.6)
    size = 2.6 if kept.sum() < 200 else 1.5
    for flags, colour in ((~flagged[kept], BLUE), (flagged[kept], VERMILION)):
        axes.plot(across[flags], chart.points[kept][flags], "o", color=colour, markersize=size)
    edges = np.array([across[0] - 0.5, across[-1] + 0.5])
    axes.plot(edges, [chart.centre] * 2, color=QUIET, linewidth=0.7)
    for limit in (chart.lower, chart.upper):
        # Points stand in the middle of their step, so that limits that vary follow each point.
        steps = np.append(limit[kept], limit[kept][-1])
        axes.step(np.append(across - 0.5, edges[1]), steps, where="post", color=INK, linewidth=0.7, linestyle="--")
