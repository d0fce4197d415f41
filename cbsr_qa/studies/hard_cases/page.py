"""The page of ``cbsr-qa stability``: what is hard, what came of it, and how to read that."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from cbsr_qa.domain.results import Banner, Block, Cell, Figure, Outcome, Page, Paragraph, Section
from cbsr_qa.report import number, plural, text_table
from cbsr_qa.report.draw import BLUE, FAINT, INK, QUIET, VERMILION, canvas, drawn, light_grid, name_rows
from cbsr_qa.studies.hard_cases.case import CONDITIONING_ROOM, EPSILON, CaseResult, Ending

_SUPERSCRIPTS: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_EXACT: Final = 1e-18  # where an error of exactly zero is drawn
_READING: Final = (
    "A sensor's force comes out of long chains of arithmetic with numbers of sixteen digits. Some inputs cost "
    "digits: contacts a billion times too poor, a load a hundred million times the sheet's conductance, readings "
    "that lie on an offset a million times as large. This page lists such cases. Each is computed as any measurement "
    "would be, and held against a truth found in another way: a formula, the same equations in fifty digits, or an "
    "identity that must hold exactly.",
    "The error is what the answer is off by, relative where no unit is given. The bound is what it may be off by. "
    "The condition number says how much the problem itself magnifies a last digit: no method can do better than "
    "condition × 2.2 × 10⁻¹⁶, and a bound that rests on it allows a hundred times that. Where truth is continuous "
    "and the answer comes from a mesh, the bound is of the mesh, and says so.",
    "A case may also end in a refusal: the program says what it found and what to do, and gives no number. That is "
    "right where a number would be rounding, and wrong anywhere else. A case that is out of its bound, gives no "
    "number or raises a warning is broken, and the command ends with exit code 1.",
)
_CELLS: Final = {Ending.OK: Outcome.PASS, Ending.REFUSED: Outcome.NOT_JUDGED, Ending.BROKEN: Outcome.FAIL}
_WORDS: Final = {Ending.OK: "within its bound", Ending.REFUSED: "refused", Ending.BROKEN: "BROKEN"}


def stability_page(results: Sequence[CaseResult]) -> Page:
    """Say what the page begins with."""
    counts = Counter(result.outcome for result in results)
    broken = [result.case.name for result in results if result.outcome is Ending.BROKEN]
    if broken:
        banner = Banner("fail", "✗", f"{plural(len(broken), 'case')} broken", f"out of bounds: {', '.join(broken)}")
    else:
        banner = Banner("pass", "✓", "No bound is broken", "every case is within its bound or refused by name")
    identity = (
        ("Cases", str(len(results))),
        ("Within their bound", str(counts[Ending.OK])),
        ("Refused by name", str(counts[Ending.REFUSED])),
        ("Broken", str(counts[Ending.BROKEN])),
        ("Took", f"{sum(result.seconds for result in results):.0f} s of computing"),
    )
    return Page("Numerical stability", "Numerically hard cases", banner, identity, (), ())


def stability_sections(results: Sequence[CaseResult]) -> tuple[Section, ...]:
    """Return how to read the page, with errors against condition numbers, and one section an area."""
    numbers = [result for result in results if result.answer is not None]
    blocks: list[Block] = [Paragraph(words) for words in _READING]
    if any(result.answer is not None and result.answer.condition is not None for result in numbers):
        blocks.append(condition_figure(numbers))
    areas = dict.fromkeys(result.case.area for result in results)
    sections = [_area(area, [result for result in results if result.case.area == area]) for area in areas]
    return (Section("How to read this page", tuple(blocks)), *sections)


def _area(area: str, results: Sequence[CaseResult]) -> Section:
    rows = [_row(result) for result in results]
    columns = ["case", "what is hard", "held against", "error", "bound", "condition", "outcome"]
    numbers = [result for result in results if result.answer is not None]
    blocks: list[Block] = [error_figure(area, numbers)] if numbers else []
    blocks.append(text_table(f"Cases of the area {area}", columns, rows, (3, 4, 5)))
    for result in results:
        if result.outcome is not Ending.OK:
            tone = "warning" if result.outcome is Ending.BROKEN else "plain"
            words = f"{result.case.name}, {_WORDS[result.outcome]}: {result.reason}."
            blocks.append(Paragraph(f"{words} What to do: {result.remedy}." if result.remedy else words, tone))
        elif result.answer is not None and result.answer.note:
            blocks.append(Paragraph(f"{result.case.name}: {result.answer.note}.", "note"))
    return Section(area[0].upper() + area[1:], tuple(blocks))


def _row(result: CaseResult) -> tuple[str | Cell, ...]:
    case, answer = result.case, result.answer
    numbers = ["–", "–", "–"]
    if answer is not None:
        unit = "" if answer.unit == "1" else f" {answer.unit}"
        numbers[0] = _text(answer.error, unit)
        numbers[1] = _text(answer.bound, unit)
        numbers[2] = "–" if answer.condition is None else number(answer.condition, 2)
    return case.name, case.hard, case.truth, *numbers, Cell(_WORDS[result.outcome], _CELLS[result.outcome])


def _text(value: float, unit: str) -> str:
    return f"{number(value, 2)}{unit}" if np.isfinite(value) else "no number"


def error_figure(area: str, results: Sequence[CaseResult]) -> Figure:
    """Draw every error of an area and its bound on a logarithmic axis."""

    def build() -> Canvas:
        height = 0.8 + 0.15 * len(results)
        figure = canvas(height)
        axes = figure.add_axes((0.44, 0.5 / height, 0.54, 1 - 0.62 / height))
        light_grid(axes, "x")
        axes.set_xscale("log")
        for row, result in enumerate(results):
            _error(axes, row, result)
        _powers(axes.xaxis, *axes.get_xlim())
        axes.set_xlabel("error (dot) and bound (bar), relative or in the case's own unit")
        name_rows(axes, [result.case.name for result in results], most=len(results))
        return figure

    return drawn(
        build,
        caption="Error of every case with a number (dot; hollow where it is exactly zero) and the bound it may not "
        "pass (bar). A red dot is out of its bound.",
        alternative=f"{area}: errors and bounds of {len(results)} cases; the table below has the numbers.",
    )


def _error(axes: Axes, row: int, result: CaseResult) -> None:
    answer = result.answer
    if answer is None or not np.isfinite([answer.error, answer.bound]).all():
        return
    error, bound = max(answer.error, _EXACT), max(answer.bound, _EXACT)
    colour = VERMILION if result.outcome is Ending.BROKEN else BLUE
    axes.plot([error, bound], [row, row], color=FAINT, linewidth=0.8)
    axes.plot(bound, row, color=INK, marker="|", markersize=6, linestyle="none")
    filled = colour if answer.error > 0 else "none"
    axes.plot(error, row, color=colour, marker="o", markersize=3.2, markerfacecolor=filled, linestyle="none")


def _powers(axis: Axis, low: float, high: float) -> None:
    """Number a logarithmic axis by every second power of ten or so."""
    first, last = int(np.ceil(np.log10(low))), int(np.floor(np.log10(high)))
    powers = range(first, last + 1, max(1, -(-(last - first) // 10)))
    axis.set_major_locator(FixedLocator([10.0**power for power in powers]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(
        FuncFormatter(lambda value, _: "10" + str(round(np.log10(value))).translate(_SUPERSCRIPTS))
    )


def condition_figure(results: Sequence[CaseResult]) -> Figure:
    """Draw errors against condition number times machine precision, with lines of once and a hundred times it."""
    known = [
        (result.answer.condition * EPSILON, max(result.answer.error, _EXACT), result)
        for result in results
        if result.answer is not None and result.answer.condition is not None and result.answer.unit == "1"
    ]

    def build() -> Canvas:
        figure = canvas(3.1)
        axes = figure.add_axes((0.1, 0.15, 0.62, 0.8))
        light_grid(axes, "both")
        axes.set_xscale("log")
        axes.set_yscale("log")
        for across, up, result in known:
            filled = BLUE if result.answer is not None and result.answer.error > 0 else "none"
            colour = VERMILION if result.outcome is Ending.BROKEN else BLUE
            axes.plot(across, up, "o", color=colour, markersize=3.6, markerfacecolor=filled, linestyle="none")
        ends = np.array([EPSILON / 3, 10 * max(*(across for across, _, _ in known), EPSILON)])
        axes.plot(ends, ends, color=QUIET, linewidth=0.8)
        axes.plot(ends, CONDITIONING_ROOM * ends, color=INK, linewidth=0.8)
        axes.text(ends[1], ends[1], " what rounding the input costs", color=QUIET, fontsize=7, va="center")
        axes.text(ends[1], CONDITIONING_ROOM * ends[1], " a hundred times that", color=INK, fontsize=7, va="center")
        _powers(axes.xaxis, *axes.get_xlim())
        _powers(axes.yaxis, *axes.get_ylim())
        axes.set_xlabel("condition number × machine precision")
        axes.set_ylabel("error")
        return figure

    return drawn(
        build,
        caption="Relative errors against what the problem's condition number makes of one rounding (hollow: exactly "
        "zero). Above the upper line digits would be lost for no reason; cases whose bound is of a mesh or of a "
        "limit may lie above it, and say so.",
        alternative=f"Errors of {len(known)} cases against condition numbers; the tables below have the numbers.",
    )
