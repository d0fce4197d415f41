"""Plots of errors of numerically hard cases against their bounds, and against condition numbers."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure as Canvas

from cbsr_qa.report.draw.style import (
    BLUE,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    canvas,
    draw_svg,
    light_grid,
    name_rows,
    place_plain_ticks,
)
from cbsr_qa.studies.hard_cases.case import CONDITIONING_ROOM, EPSILON, CaseResult, Ending

_SUPERSCRIPTS: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: Where an error of exactly zero is drawn on a logarithmic axis.
_SHOWN_ZERO: Final = 1e-18


@draw_svg
def errors_svg(results: Sequence[CaseResult]) -> Canvas:
    """Draw the error of every case of an area, and its bound, on a logarithmic axis."""
    height = 0.8 + 0.15 * len(results)
    figure = canvas(height)
    axes = figure.add_axes((0.44, 0.5 / height, 0.54, 1 - 0.62 / height))
    light_grid(axes, "x")
    axes.set_xscale("log")
    for row, result in enumerate(results):
        if result.error is not None and result.bound is not None:
            error, bound = max(result.error, _SHOWN_ZERO), max(result.bound, _SHOWN_ZERO)
            axes.plot([error, bound], [row, row], color=FAINT, linewidth=0.8)
            axes.plot(bound, row, color=INK, marker="|", markersize=6, linestyle="none")
            _draw_case(axes, error, row, result, 3.2)
    _label_powers_of_ten(axes.xaxis)
    axes.set_xlabel("error (dot) and bound (bar), relative or in the case's own unit")
    name_rows(axes, [result.name for result in results], most=len(results))
    return figure


@draw_svg
def conditions_svg(results: Sequence[CaseResult]) -> Canvas:
    """Draw relative errors against condition number × machine precision, with lines at once and at 100 times that."""
    figure = canvas(3.1)
    axes = figure.add_axes((0.1, 0.15, 0.62, 0.8))
    light_grid(axes, "both")
    axes.set_xscale("log")
    axes.set_yscale("log")
    largest = EPSILON
    for result in results:
        if result.condition is not None and result.error is not None and result.unit == "1":
            rounding = result.condition * EPSILON
            largest = max(largest, rounding)
            _draw_case(axes, rounding, max(result.error, _SHOWN_ZERO), result, 3.6)
    ends = np.array([EPSILON / 3, 10 * largest])
    axes.plot(ends, ends, color=QUIET, linewidth=0.8)
    axes.plot(ends, CONDITIONING_ROOM * ends, color=INK, linewidth=0.8)
    axes.text(ends[1], ends[1], " what rounding the input costs", color=QUIET, fontsize=7, va="center")
    axes.text(ends[1], CONDITIONING_ROOM * ends[1], " a hundred times that", color=INK, fontsize=7, va="center")
    _label_powers_of_ten(axes.xaxis)
    _label_powers_of_ten(axes.yaxis)
    axes.set_xlabel("condition number × machine precision")
    axes.set_ylabel("error")
    return figure


def _draw_case(axes: Axes, x: float, y: float, result: CaseResult, size: float) -> None:
    """Draw a case: hollow if its error is exactly zero, red if it is broken."""
    colour = VERMILION if result.outcome is Ending.BROKEN else BLUE
    axes.plot(x, y, "o", color=colour, markersize=size, markerfacecolor=colour if result.error else "none")


def _label_powers_of_ten(axis: Axis) -> None:
    """Label a logarithmic axis at about every second power of ten."""
    low, high = np.log10(axis.get_view_interval())
    first, last = int(np.ceil(low)), int(np.floor(high))
    powers = range(first, last + 1, max(1, -(-(last - first) // 10)))
    ticks = [10.0**power for power in powers]
    place_plain_ticks(axis, ticks, lambda value: "10" + str(round(np.log10(value))).translate(_SUPERSCRIPTS))
