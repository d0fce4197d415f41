"""Report of the reproduction: one section per table, with figures.

Printed numbers and ours as words.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.results import Block, Figure, Paragraph, Section
from cbsr_qa.report import number, text_table, with_uncertainty
from cbsr_qa.report.draw import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    QUIET,
    VERMILION,
    canvas,
    drawn,
    fit_left,
    light_grid,
    name_rows,
)
from cbsr_qa.studies.reproduce.compare import ComparedTable, Comparison, Kind, Ours, Printed, Rule


def printed_text(printed: Printed) -> str:
    """Format a printed number as in the paper: ``18.1 ± 9.8``, ``0.6``, or both ranges."""
    if printed.ranges:
        return " / ".join(f"{low:g}–{high:g}" for _, low, high in printed.ranges)
    if printed.value is None:
        return "–"
    if printed.deviation is None:
        return f"{printed.value:g}"
    decimals = max(len(f"{one:g}".partition(".")[2]) for one in (printed.value, printed.deviation))
    return f"{printed.value:.{decimals or 1}f} ± {printed.deviation:.{decimals or 1}f}"


def ours_text(ours: Ours) -> str:
    """Format our number with its uncertainty; ``–`` if missing, ``≥`` for a lower bound."""
    if ours.value is None:
        return "–"
    sign = "≥ " if ours.at_least else ""
    spread = ours.uncertainty
    if spread is None:
        return f"{sign}{number(ours.value)}"
    if spread < 5e-4 * abs(ours.value):  # more digits than the printed number has would say nothing
        return f"{sign}{number(ours.value, 4)}"
    return f"{sign}{with_uncertainty(ours.value, spread)}"


def agreement_sign(agrees: bool | None) -> str:
    """Write whether two numbers agree."""
    return {True: "yes", False: "no", None: "–"}[agrees]


#: Tables whose rows are drawn with the bars of both.
_DRAWN = {"table3", "table4", "table5", "tableF6"}


@dataclass(frozen=True, slots=True)
class CentreForces:
    """Forces at the centre: (measured, estimated) [N] of the uniform and of the bench sheet, and the paper's ±."""

    group: str
    printed_N: float
    uniform_N: tuple[tuple[float, float], ...]
    bench_N: tuple[tuple[float, float], ...]


def reproduction_sections(tables: Sequence[ComparedTable], forces: Sequence[CentreForces]) -> tuple[Section, ...]:
    """Return one section a table."""
    return tuple(_section(table, forces) for table in tables)


