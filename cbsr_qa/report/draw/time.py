"""Traces against time, and time budgets."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.transforms import blended_transform_factory

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.observation import Trace
from cbsr_qa.report.draw.style import BLUE, CYCLE, INK, QUIET, annotate, canvas, draw_svg, fit_left, light_grid, note
from cbsr_qa.report.tables import duration, unit_shown


@dataclass(frozen=True, slots=True)
class Budget:
    """A total and its parts, in seconds."""

    title: str
    parts: tuple[tuple[str, float], ...]


@draw_svg
def budget_figure(budgets: Sequence[Budget]) -> Canvas:
    """Draw one panel of bars per budget, the largest part first, each bar with its time and share."""
    rows = max(len(budget.parts) for budget in budgets)
    height_in = 0.19 * rows + 0.42
    figure = canvas(height_in)
    width = 1 / len(budgets)
    for column, budget in enumerate(budgets):
        share = len(budget.parts) / rows
        top = 1 - 0.3 / height_in
        height = (0.19 * rows / height_in) * share
        axes = figure.add_axes((column * width + 0.15, top - height, width - 0.29, height))
        _draw_bars(axes, budget)
    return figure


def _draw_bars(axes: Axes, budget: Budget) -> None:
    sorted_parts = sorted(budget.parts, key=lambda part: -part[1])
    total = sum(seconds for _, seconds in sorted_parts)
    axes.barh(
        range(len(sorted_parts)), [seconds for _, seconds in sorted_parts], height=0.68, color=BLUE, linewidth=0
    )
    for row, (_, seconds) in enumerate(sorted_parts):
        share = f"  ({100 * seconds / total:.0f} %)" if total else ""
        annotate(axes, f"{duration(seconds)}{share}", (seconds, row), (3, 0), va="center")
    axes.set_yticks(range(len(sorted_parts)), [name for name, _ in sorted_parts])
    axes.set_ylim(len(sorted_parts) - 0.5, -0.5)
    axes.set_xticks([])
    axes.tick_params(axis="y", length=0)
    for side in ("bottom", "left"):
        axes.spines[side].set_visible(False)
    axes.set_title(f"{budget.title}: {duration(total)}", x=0, pad=3)


@draw_svg
def error_figure(minutes: Sequence[float], expected_N: Sequence[float], upper_N: Sequence[float]) -> Canvas:
    """Draw the expected error of force against station time, and its upper bound, on a logarithmic scale."""
    figure = canvas(2.0)
    axes = figure.add_axes((0.09, 0.22, 0.88, 0.72))
    axes.plot(minutes, upper_N, color=QUIET, linewidth=0.9)
    axes.plot(minutes, expected_N, color=BLUE, marker="o", markersize=3)
    axes.set_yscale("log")
    axes.set_xlabel("station time [min]")
    axes.set_ylabel("force error [N]")
    light_grid(axes)
    for value, colour, label in ((upper_N[-1], QUIET, "upper bound"), (expected_N[-1], BLUE, "expected")):
        annotate(axes, f"{label} {value:.3g} N", (minutes[-1], value), (-4, 6), ha="right", color=colour)
    return figure


#: More points than a line on a page can show are drawn as the extremes of each stretch.
_POINTS: Final = 1600


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of time worth pointing at, on the traces' clock; a peak is marked with a tick."""

    start_s: float
    end_s: float
    label: str
    peak_s: float | None = None


@draw_svg
def timeline_figure(
    traces: Sequence[Trace], spans: Sequence[Span], *, time_label: str = "time since the first complete frame [s]"
) -> Canvas:
    """Draw traces below each other over one time axis, those of equal unit in one panel.

    Spans are shaded through all panels and named above the first. Traces without points are left out.
    """
    panels = _group_by_unit(traces)
    height_in = 1.35 * len(panels) + 0.75
    figure = canvas(height_in)
    grid = figure.add_gridspec(
        len(panels), 1, left=0.085, right=0.87, bottom=0.42 / height_in, top=1 - 0.3 / height_in, hspace=0.16
    )
    drawn_axes: list[Axes] = []
    for row, (unit, members) in enumerate(panels):
        axes = figure.add_subplot(grid[row], sharex=drawn_axes[0] if drawn_axes else None)
        drawn_axes.append(axes)
        _draw_traces(axes, members, unit)
        for span in spans:
            shade(axes, span, named=row == 0)
        if row < len(panels) - 1:
            axes.tick_params(labelbottom=False)
    axes.set_xlabel(time_label)
    axes.margins(x=0.01)
    fit_left(figure, grid, drawn_axes)
    return figure


def draw_timeline(axes: Axes, traces: Sequence[Trace], spans: Sequence[Span], *, time_label: str) -> None:
    """Draw traces of one unit and shaded spans on the axes of any figure."""
    _draw_traces(axes, list(traces), traces[0].unit)
    for span in spans:
        shade(axes, span, named=bool(span.label))
    axes.set_xlabel(time_label)


def shade(axes: Axes, span: Span, *, named: bool) -> None:
    """Shade a stretch of time, tick its peak, and name it above the axes."""
    axes.axvspan(span.start_s, max(span.end_s, span.start_s), color="#f0e3cf", linewidth=0, zorder=0)
    data_and_axes = blended_transform_factory(axes.transData, axes.transAxes)
    if span.peak_s is not None:
        axes.plot([span.peak_s] * 2, [0.94, 1.0], transform=data_and_axes, color=INK, linewidth=1.0, clip_on=False)
    if named:
        middle = (span.start_s + span.end_s) / 2
        axes.text(middle, 1.03, span.label, transform=data_and_axes, ha="center", va="bottom", fontsize=7)


def thin_trace(time_s: Array, values: Array, points: int = _POINTS) -> tuple[Array, Array]:
    """Keep lowest and highest value of each stretch, so that no spike is lost where points are too many to draw."""
    if len(values) <= points:
        return time_s, values
    starts = np.linspace(0, len(values), points // 2 + 1).astype(np.int64)
    pairs = pairwise(starts)
    kept_indices = [a + k for a, b in pairs for k in sorted({int(values[a:b].argmin()), int(values[a:b].argmax())})]
    return time_s[kept_indices], values[kept_indices]


def _group_by_unit(traces: Sequence[Trace]) -> list[tuple[str, list[Trace]]]:
    panels: dict[str, list[Trace]] = {}
    for trace in traces:
        if len(trace.values):
            panels.setdefault(trace.unit, []).append(trace)
    return list(panels.items()) or [("", [])]


def _draw_traces(axes: Axes, traces: list[Trace], unit: str) -> None:
    light_grid(axes)
    for index, trace in enumerate(traces):
        colour = CYCLE[index % len(CYCLE)] if len(traces) > 1 else BLUE
        time_s, values = thin_trace(trace.time_s, trace.values)
        axes.plot(time_s, values, color=colour, linewidth=0.9)
        if len(traces) > 1:
            note(axes, 1.01, 0.95 - 0.13 * index, trace.name, colour, va="top")
    name = traces[0].name if len(traces) == 1 else ""
    shown_unit = unit_shown(unit)
    axes.set_ylabel(
        f"{name}\n[{shown_unit}]" if name and shown_unit else name or (f"[{shown_unit}]" if shown_unit else ""),
        color=INK,
    )
    axes.yaxis.label.set_fontsize(7.5)
    axes.tick_params(axis="y", color=QUIET)
