"""Relaxations: traces with their fits, and settling times (the paper's Figs D.19 to D.22).

Two relaxations side by side, and their difference within the margins of equivalence.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from cbsr_qa.analysis.run import DirectedAgreement
from cbsr_qa.calibration.fits import SHAPE_MARGIN, ComparedCurves, restricted_mean
from cbsr_qa.domain.results import Figure, FitStatus, RelaxationFit, RelaxationObservation
from cbsr_qa.report.draw.style import (
    BLUE,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    canvas,
    drawn,
    fit_left,
    light_grid,
)
from cbsr_qa.report.draw.time import thinned
from cbsr_qa.report.tables import unit_shown

#: Standard errors of an interval of 90 %: the one that two one-sided tests at 5 % hold against the margin.
_NINETY: Final = 1.6449


def agreement_figure(compared: Sequence[DirectedAgreement], *, caption: str, alternative: str) -> Figure:
    """Draw both curves (above) and their difference with its 90 % interval and the margin (below), by direction.

    Parameters
    ----------
    compared : one column each; those without curves say why.
    """

    def build() -> Canvas:
        height_in = 3.3
        figure = canvas(height_in)
        grid = figure.add_gridspec(
            2,
            len(compared),
            left=0.085,
            right=0.985,
            bottom=0.42 / height_in,
            top=1 - 0.25 / height_in,
            hspace=0.18,
            wspace=0.2,
            height_ratios=(1.2, 1.0),
        )
        labelled: list[Axes] = []
        for column, agreement in enumerate(compared):
            above, below = (figure.add_subplot(grid[row, column]) for row in range(2))
            _draw(above, below, agreement)
            if column == 0 and agreement.found.curves is not None:
                above.set_ylabel("over the change")
                below.set_ylabel("difference")
                labelled += [above, below]
        fit_left(figure, grid, labelled)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _draw(above: Axes, below: Axes, agreement: DirectedAgreement) -> None:
    curves, after = agreement.found.curves, "press" if agreement.loading else "release"
    above.set_title(f"after the {after}", fontweight="normal")
    if curves is None:
        above.text(0.5, 0.5, "not compared", transform=above.transAxes, ha="center", color=QUIET)
        above.set_axis_off()
        below.set_axis_off()
        return
    _draw_curves(above, curves, agreement)
    _draw_difference(below, curves, str(agreement.found.shape))


def _draw_curves(axes: Axes, curves: ComparedCurves, agreement: DirectedAgreement) -> None:
    light_grid(axes)
    for values, stderr, colour, words in (
        (curves.first, curves.first_stderr, VERMILION, agreement.first),
        (curves.second, curves.second_stderr, BLUE, agreement.second),
    ):
        band = _NINETY * stderr
        axes.fill_between(curves.time_s, values - band, values + band, color=colour, alpha=0.15, linewidth=0)
        axes.plot(curves.time_s, values, color=colour, linewidth=1.1, label=words)
    axes.set_xlim(0, float(curves.time_s[-1]))
    axes.tick_params(labelbottom=False)
    axes.legend(frameon=False, fontsize=7, loc="lower right" if agreement.loading else "upper right")


def _draw_difference(axes: Axes, curves: ComparedCurves, words: str) -> None:
    light_grid(axes)
    band = _NINETY * curves.stderr
    difference = curves.difference
    axes.axhspan(-SHAPE_MARGIN, SHAPE_MARGIN, color=QUIET, alpha=0.12, linewidth=0)
    axes.fill_between(curves.time_s, difference - band, difference + band, color=BLUE, alpha=0.25, linewidth=0)
    axes.plot(curves.time_s, difference, color=INK, linewidth=1.0)
    axes.set_xlim(0, float(curves.time_s[-1]))
    reach = max(1.6 * SHAPE_MARGIN, 1.15 * float((abs(difference) + band).max()))
    axes.set_ylim(-reach, reach)
    axes.set_xlabel("time since the end of the ramp [s]")
    axes.text(0.98, 0.95, words, transform=axes.transAxes, ha="right", va="top", fontsize=7, color=INK)


_DIRECTIONS: Final = ((True, "after the press"), (False, "after the release"))

#: Points per trace behind the one that is pointed out.
_QUIET_POINTS: Final = 90


@dataclass(frozen=True, slots=True, eq=False)
class SettledLoad:
    """The relaxations of one load.

    Parameters
    ----------
    label : e.g. ``"L3"``.
    group : the phase it belongs to.
    strain : as a fraction.
    relaxations : of all signals and both directions.
    """

    label: str
    group: str
    strain: float
    relaxations: tuple[RelaxationObservation, ...]

    def one(self, signal: str, loading: bool) -> RelaxationObservation | None:
        """Return the relaxation of a signal in a direction; None where there is none."""
        return next((r for r in self.relaxations if r.signal == signal and r.loading == loading), None)


def relaxation_value(fit: RelaxationFit, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Evaluate G(t) = a₀ + Σ aᵢ e^(−t/τᵢ) (paper Eq 3).

    Parameters
    ----------
    time_s : (n,) from the end of the ramp [s].
    """
    terms = zip(fit.amplitudes, fit.time_constants_s, strict=True)
    return fit.offset + sum((a * np.exp(-time_s / tau) for a, tau in terms), np.zeros_like(time_s))


