"""Boundary nodes of a sheet: spaced by a size field, with a node on every corner and electrode end.

It also defines the local size of the elements.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cbsr_qa.domain.geometry.curve import ClosedCurve
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import CircleArcs
from cbsr_qa.eit.mesh.triangulate import Points

Lengths = Array
Size = Callable[[Points], Lengths]
#: (least edge length, distances from its place) → edge lengths
Grade = Callable[[float, Lengths], Lengths]

FINEST: Final = 1 / 16  # edge length at a pin's rim or an arc's end, relative to the sheet's
EDGES_PER_PIN: Final = 12  # least number of edges round a pin
EDGES_PER_ARC: Final = 10  # and along an arc
FEWEST_SMOOTHLY: Final = 4  # edges along an arc, for elements of second order
SMOOTHING: Final = 10  # passes
_STEEPEST = 0.45  # growth of the edge length per distance from an electrode; more makes thin triangles
# For the second order: with a size of 0.12 radii all readings of a disc with 16 arcs err by 1e-4, with 7000 unknowns.
_SMOOTH_SIZE = 0.12
_SMOOTH_FACTOR = 0.17
_SMOOTH_POWER = 0.6
_SMOOTH_STEEPEST = 0.6
_REACH = 0.13  # of the radius: reach of the refinement, so that a family of meshes refines everywhere alike


def growth(size: float, radius: float) -> float:
    """Growth of the edge length per distance."""
    return min(_STEEPEST, size / (_REACH * radius))


def grade_lengths(size: float, radius: float) -> Grade:
    """Edge lengths from the least one and the distance from there."""
    slope = growth(size, radius)
    return lambda finest, away: np.minimum(size, finest + slope * np.maximum(away, 0))


def smooth_lengths(size: float, radius: float, power: float = _SMOOTH_POWER) -> Grade:
    """Edge lengths for elements of second order, from the least one and the distance from there.

    They equalise the error of a singularity at the distance 0: for a field ∝ r log r error and size together are
    minimal for h ∝ r^(2/3). Readings converge with the fourth order of ``size``.

    Parameters
    ----------
    power : exponent of the distance; 1 − λ/3 at a corner with a field ∝ r^λ.
    """
    scale = size / (_SMOOTH_SIZE * radius)
    slope = _SMOOTH_STEEPEST * min(1.0, scale)

    def lengths(finest: float, distance: Lengths) -> Lengths:
        away = np.maximum(distance, 0)
        far = np.minimum(size, _SMOOTH_FACTOR * scale * radius * (away / radius) ** power)
        return np.maximum(finest, np.minimum(far, finest + slope * away))

    return lengths


def finest_at_corner(size: float, radius: float, power: float) -> float:
    """Edge length at a re-entrant corner, for elements of second order: where its power of r meets the slope."""
    scale = size / (_SMOOTH_SIZE * radius)
    slope = _SMOOTH_STEEPEST * min(1.0, scale)
    return float(slope * radius * min(1.0, _SMOOTH_FACTOR * scale / slope) ** (1 / (1 - power)))


def finest_smoothly(size: float, radius: float, length: float) -> float:
    """Edge length at the ends of an electrode of some length, for elements of second order."""
    scale = size / (_SMOOTH_SIZE * radius)
    return float(min(0.012 * scale ** (1 / (1 - _SMOOTH_POWER)), 0.1)) * length


def edges_round_pin_smoothly(size: float, radius: float) -> int:
    """Edges round a pin, for elements of second order."""
    return max(6, int(np.ceil(8 * _SMOOTH_SIZE * radius / size - 1e-9)))


def finest_of_arc(size: float, radius: float, length: float) -> float:
    """Edge length at an arc's ends, small enough for its least number of edges."""
    slope = growth(size, radius)
    return min(size * FINEST, slope * length / 2 / float(np.expm1(slope * EDGES_PER_ARC / 2)))


def ring_edges(count: int) -> Indices:
    """Edges of a closed line of n nodes."""
    return np.column_stack([np.arange(count), (np.arange(count) + 1) % count]).astype(np.int64)


def spread(density: Lengths, places: Lengths, *, at_least: int) -> Lengths:
    """Distribute the integral of a density (n,) evenly: places from the first to the last, ends included."""
    total = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2) * (places[1] - places[0])])
    count = max(at_least, int(np.ceil(total[-1])))
    chosen: Lengths = np.interp(np.arange(count + 1) / count * total[-1], total, places)
    return chosen


