"""Noise figure against a regularisation parameter: candidates and choice."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator
from numpy.typing import NDArray

from cbsr_qa.domain.imaging import ParameterCurve
from cbsr_qa.report.draw.style import (
    BLUE,
    CYCLE,
    DASHED,
    FAINT,
    HAIR,
    INK,
    QUIET,
    annotate,
    canvas,
    draw_svg,
    note,
    plot,
)
from cbsr_qa.report.tables import number

_SHAPES: Final = "osD^vP"
_LARGEST: Final = 1e3  # noise figure drawn: above, an image is nothing but noise
_AROUND: Final = 3.0  # factor on both sides of the marks that is drawn large
_COUNTS_AROUND: Final = 8
_FEW: Final = 30  #: with fewer values those looked at are drawn as dots


@dataclass(frozen=True, slots=True)
class ParameterMark:
    """Choice of one criterion, and its noise figure; None if it has no answer."""

    title: str
    value: float | None
    noise_figure: float | None
    chosen: bool


@draw_svg
def parameter_figure(curve: ParameterCurve, marks: Sequence[ParameterMark], name: str) -> Canvas:
    """Draw the noise figure over all that was searched, with the chosen value, and again large around all marks.

    Criteria without an answer are named without a mark.
    """
    figure = canvas(2.35)
    label = name if curve.discrete else f"{name} (no unit)"
    boxes = ((0.07, 0.175, 0.3, 0.72), (0.44, 0.175, 0.29, 0.72))
    whole_search = plot(figure, boxes[0], "whole search", x=label, y="noise figure", grid="both")
    around_choices = plot(figure, boxes[1], "around the choices", x=label, grid="both")
    close_range = choose_range(curve, marks)
    for axes in (whole_search, around_choices):
        axes.set(yscale="log", xscale="linear" if curve.discrete else "log")
        _draw_curve(axes, curve)
    _draw_marks(whole_search, [(order, mark) for order, mark in enumerate(marks) if mark.chosen])
    _draw_marks(around_choices, list(enumerate(marks)))
    finite_figures = curve.noise_figures[np.isfinite(curve.noise_figures)]
    whole_search.set_ylim(0.7 * float(finite_figures.min()), 1.4 * min(float(finite_figures.max()), _LARGEST))
    whole_search.axvspan(*close_range, color=HAIR, linewidth=0, zorder=0)
    around_choices.set_xlim(*close_range)
    around_choices.set_ylim(*_heights(curve, marks, close_range))
    for axes in (whole_search, around_choices):
        _label_ticks(axes, discrete=curve.discrete)
    if curve.target is not None:
        look = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
        annotate(around_choices, f"target {curve.target:g}", (1.0, curve.target), (-2, 2), QUIET, **look)
    _name_marks(around_choices, marks, discrete=curve.discrete)
    return figure


def choose_range(curve: ParameterCurve, marks: Sequence[ParameterMark]) -> tuple[float, float]:
    """Return the stretch of the parameter that is drawn large."""
    mark_values = [mark.value for mark in marks if mark.value is not None] or [float(np.median(curve.values))]
    low, high = min(mark_values), max(mark_values)
    if curve.discrete:
        return max(low - _COUNTS_AROUND, 0.5), high + _COUNTS_AROUND
    return low / _AROUND, high * _AROUND


def value_text(value: float, *, discrete: bool) -> str:
    """Write a value of the parameter: a count as such."""
    return f"{value:.0f}" if discrete else number(value)


def _heights(
    curve: ParameterCurve, marks: Sequence[ParameterMark], across: tuple[float, float]
) -> tuple[float, float]:
    """Return limits that show the curve there, its marks and the target."""
    within: NDArray[np.bool_] = (curve.values >= across[0]) & (curve.values <= across[1])
    shown_figures = [float(value) for value in curve.noise_figures[within] if np.isfinite(value)]
    shown_figures += [mark.noise_figure for mark in marks if mark.noise_figure is not None]
    shown_figures += [] if curve.target is None else [curve.target]
    return min(shown_figures) / 1.25, min(max(shown_figures), _LARGEST) * 1.25


def _label_ticks(axes: Axes, *, discrete: bool) -> None:
    scales: list[tuple[Axis, tuple[float, float]]] = [(axes.yaxis, axes.get_ylim())]
    if discrete:
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    else:
        scales.append((axes.xaxis, axes.get_xlim()))
    for axis, (low, high) in scales:
        axis.set_major_locator(FixedLocator(log_ticks(low, high)))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: number(value, 1).removeprefix("1 × ")))


def log_ticks(low: float, high: float) -> list[float]:
    """Return round values between two limits: powers of ten, with 2 and 5 or more where the limits are close."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ratio = high / low
    steps = (1.0,) if ratio > 100 else (1.0, 2.0, 5.0) if ratio > 6 else (1.0, 2.0, 3.0, 4.0, 5.0, 7.0)
    ticks = [step * 10.0**power for power in powers for step in steps if low <= step * 10.0**power <= high]
    return ticks if ratio <= 100 else ticks[:: max(1, len(ticks) // 4)]


def _draw_curve(axes: Axes, curve: ParameterCurve) -> None:
    if curve.discrete or len(curve.values) < _FEW:
        axes.plot(curve.values, curve.noise_figures, color=FAINT, linewidth=0.6, zorder=2)
        axes.plot(curve.values, curve.noise_figures, color=BLUE, linestyle="", marker=".", markersize=3, zorder=3)
    else:
        axes.plot(curve.values, curve.noise_figures, color=BLUE, zorder=3)
    if curve.target is not None:
        axes.axhline(curve.target, color=QUIET, linewidth=0.8, linestyle=DASHED, zorder=1)


def _draw_marks(axes: Axes, marks: Sequence[tuple[int, ParameterMark]]) -> None:
    for order, mark in marks:
        if mark.value is not None and mark.noise_figure is not None:
            axes.plot([mark.value], [mark.noise_figure], **_look(order, chosen=mark.chosen))
            if mark.chosen:
                axes.axvline(mark.value, color=INK, linewidth=0.6, zorder=1)


def _look(order: int, *, chosen: bool) -> dict[str, Any]:
    """Return the look of a mark; the chosen one is full and drawn above the others."""
    colour = CYCLE[(order + 1) % len(CYCLE)]
    return {
        "marker": _SHAPES[order % len(_SHAPES)],
        "linestyle": "",
        "markersize": 6 if chosen else 5,
        "markeredgecolor": INK if chosen else colour,
        "markerfacecolor": INK if chosen else "white",
        "markeredgewidth": 1.1,
        "zorder": 6 if chosen else 5,
    }


def _name_marks(axes: Axes, marks: Sequence[ParameterMark], *, discrete: bool) -> None:
    """Write a key beside the axes: each criterion with its value and the noise figure there."""
    for order, mark in enumerate(marks):
        height = 0.97 - 0.25 * order
        value_words = "no answer"
        if mark.value is not None:
            value_words = value_text(mark.value, discrete=discrete)
            value_words += "" if mark.noise_figure is None else f", noise figure {number(mark.noise_figure)}"
            axes.plot([1.06], [height], transform=axes.transAxes, clip_on=False, **_look(order, chosen=mark.chosen))
        title = f"{mark.title} (chosen)" if mark.chosen else mark.title
        note(axes, 1.1, height, title, va="center", fontweight="bold" if mark.chosen else "normal")
        note(axes, 1.1, height - 0.085, value_words, QUIET, va="center")