def relaxation_figure(
    loads: Sequence[SettledLoad], shown: SettledLoad, signals: Sequence[str], *, caption: str, alternative: str
) -> Figure:
    """Draw the traces of all loads in grey and one with its fit, settling band and settling time.

    Parameters
    ----------
    shown : the load that is pointed out.
    signals : one row each.
    """

    def build() -> Canvas:
        height_in = 1.75 * len(signals) + 0.45
        figure = canvas(height_in)
        grid = figure.add_gridspec(
            len(signals),
            2,
            left=0.085,
            right=0.985,
            bottom=0.42 / height_in,
            top=1 - 0.25 / height_in,
            hspace=0.34,
            wspace=0.2,
        )
        labelled: list[Axes] = []
        for row, signal in enumerate(signals):
            for column, (loading, words) in enumerate(_DIRECTIONS):
                axes = figure.add_subplot(grid[row, column])
                light_grid(axes)
                _draw_quiet(axes, [load.one(signal, loading) for load in loads if load is not shown])
                _draw_fit(axes, shown.one(signal, loading))
                axes.set_title(f"{signal} {words}", fontweight="normal")
                axes.set_xlim(left=0)
                if row == len(signals) - 1:
                    axes.set_xlabel("time since the end of the ramp [s]")
                if column == 0:
                    axes.set_ylabel(_axis_label(signal, loads))
                    labelled.append(axes)
        fit_left(figure, grid, labelled)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def settling_figure(
    loads: Sequence[SettledLoad], signals: Sequence[str], *, caption: str, alternative: str
) -> Figure:
    """Draw settling times in the order of the loads, or against strain where there are several strains.

    Filled: after the press. Open: after the release. An arrow stands for "later than this".
    """

    def build() -> Canvas:
        height_in = 1.55 * len(signals) + 0.75
        figure = canvas(height_in)
        grid = figure.add_gridspec(
            len(signals), 1, left=0.075, right=0.86, bottom=0.62 / height_in, top=1 - 0.2 / height_in, hspace=0.3
        )
        for row, signal in enumerate(signals):
            axes = figure.add_subplot(grid[row])
            light_grid(axes)
            for loading, words in _DIRECTIONS:
                _draw_settling(axes, loads, signal, loading, words)
            axes.set_ylim(0, 1.12 * _latest(loads, signal))
            axes.set_xlim(-0.8, len(loads) - 0.2)
            axes.set_title(signal, fontweight="normal")
            axes.set_ylabel("settling [s]")
            _name_columns(axes, loads, last=row == len(signals) - 1)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _draw_quiet(axes: Axes, relaxations: Sequence[RelaxationObservation | None]) -> None:
    lines = []
    for relaxation in relaxations:
        if relaxation is not None and len(relaxation.trace.values):
            lines.append(np.column_stack(thinned(relaxation.trace.time_s, relaxation.trace.values, _QUIET_POINTS)))
    if lines:
        axes.add_collection(LineCollection(lines, colors=FAINT, linewidths=0.5, zorder=1.5))
        axes.autoscale_view()


