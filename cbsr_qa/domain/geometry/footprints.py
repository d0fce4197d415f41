"""Footprint of a head, a disc or a polygon, to which sensed regions are compared."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.polygons import (
    Points,
    Values,
    area_under_edges,
    area_under_edges_in_polygon,
    centroid,
    distance_to_outline,
    inside_polygon,
    integrate_distance2,
    integrate_radius_deviation2,
    shoelace_area,
    simple_polygon,
)

#: Number of sides with which a circle is round in print.
_SIDES = 72


class Footprint(Protocol):
    """A closed outline on the sheet, such as an indenter's."""

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Centre of mass of the area."""
        ...

    @property
    def area_mm2(self) -> float: ...

    def area_under_edges_mm2(self, start: Points, end: Points) -> Values:
        """Areas (k,) that sum, along a closed counterclockwise outline, to the outline's area inside.

        Parameters
        ----------
        start, end : (k, 2) float64 [mm], directed edges that have a length.
        """
        ...

    def integrate_distance2_mm3(self, start: Points, end: Points) -> Values:
        """Integral of the squared distance to the footprint's outline along straight edges: (k, 2), (k, 2) → (k,)."""
        ...

    def distance_mm(self, points: Points) -> Values:
        """Distance of points (n, 2) from the outline, ≥ 0 on either side: (n,)."""
        ...

    def contains(self, points: Points) -> NDArray[np.bool_]:
        """Whether points (n, 2) lie inside: (n,)."""
        ...

    def outline_mm(self) -> Points:
        """Corners (q, 2) of the drawn outline."""
        ...


@dataclass(frozen=True, slots=True)
class RoundFootprint:
    """Footprint of a round head.

    Raises
    ------
    NumericsError
        If the radius is not a positive number.
    """

    x_mm: float
    y_mm: float
    radius_mm: float

    def __post_init__(self) -> None:
        if not 0 < self.radius_mm < float("inf"):
            raise NumericsError(f"circle radius is {self.radius_mm} mm; it must be positive and finite")

    @property
    def centre_mm(self) -> tuple[float, float]:
        return self.x_mm, self.y_mm

    @property
    def area_mm2(self) -> float:
        """π r²."""
        return float(np.pi * self.radius_mm**2)

    def area_under_edges_mm2(self, start: Points, end: Points) -> Values:
        """Areas between the centre and directed edges inside the circle; exact, arcs included."""
        return area_under_edges(start - np.array(self.centre_mm), end - np.array(self.centre_mm), self.radius_mm)

    def integrate_distance2_mm3(self, start: Points, end: Points) -> Values:
        """∫ (‖P − F‖ − r)² along edges, in closed form."""
        centre = np.array(self.centre_mm)
        return integrate_radius_deviation2(start - centre, end - centre, self.radius_mm)

    def distance_mm(self, points: Points) -> Values:
        """|‖P − F‖ − r|."""
        distance: Values = np.abs(np.hypot(*(points - np.array(self.centre_mm)).T) - self.radius_mm)
        return distance

    def contains(self, points: Points) -> NDArray[np.bool_]:
        """‖P − F‖ ≤ r."""
        inside_mask: NDArray[np.bool_] = np.hypot(*(points - np.array(self.centre_mm)).T) <= self.radius_mm
        return inside_mask

    def outline_mm(self) -> Points:
        angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
        return np.array(self.centre_mm) + self.radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True, eq=False)
class PolygonFootprint:
    """Footprint of any other head: a polygon, convex or not, without holes.

    Parameters
    ----------
    corners_mm : (q, 2) float64, either way round; kept counterclockwise.

    Raises
    ------
    NumericsError
        If it is not a simple polygon, see :func:`cbsr_qa.domain.geometry.polygons.simple_polygon`.
    """

    corners_mm: Points

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners_mm", simple_polygon(self.corners_mm))

    @cached_property
    def centre_mm(self) -> tuple[float, float]:
        x_mm, y_mm = centroid(self.corners_mm).tolist()
        return x_mm, y_mm

    @cached_property
    def area_mm2(self) -> float:
        return shoelace_area(self.corners_mm)

    def area_under_edges_mm2(self, start: Points, end: Points) -> Values:
        """Areas of the strips under directed edges inside the polygon; exact."""
        return area_under_edges_in_polygon(start, end, self.corners_mm)

    def integrate_distance2_mm3(self, start: Points, end: Points) -> Values:
        """Integral of the squared distance to the nearest side, to 1e-9 of the polygon's area."""
        return integrate_distance2(start, end, self.corners_mm)

    def distance_mm(self, points: Points) -> Values:
        return distance_to_outline(points, self.corners_mm)

    def contains(self, points: Points) -> NDArray[np.bool_]:
        return inside_polygon(points, self.corners_mm)

    def outline_mm(self) -> Points:
        return self.corners_mm


def overlap_mm2(footprint: Footprint, corners_mm: Points) -> Values:
    """Area of each triangle inside a footprint, exactly.

    Parameters
    ----------
    corners_mm : (e, 3, 2) float64, each counterclockwise.

    Returns
    -------
    (e,) float64 [mm²], not below 0.
    """
    drawn_outline_mm = footprint.outline_mm()
    # A drawn circle lies inside the true one.
    margin = 0.01 * np.ptp(drawn_outline_mm, axis=0)
    low, high = drawn_outline_mm.min(axis=0) - margin, drawn_outline_mm.max(axis=0) + margin
    near_mask = ((corners_mm.min(axis=1) <= high) & (corners_mm.max(axis=1) >= low)).all(axis=1)
    # Far triangles cancel to rounding of their distance squared, not to zero.
    area = np.zeros(len(corners_mm))
    start = corners_mm[near_mask]
    end = np.roll(start, -1, axis=1)
    under = footprint.area_under_edges_mm2(start.reshape(-1, 2), end.reshape(-1, 2))
    area[near_mask] = np.maximum(under.reshape(-1, 3).sum(axis=1), 0.0)
    return area
