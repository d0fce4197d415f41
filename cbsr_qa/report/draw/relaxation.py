"""Relaxations with their fits and settling times (the paper's Figs D.19 to D.22), and two of them compared."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure as Canvas
from matplotlib.gridspec import GridSpec

from cbsr_qa.analysis.run.agreement import DirectedAgreement
from cbsr_qa.calibration.fits.agreement import SHAPE_MARGIN, ComparedCurves
from cbsr_qa.calibration.fits.settling import estimate_restricted_mean
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.observation import RelaxationObservation
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit
from cbsr_qa.report.draw.style import (
    BLUE,
    DASHED,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    annotate,
    canvas,
    draw_svg,
    fit_left,
    note,
    plot,
)
from cbsr_qa.report.draw.time import thin_trace
from cbsr_qa.report.tables import unit_shown

#: Standard errors of an interval of 90 %: the one that two one-sided tests at 5 % compare with the margin.
_NINETY: Final = 1.6449


@draw_svg
def agreement_figure(compared: Sequence[DirectedAgreement]) -> Canvas:
    """Draw both curves (above) and their difference with its 90 % interval and the margin (below), by direction."""
    figure, grid = _panels(3.3, 2, len(compared), hspace=0.18, height_ratios=(1.2, 1.0))
    labelled: list[Axes] = []
    for column, agreement in enumerate(compared):
        curves, direction = agreement.found.curves, "press" if agreement.loading else "release"
        upper_axes = plot(figure, grid[0, column], f"after the {direction}")
        if curves is None:
            note(upper_axes, 0.5, 0.5, "not compared", QUIET, ha="center")
            upper_axes.set_axis_off()
            continue
        lower_axes = plot(figure, grid[1, column], x=_TIME_LABEL)
        _draw_curves(upper_axes, curves, agreement)
        _draw_difference(lower_axes, curves, str(agreement.found.shape))
        if column == 0:
            upper_axes.set_ylabel("share of the change")
            lower_axes.set_ylabel("difference")
            labelled += [upper_axes, lower_axes]
    fit_left(figure, grid, labelled)
    return figure


def _panels(height_in: float, rows: int, columns: int, **spaces: Any) -> tuple[Canvas, GridSpec]:
    """A figure of panels that share their time axis; ``spaces`` as of matplotlib's grid."""
    figure = canvas(height_in)
    edges = {"left": 0.085, "right": 0.985, "bottom": 0.42 / height_in, "top": 1 - 0.25 / height_in, "wspace": 0.2}
    return figure, figure.add_gridspec(rows, columns, **(edges | spaces))


def _draw_curves(axes: Axes, curves: ComparedCurves, agreement: DirectedAgreement) -> None:
    for values, stderr, colour, label in (
        (curves.first, curves.first_stderr, VERMILION, agreement.first),
        (curves.second, curves.second_stderr, BLUE, agreement.second),
    ):
        band = _NINETY * stderr
        axes.fill_between(curves.time_s, values - band, values + band, color=colour, alpha=0.15, linewidth=0)
        axes.plot(curves.time_s, values, color=colour, linewidth=1.1, label=label)
    axes.set_xlim(0, float(curves.time_s[-1]))
    axes.tick_params(labelbottom=False)
    axes.legend(frameon=False, fontsize=7, loc="lower right" if agreement.loading else "upper right")


def _draw_difference(axes: Axes, curves: ComparedCurves, words: str) -> None:
    band = _NINETY * curves.stderr
    difference = curves.difference
    axes.axhspan(-SHAPE_MARGIN, SHAPE_MARGIN, color=QUIET, alpha=0.12, linewidth=0)
    axes.fill_between(curves.time_s, difference - band, difference + band, color=BLUE, alpha=0.25, linewidth=0)
    axes.plot(curves.time_s, difference, color=INK, linewidth=1.0)
    axes.set_xlim(0, float(curves.time_s[-1]))
    reach = max(1.6 * SHAPE_MARGIN, 1.15 * float((abs(difference) + band).max()))
    axes.set_ylim(-reach, reach)
    note(axes, 0.98, 0.95, words, ha="right", va="top")


