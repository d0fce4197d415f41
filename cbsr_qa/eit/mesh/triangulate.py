"""Triangulation of an outline to a size field: Delaunay refinement, then smoothing.

Points are inserted at circumcentres of triangles that are too large (Chew 1989; Ruppert 1995), many at a time, and
then moved so that every edge gets the length of the size function (Persson & Strang 2004). The result does not depend
on random numbers or the order of execution: the same outline has the same mesh on any machine with the same qhull.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices, Mask

Points = Array

_TOO_LARGE = 1.25  # a larger circumradius, relative to an equilateral triangle's, needs a point
_SPACING = 0.86  # distance between points inserted together, in wanted sizes
_CLEARANCE = 0.58  # and from the outline
_ROUNDS = 60
#: Largest number of points: more than any sheet's mesh needs (3000 to 20000); so many take about a minute.
MOST_POINTS: Final = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """The area to triangulate.

    Parameters
    ----------
    points : (k, 2) fixed nodes on the outline.
    hole : (k,) int64, number of the hole a node is on the rim of, −1 on the outer edge. Holes are convex.
    size : wanted edge length at (n, 2) points, (n,).
    clearance : distance of (n, 2) points to the outline, (n,), negative outside.
    inside : whether (n, 2) points lie within the outer edge, (n,); None if that is convex.
    """

    points: Points
    hole: Indices
    size: Callable[[Points], Array]
    clearance: Callable[[Points], Array]
    inside: Callable[[Points], Mask] | None = None


def fill(outline: Outline, start: Points, *, smoothing: int) -> tuple[Points, Indices]:
    """Triangulate an outline: nodes (n, 2), the outline's first, and elements (e, 3) counterclockwise.

    Parameters
    ----------
    start : (n, 2) initial points inside the outline; may be empty.
    smoothing : number of smoothing passes, at least one; the pass with the best worst angle is kept.

    Raises
    ------
    NumericsError
        If it would take more than :data:`MOST_POINTS` points.
    """
    points = _refine(outline, np.vstack([outline.points, start]))
    elements = triangulate(outline, points)
    best = points, elements, 0.0
    for _ in range(smoothing):
        points = _smooth(outline, points, elements)
        elements = triangulate(outline, points)
        angle = float(smallest_angle_deg(points, elements).min())
        if angle > best[2]:  # a pass helps overall, but may flatten single elements
            best = points, elements, angle
    return best[0], best[1]


def triangulate(outline: Outline, points: Points) -> Indices:
    """Delaunay triangles of the points, counterclockwise, without those that fill a hole or have no area.

    Triangles outside a concave edge, which join three of its nodes, are left out too.
    """
    elements = Delaunay(points).simplices.astype(np.int64)
    hole = np.full(len(points), -1)
    hole[: len(outline.hole)] = outline.hole
    element_holes = hole[elements]
    in_hole = (
        (element_holes[:, 0] >= 0)
        & (element_holes[:, 0] == element_holes[:, 1])
        & (element_holes[:, 1] == element_holes[:, 2])
    )
    elements = elements[~in_hole]
    twice = twice_area(points, elements)
    turned = twice < 0
    elements[turned] = elements[turned][:, ::-1]
    longest = _edge_lengths(points, elements).max(axis=1)
    solid: Indices = elements[np.abs(twice) > 1e-9 * longest**2]
    if outline.inside is not None:
        edge = np.flatnonzero(((solid < len(outline.hole)) & (hole[solid] < 0)).all(axis=1))
        outside = ~outline.inside(points[solid[edge]].mean(axis=1))
        solid = np.delete(solid, edge[outside], axis=0)
    return solid


def smallest_angle_deg(points: Points, elements: Indices) -> Array:
    """Smallest angle of each triangle, (e,) [°]."""
    lengths = np.sort(_edge_lengths(points, elements), axis=1)
    short, middle, long = lengths.T
    cosine = (middle**2 + long**2 - short**2) / (2 * middle * long)
    angle: Array = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    return angle


def _refine(outline: Outline, points: Points) -> Points:
    for _ in range(_ROUNDS):
        _check_number(len(points), len(outline.points))
        centres, radii = _circumcircles(points, triangulate(outline, points))
        keep = outline.clearance(centres) > 0
        centres, radii = centres[keep], radii[keep]
        sizes = outline.size(centres)
        excess = radii * np.sqrt(3) / sizes
        keep = (excess > _TOO_LARGE) & (outline.clearance(centres) > _CLEARANCE * sizes)
        if not keep.any():
            break
        order = np.argsort(-excess[keep], kind="stable")
        centres, sizes = centres[keep][order], sizes[keep][order]
        points = np.vstack([points, centres[_spread(centres, _SPACING * sizes)]])
    return points


def _check_number(points: int, on_outline: int) -> None:
    if points > MOST_POINTS:
        raise NumericsError(
            f"the mesh would take more than {MOST_POINTS} points ({on_outline} of them on the outline and round"
            " electrodes)",
            remedy="take larger elements, or give electrodes more width, or more room to the edge and to each other",
        )


def _spread(points: Points, distance: Array) -> Indices:
    """Take points in order, leaving out those too close to one already taken."""
    near_points = cKDTree(points).query_ball_point(points, distance, return_sorted=True)
    dropped = np.zeros(len(points), dtype=bool)
    for index, neighbours in enumerate(near_points):
        if not dropped[index]:
            later = np.asarray(neighbours)
            dropped[later[later > index]] = True
    return np.flatnonzero(~dropped)


def _smooth(outline: Outline, points: Points, elements: Indices) -> Points:
    """Push the ends of short edges apart, in proportion to the missing length (Persson & Strang 2004)."""
    edges = np.sort(np.vstack([elements[:, [0, 1]], elements[:, [1, 2]], elements[:, [2, 0]]]), axis=1)
    edges = np.unique(edges[:, 0] * len(points) + edges[:, 1])
    first_end, second_end = np.divmod(edges, len(points))
    edge_vectors = points[second_end] - points[first_end]
    length = np.hypot(edge_vectors[:, 0], edge_vectors[:, 1])
    target_length = outline.size((points[first_end] + points[second_end]) / 2)
    target_length = 1.2 * target_length * np.sqrt((length**2).sum() / (target_length**2).sum())
    push = (np.maximum(target_length - length, 0) / length)[:, None] * edge_vectors
    move = np.zeros_like(points)
    np.add.at(move, first_end, -push)
    np.add.at(move, second_end, push)
    fixed = len(outline.points)
    moved_points = points.copy()
    moved_points[fixed:] += 0.2 * move[fixed:]
    is_stray = outline.clearance(moved_points[fixed:]) < 0.3 * outline.size(moved_points[fixed:])
    moved_points[fixed:][is_stray] = points[fixed:][is_stray]
    return moved_points


def twice_area(points: Points, elements: Indices) -> Array:
    """Twice the signed area of each element, (e,)."""
    a, b, c = (points[elements[:, k]] for k in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def _edge_lengths(points: Points, elements: Indices) -> Array:
    corners = points[elements]
    sides = corners - np.roll(corners, -1, axis=1)
    return np.hypot(sides[..., 0], sides[..., 1])


def _circumcircles(points: Points, elements: Indices) -> tuple[Points, Array]:
    a, b, c = (points[elements[:, k]] for k in range(3))
    u, v = b - a, c - a
    twice = 2 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    uu, vv = (u**2).sum(axis=1), (v**2).sum(axis=1)
    offset = np.column_stack([v[:, 1] * uu - u[:, 1] * vv, u[:, 0] * vv - v[:, 0] * uu]) / twice[:, None]
    return a + offset, np.hypot(offset[:, 0], offset[:, 1])
