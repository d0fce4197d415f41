"""Control charts over runs: points, centre line and limits, the reference period, and the points that signal."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import MaxNLocator

from cbsr_qa.report.draw.style import BLUE, FAINT, INK, QUIET, VERMILION, canvas, draw_svg, fit_left, light_grid
from cbsr_qa.report.tables import unit_column
from cbsr_qa.studies.charts.charting import MOST_DRAWN, ChartPhase, MetricChart


@draw_svg
def control_charts_svg(chart: MetricChart) -> Canvas:
    """Draw charts in rows (individuals above their moving range), with both phases side by side."""
    rows = list(dict.fromkeys(phase.name for phase in chart.charts))
    numbers = {run: number for number, run in enumerate(chart.runs, start=1)}
    first_number = max(0, len(chart.runs) - MOST_DRAWN) + 1
    height = 0.75 + 1.55 * len(rows)
    figure = canvas(height)
    grid = figure.add_gridspec(
        len(rows), 1, left=0.09, right=0.985, bottom=0.45 / height, top=1 - 0.25 / height, hspace=0.3
    )
    labelled = [figure.add_subplot(grid[row]) for row in range(len(rows))]
    for name, axes in zip(rows, labelled, strict=True):
        for phase in chart.charts:
            if phase.name == name:
                _draw(axes, phase, numbers, first_number)
        if chart.reference_runs >= first_number:
            axes.axvspan(first_number - 0.5, chart.reference_runs + 0.5, color=FAINT, alpha=0.25, linewidth=0)
        axes.set_ylabel(unit_column(name, chart.unit))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.tick_params(labelbottom=axes is labelled[-1])
    labelled[-1].set_xlabel("run, in the order they were made")
    fit_left(figure, grid, labelled)
    return figure


def _draw(axes: Axes, part: ChartPhase, numbers: Mapping[str, int], first: int) -> None:
    runs = np.array([numbers[run] for run in part.runs])
    is_drawn = runs >= first
    if not is_drawn.any():
        return
    light_grid(axes)
    drawn_runs, points = runs[is_drawn], np.array(part.points)[is_drawn]
    flagged = np.isin(drawn_runs, [numbers[signal.run] for signal in part.signals])
    axes.plot(drawn_runs, points, "-", color=FAINT, linewidth=0.6)
    size = 2.6 if len(drawn_runs) < 200 else 1.5
    for flags, colour in ((~flagged, BLUE), (flagged, VERMILION)):
        axes.plot(drawn_runs[flags], points[flags], "o", color=colour, markersize=size)
    edges = np.array([drawn_runs[0] - 0.5, drawn_runs[-1] + 0.5])
    axes.plot(edges, [part.centre] * 2, color=QUIET, linewidth=0.7)
    for limits in (part.lower, part.upper):
        # Points are drawn in the middle of their step, so that varying limits follow each point.
        steps = np.array(limits)[is_drawn]
        step_edges, heights = np.append(drawn_runs - 0.5, edges[1]), np.append(steps, steps[-1])
        axes.step(step_edges, heights, where="post", color=INK, linewidth=0.7, linestyle="--")
