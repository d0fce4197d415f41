"""Drawings of a batch: the common map, and each sensor's beside it."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.draw.sheet import add_scale, draw_sheet, fit_sheet
from cbsr_qa.report.draw.style import CHANGE_MAP, INK, VERMILION, WIDTH_IN, bare, canvas, draw_svg

#: Sheets in a row, and space above and below the rows [in].
_ACROSS: Final = 6
_TITLE_IN: Final = 0.22
_SCALE_IN: Final = 0.5
_LEAST: Final = 0.01


@draw_svg
def maps_figure(
    places_mm: Array,
    maps: Sequence[tuple[str, Array, bool]],
    sensor: SensorType,
    pressed_mm: Array,
) -> Canvas:
    """Draw maps in colours of one scale, relative to the mean of the first.

    Parameters
    ----------
    places_mm : (n, 2) places of a lattice.
    maps : name, logarithm of the response (n,) and whether it stands out, of each sheet.
    pressed_mm : (p, 2) places that were pressed.
    """
    side_in = WIDTH_IN / _ACROSS
    row_count = -(-len(maps) // _ACROSS)
    height_in = row_count * (side_in + _TITLE_IN) + _SCALE_IN
    figure = canvas(height_in)
    middle = float(maps[0][1].mean())
    values = [100 * np.expm1(values - middle) for _, values, _ in maps]
    reach = max(float(np.abs(value).max()) for value in values)
    norm = Normalize(-max(reach, _LEAST), max(reach, _LEAST))
    for number, ((name, _, stands_out), value) in enumerate(zip(maps, values, strict=True)):
        row, column = divmod(number, _ACROSS)
        bottom_in = height_in - (row + 1) * (side_in + _TITLE_IN)
        box = column / _ACROSS, bottom_in / height_in, 0.95 / _ACROSS, side_in / height_in
        axes = figure.add_axes(box)
        bare(axes)
        draw_sheet(axes, sensor.outline, filled=True)
        _draw_values(axes, places_mm, value, norm)
        axes.plot(*pressed_mm.T, ".", color=INK, markersize=1.2, zorder=4)
        fit_sheet(axes, sensor.outline)
        weight = "bold" if stands_out or not number else "normal"
        axes.set_title(name, fontsize=6.5, fontweight=weight, color=VERMILION if stands_out else INK)
    add_scale(
        figure,
        figure.axes[min(2, len(maps) - 1)],
        norm,
        CHANGE_MAP,
        label="response against the batch's mean [%]",
        place="bottom",
        bottom_in=0.3,
    )
    return figure


def _draw_values(axes: Axes, places_mm: Array, values: Array, norm: Normalize) -> None:
    """Draw values (n,) at some places (n, 2) of a square lattice as a picture, nothing elsewhere."""
    (x_mm, column), (y_mm, row) = (np.unique(coordinate, return_inverse=True) for coordinate in places_mm.T)
    picture = np.full((len(y_mm), len(x_mm)), np.nan)
    picture[row, column] = values
    half_mm = (x_mm[1] - x_mm[0]) / 2
    extent = (x_mm[0] - half_mm, x_mm[-1] + half_mm, y_mm[0] - half_mm, y_mm[-1] + half_mm)
    axes.imshow(picture, extent=extent, origin="lower", norm=norm, cmap=CHANGE_MAP, zorder=3)