def _section(table: ComparedTable, forces: Sequence[CentreForces]) -> Section:
    agreeing, of = table.counts
    blocks: list[Block] = [Paragraph(f"{agreeing} of {of} numbers that are compared agree.")]
    blocks += [Paragraph(note, "note") for note in table.notes]
    if table.key in _DRAWN:
        blocks.append(bars_figure(table))
    elif table.key == "settling":
        blocks.append(settling_figure(table))
    elif table.key == "force" and any(one.uniform_N for one in forces):
        blocks.append(force_figure(forces))
    reasons = list(dict.fromkeys(row.reason for row in table.rows if row.reason))
    rows = [_cells(row, reasons) for row in table.rows]
    columns = ["", "quantity", "paper", "simulated", "bench, simulated", "agrees", "why", "bands"]
    if not any(row.bands[0] for row in table.rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    blocks.append(text_table("Numbers of the paper and of our simulation", columns, rows, (2, 3, 4)))
    blocks += [Paragraph(f"{_sign(number)}: {reason}.".replace("..", ".")) for number, reason in enumerate(reasons)]
    return Section(table.title, tuple(blocks))


def _sign(number: int) -> str:
    return "abcdefghijklmnopqrstuvwxyz"[number % 26] * (1 + number // 26)


def _cells(row: Comparison, reasons: Sequence[str]) -> tuple[str, ...]:
    name = row.name if row.unit == "1" else f"{row.name} [{row.unit}]"
    name += ", an input" if row.kind is Kind.INPUT else ""
    beside = ours_text(row.beside[0]) if row.beside else "–"
    bands = f"{row.bands[0]}, {row.bands[1]}" if row.bands[0] else ""
    rule = "not compared" if row.rule is Rule.NONE else agreement_sign(row.agrees)
    why = _sign(reasons.index(row.reason)) if row.reason else ""
    return row.group, name, printed_text(row.printed), ours_text(row.ours), beside, rule, why, bands


def bars_figure(table: ComparedTable) -> Figure:
    """Draw every row with the paper's mean and ± beside ours, one panel a quantity."""
    names = list(dict.fromkeys(row.name for row in table.rows))
    groups = list(dict.fromkeys(row.group for row in table.rows))

    def build() -> Canvas:
        figure = canvas(0.75 + 0.3 * len(groups))
        low = 0.42 / (0.75 + 0.3 * len(groups))
        grid = figure.add_gridspec(1, len(names), left=0.16, right=0.985, bottom=low, top=1 - 0.9 * low, wspace=0.08)
        first: list[Axes] = []
        for column, name in enumerate(names):
            axes = figure.add_subplot(grid[column])
            light_grid(axes, "x")
            rows = [row for row in table.rows if row.name == name]
            for row in rows:
                _bars(axes, groups.index(row.group), row)
            axes.set_title(f"{name} [{rows[0].unit}]", fontweight="normal")
            axes.set_xlim(*_limits(rows))
            name_rows(axes, groups)
            axes.tick_params(labelleft=column == 0)
            first += [axes] if column == 0 else []
        _legend(figure)
        fit_left(figure, grid, first)
        return figure

    return drawn(
        build,
        caption="Mean and ± as printed (grey), of the simulated uniform sheet (blue) and, where it was simulated, of "
        "the bench sheet (orange, which may lie beyond the scale).",
        alternative=f"{table.title}: {len(table.rows)} means with their deviations; the table below has the numbers.",
    )


def _bars(axes: Axes, place: int, row: Comparison) -> None:
    _bar(axes, place - 0.22, row.printed.value, row.printed.deviation, QUIET, "s")
    _bar(axes, place, row.ours.value, row.ours.uncertainty, BLUE, "o")
    for one in row.beside:
        _bar(axes, place + 0.22, one.value, one.uncertainty, ORANGE, "D")


def _bar(axes: Axes, y: float, value: float | None, spread: float | None, colour: str, marker: str) -> None:
    if value is None:
        return
    axes.plot([value - (spread or 0.0), value + (spread or 0.0)], [y, y], color=colour, linewidth=1.1)
    axes.plot(value, y, color=colour, marker=marker, markersize=3.2, linestyle="none")


def _limits(rows: Sequence[Comparison]) -> tuple[float, float]:
    """Scale that holds the paper's bars and our uniform sheet's; the bench sheet may leave it."""
    ends = [(row.printed.value or 0.0) + (row.printed.deviation or 0.0) for row in rows]
    ends += [(row.ours.value or 0.0) + (row.ours.uncertainty or 0.0) for row in rows]
    return 0.0, 1.06 * max(ends)


def _legend(figure: Canvas) -> None:
    for place, (words, colour) in enumerate((("paper", QUIET), ("simulated", BLUE), ("bench, simulated", ORANGE))):
        figure.text(0.62 + 0.12 * place, 0.012, words, color=colour, fontsize=7, va="bottom")


def settling_figure(table: ComparedTable) -> Figure:
    """Draw mean settling times by strain and direction over the paper's ranges."""

    def build() -> Canvas:
        figure = canvas(2.5)
        grid = figure.add_gridspec(1, 2, left=0.08, right=0.985, bottom=0.17, top=0.88, wspace=0.12)
        labelled: list[Axes] = []
        for column, percent in enumerate(("8 wt%", "9 wt%")):
            axes = figure.add_subplot(grid[column])
            light_grid(axes)
            rows = [row for row in table.rows if row.group.startswith(f"{percent},") and "%" in row.name]
            if rows:
                _ranges(axes, rows[0].printed)
            for direction, colour, marker in (("loading", BLUE, "o"), ("unloading", VERMILION, "s")):
                _settling_line(axes, [r for r in rows if r.group == f"{percent}, {direction}"], colour, marker)
            axes.set_title(f"{percent}, simulated uniform sheet", fontweight="normal")
            axes.set_xlabel("strain [%]")
            axes.set_xlim(2, 33)
            axes.set_ylim(0, 60)
            labelled += [axes] if column == 0 else []
        labelled[0].set_ylabel("mean settling time [s]")
        labelled[0].text(3, 2, "● loading", color=BLUE, fontsize=7)
        labelled[0].text(10, 2, "■ unloading", color=VERMILION, fontsize=7)
        fit_left(figure, grid, labelled)
        return figure

    return drawn(
        build,
        caption="Mean settling times over nine locations and all trials, with their standard errors, over the ranges "
        "the paper prints: pale its abstract's, darker those of 4.3.2, which contradict each other. Strains at which "
        "fewer than half of the fits pass R² of 0.85 have no mean.",
        alternative="Simulated means by strain; the table below has the numbers.",
    )


def _ranges(axes: Axes, printed: Printed) -> None:
    for (name, low, high), shade, edge in zip(printed.ranges, (0.35, 0.6), (2.6, 26.5), strict=True):
        axes.axhspan(low, high, color=FAINT, alpha=shade, linewidth=0)
        axes.text(edge, high - 0.4, name, fontsize=6.5, color=INK, va="top")


def _settling_line(axes: Axes, rows: Sequence[Comparison], colour: str, marker: str) -> None:
    known = [(float(row.name.split(" ")[0]), row.ours) for row in rows if row.ours.value is not None]
    for strain, one in known:
        _upright(axes, strain, one, colour, marker)


def _upright(axes: Axes, place: float, one: Ours, colour: str, marker: str) -> None:
    assert one.value is not None
    spread = one.uncertainty or 0.0
    axes.plot([place, place], [one.value - spread, one.value + spread], color=colour)
    filled = "none" if one.at_least else colour
    axes.plot(place, one.value, color=colour, marker=marker, markersize=4, markerfacecolor=filled, linestyle="none")


def force_figure(forces: Sequence[CentreForces]) -> Figure:
    """Draw estimated less measured force at L0 over the paper's ±."""

    def build() -> Canvas:
        figure = canvas(2.3)
        grid = figure.add_gridspec(1, 2, left=0.08, right=0.985, bottom=0.18, top=0.88, wspace=0.12)
        labelled: list[Axes] = []
        for column, one in enumerate(forces):
            axes = figure.add_subplot(grid[column])
            light_grid(axes)
            axes.axhspan(-one.printed_N, one.printed_N, color=FAINT, alpha=0.45, linewidth=0)
            axes.axhline(0, color=QUIET, linewidth=0.6)
            for pairs, colour, marker in ((one.bench_N, ORANGE, "D"), (one.uniform_N, BLUE, "o")):
                values = np.array(pairs).reshape(-1, 2)
                axes.plot(
                    values[:, 0], values[:, 1] - values[:, 0], color=colour, marker=marker, markersize=3.4,
                    linestyle="none",
                )  # fmt: skip
            axes.set_title(f"{one.group}, simulated", fontweight="normal")
            axes.set_xlabel("measured force [N]")
            axes.set_xlim(left=0)
            axes.set_ylim(-2.2, 2.2)
            axes.text(0.02, 0.97, f"paper ± {one.printed_N:g} N", transform=axes.transAxes, va="top", fontsize=7)
            labelled += [axes] if column == 0 else []
        labelled[0].set_ylabel("estimated − measured [N]")
        labelled[0].text(0.02, 0.04, "● uniform", transform=labelled[0].transAxes, color=BLUE, fontsize=7)
        labelled[0].text(0.22, 0.04, "◆ bench", transform=labelled[0].transAxes, color=ORANGE, fontsize=7)
        fit_left(figure, grid, labelled)
        return figure

    return drawn(
        build,
        caption="Errors of the force at L0, each press left out of what estimates it, with one response for the "
        "whole sheet: simulated uniform sheet and bench sheet over the standard deviation the paper prints (grey).",
        alternative="Simulated force errors at the centre; the table below has their deviations.",
    )
