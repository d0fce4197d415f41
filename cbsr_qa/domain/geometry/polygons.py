"""Exact areas and distances of polygons, concave ones included.

Exact areas of simple figures.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array

Points = NDArray[np.float64]
Values = NDArray[np.float64]

#: Points on (0, 1) that integrate edges no longer than their distance from a circle's centre to 1e-16.
_GAUSS_NODES, _GAUSS_WEIGHTS = (np.polynomial.legendre.leggauss(14) + np.array([[1.0], [0.0]])) * 0.5


def circle_overlap_mm2(corners_mm: Points, centre_mm: tuple[float, float], radius_mm: float) -> Array:
    """Return the area of triangles inside a circle, exactly, arcs included.

    By Green's theorem the area is a sum over the triangle's directed edges: the stretch of an edge inside the
    circle adds the triangle it spans with the centre, the stretches outside add circular sectors.

    Parameters
    ----------
    corners_mm : (e, 3, 2) float64 [mm], each triangle counterclockwise.
    centre_mm, radius_mm : centre and radius of the circle [mm].

    Returns
    -------
    (e,) float64 [mm²], not below 0.

    Raises
    ------
    NumericsError
        If the radius is not a positive number.
    """
    if not 0 < radius_mm < float("inf"):
        raise NumericsError(f"circle radius is {radius_mm} mm; it must be positive and finite")
    start = corners_mm - np.asarray(centre_mm)
    area: Array = area_under_edges(start, np.roll(start, -1, axis=1), radius_mm).sum(axis=1)
    # Far triangles cancel to rounding of their distance squared, not to zero.
    boxes_touch: NDArray[np.bool_] = ((start.min(axis=1) < radius_mm) & (start.max(axis=1) > -radius_mm)).all(axis=1)
    return np.maximum(np.where(boxes_touch, area, 0.0), 0.0)


def area_under_edges(start: Points, end: Points, radius: float) -> Array:
    """Signed area between the origin and directed edges inside a circle about the origin, (…, 2) → (…)."""
    along = end - start
    length_squared = _dot(along, along)
    middle = -_dot(start, along) / length_squared
    # |start × along|² / |along|² is the squared distance of the line; this form keeps its digits near tangency.
    cross_product = _cross(start, along)
    half_chord = np.sqrt(np.maximum(radius**2 - cross_product**2 / length_squared, 0.0) / length_squared)
    enter_share, leave_share = np.clip(middle - half_chord, 0.0, 1.0), np.clip(middle + half_chord, 0.0, 1.0)
    enters, leaves = start + enter_share[..., None] * along, start + leave_share[..., None] * along
    # An end inside the circle has no sector; near the centre its direction would be rounding alone.
    # Along one line, cross products are shares of that of the edge: those of places that lie close would cancel.
    angle_before = np.where(enter_share > 0, np.arctan2(enter_share * cross_product, _dot(start, enters)), 0.0)
    angle_after = np.where(leave_share < 1, np.arctan2((1 - leave_share) * cross_product, _dot(leaves, end)), 0.0)
    return (radius**2 * (angle_before + angle_after) + (leave_share - enter_share) * cross_product) / 2


def integrate_radius_deviation2(start: Points, end: Points, radius: float) -> Array:
    """Integral of (‖P‖ − r)² along straight edges, exact to rounding: (k, 2), (k, 2) → (k,).

    With u the coordinate along the edge's line from the foot of the perpendicular and h the line's distance,
    the integrand is u² + h² + r² − 2 r √(u² + h²), whose primitive is known. Near the circle its terms cancel, so
    edges shorter than their distance from the origin are summed over Gauss points instead, where (‖P‖² − r²)² over
    (‖P‖ + r)² has no negative part. Edges must have a length.
    """
    along = end - start
    length = np.sqrt(_dot(along, along))
    start_along, end_along = _dot(start, along) / length, _dot(end, along) / length
    height = np.abs(_cross(start, along)) / length
    along_distance = np.where(
        (start_along < 0) & (end_along > 0), 0.0, np.minimum(np.abs(start_along), np.abs(end_along))
    )
    short = length <= np.hypot(height, along_distance)
    return np.where(
        short,
        _deviation_at_points(start, along, length, radius),
        _deviation_primitive(start_along, end_along, height, radius),
    )


def _deviation_at_points(start: Points, along: Points, length: Values, radius: float) -> Values:
    points = start + _GAUSS_NODES[:, None, None] * along
    squared = _dot(points, points)
    deviation = (squared - radius**2) / (np.sqrt(squared) + radius)
    integral: Values = length * (_GAUSS_WEIGHTS @ deviation**2)
    return integral


def _deviation_primitive(first: Values, last: Values, height: Values, radius: float) -> Values:
    def primitive(u: Array) -> Array:
        # h² asinh(u/h) vanishes with h; the floor keeps the quotient finite.
        bent = height**2 * np.arcsinh(u / np.maximum(height, 1e-150))
        return u**3 / 3 + (height**2 + radius**2) * u - radius * (u * np.sqrt(u**2 + height**2) + bent)

    return np.maximum(primitive(last) - primitive(first), 0.0)


def _dot(a: Points, b: Points) -> Array:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def _cross(a: Points, b: Points) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


#: Largest difference of a stretch's two Simpson's rules, relative to the polygon's area and the whole edge's length.
_TOLERANCE: Final = 1e-9
_DEEPEST: Final = 48  # halvings; 2⁻⁴⁸ of an edge is rounding
_QUARTERS: Final = np.linspace(0.0, 1.0, 5)[:, None, None]
_COARSE: Final = np.array([1, 0, 4, 0, 1]) / 6  # Simpson's rule of a stretch …
_FINE: Final = np.array([1, 4, 2, 4, 1]) / 12  # … and of its halves


#: Largest number of sides: the check compares every side with every other.
_MOST_CORNERS: Final = 1000


def simple_polygon(corners_mm: Points) -> Points:
    """Check a polygon and turn it counterclockwise.

    Parameters
    ----------
    corners_mm : (q, 2) float64 in order, either way round; the first corner is not repeated.

    Returns
    -------
    (q, 2) float64.

    Raises
    ------
    NumericsError
        If there are fewer than three corners or more than a thousand, one is not finite or repeats its neighbour, or
        the outline cuts itself.
    """
    corners = np.asarray(corners_mm, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1:] != (2,) or len(corners) < 3 or not np.isfinite(corners).all():
        raise NumericsError(f"an outline needs three or more finite corners (x, y); its shape is {corners.shape}")
    if len(corners) > _MOST_CORNERS:
        raise NumericsError(f"an outline has {len(corners)} corners; at most {_MOST_CORNERS} are allowed")
    along = np.roll(corners, -1, axis=0) - corners
    repeated = np.flatnonzero(~along.any(axis=1))
    if repeated.size:
        raise NumericsError(
            f"corner {repeated[0] + 1} of the outline is repeated",
            remedy="leave it out: an outline is closed automatically",
        )
    crossed = _first_crossing(corners)
    if crossed is not None:
        raise NumericsError(
            f"sides {crossed[0] + 1} and {crossed[1] + 1} of the outline meet",
            remedy="list its corners in order around the edge",
        )
    return corners if shoelace_area(corners) > 0 else corners[::-1].copy()


def shoelace_area(corners: Points) -> float:
    """Area of a polygon, positive counterclockwise."""
    around = corners - corners[0]
    following = np.roll(around, -1, axis=0)
    return float(_cross(around, following).sum()) / 2


def centroid(corners: Points) -> Points:
    """Centre of mass of a polygon's area, (2,)."""
    around = corners - corners[0]
    following = np.roll(around, -1, axis=0)
    weight = _cross(around, following)
    centre: Points = corners[0] + weight @ (around + following) / (3 * weight.sum())
    return centre


