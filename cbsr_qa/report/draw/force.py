"""Force estimated against measured, and what the readings' change is over what the quasi-static line predicts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from cbsr_qa.domain.results import Figure
from cbsr_qa.report.draw.style import BLUE, FAINT, INK, QUIET, VERMILION, canvas, drawn, light_grid

Array = NDArray[np.float64]

#: Errors of one response for the sheet that exceed all others by more than this are marks at the edge: drawn to scale
#: they would flatten what the panel is about.
_FURTHEST: Final = 1.5
_BANDS: Final = ((2.0, 0.10), (1.0, 0.16))
_STEPS: Final = 60


@dataclass(frozen=True, slots=True, eq=False)
class ForcePanel:
    """Loads as one way of estimating has them.

    Parameters
    ----------
    title : over the panel.
    measured_N, estimated_N, stderr_N : (n,) each.
    sampled : (n,) loads at random places; the others are drawn as open marks.
    missed_N : forces of the loads without an estimate.
    """

    title: str
    measured_N: Array
    estimated_N: Array
    stderr_N: Array
    sampled: NDArray[np.bool_]
    missed_N: Array


def force_figure(panels: Sequence[ForcePanel], flat: ForcePanel | None, *, caption: str, alternative: str) -> Figure:
    """Draw estimated against measured force, and below it the errors with bands of one and two stated errors.

    Parameters
    ----------
    panels : one or two, each with a load.
    flat : the same loads with one response for the whole sheet, drawn faintly among the errors.
    """

    def build() -> Canvas:
        figure = canvas(4.9)
        largest = _largest_N(panels, flat)
        reach = _reach_N(panels, flat)
        for number, panel in enumerate(panels):
            left = 0.075 + 0.5 * number
            above = figure.add_axes((left, 0.50, 0.41, 0.455))
            below = figure.add_axes((left, 0.09, 0.41, 0.345), sharex=above)
            _draw_estimates(above, panel, largest)
            _draw_errors(below, panel, flat, largest, reach)
            if number == 0:
                above.set_ylabel("estimated force [N]")
                below.set_ylabel("estimated − measured [N]")
            below.set_xlabel("measured force [N]")
        return figure

    return drawn(build, caption=caption, alternative=alternative)


@dataclass(frozen=True, slots=True, eq=False)
class RatioPoints:
    """Seen over predicted change of the loads of a calibration.

    Parameters
    ----------
    force_N, raw : (n,) force, and the ratio as it is, what its place does included.
    placed, stderr : (n,) the ratio over the map at its place, and the standard error of one load.
    line_N, line : (k,) forces and what the fitted line predicts over what the material's does, level removed.
    band : (k,) its standard error; zeros where no intercept was fitted.
    """

    force_N: Array
    raw: Array
    placed: Array
    stderr: Array
    line_N: Array
    line: Array
    band: Array


def ratio_figure(points: RatioPoints, *, caption: str, alternative: str) -> Figure:
    """Draw the ratio against force: as seen, and with what the map explains taken out.

    Parameters
    ----------
    points : at least one.
    """

    def build() -> Canvas:
        figure = canvas(2.5)
        axes = figure.add_axes((0.075, 0.175, 0.55, 0.74))
        side = figure.add_axes((0.715, 0.175, 0.275, 0.74))
        _draw_ratios(axes, points)
        _draw_deviations(side, points)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _largest_N(panels: Sequence[ForcePanel], flat: ForcePanel | None) -> float:
    values = [v for p in panels for v in (p.measured_N, p.estimated_N, p.missed_N)]
    values += [flat.measured_N] if flat is not None else []
    return 1.06 * max([float(part.max()) for part in values if len(part)] + [1e-6])


def _reach_N(panels: Sequence[ForcePanel], flat: ForcePanel | None) -> float:
    """Half the height of the panels of errors: all errors, and those of one response as far as there is room."""
    own = [np.abs(p.estimated_N - p.measured_N) + 0.0 * p.stderr_N for p in panels]
    stated = [2 * p.stderr_N for p in panels]
    most = max([float(part.max()) for part in (*own, *stated) if len(part)] + [1e-6])
    if flat is None or not len(flat.measured_N):
        return 1.12 * most
    beside = float(np.abs(flat.estimated_N - flat.measured_N).max())
    return 1.12 * max(most, min(beside, _FURTHEST * most))


def _draw_estimates(axes: Axes, panel: ForcePanel, largest_N: float) -> None:
    light_grid(axes, "both")
    axes.plot([0, largest_N], [0, largest_N], color=INK, linewidth=0.7, zorder=2)
    _points(axes, panel, panel.estimated_N, panel.stderr_N)
    if len(panel.missed_N):
        axes.plot(panel.missed_N, np.zeros(len(panel.missed_N)), linestyle="", marker="x", color=VERMILION,
                  markersize=5, markeredgewidth=1.1, clip_on=False, zorder=5)  # fmt: skip
    axes.set_xlim(0, largest_N)
    axes.set_ylim(min(0.0, float(panel.estimated_N.min(initial=0.0)) * 1.06), largest_N)
    axes.tick_params(axis="x", labelbottom=False)
    axes.set_title(panel.title, fontweight="normal")


def _draw_errors(axes: Axes, panel: ForcePanel, flat: ForcePanel | None, largest_N: float, reach_N: float) -> None:
    light_grid(axes)
    force = np.linspace(0, largest_N, _STEPS)
    stated = stated_error(panel.measured_N, panel.stderr_N, force)
    for times, alpha in _BANDS:
        axes.fill_between(force, -times * stated, times * stated, color=BLUE, alpha=alpha, linewidth=0, zorder=1)
    axes.axhline(0.0, color=INK, linewidth=0.7, zorder=2)
    if flat is not None:
        error = flat.estimated_N - flat.measured_N
        shown = np.abs(error) <= reach_N
        axes.plot(flat.measured_N[shown], error[shown], linestyle="", marker="D", markersize=2.6,
                  markerfacecolor="none", markeredgecolor=QUIET, markeredgewidth=0.6, zorder=2.5)  # fmt: skip
        for upwards in (True, False):
            out = ~shown & ((error > 0) == upwards)
            axes.plot(flat.measured_N[out], np.full(int(out.sum()), 0.985 * reach_N * (1 if upwards else -1)),
                      linestyle="", marker="^" if upwards else "v", markersize=3.4, markerfacecolor="none",
                      markeredgecolor=QUIET, markeredgewidth=0.6, clip_on=False, zorder=2.5)  # fmt: skip
    _points(axes, panel, panel.estimated_N - panel.measured_N, None)
    axes.set_ylim(-reach_N, reach_N)


def _points(axes: Axes, panel: ForcePanel, values: Array, errors: Array | None) -> None:
    for which, face in ((panel.sampled, BLUE), (~panel.sampled, "white")):
        axes.errorbar(panel.measured_N[which], values[which], yerr=None if errors is None else errors[which],
                      fmt="o", markersize=3.3, color=BLUE, markerfacecolor=face, markeredgewidth=0.8,
                      elinewidth=0.8, zorder=4)  # fmt: skip


def stated_error(measured_N: Array, stderr_N: Array, force_N: Array) -> Array:
    """Stated standard error against force (k,), as √(a + b F²) with a, b ≥ 0 by least squares of the squares.

    Noise of the readings does not grow with force, errors of the map and the line do.
    """
    if not len(measured_N):
        return np.zeros(len(force_N))
    square, variance = measured_N**2, stderr_N**2
    centred = square - square.mean()
    spread = float(centred @ centred)
    slope = max(float(centred @ variance) / spread, 0.0) if spread > 0 else 0.0
    level = float(variance.mean()) - slope * float(square.mean())
    if level < 0:
        level, slope = 0.0, float(square @ variance) / float(square @ square)
    found: Array = np.sqrt(level + slope * force_N**2)
    return found


def _draw_ratios(axes: Axes, points: RatioPoints) -> None:
    light_grid(axes)
    axes.plot(points.force_N, points.raw, linestyle="", marker="D", markersize=2.6, markerfacecolor="none",
              markeredgecolor=QUIET, markeredgewidth=0.6, zorder=2)  # fmt: skip
    axes.errorbar(points.force_N, points.placed, yerr=points.stderr, fmt="o", markersize=3.3, color=BLUE,
                  elinewidth=0.8, zorder=4)  # fmt: skip
    axes.fill_between(points.line_N, points.line - points.band, points.line + points.band, color=VERMILION,
                      alpha=0.15, linewidth=0, zorder=1)  # fmt: skip
    axes.plot(points.line_N, points.line, color=VERMILION, linewidth=1.0, zorder=3)
    axes.axhline(1.0, color=FAINT, linewidth=0.7, zorder=1)
    axes.set_xlim(0, 1.06 * float(max(points.force_N.max(), points.line_N.max(initial=0.0))))
    axes.set_xlabel("measured force [N]")
    axes.set_ylabel("seen over predicted change")
    axes.set_title("each load of the calibration", fontweight="normal")


def _draw_deviations(axes: Axes, points: RatioPoints) -> None:
    """Draw what is left over of each load, in standard errors of one load, beside a normal distribution."""
    expected = np.interp(points.force_N, points.line_N, points.line)
    left = 100 * (points.placed / expected - 1)
    order = np.argsort(left)
    rank = (np.arange(len(left)) + 0.5) / len(left)
    light_grid(axes, "both")
    axes.axvline(0.0, color=FAINT, linewidth=0.7, zorder=1)
    axes.plot(left[order], 100 * rank, linestyle="", marker="o", markersize=3.0, color=BLUE, zorder=3)
    widest = 1.15 * max(float(np.abs(left).max()), 1e-3)
    axes.set_xlim(-widest, widest)
    axes.set_ylim(0, 100)
    axes.set_xlabel("left over by map and line [%]")
    axes.set_ylabel("loads up to here [%]")
    axes.set_title("what neither explains", fontweight="normal")
