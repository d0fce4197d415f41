"""Change against stress with its best line, loops of output against stress, and values over the sheet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle

from cbsr_qa.calibration.fits.estimates import StraightLine
from cbsr_qa.calibration.fits.hysteresis_fit import LoopCurve
from cbsr_qa.calibration.sheet.characteristic import Characteristic
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.draw.sheet import MOST_NAMES, add_scale, disc_radius_mm, sheet_axes
from cbsr_qa.report.draw.style import (
    AMOUNT_MAP,
    BLUE,
    CHANGE_MAP,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    canvas,
    dots,
    draw_svg,
    plot,
)


def _stress_pair(figure: Canvas, end_kPa: float, titles: tuple[str, str], labels: tuple[str, str]) -> list[Axes]:
    boxes = ((0.075, 0.16, 0.39, 0.74), (0.575, 0.16, 0.41, 0.74))
    panels = [
        plot(figure, box, title, x="stress [kPa]", y=label)
        for box, title, label in zip(boxes, titles, labels, strict=True)
    ]
    for axes in panels:
        axes.set_xlim(0.0, end_kPa)
    return panels


@draw_svg
def loop_figure(curves: Sequence[LoopCurve], read: Sequence[LoopCurve]) -> Canvas:
    """Draw the branches of every place, and their difference at equal stress.

    Parameters
    ----------
    curves, read : curves without what had not relaxed, and curves as they were read (may be empty).
    """
    figure = canvas(2.75)
    end_kPa = 1.04 * max(float(curve.stress_kPa[curve.peak]) for curve in curves)
    titles = ("way up (filled) and down (open)", "difference at equal stress")
    output_axes, difference_axes = _stress_pair(
        figure, end_kPa, titles, ("output [% of span]", "down less up [% of span]")
    )
    for curve in curves:
        _draw_loop(output_axes, curve)
        falling = curve.stress_kPa[curve.peak + 1 :]
        dots(difference_axes, falling, 100 * curve.difference, VERMILION, errors=100 * curve.stderr, hollow=True)
    for curve in read:
        falling = curve.stress_kPa[curve.peak + 1 :]
        difference_axes.plot(falling, 100 * curve.difference, "x", markersize=4, color=QUIET, zorder=2.5)
    difference_axes.axhline(0.0, color=FAINT, linewidth=0.9, zorder=1.5)
    return figure


def _draw_loop(axes: Axes, curve: LoopCurve) -> None:
    peak, stress, output = curve.peak, curve.stress_kPa, 100 * curve.output
    loading, unloading = slice(0, peak + 1), slice(peak + 1, None)
    axes.plot(np.append(0.0, stress[loading]), np.append(0.0, output[loading]), color=BLUE, linewidth=0.9, zorder=2)
    axes.plot(stress[peak:], output[peak:], color=VERMILION, linewidth=0.9, linestyle="--", zorder=2)
    dots(axes, stress[loading], output[loading], BLUE)
    dots(axes, stress[unloading], output[unloading], VERMILION, hollow=True)


@dataclass(frozen=True, slots=True)
class PlaceValue:
    """A number at a place of the sheet."""

    label: str
    x_mm: float
    y_mm: float
    value: float


@dataclass(frozen=True, slots=True)
class PlaceMap:
    """Numbers at places of the sheet, in two colours about ``about``, or from little to much where that is None."""

    title: str
    unit: str
    places: tuple[PlaceValue, ...]
    about: float | None = None


@draw_svg
def characteristic_figure(
    curves: Sequence[Characteristic], mean: Characteristic, line: StraightLine, scatter: float | None
) -> Canvas:
    """Draw the change against stress of every location, and how far it leaves the mean's best straight line.

    Parameters
    ----------
    curves : curves of the locations, each with stresses and a positive span.
    mean : mean curve over them, in shares of the span.
    line : through the mean.
    scatter : repeatability in shares of the span; None if unknown.
    """
    figure = canvas(2.75)
    ends = np.array([0.0, 1.04 * _stress(mean)[-1]])
    titles = ("change against stress", "deviation from the best straight line")
    labels = ("change [% of the location's span]", "change less line [% of span]")
    output_axes, deviation_axes = _stress_pair(figure, ends[1], titles, labels)
    lines = [np.column_stack([_stress(c), 100 * c.change / c.span]) for c in curves]
    output_axes.add_collection(LineCollection(lines, colors=FAINT, linewidths=0.6, zorder=1.5))
    dots(output_axes, _stress(mean), 100 * mean.change, BLUE, size=3.5)
    output_axes.plot(ends, 100 * (line.intercept + line.slope * ends), color=VERMILION, linewidth=0.9, zorder=2)
    output_axes.set_ylim(bottom=min(0.0, 100 * line.intercept))
    _draw_residuals(deviation_axes, curves, mean, line, scatter)
    return figure


@draw_svg
def place_maps_figure(maps: Sequence[PlaceMap], sensor: SensorType) -> Canvas:
    """Draw one or two sheets beside each other with a coloured disc at every place."""
    figure = canvas(3.05)
    for number, place_map in enumerate(maps):
        axes = sheet_axes(figure, (0.5 * number, 0.0, 0.4, 0.92), sensor)
        norm, colours = _scale(place_map)
        _draw_values(axes, place_map, sensor, norm, colours)
        axes.set_title(place_map.title, fontweight="normal")
        add_scale(figure, axes, norm, colours, label=place_map.unit, place="right")
    return figure


def _stress(curve: Characteristic) -> np.ndarray:
    assert curve.stress_kPa is not None
    return curve.stress_kPa


def _draw_residuals(
    axes: Axes,
    curves: Sequence[Characteristic],
    mean: Characteristic,
    line: StraightLine,
    scatter: float | None,
) -> None:
    lines = []
    for curve in curves:
        stress = _stress(curve)
        residual_percent = 100 * (curve.change / curve.span - line.intercept - line.slope * stress)
        lines.append(np.column_stack([stress, residual_percent]))
    axes.add_collection(LineCollection(lines, colors=FAINT, linewidths=0.6, zorder=1.5))
    errors = None if scatter is None else 100 * scatter / np.sqrt(mean.loads)
    dots(axes, _stress(mean), 100 * line.deviations, BLUE, errors=errors, size=3.5)
    largest = 100 * line.largest
    axes.axhspan(-largest, largest, color=VERMILION, alpha=0.1, linewidth=0, zorder=1)
    axes.axhline(0.0, color=VERMILION, linewidth=0.9, zorder=2)
    reach = 1.15 * max(*(float(np.abs(part[:, 1]).max()) for part in lines), largest)
    axes.set_ylim(-reach, reach)


def _draw_values(axes: Axes, shown: PlaceMap, sensor: SensorType, norm: Normalize, colours: Colormap) -> None:
    radius_mm = disc_radius_mm([(place.x_mm, place.y_mm) for place in shown.places], sensor)
    for place in shown.places:
        centre_mm, face = (place.x_mm, place.y_mm), colours(norm(place.value))
        axes.add_patch(Circle(centre_mm, radius_mm, facecolor=face, edgecolor=QUIET, linewidth=0.5, zorder=4))
        if len(shown.places) <= MOST_NAMES:
            red, green, blue, _ = face
            dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
            name = axes.text(*centre_mm, place.label, ha="center", va="center", fontsize=6.5, zorder=6)
            name.set_color("white" if dark else INK)


def _scale(shown: PlaceMap) -> tuple[Normalize, Colormap]:
    values = [place.value for place in shown.places]
    if shown.about is not None:
        reach = max(abs(value - shown.about) for value in values) or 1e-6
        return Normalize(shown.about - reach, shown.about + reach), CHANGE_MAP
    low, high = min(values), max(values)
    room = 0.1 * (high - low) or 0.01 * abs(high) or 1e-6
    return Normalize(low - room, high + room), AMOUNT_MAP