def area_under_edges_in_polygon(start: Points, end: Points, corners: Points) -> Values:
    """Areas that sum, along a closed counterclockwise outline, to the outline's area inside a polygon: (k,).

    A polygon is the signed sum of the strips between its sides and a line below everything. The strip of an edge
    meets that of a side in ∫ min(y_edge, y_side) dx over their common x, so neither need be convex or in one piece.
    Exact; work and memory are k × q.

    Parameters
    ----------
    start, end : (k, 2) float64, directed edges.
    corners : (q, 2) float64, counterclockwise.
    """
    if not len(start):
        return np.zeros(0)
    floor = min(float(points[:, 1].min()) for points in (start, end, corners))
    edge_left, edge_right, edge_y, edge_slope, edge_sign = _strips(start, end)
    side_left, side_right, side_y, side_slope, side_sign = _strips(corners, np.roll(corners, -1, axis=0))
    left_x = np.maximum(edge_left[:, None], side_left)
    width = np.maximum(np.minimum(edge_right[:, None], side_right) - left_x, 0.0)
    edge = (edge_y - edge_slope * edge_left)[:, None] + edge_slope[:, None] * left_x
    side = (side_y - side_slope * side_left) + side_slope * left_x
    height = edge - side
    height_after = height + (edge_slope[:, None] - side_slope) * width
    # ∫ min(d, 0) of a linear d is −n²/2(|d₀| + |d₁|) times the width, n what of d₀ and d₁ is negative.
    negative = np.minimum(height, 0.0) + np.minimum(height_after, 0.0)
    spread = np.abs(height) + np.abs(height_after)
    cut = negative**2 / (2 * np.where(spread > 0, spread, 1.0))
    common = width * (side + side_slope * width / 2 - floor - cut)
    area: Values = edge_sign * (common @ side_sign)
    return area


