"""The page of ``cbsr-qa charts``: which charts signal first, then every chart.

Control charts over runs: points, centre line and limits, the reference period, and what signals.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import MaxNLocator

from cbsr_qa.domain.results import Banner, Block, Figure, Page, Paragraph, Section
from cbsr_qa.domain.run import ChartKind, ChartReference
from cbsr_qa.report import number, plural, render_sections, unit_shown
from cbsr_qa.report.draw import BLUE, FAINT, INK, QUIET, VERMILION, canvas, drawn, fit_left, light_grid
from cbsr_qa.stats import Chart
from cbsr_qa.studies.charts.charting import STANDS, MetricChart
from cbsr_qa.studies.charts.charts import Charts

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


_READING: Final = (
    "A chart holds every run's figure against limits that come from a reference period, in which the station was "
    "known to be well. {limits} They say nothing about whether a sensor is good. "
    "A signal says that the station, its surroundings or what is fed to it has "
    "changed: it asks for a look, at a golden sensor first, since a new batch of material signals too.",
    f"A signal stands until {STANDS} runs in a row gave none. While one stands, every report of the station says so. "
    "After the cause was found and mended, a new reference period makes new limits; the old ones stay stored.",
)
_LIMITS: Final = {
    ChartKind.INDIVIDUALS: "three deviations away from the mean (i-mr)",
    ChartKind.MEANS: "three deviations of a mean away (xbar-r)",
    ChartKind.EWMA: "{width:g} deviations of the average away (ewma)",
    ChartKind.CUSUM: "{threshold:g} deviations of single runs away from zero (cusum)",
}


def _reading(found: Charts) -> tuple[str, ...]:
    """How to read the page: where limits are goes by the kinds of charts on it."""
    settings = [one.reference.settings for one in found.charts if one.reference is not None]
    kinds = dict.fromkeys(_LIMITS[one.kind].format(width=one.width, threshold=one.threshold) for one in settings)
    away = f"Limits are {' or '.join(kinds)}; a deviation is what runs after each other differ by."
    return _READING[0].format(limits=away if kinds else "Nothing is charted here now."), *_READING[1:]


def charts_html(found: Charts) -> str:
    """Return the page as one HTML document."""
    return render_sections(_head(found), _sections(found))


def _head(found: Charts) -> Page:
    signals, charted = found.signals, [one for one in found.charts if one.reference is not None]
    if signals:
        reason = "; ".join(signal.words() for signal in signals[:3])
        banner = Banner("fail", "✗", f"{plural(len(signals), 'chart')} out of control", reason)
    else:
        banner = Banner("pass", "✓", "In control", f"no signal stands on any of {plural(len(charted), 'chart')}")
    facts = (
        ("Station", found.request.station),
        ("Recipe", found.recipe),
        ("Charted are", f"golden sensor {found.request.golden}" if found.request.golden else "production runs"),
        ("Runs", str(found.runs)),
    )
    simulated = ("the runs charted here",) if found.simulated else ()
    return Page("Control charts", found.request.station, banner, facts, simulated, found.notes)


def _sections(found: Charts) -> list[Section]:
    sections = [Section("How to read this page", tuple(Paragraph(words) for words in _reading(found)))]
    return [*sections, *(Section(one.label, tuple(_blocks(one))) for one in found.charts)]


def chart_words(one: MetricChart) -> tuple[str, ...]:
    """Say how one chart stands and what its limits rest on."""
    if one.reference is None:
        return (f"No chart: {one.why}.", *one.notes)
    signal = one.signal
    since = len(one.values) - one.phase_1
    said = "No signal stands" if signal is None else f"Out of control: {signal.words().partition(', signals ')[2]}"
    return (
        f"{said}; {plural(since, 'run')} after the reference period.",
        reference_words(one, one.reference),
        *one.notes,
    )


def reference_words(chart: MetricChart, one: ChartReference) -> str:
    """Say what a chart's limits rest on, and who set them when."""
    unit = unit_shown(one.unit)
    unit = f" {unit}" if unit else ""
    size = f"mean {number(one.mean, 4)}{unit}, deviation {number(one.deviation)}{unit}"
    why = f" ({one.why})" if one.why else ""
    rules = (
        f"; Nelson's rules {', '.join(map(str, one.settings.rules))}"
        if one.settings.kind in ("i-mr", "xbar-r")
        else ""
    )
    return (
        f"Limits: {size}, from {one.runs} runs ({chart.named_run(one.first_run)} to "
        f"{chart.named_run(one.last_run)}), set by {one.operator or 'nobody named'} on "
        f"{one.made_at:%Y-%m-%d}{why}{rules}."
    )


def _blocks(one: MetricChart) -> list[Block]:
    tone = "warning" if one.signal is not None or one.reference is None else "plain"
    first, *rest = chart_words(one)
    blocks: list[Block] = [Paragraph(first, tone), *(Paragraph(words) for words in rest)]
    parts = [ChartPart(charted.chart, charted.ends) for charted in one.before]
    parts += [ChartPart(c.chart, [one.phase_1 + end for end in c.ends]) for c in one.after]
    if parts:
        blocks.append(control_figure(parts, one.phase_1, one.unit, label=one.label))
    return blocks
