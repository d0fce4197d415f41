"""Drawings of a live page: the image as a PNG of palette colours, traces as points of an SVG line."""

import io
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import ceil, dist, floor, log10
from typing import Any, Final, Self

import numpy as np
from matplotlib.colors import to_hex

from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.draw.sheet import sheet_path
from cbsr_qa.report.draw.style import CHANGE_MAP

#: Size of a trace's drawing, in its own units.
WIDTH: Final = 480.0
HEIGHT: Final = 110.0
#: Largest mark of a place, as part of the sheet's longer side.
_PLACE_R: Final = 0.045

#: Palette of an image: 255 colours of the scale, and one that is transparent.
_PALETTE: Final = np.round(255 * np.asarray(CHANGE_MAP(np.linspace(0, 1, 255)))[:, :3]).astype(
    np.uint8
).tobytes() + bytes(3)


def png(picture: "np.ma.MaskedArray[Any, np.dtype[np.float64]]", largest: float) -> bytes:
    """Return a picture of relative changes as a PNG, transparent where it is masked.

    Parameters
    ----------
    picture : (rows, columns), bottom row first.
    largest : change at either end of the scale.
    """
    from PIL import Image

    scaled = np.clip(127 + 127 * picture.filled(0.0) / largest, 0, 254)
    index = np.where(np.ma.getmaskarray(picture), 255, np.round(scaled)).astype(np.uint8)
    image = Image.fromarray(index[::-1], "P")
    image.putpalette(_PALETTE)
    file = io.BytesIO()
    image.save(file, "PNG", transparency=255)
    return file.getvalue()


@dataclass(frozen=True, slots=True)
class Trace:
    """A line of an SVG drawing of :data:`WIDTH` by :data:`HEIGHT`.

    Parameters
    ----------
    points : points of a polyline, as SVG text; empty without values.
    low, high : values at the lower and the upper edge.
    last : latest value; None without values.
    zero_y : height of the value zero in the drawing; None if it is outside.
    """

    points: str
    low: float
    high: float
    last: float | None
    zero_y: float | None


def trace(points: Sequence[tuple[float, float]], span_s: float, least: float) -> Trace:
    """Lay out a trace that ends at the right edge.

    Parameters
    ----------
    points : pairs (time_s, value).
    span_s : time of the whole width.
    least : smallest range of values to show.
    """
    if not points:
        return Trace("", 0.0, least, None, None)
    values = [value for _, value in points]
    low, high = min(0.0, *values), max(least, *values)
    # The range is widened to round numbers, so that the scale rarely changes.
    step = 10.0 ** floor(log10(max(high - low, 1e-9)))
    step = step if (high - low) / step >= 4 else step / 2
    low, high = step * floor(low / step + 1e-9), step * ceil(high / step - 1e-9)
    end_s = points[-1][0]

    def y(value: float) -> float:
        return HEIGHT * (1 - (value - low) / (high - low))

    line = " ".join(f"{WIDTH * (1 - (end_s - time_s) / span_s):.1f},{y(value):.1f}" for time_s, value in points)
    return Trace(line, low, high, values[-1], y(0.0) if low <= 0 <= high else None)


@dataclass(frozen=True, slots=True)
class SheetDrawing:
    """A sheet from above, in millimetres; y points down, as in SVG.

    Parameters
    ----------
    outline : path of its edge.
    x, y, width, height : box around the sheet, which an image of it fills [mm].
    place_r : radius of the mark of a place.
    touch_r : radius around a place within which no other place is nearer; for fingers.
    """

    view_box: str
    outline: str
    x: float
    y: float
    width: float
    height: float
    electrodes: tuple[tuple[float, float], ...]
    electrode_r: float
    head_r: float
    place_r: float
    touch_r: float

    @classmethod
    def from_sensor_type(
        cls, sensor_type: SensorType, indenter: Indenter, places_mm: Collection[tuple[float, float]] = ()
    ) -> Self:
        """Draw a sheet, with marks of places that do not touch each other."""
        low_x, high_x, low_y, high_y = sensor_type.outline.extent_mm
        width, height = high_x - low_x, high_y - low_y
        margin = 0.04 * max(width, height)
        corners = " L".join(f"{x:.2f} {-y:.2f}" for x, y in sheet_path(sensor_type.outline))
        places = [(round(float(x), 2), round(-float(y), 2)) for x, y in sensor_type.electrodes.positions_mm()]
        nearest_mm = [0.45 * dist(one, other) for one, other in combinations(places_mm, 2)]
        box = (low_x - margin, -high_y - margin, width + 2 * margin, height + 2 * margin)
        return cls(
            view_box=" ".join(f"{value_mm:.2f}" for value_mm in box),
            outline=f"M{corners} Z",
            x=low_x,
            y=-high_y,
            width=width,
            height=height,
            electrodes=tuple(places),
            electrode_r=round(0.012 * max(width, height), 2),
            head_r=round(indenter.radius_mm, 2),
            place_r=round(min([_PLACE_R * max(width, height), *nearest_mm]), 2),
            touch_r=round(min([3 * _PLACE_R * max(width, height), *nearest_mm]), 2),
        )


def scale_colours() -> tuple[str, ...]:
    """Colours of the scale from its lowest to its highest value, as in images."""
    return tuple(to_hex(CHANGE_MAP(value)) for value in np.linspace(0, 1, 25))