_TIME_LABEL: Final = "time since the end of the ramp [s]"
_DIRECTIONS: Final = ((True, "after the press"), (False, "after the release"))

#: Points per trace behind the one that is pointed out.
_QUIET_POINTS: Final = 90


@dataclass(frozen=True, slots=True, eq=False)
class SettledLoad:
    """The relaxations of one load, all signals and both directions; ``group`` is its phase, ``strain`` a fraction."""

    label: str
    group: str
    strain: float
    relaxations: tuple[RelaxationObservation, ...]

    def find(self, signal: str, loading: bool) -> RelaxationObservation | None:
        """Return the relaxation of a signal in a direction; None without one."""
        return next((r for r in self.relaxations if r.signal == signal and r.loading == loading), None)


def relaxation_value(fit: RelaxationFit, time_s: Array) -> Array:
    """Evaluate G(t) = a₀ + Σ aᵢ e^(−t/τᵢ) (paper Eq 3) at times (n,) from the end of the ramp [s]."""
    terms = zip(fit.amplitudes, fit.time_constants_s, strict=True)
    return fit.offset + sum((a * np.exp(-time_s / tau) for a, tau in terms), np.zeros_like(time_s))


@draw_svg
def relaxation_figure(loads: Sequence[SettledLoad], shown: SettledLoad, signals: Sequence[str]) -> Canvas:
    """Draw a row for each signal: all loads in grey, one with its fit, settling band and settling time."""
    figure, grid = _panels(1.75 * len(signals) + 0.45, len(signals), 2, hspace=0.34)
    labelled: list[Axes] = []
    for row, signal in enumerate(signals):
        units = (r.trace.unit for load in loads for r in load.relaxations if r.signal == signal)
        unit = unit_shown(next(units, ""))
        for column, (loading, direction) in enumerate(_DIRECTIONS):
            axes = plot(figure, grid[row, column], f"{signal} {direction}")
            _draw_quiet(axes, [load.find(signal, loading) for load in loads if load is not shown])
            _draw_fit(axes, shown.find(signal, loading))
            axes.set_xlim(left=0)
            if row == len(signals) - 1:
                axes.set_xlabel(_TIME_LABEL)
            if column == 0:
                axes.set_ylabel(f"{signal} [{unit}]" if unit else f"{signal} change")
                labelled.append(axes)
    fit_left(figure, grid, labelled)
    return figure


@draw_svg
def settling_figure(loads: Sequence[SettledLoad], signals: Sequence[str]) -> Canvas:
    """Draw settling times in the order of the loads, or against strain where there are several strains.

    Filled: after the press. Open: after the release. An arrow stands for "later than this".
    """
    height_in = 1.55 * len(signals) + 0.75
    edges = {"left": 0.075, "right": 0.86, "bottom": 0.62 / height_in, "top": 1 - 0.2 / height_in}
    figure, grid = _panels(height_in, len(signals), 1, hspace=0.3, **edges)
    for row, signal in enumerate(signals):
        axes = plot(figure, grid[row], signal, y="settling [s]")
        for loading, direction in _DIRECTIONS:
            _draw_settling(axes, loads, signal, loading, direction)
        times = [r.settling.value_s for load in loads for r in load.relaxations if r.signal == signal]
        latest = max((value for value in times if value), default=1.0)
        axes.set_ylim(0, 1.12 * latest)
        axes.set_xlim(-0.8, len(loads) - 0.2)
        _name_columns(axes, loads, last=row == len(signals) - 1)
    return figure


def _draw_quiet(axes: Axes, relaxations: Sequence[RelaxationObservation | None]) -> None:
    lines = []
    for relaxation in relaxations:
        if relaxation is not None and len(relaxation.trace.values):
            lines.append(np.column_stack(thin_trace(relaxation.trace.time_s, relaxation.trace.values, _QUIET_POINTS)))
    if lines:
        axes.add_collection(LineCollection(lines, colors=FAINT, linewidths=0.5, zorder=1.5))
        axes.autoscale_view()