_ACROSS: Final = 2.5  # elements across a narrow place, at least
#: Ratio of the way along the edge to the straight distance above which two places face each other.
_DETOUR: Final = 4.0
_TURN_PER_EDGE: Final = np.pi / 3  # of a rounded corner, at most
_SHORT_ARC: Final = 0.6  # of the elements: shorter arcs have one node
_SHORT_EDGE: Final = 0.45  # of the elements: round shorter edges they are smaller
_ON_CORNER: Final = 0.01  # of a strip's width: ends closer to a corner lie on it
#: Places along a stretch at which sizes are evaluated: dense at its ends, where they may be far smaller.
_SAMPLES: Final = np.unique(
    np.concatenate([np.linspace(0, 1, 401), np.geomspace(1e-6, 0.1, 200), 1 - np.geomspace(1e-6, 0.1, 200)])
)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A disc with the finest elements at its rim, or a point if its radius is 0."""

    centre: Points
    radius: float
    finest: float
    grade: Grade


@dataclass(frozen=True, slots=True, eq=False)
class SizeField:
    """Wanted edge lengths: ``size``, and less near singularities of the field and narrow places.

    Parameters
    ----------
    size : far from such places.
    slope : growth of the edge length per distance from a narrow place.
    sources : places where the field is singular.
    narrow, across : (w, 2), (w,) places on the edge and the edge length there.
    """

    size: float
    slope: float
    sources: tuple[Source, ...]
    narrow: Points
    across: Lengths

    def __call__(self, points: Points) -> Lengths:
        """Edge lengths at (n, 2) points, (n,)."""
        sizes = np.full(len(points), self.size)
        for source in self.sources:
            away = np.hypot(points[:, 0] - source.centre[0], points[:, 1] - source.centre[1]) - source.radius
            np.minimum(sizes, source.grade(source.finest, away), out=sizes)
        if len(self.narrow):
            count = min(4, len(self.narrow))
            away, nearest = cKDTree(self.narrow).query(points, k=range(1, count + 1))
            np.minimum(sizes, (self.across[nearest] + self.slope * away).min(axis=1), out=sizes)
        return sizes

    def with_narrow(self, places: Points, across: Lengths) -> "SizeField":
        """Return the field with further narrow places."""
        places, across = np.vstack([self.narrow, places]), np.concatenate([self.across, across])
        return replace(self, narrow=places, across=across)


def narrow_places(curve: ClosedCurve, size: float) -> tuple[Points, Lengths]:
    """Find places where the sheet, or the gap between two parts of it, is too narrow for elements of a size.

    (w, 2) places on the edge, and (w,) the edge length that fits, not below ``size`` times :data:`FINEST`.
    """
    count = min(max(int(np.ceil(4 * curve.perimeter / size)), 16), 4000)
    positions = curve.perimeter * np.arange(count) / count
    points = curve.points_at(positions)
    pairs = cKDTree(points).query_pairs(_ACROSS * size, output_type="ndarray")
    path_lengths = np.abs(positions[pairs[:, 0]] - positions[pairs[:, 1]])
    path_lengths = np.minimum(path_lengths, curve.perimeter - path_lengths)
    distances = np.hypot(*(points[pairs[:, 0]] - points[pairs[:, 1]]).T)
    is_facing = path_lengths > _DETOUR * distances
    width = np.full(count, np.inf)
    for end in (0, 1):
        np.minimum.at(width, pairs[is_facing, end], distances[is_facing])
    sizes_across = np.maximum(width / _ACROSS, FINEST * size)
    is_narrow = sizes_across < size
    return points[is_narrow], sizes_across[is_narrow]


def singular_corners(curve: ClosedCurve, size: float, radius: float, order: int) -> Iterator[Source]:
    """Yield the re-entrant corners: at an inner angle ω the field is singular as r^(π/ω)."""
    inner = np.pi - curve.turns
    for corner in np.flatnonzero(inner > np.pi + 1e-6):
        exponent = float(np.pi / inner[corner])
        if order == 1:
            grade, finest = grade_lengths(size, radius), size * FINEST ** (2 * (1 - exponent))
        else:
            power = 1 - exponent / 3
            grade, finest = smooth_lengths(size, radius, power), finest_at_corner(size, radius, power)
        yield Source(curve.start[corner], 0.0, finest, grade)


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """The outline as nodes.

    Parameters
    ----------
    points : (k, 2) counterclockwise.
    strips : (k_l, 2) pairs of nodes for each strip.
    arcs : edges that represent arcs.
    """

    points: Points
    strips: tuple[Indices, ...]
    arcs: tuple[CircleArcs, ...]


def find_fixed_places(curve: ClosedCurve, sizes: Size, strips: Lengths, width: float) -> Lengths:
    """Positions along an edge that need a node, rising: corners, ends of arcs, ends of strips."""
    begins, ends = curve.begins[:-1], curve.begins[1:]
    middles = (begins + ends) / 2
    short = (curve.curvature != 0) & (curve.length < _SHORT_ARC * sizes(curve.points_at(middles)))
    smooth = np.abs(curve.turns) < 1e-6
    free = smooth & (short | np.roll(short, 1))  # start or end of a short arc
    corners = np.concatenate([begins[~free], middles[short]])
    stops = np.concatenate([strips - width / 2, strips + width / 2]) % curve.perimeter
    for corner in corners:
        away = np.abs(stops - corner)
        stops[np.minimum(away, curve.perimeter - away) < _ON_CORNER * width] = corner
    places = np.unique(np.concatenate([corners, stops]))
    gaps = np.diff(np.append(places, places[0] + curve.perimeter))
    return places[np.roll(gaps, 1) > 1e-9 * curve.perimeter]


def find_short_edges(points: Points, sizes: Size) -> tuple[Points, Lengths]:
    """Places (w, 2) and lengths (w,) where nodes of a closed line are closer than elements are large."""
    ends = np.roll(points, -1, axis=0)
    middles, length = (points + ends) / 2, np.hypot(*(ends - points).T)
    short = length < _SHORT_EDGE * sizes(middles)
    return middles[short], length[short]


def edge_nodes(curve: ClosedCurve, sizes: Size, fixed: Lengths, strips: Lengths, width: float, fewest: int) -> Edge:
    """Spread nodes along an edge between fixed places.

    ``strips``: (l,) lengths along the edge of the strips' centres; ``fewest``: least number of edges of each strip.
    """
    points: list[Points] = []
    owners: list[int] = []
    pieces: list[int] = []
    for begin, end in zip(fixed, np.append(fixed[1:], fixed[0] + curve.perimeter), strict=True):
        middle = (begin + end) / 2 % curve.perimeter
        piece = _find_piece(curve, begin, end)
        # Strip that covers a place on the edge; −1 if none.
        away = np.abs(strips - middle)
        covered = np.flatnonzero(np.minimum(away, curve.perimeter - away) < width / 2)
        owner = int(covered[0]) if covered.size else -1
        turn = 0.0 if piece < 0 else (end - begin) * abs(curve.curvature[piece])
        least = max(1, int(np.ceil(turn / _TURN_PER_EDGE - 1e-9)))
        if owner >= 0:
            least = max(least, int(np.ceil(fewest * (end - begin) / width - 0.2)))
        places = begin + _SAMPLES * (end - begin)
        stretch_nodes = _spread_nodes(1 / sizes(curve.points_at(places)), places, least)[:-1]
        points.append(curve.points_at(stretch_nodes))
        owners += [owner] * len(stretch_nodes)
        pieces += [piece] * len(stretch_nodes)
    edges = ring_edges(len(owners))
    of_strip, of_piece = np.array(owners), np.array(pieces)
    arcs = []
    for piece in np.flatnonzero(curve.curvature).tolist():
        if (of_piece == piece).any():
            heading, radius = float(curve.heading[piece]), 1 / float(curve.curvature[piece])
            x, y = curve.start[piece].tolist()
            centre = (x - radius * float(np.sin(heading)), y + radius * float(np.cos(heading)))
            arcs.append(CircleArcs(edges[of_piece == piece], centre, float(1 / abs(curve.curvature[piece]))))
    return Edge(np.vstack(points), tuple(edges[of_strip == strip] for strip in range(len(strips))), tuple(arcs))


def _spread_nodes(density: Lengths, places: Lengths, at_least: int) -> Lengths:
    total = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(places))])
    count = max(at_least, int(np.ceil(total[-1])))
    chosen: Lengths = np.interp(np.arange(count + 1) / count * total[-1], total, places)
    return chosen


def _find_piece(curve: ClosedCurve, begin: float, end: float) -> int:
    """The piece that a stretch lies on; −1 if it crosses from one to the next."""
    middle = (begin + end) / 2 % curve.perimeter
    piece = int(np.searchsorted(curve.begins, middle, side="right")) - 1
    is_within = end - begin <= 2 * min(middle - curve.begins[piece], curve.begins[piece + 1] - middle) * (1 + 1e-9)
    return piece if is_within else -1