def integrate_distance2(start: Points, end: Points, corners: Points) -> Values:
    """Integral of the squared distance to a polygon's outline along straight edges: (k, 2), (k, 2) → (k,).

    By Simpson's rule, exact where one side or corner of the polygon stays the nearest. Stretches on which it and its
    halves differ by more than 1e-9 of the polygon's area, weighed by length, are halved. Sides that cannot be the
    nearest anywhere on a stretch are dropped as stretches get shorter.
    """
    tolerance = _TOLERANCE * abs(shoelace_area(corners))
    integral, owner, sides = np.zeros(len(start)), np.arange(len(start)), len(corners)
    if not len(start):
        return integral
    stretch, side = np.repeat(owner, sides), np.tile(np.arange(sides), len(owner))
    for depth in range(_DEEPEST):
        length = np.hypot(*(end - start).T)
        distance = _distance_to_sides((start + end)[stretch] / 2, side, corners)
        nearest = np.minimum.reduceat(distance, np.searchsorted(stretch, np.arange(len(owner))))
        near_mask = distance <= (nearest + length)[stretch]
        stretch, side = stretch[near_mask], side[near_mask]
        points = start + _QUARTERS * (end - start)
        distance = _distance_to_sides(points[:, stretch], side, corners)
        squared = np.minimum.reduceat(distance, np.searchsorted(stretch, np.arange(len(owner))), axis=1) ** 2
        fine = _FINE @ squared
        inexact_mask = np.abs(fine - _COARSE @ squared) > tolerance * 2.0**depth
        done_mask = ~inexact_mask if depth < _DEEPEST - 1 else np.ones_like(inexact_mask)
        np.add.at(integral, owner[done_mask], (length * fine)[done_mask])
        if done_mask.all():
            break
        start, end = (
            np.concatenate([start[inexact_mask], points[2, inexact_mask]]),
            np.concatenate([points[2, inexact_mask], end[inexact_mask]]),
        )
        number, inexact_stretch_mask = np.cumsum(inexact_mask) - 1, inexact_mask[stretch]
        stretch = np.concatenate(
            [number[stretch[inexact_stretch_mask]], number[stretch[inexact_stretch_mask]] + int(inexact_mask.sum())]
        )
        owner, side = np.tile(owner[inexact_mask], 2), np.tile(side[inexact_stretch_mask], 2)
    return integral


def distance_to_outline(points: Points, corners: Points) -> Values:
    """Distance of points from a polygon's outline, not below 0 inside either: (n, 2) → (n,)."""
    distance: Values = _distance_to_sides(points[:, None], np.arange(len(corners)), corners).min(axis=1)
    return distance


