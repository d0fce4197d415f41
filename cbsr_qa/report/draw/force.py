"""Force estimated against measured, and what the readings' change is over what the quasi-static line predicts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.report.draw.style import BLUE, FAINT, INK, QUIET, VERMILION, canvas, dots, draw_svg, plot

#: Errors of one response for the sheet that exceed all others by more than this are marks at the edge: drawn to scale
#: they would flatten what the panel is about.
_FURTHEST: Final = 1.5
_BANDS: Final = ((2.0, 0.10), (1.0, 0.16))
_STEPS: Final = 60
_OPEN: Final = "open: repeated presses of one place"
#: Colour of loads without the effect that the figure shows.
_FAINT_MARK: Final[dict[str, Any]] = {
    "markersize": 2.8,
    "markerfacecolor": "none",
    "markeredgecolor": QUIET,
    "markeredgewidth": 0.6,
    "zorder": 2.5,
}


@dataclass(frozen=True, slots=True, eq=False)
class ForcePanel:
    """Loads by one way of estimating.

    Parameters
    ----------
    title : text over the panel.
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


@draw_svg
def force_figure(panels: Sequence[ForcePanel], flat: ForcePanel | None) -> Canvas:
    """Draw estimated against measured force, and below it the errors with bands of one and two stated errors.

    Parameters
    ----------
    panels : one or two.
    flat : the same loads with one response for the whole sheet, drawn faintly among the errors.
    """
    figure = canvas(4.9)
    values = [v for p in panels for v in (p.measured_N, p.estimated_N, p.missed_N)]
    values += [flat.measured_N] if flat is not None else []
    largest = 1.06 * max([float(part.max()) for part in values if len(part)] + [1e-6])
    reach = _reach_N(panels, flat)
    for number, panel in enumerate(panels):
        panel_left = 0.095 + 0.5 * number
        labels = ("", "") if number else ("estimated force [N]", "estimated − measured [N]")
        upper_axes = plot(figure, (panel_left, 0.50, 0.395, 0.455), panel.title, y=labels[0], grid="both")
        lower_axes = plot(figure, (panel_left, 0.09, 0.395, 0.345), x="measured force [N]", y=labels[1])
        _draw_estimates(upper_axes, panel, largest)
        if not panel.sampled.all():
            upper_axes.text(0.03, 0.93, _OPEN, transform=upper_axes.transAxes, fontsize=6.5, color=QUIET, va="top")
        _draw_errors(lower_axes, panel, flat, largest, reach)
    return figure


