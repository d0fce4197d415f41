"""A loop of output against stress, and how far its branches lie apart."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.calibrate.hysteresis import LoopCurve
from cbsr_qa.domain.report import Figure
from cbsr_qa.report.style import BLUE, FAINT, QUIET, VERMILION, canvas, light_grid
from cbsr_qa.report.svg import drawn


def loop_figure(curves: Sequence[LoopCurve], read: Sequence[LoopCurve], *, caption: str, alternative: str) -> Figure:
    """Draw the branches of every place, and their difference at equal stress.

    Parameters
    ----------
    curves : of the places, without what had not relaxed.
    read : the same as they were read; may be empty.
    """

    def build() -> Canvas:
        figure = canvas(2.75)
        left = figure.add_axes((0.075, 0.16, 0.39, 0.74))
        right = figure.add_axes((0.575, 0.16, 0.41, 0.74))
        light_grid(left)
        light_grid(right)
        for curve in curves:
            _draw_loop(left, curve)
            _draw_difference(right, curve)
        for curve in read:
            falling = slice(curve.peak + 1, None)
            right.plot(curve.stress_kPa[falling], 100 * curve.difference, "x", markersize=4, color=QUIET, zorder=2.5)
        left.set_ylabel("output [% of span]")
        left.set_title("way up (filled) and down (open)", fontweight="normal")
        right.axhline(0.0, color=FAINT, linewidth=0.9, zorder=1.5)
        right.set_ylabel("down less up [% of span]")
        right.set_title("difference at equal stress", fontweight="normal")
        end = 1.04 * max(float(curve.stress_kPa[curve.peak]) for curve in curves)
        for axes in (left, right):
            axes.set_xlim(0.0, end)
            axes.set_xlabel("stress [kPa]")
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _draw_loop(axes: Axes, curve: LoopCurve) -> None:
    peak, stress, output = curve.peak, curve.stress_kPa, 100 * curve.output
    up = slice(0, peak + 1)
    axes.plot(np.append(0.0, stress[up]), np.append(0.0, output[up]), color=BLUE, linewidth=0.9, zorder=2)
    axes.plot(stress[up], output[up], "o", markersize=4, color=BLUE, zorder=3)
    axes.plot(stress[peak:], output[peak:], color=VERMILION, linewidth=0.9, linestyle="--", zorder=2)
    axes.plot(
        stress[peak + 1 :], output[peak + 1 :], "o", markersize=4, color=VERMILION, markerfacecolor="white", zorder=3
    )


def _draw_difference(axes: Axes, curve: LoopCurve) -> None:
    axes.errorbar(
        curve.stress_kPa[curve.peak + 1 :],
        100 * curve.difference,
        yerr=100 * curve.stderr,
        fmt="o",
        markersize=4,
        color=VERMILION,
        markerfacecolor="white",
        elinewidth=0.9,
        zorder=3,
    )