def _draw_fit(axes: Axes, relaxation: RelaxationObservation | None) -> None:
    if relaxation is None or not len(relaxation.trace.values):
        note(axes, 0.5, 0.5, "not recorded", QUIET, ha="center")
        axes.set_axis_off()
        return
    time_s, values = thin_trace(relaxation.trace.time_s, relaxation.trace.values, 240)
    axes.plot(time_s, values, linestyle="none", marker="o", markersize=2, color=BLUE, markeredgewidth=0, zorder=3)
    fit, settling = relaxation.fit, relaxation.settling
    if fit.status in (FitStatus.REJECTED, FitStatus.DRIFTING):
        ending = f"fit rejected: R² {fit.r_squared:.2f}" if fit.status is FitStatus.REJECTED else fit.status.value
        note(axes, 0.98, 0.95, ending, ha="right", va="top")
        return
    fine = np.linspace(0.0, float(relaxation.trace.time_s[-1]), 160)
    axes.plot(fine, relaxation_value(fit, fine), color=INK, linewidth=1.1, zorder=4)
    axes.axhspan(fit.offset - settling.band, fit.offset + settling.band, color="#0072b2", alpha=0.09, linewidth=0)
    if settling.value_s is not None:
        _draw_time(axes, settling.value_s, float(relaxation.trace.time_s[-1]), late=settling.censored)


def _draw_time(axes: Axes, settled_s: float, end_s: float, *, late: bool) -> None:
    """Mark a settling time, with its label on the side with room."""
    sign = "≥ " if late else ""
    axes.axvline(settled_s, color=VERMILION, linewidth=0.9, linestyle=DASHED, zorder=2)
    ha, shift = ("right", (-3, -2)) if settled_s > 0.6 * end_s else ("left", (3, -2))
    label, across = f"settled {sign}{settled_s:.1f} s", ("data", "axes fraction")
    annotate(axes, label, (settled_s, 1.0), shift, VERMILION, xycoords=across, ha=ha, va="top")


def _draw_settling(axes: Axes, loads: Sequence[SettledLoad], signal: str, loading: bool, words: str) -> None:
    colour, shift = (BLUE, -0.13) if loading else (VERMILION, 0.13)
    face = colour if loading else "white"
    relaxations = [(index, load.find(signal, loading)) for index, load in enumerate(loads)]
    times = [
        (i + shift, r.settling.value_s, r.settling.censored)
        for i, r in relaxations
        if r and r.settling.value_s is not None
    ]
    for censored, symbol in ((False, "o"), (True, "^")):
        points = [(x, value) for x, value, is_censored in times if is_censored == censored]
        if points:
            x, y = zip(*points, strict=True)
            axes.scatter(x, y, s=17, marker=symbol, facecolors=face, edgecolors=colour, linewidths=0.9, zorder=3)
    if not times or 2 * len(times) < sum(r is not None for _, r in relaxations):
        return
    mean_s, _ = estimate_restricted_mean([value for _, value, _ in times], [censored for _, _, censored in times])
    axes.axhline(mean_s, color=colour, linewidth=0.8, linestyle="solid" if loading else DASHED)
    height = 0.9 if loading else 0.62
    note(axes, 1.015, height, words, colour, va="top")
    bound = "≥ " if any(censored for _, _, censored in times) else ""
    note(axes, 1.015, height - 0.11, f"mean {bound}{mean_s:.1f} s", QUIET, va="top")


def _name_columns(axes: Axes, loads: Sequence[SettledLoad], *, last: bool) -> None:
    axes.tick_params(axis="x", length=0)
    every = max(1, len(loads) // 30)
    places = list(range(0, len(loads), every))
    axes.set_xticks(places, [loads[place].label for place in places] if last else [""] * len(places))
    starts = [i for i, load in enumerate(loads) if i == 0 or load.group != loads[i - 1].group]
    for start in starts[1:]:
        axes.axvline(start - 0.5, color=FAINT, linewidth=0.6)
    for start in starts if last else ():
        under = {"xycoords": ("data", "axes fraction"), "va": "top", "fontsize": 6.5}
        annotate(axes, loads[start].group, (start - 0.4, 0), (0, -15), QUIET, **under)
