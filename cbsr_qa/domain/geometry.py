"""Exact areas of simple figures."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError

Points = NDArray[np.float64]
Values = NDArray[np.float64]

#: Points on (0, 1) at which edges no longer than their distance from a circle's centre are integrated: to 1e-16.
_GAUSS_NODES, _GAUSS_WEIGHTS = (np.polynomial.legendre.leggauss(14) + np.array([[1.0], [0.0]])) * 0.5


def circle_overlap_mm2(corners_mm: Points, centre_mm: tuple[float, float], radius_mm: float) -> NDArray[np.float64]:
    """Return the area of triangles inside a circle, exactly, arcs included.

    By Green's theorem the area is a sum over the triangle's directed edges: the stretch of an edge inside the
    circle adds the triangle it spans with the centre, the stretches outside add circular sectors.

    Parameters
    ----------
    corners_mm : (e, 3, 2) float64 [mm], each triangle counterclockwise.
    centre_mm, radius_mm : of the circle.

    Returns
    -------
    (e,) float64 [mm²], not below 0.

    Raises
    ------
    NumericsError
        If the radius is not a positive number.
    """
    if not 0 < radius_mm < float("inf"):
        raise NumericsError(f"the radius of a circle is {radius_mm} mm; it must be a positive number")
    start = corners_mm - np.asarray(centre_mm)
    area: NDArray[np.float64] = area_under_edges(start, np.roll(start, -1, axis=1), radius_mm).sum(axis=1)
    # Far triangles cancel to rounding of their distance squared, not to zero.
    return np.maximum(np.where(_boxes_touch(start, radius_mm), area, 0.0), 0.0)


def area_under_edges(start: Points, end: Points, radius: float) -> NDArray[np.float64]:
    """Signed area between the origin and directed edges inside a circle about the origin, (…, 2) → (…)."""
    along = end - start
    length_squared = _dot(along, along)
    middle = -_dot(start, along) / length_squared
    # |start × along|² / |along|² is the squared distance of the line; this form keeps its digits near tangency.
    across = _cross(start, along)
    half = np.sqrt(np.maximum(radius**2 - across**2 / length_squared, 0.0) / length_squared)
    first, last = np.clip(middle - half, 0.0, 1.0), np.clip(middle + half, 0.0, 1.0)
    enters, leaves = start + first[..., None] * along, start + last[..., None] * along
    # An end inside the circle has no sector; near the centre its direction would be rounding alone.
    # Along one line, cross products are shares of that of the edge: those of places that lie close would cancel.
    before = np.where(first > 0, np.arctan2(first * across, _dot(start, enters)), 0.0)
    after = np.where(last < 1, np.arctan2((1 - last) * across, _dot(leaves, end)), 0.0)
    area: NDArray[np.float64] = (radius**2 * (before + after) + (last - first) * across) / 2
    return area


def squared_deviation_integral(start: Points, end: Points, radius: float) -> NDArray[np.float64]:
    """Integral of (‖P‖ − r)² along straight edges, exact to rounding: (k, 2), (k, 2) → (k,).

    With u the coordinate along the edge's line from the foot of the perpendicular and h the line's distance,
    the integrand is u² + h² + r² − 2 r √(u² + h²), whose primitive is known. Near the circle its terms cancel, so
    edges shorter than their distance from the origin are summed over Gauss points instead, where (‖P‖² − r²)² over
    (‖P‖ + r)² has no negative part. Edges must have a length.
    """
    along = end - start
    length = np.sqrt(_dot(along, along))
    first, last = _dot(start, along) / length, _dot(end, along) / length
    height = np.abs(_cross(start, along)) / length
    beside = np.where((first < 0) & (last > 0), 0.0, np.minimum(np.abs(first), np.abs(last)))
    short = length <= np.hypot(height, beside)
    integral: NDArray[np.float64] = np.where(
        short, _deviation_at_points(start, along, length, radius), _deviation_primitive(first, last, height, radius)
    )
    return integral


def _deviation_at_points(start: Points, along: Points, length: Values, radius: float) -> Values:
    points = start + _GAUSS_NODES[:, None, None] * along
    squared = _dot(points, points)
    apart = (squared - radius**2) / (np.sqrt(squared) + radius)
    integral: Values = length * (_GAUSS_WEIGHTS @ apart**2)
    return integral


def _deviation_primitive(first: Values, last: Values, height: Values, radius: float) -> Values:
    def primitive(u: NDArray[np.float64]) -> NDArray[np.float64]:
        # h² asinh(u/h) vanishes with h; the floor keeps the quotient finite.
        bent = height**2 * np.arcsinh(u / np.maximum(height, 1e-150))
        value: NDArray[np.float64] = (
            u**3 / 3 + (height**2 + radius**2) * u - radius * (u * np.sqrt(u**2 + height**2) + bent)
        )
        return value

    integral: Values = np.maximum(primitive(last) - primitive(first), 0.0)
    return integral


def _boxes_touch(start: Points, radius: float) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = ((start.min(axis=1) < radius) & (start.max(axis=1) > -radius)).all(axis=1)
    return near


def _dot(a: Points, b: Points) -> NDArray[np.float64]:
    dot: NDArray[np.float64] = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    return dot


def _cross(a: Points, b: Points) -> NDArray[np.float64]:
    cross: NDArray[np.float64] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return cross