@draw_svg
def force_overview_figure(panel: ForcePanel) -> Canvas:
    """Draw estimated against measured force, and beside it the errors with bands of one and two stated errors."""
    figure = canvas(2.6)
    values = (panel.measured_N, panel.estimated_N, panel.missed_N)
    largest = 1.06 * max([float(part.max()) for part in values if len(part)] + [1e-6])
    labels = {"x": "measured force [N]", "y": "estimated force [N]"}
    left_axes = plot(figure, (0.075, 0.175, 0.4, 0.77), grid="both", **labels)
    right_axes = plot(figure, (0.59, 0.175, 0.4, 0.77), x=labels["x"], y="estimated − measured [N]")
    _draw_estimates(left_axes, panel, largest)
    left_axes.tick_params(labelbottom=True)
    _draw_errors(right_axes, panel, None, largest, _reach_N([panel], None))
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class RatioPoints:
    """Measured over predicted change of the loads of a calibration.

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


@draw_svg
def ratio_figure(points: RatioPoints) -> Canvas:
    """Draw the ratio of at least one load against force: as seen, and with what the map explains taken out."""
    figure = canvas(2.5)
    axes = plot(figure, (0.075, 0.175, 0.55, 0.74), "each load of the calibration", x="measured force [N]")
    axes.set_ylabel("seen over predicted change")
    _draw_ratios(axes, points)
    side = plot(figure, (0.715, 0.175, 0.275, 0.74), "residuals", grid="both")
    _draw_deviations(side, points)
    return figure


def _reach_N(panels: Sequence[ForcePanel], flat: ForcePanel | None) -> float:
    """Half the height of the panels of errors: all errors, and those of one response as far as there is room."""
    errors_N = [np.abs(p.estimated_N - p.measured_N) + 0.0 * p.stderr_N for p in panels]
    stated = [2 * p.stderr_N for p in panels]
    largest_N = max([float(part.max()) for part in (*errors_N, *stated) if len(part)] + [1e-6])
    if flat is None or not len(flat.measured_N):
        return 1.12 * largest_N
    flat_error_N = float(np.abs(flat.estimated_N - flat.measured_N).max())
    return 1.12 * max(largest_N, min(flat_error_N, _FURTHEST * largest_N))


def _draw_estimates(axes: Axes, panel: ForcePanel, largest_N: float) -> None:
    axes.plot([0, largest_N], [0, largest_N], color=INK, linewidth=0.7, zorder=2)
    _points(axes, panel, panel.estimated_N, panel.stderr_N)
    if len(panel.missed_N):
        marks = axes.plot(
            panel.missed_N, np.zeros(len(panel.missed_N)), "x", color=VERMILION, clip_on=False, zorder=5
        )
        marks[0].set(markersize=5, markeredgewidth=1.1)
    axes.set_xlim(0, largest_N)
    axes.set_ylim(min(0.0, float(panel.estimated_N.min(initial=0.0)) * 1.06), largest_N)
    axes.tick_params(axis="x", labelbottom=False)


def _draw_errors(axes: Axes, panel: ForcePanel, flat: ForcePanel | None, largest_N: float, reach_N: float) -> None:
    force = np.linspace(0, largest_N, _STEPS)
    stated = fit_stated_error(panel.measured_N, panel.stderr_N, force)
    for times, alpha in _BANDS:
        axes.fill_between(force, -times * stated, times * stated, color=BLUE, alpha=alpha, linewidth=0, zorder=1)
    axes.axhline(0.0, color=INK, linewidth=0.7, zorder=2)
    if flat is not None:
        error = flat.estimated_N - flat.measured_N
        edge, beyond = 0.985 * reach_N, np.abs(error) > reach_N
        for side_mask, symbol in ((~beyond, "D"), (beyond & (error > 0), "^"), (beyond & (error < 0), "v")):
            shown_error = np.clip(error[side_mask], -edge, edge) if symbol != "D" else error[side_mask]
            axes.plot(flat.measured_N[side_mask], shown_error, symbol, clip_on=symbol == "D", **_FAINT_MARK)
    _points(axes, panel, panel.estimated_N - panel.measured_N, None)
    axes.set_xlim(0, largest_N)
    axes.set_ylim(-reach_N, reach_N)


def _points(axes: Axes, panel: ForcePanel, values: Array, errors: Array | None) -> None:
    for kind_mask, hollow in ((panel.sampled, False), (~panel.sampled, True)):
        stderr = None if errors is None else errors[kind_mask]
        dots(
            axes,
            panel.measured_N[kind_mask],
            values[kind_mask],
            BLUE,
            errors=stderr,
            size=3.3,
            hollow=hollow,
            zorder=4,
        )


def fit_stated_error(measured_N: Array, stderr_N: Array, force_N: Array) -> Array:
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
    return np.sqrt(level + slope * force_N**2)


def _draw_ratios(axes: Axes, points: RatioPoints) -> None:
    axes.plot(points.force_N, points.raw, "D", **_FAINT_MARK)
    dots(axes, points.force_N, points.placed, BLUE, errors=points.stderr, size=3.3, zorder=4)
    band = (points.line - points.band, points.line + points.band)
    axes.fill_between(points.line_N, *band, color=VERMILION, alpha=0.15, linewidth=0, zorder=1)
    axes.plot(points.line_N, points.line, color=VERMILION, linewidth=1.0, zorder=3)
    axes.axhline(1.0, color=FAINT, linewidth=0.7, zorder=1)
    axes.set_xlim(0, 1.06 * float(max(points.force_N.max(), points.line_N.max(initial=0.0))))


def _draw_deviations(axes: Axes, points: RatioPoints) -> None:
    expected = np.interp(points.force_N, points.line_N, points.line)
    deviations_percent = np.sort(100 * (points.placed / expected - 1))
    rank = (np.arange(len(deviations_percent)) + 0.5) / len(deviations_percent)
    axes.axvline(0.0, color=FAINT, linewidth=0.7, zorder=1)
    dots(axes, deviations_percent, 100 * rank, BLUE, size=3.0)
    widest = 1.15 * max(float(np.abs(deviations_percent).max()), 1e-3)
    axes.set(xlim=(-widest, widest), ylim=(0, 100))
    axes.set_xlabel("residual after map and line [%]")
    axes.set_ylabel("cumulative share of loads [%]")
