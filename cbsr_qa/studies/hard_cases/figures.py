"""Plots of errors of numerically hard cases against their bounds, and against condition numbers."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from cbsr_qa.report.draw import BLUE, FAINT, INK, QUIET, VERMILION, canvas, light_grid, name_rows, svg_of
from cbsr_qa.studies.hard_cases.case import CONDITIONING_ROOM, EPSILON, CaseResult, Ending

_SUPERSCRIPTS: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_EXACT: Final = 1e-18  # position of errors that are exactly zero


def errors_svg(results: Sequence[CaseResult]) -> str:
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
        name_rows(axes, [result.name for result in results], most=len(results))
        return figure

    return svg_of(build)


def _error(axes: Axes, row: int, result: CaseResult) -> None:
    if result.error is None or result.bound is None:
        return
    error, bound = max(result.error, _EXACT), max(result.bound, _EXACT)
    colour = VERMILION if result.outcome is Ending.BROKEN else BLUE
    axes.plot([error, bound], [row, row], color=FAINT, linewidth=0.8)
    axes.plot(bound, row, color=INK, marker="|", markersize=6, linestyle="none")
    filled = colour if result.error > 0 else "none"
    axes.plot(error, row, color=colour, marker="o", markersize=3.2, markerfacecolor=filled, linestyle="none")


def _powers(axis: Axis, low: float, high: float) -> None:
    """Label a logarithmic axis at about every second power of ten."""
    first, last = int(np.ceil(np.log10(low))), int(np.floor(np.log10(high)))
    powers = range(first, last + 1, max(1, -(-(last - first) // 10)))
    axis.set_major_locator(FixedLocator([10.0**power for power in powers]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(
        FuncFormatter(lambda value, _: "10" + str(round(np.log10(value))).translate(_SUPERSCRIPTS))
    )


def conditions_svg(results: Sequence[CaseResult]) -> str:
    """Draw errors against condition number times machine precision, with lines of once and a hundred times it."""
    known = [
        (result.condition * EPSILON, result.error, result.outcome)
        for result in results
        if result.condition is not None and result.error is not None and result.unit == "1"
    ]

    def build() -> Canvas:
        figure = canvas(3.1)
        axes = figure.add_axes((0.1, 0.15, 0.62, 0.8))
        light_grid(axes, "both")
        axes.set_xscale("log")
        axes.set_yscale("log")
        for across, error, outcome in known:
            filled = BLUE if error > 0 else "none"
            colour = VERMILION if outcome is Ending.BROKEN else BLUE
            axes.plot(
                across,
                max(error, _EXACT),
                "o",
                color=colour,
                markersize=3.6,
                markerfacecolor=filled,
                linestyle="none",
            )
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

    return svg_of(build)
