"""Estimated places of loads with their uncertainty, and their places in images."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.geometry.footprints import Footprint
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.draw.sheet import draw_heads, head_path, sheet_axes
from cbsr_qa.report.draw.style import (
    BLUE,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    canvas,
    draw_svg,
    name_rows,
    plot,
)

#: Mahalanobis distance of the ellipse that holds 68.27 % of a normal distribution in the plane.
ELLIPSE_68: Final = float(np.sqrt(-2 * np.log(1 - 0.6827)))
_SCALES: Final = (1, 2, 5, 10, 20, 50, 100)
_CORNERS: Final = 48


@dataclass(frozen=True, slots=True, eq=False)
class PlacedLoad:
    """A press with its places by readings and by image.

    Parameters
    ----------
    label : short name.
    pressed : outline of the indenter where it pressed.
    imaged_mm : centre of mass of the sensed region; None without one.
    estimated_mm, covariance_mm2 : place and covariance of the estimate, (2,) and (2, 2); None where it was refused.
    """

    label: str
    pressed: Footprint
    imaged_mm: Array | None
    estimated_mm: Array | None
    covariance_mm2: Array | None

    @property
    def imaged_error(self) -> Array | None:
        """From the indenter's centre to the image's centre of mass [mm]."""
        return None if self.imaged_mm is None else self.imaged_mm - np.asarray(self.pressed.centre_mm)

    @property
    def estimated_error(self) -> Array | None:
        """From the indenter's centre to the estimate [mm]."""
        return None if self.estimated_mm is None else self.estimated_mm - np.asarray(self.pressed.centre_mm)

    @property
    def covered(self) -> bool:
        """Whether the 68 % ellipse holds the indenter's centre."""
        error = self.estimated_error
        if error is None or self.covariance_mm2 is None:
            return False
        return bool(error @ np.linalg.solve(self.covariance_mm2, error) <= ELLIPSE_68**2)


@draw_svg
def estimates_figure(loads: Sequence[PlacedLoad], sensor: SensorType) -> Canvas:
    """Draw the sheet with both places of every load and their errors, lengthened by :func:`error_scale`."""
    figure = canvas(3.75)
    _draw_places(sheet_axes(figure, (0.0, 0.01, 0.545, 0.98), sensor), loads, error_scale(loads))
    side = plot(figure, (0.64, 0.115, 0.345, 0.8), "error [mm]: × image, ● estimate", grid="x")
    _draw_errors(side, loads)
    return figure


def error_scale(loads: Sequence[PlacedLoad]) -> int:
    """Factor that lengthens errors and ellipses: the largest then exceeds the head by at most half of it."""
    errors = [
        float(np.hypot(*e)) for load in loads for e in (load.imaged_error, load.estimated_error) if e is not None
    ]
    largest = max(errors, default=0.0)
    if largest == 0:
        return 1
    reach = float(np.sqrt(loads[0].pressed.area_mm2 / np.pi))
    return max((scale for scale in _SCALES if scale <= 1.5 * reach / largest), default=1)


def _draw_places(axes: Axes, loads: Sequence[PlacedLoad], scale: int) -> None:
    heads = {load.pressed.centre_mm: head_path(load.pressed) for load in loads}
    draw_heads(axes, list(heads.values()), color=QUIET, dashed=True)
    ellipses = []
    for load in loads:
        centre, imaged, estimated = np.asarray(load.pressed.centre_mm), load.imaged_error, load.estimated_error
        axes.plot(*centre, marker="+", markersize=3.5, color=QUIET, markeredgewidth=0.6, zorder=6)
        if imaged is not None:
            end = centre + scale * imaged
            axes.plot([centre[0], end[0]], [centre[1], end[1]], color=FAINT, linewidth=0.7, zorder=6)
            axes.plot(*end, marker="x", markersize=4, color=INK, markeredgewidth=0.9, zorder=7)
        if estimated is not None and load.covariance_mm2 is not None:
            ellipses.append(centre + scale * (estimated + _ellipse(load.covariance_mm2)))
            axes.plot(*(centre + scale * estimated), marker="o", markersize=2.4, color=BLUE, zorder=8)
    axes.add_collection(
        PolyCollection(ellipses, facecolors="#0072b22a", edgecolors=BLUE, linewidths=0.8, zorder=5)
    )  # fmt: skip


def _draw_errors(axes: Axes, loads: Sequence[PlacedLoad]) -> None:
    order = list(dict.fromkeys(load.label for load in loads))
    rank = {label: place for place, label in enumerate(order)}
    for load in loads:
        row = rank[load.label]
        if load.imaged_error is not None:
            axes.plot([np.hypot(*load.imaged_error)], [row], marker="x", color=INK, markersize=4, zorder=3)
        if load.estimated_error is not None and load.covariance_mm2 is not None:
            error, stderr = float(np.hypot(*load.estimated_error)), float(np.sqrt(np.trace(load.covariance_mm2) / 2))
            axes.plot([max(error - stderr, 0), error + stderr], [row + 0.18] * 2, color=BLUE, linewidth=1.2, zorder=2)
            axes.plot([error], [row + 0.18], marker="o", color=BLUE, markersize=3.5, zorder=4)
        else:
            axes.plot([0], [row + 0.18], marker="|", color=VERMILION, markersize=5, clip_on=False, zorder=4)
    name_rows(axes, order)
    axes.set_xlim(left=0)


def _ellipse(covariance: Array) -> Array:
    size, axes = np.linalg.eigh(covariance)
    turn = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    ellipse: Array = ELLIPSE_68 * (circle * np.sqrt(np.maximum(size, 0))) @ axes.T
    return ellipse
