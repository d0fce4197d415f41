"""Figures of the reproduction: the paper's numbers and ours."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.report.draw.style import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    QUIET,
    VERMILION,
    canvas,
    draw_svg,
    fit_left,
    light_grid,
    name_rows,
)
from cbsr_qa.studies.reproduce.compare import ComparedRow
from cbsr_qa.studies.reproduce.reproduce import CentreForces


@draw_svg
def bars_svg(table: Sequence[ComparedRow]) -> Canvas:
    """Draw every row with the paper's mean and ± beside ours, one panel per quantity."""
    names = list(dict.fromkeys(row.name for row in table))
    groups = list(dict.fromkeys(row.group for row in table))
    height = 0.75 + 0.3 * len(groups)
    figure, low = canvas(height), 0.42 / height
    grid = figure.add_gridspec(1, len(names), left=0.16, right=0.985, bottom=low, top=1 - 0.9 * low, wspace=0.08)
    panels = [figure.add_subplot(grid[column]) for column in range(len(names))]
    for axes, name in zip(panels, names, strict=True):
        light_grid(axes, "x")
        rows = [row for row in table if row.name == name]
        for row in rows:
            place = groups.index(row.group)
            _bar(axes, place - 0.22, row.paper.value, row.paper.deviation, QUIET, "s")
            _bar(axes, place, row.ours.value, row.ours.uncertainty, BLUE, "o")
            for bench in row.beside:
                _bar(axes, place + 0.22, bench.value, bench.uncertainty, ORANGE, "D")
        axes.set_title(f"{name} [{rows[0].unit}]", fontweight="normal")
        # Scale for the paper's bars and our uniform sheet's; the bench sheet may exceed it.
        ends = [(row.paper.value or 0.0) + (row.paper.deviation or 0.0) for row in rows]
        ends += [(row.ours.value or 0.0) + (row.ours.uncertainty or 0.0) for row in rows]
        limits = 0.0, 1.06 * max(ends)
        axes.set_xlim(*limits)
        name_rows(axes, groups)
        axes.tick_params(labelleft=axes is panels[0])
    for place, (label, colour) in enumerate((("paper", QUIET), ("simulated", BLUE), ("bench, simulated", ORANGE))):
        figure.text(0.62 + 0.12 * place, 0.012, label, color=colour, fontsize=7, va="bottom")
    fit_left(figure, grid, panels[:1])
    return figure


def _bar(axes: Axes, y: float, value: float | None, spread: float | None, colour: str, marker: str) -> None:
    if value is None:
        return
    axes.plot([value - (spread or 0.0), value + (spread or 0.0)], [y, y], color=colour, linewidth=1.1)
    axes.plot(value, y, color=colour, marker=marker, markersize=3.2, linestyle="none")


@draw_svg
def _two_panels(height_in: float, draw: Callable[[list[Axes]], None]) -> Canvas:
    figure = canvas(height_in)
    grid = figure.add_gridspec(1, 2, left=0.08, right=0.985, bottom=0.42 / height_in, top=0.88, wspace=0.12)
    panels = [figure.add_subplot(grid[column]) for column in range(2)]
    for axes in panels:
        light_grid(axes)
    draw(panels)
    fit_left(figure, grid, panels[:1])
    return figure


def settling_svg(table: Sequence[ComparedRow]) -> str:
    """Draw mean settling times by strain and direction over the paper's ranges."""

    def draw(panels: list[Axes]) -> None:
        for axes, percent in zip(panels, ("8 wt%", "9 wt%"), strict=True):
            rows = [row for row in table if row.group.startswith(f"{percent},") and "%" in row.name]
            if rows:
                for printed, shade, edge in zip(rows[0].paper.ranges, (0.35, 0.6), (2.6, 26.5), strict=True):
                    axes.axhspan(printed.low, printed.high, color=FAINT, alpha=shade, linewidth=0)
                    axes.text(edge, printed.high - 0.4, printed.where, fontsize=6.5, color=INK, va="top")
            for direction, colour, marker in (("loading", BLUE, "o"), ("unloading", VERMILION, "s")):
                _draw_settling(axes, (row for row in rows if row.group == f"{percent}, {direction}"), colour, marker)
            axes.set_title(f"{percent}, simulated uniform sheet", fontweight="normal")
            axes.set_xlabel("strain [%]")
            axes.set_xlim(2, 33)
            axes.set_ylim(0, 60)
        panels[0].set_ylabel("mean settling time [s]")
        panels[0].text(3, 2, "● loading", color=BLUE, fontsize=7)
        panels[0].text(10, 2, "■ unloading", color=VERMILION, fontsize=7)

    return _two_panels(2.5, draw)


def _draw_settling(axes: Axes, rows: Iterable[ComparedRow], colour: str, marker: str) -> None:
    for row in rows:
        time_s, spread_s = row.ours.value, row.ours.uncertainty or 0.0
        if time_s is None:
            continue
        strain_percent = float(row.name.split(" ")[0])
        axes.plot([strain_percent, strain_percent], [time_s - spread_s, time_s + spread_s], color=colour)
        filled = "none" if row.ours.at_least else colour
        axes.plot(
            strain_percent,
            time_s,
            color=colour,
            marker=marker,
            markersize=4,
            markerfacecolor=filled,
            linestyle="none",
        )


def force_svg(presses: Sequence[CentreForces]) -> str:
    """Draw estimated less measured force at L0 over the paper's ±."""

    def draw(panels: list[Axes]) -> None:
        for axes, forces in zip(panels, presses, strict=True):
            axes.axhspan(-forces.printed_N, forces.printed_N, color=FAINT, alpha=0.45, linewidth=0)
            axes.axhline(0, color=QUIET, linewidth=0.6)
            for pairs, colour, marker in ((forces.bench_N, ORANGE, "D"), (forces.uniform_N, BLUE, "o")):
                measured, estimated = np.array(pairs).reshape(-1, 2).T
                axes.plot(
                    measured, estimated - measured, color=colour, marker=marker, markersize=3.4, linestyle="none"
                )
            axes.set_title(f"{forces.group}, simulated", fontweight="normal")
            axes.set_xlabel("measured force [N]")
            axes.set_xlim(left=0)
            axes.set_ylim(-2.2, 2.2)
            axes.text(0.02, 0.97, f"paper ± {forces.printed_N:g} N", transform=axes.transAxes, va="top", fontsize=7)
        panels[0].set_ylabel("estimated − measured [N]")
        panels[0].text(0.02, 0.04, "● uniform", transform=panels[0].transAxes, color=BLUE, fontsize=7)
        panels[0].text(0.22, 0.04, "◆ bench", transform=panels[0].transAxes, color=ORANGE, fontsize=7)

    return _two_panels(2.3, draw)