def _draw_fit(axes: Axes, relaxation: RelaxationObservation | None) -> None:
    if relaxation is None or not len(relaxation.trace.values):
        axes.text(0.5, 0.5, "not recorded", transform=axes.transAxes, ha="center", color=QUIET)
        axes.set_axis_off()
        return
    time_s, values = thinned(relaxation.trace.time_s, relaxation.trace.values, 240)
    axes.plot(time_s, values, linestyle="none", marker="o", markersize=2, color=BLUE, markeredgewidth=0, zorder=3)
    fit, settling = relaxation.fit, relaxation.settling
    if fit.status in (FitStatus.REJECTED, FitStatus.DRIFTING):
        ending = f"fit rejected: R² {fit.r_squared:.2f}" if fit.status is FitStatus.REJECTED else fit.status.value
        axes.text(0.98, 0.95, ending, transform=axes.transAxes, ha="right", va="top")
        return
    fine = np.linspace(0.0, float(relaxation.trace.time_s[-1]), 160)
    axes.plot(fine, relaxation_value(fit, fine), color=INK, linewidth=1.1, zorder=4)
    axes.axhspan(fit.offset - settling.band, fit.offset + settling.band, color="#0072b2", alpha=0.09, linewidth=0)
    if settling.value_s is not None:
        _draw_time(axes, settling.value_s, float(relaxation.trace.time_s[-1]), late=settling.censored)


def _draw_time(axes: Axes, settled_s: float, end_s: float, *, late: bool) -> None:
    """Mark a settling time, with its words on the side where there is room."""
    sign = "≥ " if late else ""
    axes.axvline(settled_s, color=VERMILION, linewidth=0.9, linestyle=(0, (4, 2)), zorder=2)
    label = f"settled {sign}{settled_s:.1f} s"
    right = settled_s > 0.6 * end_s
    shift = (-3, -2) if right else (3, -2)
    place = (settled_s, 1.0)
    across = ("data", "axes fraction")
    text = axes.annotate(label, place, shift, xycoords=across, textcoords="offset points", va="top", fontsize=7)
    text.set(color=VERMILION, ha="right" if right else "left")


def _draw_settling(axes: Axes, loads: Sequence[SettledLoad], signal: str, loading: bool, words: str) -> None:
    colour, shift = (BLUE, -0.13) if loading else (VERMILION, 0.13)
    face = colour if loading else "white"
    relaxations = [(index, load.one(signal, loading)) for index, load in enumerate(loads)]
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
    mean_s, _ = restricted_mean([value for _, value, _ in times], [censored for _, _, censored in times])
    axes.axhline(mean_s, color=colour, linewidth=0.8, linestyle="solid" if loading else (0, (4, 2)))
    height = 0.9 if loading else 0.62
    axes.text(1.015, height, words, transform=axes.transAxes, color=colour, va="top", fontsize=7)
    bound = "≥ " if any(censored for _, _, censored in times) else ""
    summary = f"mean {bound}{mean_s:.1f} s"
    axes.text(1.015, height - 0.11, summary, transform=axes.transAxes, color=QUIET, va="top", fontsize=7)


def _latest(loads: Sequence[SettledLoad], signal: str) -> float:
    times = [r.settling.value_s for load in loads for r in load.relaxations if r.signal == signal]
    return max((value for value in times if value), default=1.0)


def _name_columns(axes: Axes, loads: Sequence[SettledLoad], *, last: bool) -> None:
    axes.tick_params(axis="x", length=0)
    every = max(1, len(loads) // 30)
    places = list(range(0, len(loads), every))
    axes.set_xticks(places, [loads[place].label for place in places] if last else [""] * len(places))
    starts = [i for i, load in enumerate(loads) if i == 0 or load.group != loads[i - 1].group]
    for start in starts[1:]:
        axes.axvline(start - 0.5, color=FAINT, linewidth=0.6)
    if last:
        for start in starts:
            offset = (0, -15)
            at = ("data", "axes fraction")
            words = loads[start].group
            axes.annotate(
                words, (start - 0.4, 0), offset, xycoords=at, textcoords="offset points", va="top", fontsize=6.5
            )
            axes.texts[-1].set_color(QUIET)


def _axis_label(signal: str, loads: Sequence[SettledLoad]) -> str:
    unit = next((r.trace.unit for load in loads for r in load.relaxations if r.signal == signal), "")
    shown = unit_shown(unit)
    return f"{signal} [{shown}]" if shown else f"{signal} change"