def _distance_to_sides(points: Points, side: NDArray[np.int64], corners: Points) -> Values:
    """Distance of points (…, 2) from sides (…,) of a polygon, one side each."""
    start = corners[side]
    along = corners[(side + 1) % len(corners)] - start
    from_start = points - start
    share = np.clip(_dot(from_start, along) / _dot(along, along), 0.0, 1.0)
    perpendicular = from_start - share[..., None] * along
    return np.sqrt(_dot(perpendicular, perpendicular))


def inside_polygon(points: Points, corners: Points) -> NDArray[np.bool_]:
    """Whether points lie inside a polygon: (n, 2) → (n,).

    A point on the outline may be inside or outside, so that it belongs to one of two adjacent polygons.
    """
    return inside_edges(points, corners, np.roll(corners, -1, axis=0))


def inside_edges(points: Points, start: Points, end: Points) -> NDArray[np.bool_]:
    """Whether closed outlines go around points, holes left out, by counting the edges to their right: (n, 2) → (n,).

    Parameters
    ----------
    start, end : (k, 2) float64, edges that make up closed outlines, in any order.
    """
    x, y = points[:, :1], points[:, 1:]
    spans = (start[:, 1] > y) != (end[:, 1] > y)
    rise = end[:, 1] - start[:, 1]
    crossing_x = start[:, 0] + (y - start[:, 1]) / np.where(rise == 0, 1.0, rise) * (end[:, 0] - start[:, 0])
    inside_mask: NDArray[np.bool_] = (spans & (x < crossing_x)).sum(axis=1) % 2 == 1
    return inside_mask


def _strips(start: Points, end: Points) -> tuple[Values, Values, Values, Values, Values]:
    """Left and right x of edges, y at the left, slope, and −1 where they run to the right: a lower side."""
    forward_mask = end[:, 0] > start[:, 0]
    left_end, right_end = np.where(forward_mask[:, None], start, end), np.where(forward_mask[:, None], end, start)
    across, rise = right_end[:, 0] - left_end[:, 0], right_end[:, 1] - left_end[:, 1]
    # An upright edge has no strip; its slope may be anything.
    steep_mask = across <= np.finfo(np.float64).eps * np.abs(rise)
    slope = np.where(steep_mask, 0.0, rise / np.where(steep_mask, 1.0, across))
    return (
        left_end[:, 0],
        np.where(steep_mask, left_end[:, 0], right_end[:, 0]),
        left_end[:, 1],
        slope,
        np.where(forward_mask, -1.0, 1.0),
    )


def _first_crossing(corners: Points) -> tuple[int, int] | None:
    """First pair of sides that meet elsewhere than in the corner they share; None for a simple polygon."""
    end = np.roll(corners, -1, axis=0)
    count = len(corners)
    first_edge, second_edge = np.triu_indices(count, 1)
    follows_mask = (second_edge == first_edge + 1) | ((first_edge == 0) & (second_edge == count - 1))
    a, b, c, d = corners[first_edge], end[first_edge], corners[second_edge], end[second_edge]
    turns = [np.sign(_cross(q - p, r - p)) for p, q, r in ((a, b, c), (a, b, d), (c, d, a), (c, d, b))]
    crosses = (turns[0] * turns[1] < 0) & (turns[2] * turns[3] < 0)
    touches = np.zeros_like(crosses)
    for turn, p, q, r in zip(turns, (a, a, c, c), (b, b, d, d), (c, d, a, b), strict=True):
        touches |= (turn == 0) & (_dot(r - p, r - q) <= 0)
    # Neighbours share one corner; they meet elsewhere only where the second turns back on the first.
    turns_back = follows_mask & (turns[1] == 0) & (turns[0] == 0) & (_dot(b - a, d - c) < 0)
    crossing_indices = np.flatnonzero((~follows_mask & (crosses | touches)) | turns_back)
    return (
        (int(first_edge[crossing_indices[0]]), int(second_edge[crossing_indices[0]]))
        if crossing_indices.size
        else None
    )
