"""What a data sheet shows: change against stress with its best line, response and stiffness over the sheet.

A loop of output against stress, and how far its branches lie apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle

from cbsr_qa.calibration.fits import LoopCurve
from cbsr_qa.calibration.sheet import Characteristic, StraightLine
from cbsr_qa.domain.results import Figure
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.report.draw.sheet import add_scale, draw_electrodes, draw_sheet, fit_sheet
from cbsr_qa.report.draw.style import (
    AMOUNT_MAP,
    BLUE,
    CHANGE_MAP,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    bare,
    canvas,
    drawn,
    light_grid,
)


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


#: More places than this stand too close for their names.
_MOST_NAMES: Final = 16


@dataclass(frozen=True, slots=True)
class PlaceValue:
    """A number at a place of the sheet."""

    label: str
    x_mm: float
    y_mm: float
    value: float


@dataclass(frozen=True, slots=True)
class PlaceMap:
    """Numbers at places of the sheet, to be coloured.

    Parameters
    ----------
    title, unit : over the map and at its scale.
    about : centre of a scale in two colours; None for one from little to much.
    """

    title: str
    unit: str
    places: tuple[PlaceValue, ...]
    about: float | None = None


def characteristic_figure(
    curves: Sequence[Characteristic],
    mean: Characteristic,
    line: StraightLine,
    scatter: float | None,
    *,
    caption: str,
    alternative: str,
) -> Figure:
    """Draw the change against stress of every location, and how far it leaves the mean's best straight line.

    Parameters
    ----------
    curves : of the locations, each with stresses and a positive span.
    mean : over them, in shares of the span.
    line : through the mean.
    scatter : repeatability in shares of the span; None where it is not known.
    """

    def build() -> Canvas:
        figure = canvas(2.75)
        left = figure.add_axes((0.075, 0.16, 0.39, 0.74))
        right = figure.add_axes((0.575, 0.16, 0.41, 0.74))
        stress = _stress(mean)
        ends = np.array([0.0, stress[-1] * 1.04])
        _draw_curves(left, curves, mean)
        left.plot(ends, 100 * (line.intercept + line.slope * ends), color=VERMILION, linewidth=0.9, zorder=2)
        left.set_ylim(bottom=min(0.0, 100 * line.intercept))
        left.set_ylabel("change [% of the location's span]")
        left.set_title("change against stress", fontweight="normal")
        _draw_residuals(right, curves, mean, line, scatter)
        for axes in (left, right):
            axes.set_xlim(*ends)
            axes.set_xlabel("stress [kPa]")
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def place_maps_figure(maps: Sequence[PlaceMap], sensor: SensorType, *, caption: str, alternative: str) -> Figure:
    """Draw one or two sheets beside each other with a coloured disc at every place.

    Parameters
    ----------
    maps : one or two, each with a place.
    """

    def build() -> Canvas:
        figure = canvas(3.05)
        for number, one in enumerate(maps):
            axes = figure.add_axes((0.5 * number, 0.0, 0.4, 0.92))
            _draw_map(figure, axes, one, sensor)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _stress(curve: Characteristic) -> np.ndarray:
    assert curve.stress_kPa is not None
    return curve.stress_kPa


def _draw_curves(axes: Axes, curves: Sequence[Characteristic], mean: Characteristic) -> None:
    light_grid(axes)
    lines = [np.column_stack([_stress(c), 100 * c.change / c.span]) for c in curves]
    axes.add_collection(LineCollection(lines, colors=FAINT, linewidths=0.6, zorder=1.5))
    axes.plot(_stress(mean), 100 * mean.change, "o", markersize=3.5, color=BLUE, zorder=3)


def _draw_residuals(
    axes: Axes,
    curves: Sequence[Characteristic],
    mean: Characteristic,
    line: StraightLine,
    scatter: float | None,
) -> None:
    light_grid(axes)
    lines = []
    for curve in curves:
        stress = _stress(curve)
        left = 100 * (curve.change / curve.span - line.intercept - line.slope * stress)
        lines.append(np.column_stack([stress, left]))
    axes.add_collection(LineCollection(lines, colors=FAINT, linewidths=0.6, zorder=1.5))
    stress = _stress(mean)
    errors = None if scatter is None else 100 * scatter / np.sqrt(mean.loads)
    axes.errorbar(
        stress, 100 * line.deviations, yerr=errors, fmt="o", markersize=3.5, color=BLUE, elinewidth=0.9, zorder=3
    )
    largest = 100 * line.largest
    axes.axhspan(-largest, largest, color=VERMILION, alpha=0.1, linewidth=0, zorder=1)
    axes.axhline(0.0, color=VERMILION, linewidth=0.9, zorder=2)
    widest = max(
        float(np.abs(part[:, 1]).max()) for part in [*lines, np.column_stack([stress, 100 * line.deviations])]
    )
    axes.set_ylim(-1.15 * max(widest, largest), 1.15 * max(widest, largest))
    axes.set_ylabel("change less line [% of span]")
    axes.set_title("left over from the best straight line", fontweight="normal")


def _draw_map(figure: Canvas, axes: Axes, shown: PlaceMap, sensor: SensorType) -> None:
    bare(axes)
    draw_sheet(axes, sensor.outline, filled=True)
    draw_electrodes(axes, sensor.electrodes, sensor.outline)
    norm, colours = _scale(shown)
    radius = _disc_mm(shown, sensor)
    for place in shown.places:
        at = (place.x_mm, place.y_mm)
        face = colours(norm(place.value))
        axes.add_patch(Circle(at, radius, facecolor=face, edgecolor=QUIET, linewidth=0.5, zorder=4))
        if len(shown.places) <= _MOST_NAMES:
            red, green, blue, _ = face
            dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
            name = axes.text(*at, place.label, ha="center", va="center", fontsize=6.5, zorder=6)
            name.set_color("white" if dark else INK)
    fit_sheet(axes, sensor.outline)
    axes.set_title(shown.title, fontweight="normal")
    add_scale(figure, axes, norm, colours, label=shown.unit, place="right")


def _scale(shown: PlaceMap) -> tuple[Normalize, Colormap]:
    values = [place.value for place in shown.places]
    if shown.about is not None:
        reach = max(abs(value - shown.about) for value in values) or 1e-6
        return Normalize(shown.about - reach, shown.about + reach), CHANGE_MAP
    low, high = min(values), max(values)
    room = 0.1 * (high - low) or 0.01 * abs(high) or 1e-6
    return Normalize(low - room, high + room), AMOUNT_MAP


def _disc_mm(shown: PlaceMap, sensor: SensorType) -> float:
    """Radius that lets most neighbours stand clear of each other."""
    at = np.array([(place.x_mm, place.y_mm) for place in shown.places])
    apart = np.hypot(*(at[:, None, :] - at[None, :, :]).transpose(2, 0, 1))
    apart[apart < 1e-9] = np.inf
    nearest = min(float(np.median(apart.min(axis=1))), sensor.radius_mm)
    return float(np.clip(0.45 * nearest, 0.03 * sensor.radius_mm, 0.13 * sensor.radius_mm))
