"""The edge of a sheet as nodes: spaced by a size field, with every corner and every strip's end on one."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cbsr_qa.domain.curve import ClosedCurve
from cbsr_qa.domain.mesh import CircleArcs
from cbsr_qa.forward.grading import (
    FINEST,
    Grade,
    Lengths,
    Points,
    Size,
    finest_at_corner,
    plain_lengths,
    smooth_lengths,
    spread,
)

Indices = NDArray[np.int64]

_ACROSS: Final = 2.5  # elements across a narrow place, at least
#: Two places on the edge face each other where it is so much longer between them than straight.
_DETOUR: Final = 4.0
_TURN_PER_EDGE: Final = np.pi / 6  # of a rounded corner, at most
_SAMPLES: Final = 401


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A disc at whose rim elements are finest, or a point where its radius is 0."""

    centre: Points
    radius: float
    finest: float
    grade: Grade


@dataclass(frozen=True, slots=True, eq=False)
class SizeField:
    """Wanted edge lengths: ``size``, and less near places where the field is singular or the sheet narrow.

    Parameters
    ----------
    size : far from everything.
    slope : growth of the edge length per distance from a narrow place.
    sources : where the field is singular.
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
            away, which = cKDTree(self.narrow).query(points, k=range(1, count + 1))
            np.minimum(sizes, (self.across[which] + self.slope * away).min(axis=1), out=sizes)
        return sizes

    def with_narrow(self, places: Points, across: Lengths) -> "SizeField":
        """Return the field with further narrow places."""
        places, across = np.vstack([self.narrow, places]), np.concatenate([self.across, across])
        return replace(self, narrow=places, across=across)


def narrow_places(curve: ClosedCurve, size: float) -> tuple[Points, Lengths]:
    """Where the sheet, or the gap between two parts of it, is too narrow for elements of a size.

    Returns
    -------
    places : (w, 2) on the edge.
    across : (w,) edge length with which enough elements fit, not below ``size`` times :data:`FINEST`.
    """
    count = min(max(int(np.ceil(4 * curve.perimeter / size)), 16), 4000)
    along = curve.perimeter * np.arange(count) / count
    points = curve.at(along)
    pairs = cKDTree(points).query_pairs(_ACROSS * size, output_type="ndarray")
    between = np.abs(along[pairs[:, 0]] - along[pairs[:, 1]])
    between = np.minimum(between, curve.perimeter - between)
    straight = np.hypot(*(points[pairs[:, 0]] - points[pairs[:, 1]]).T)
    facing = between > _DETOUR * straight
    width = np.full(count, np.inf)
    for end in (0, 1):
        np.minimum.at(width, pairs[facing, end], straight[facing])
    across = np.maximum(width / _ACROSS, FINEST * size)
    narrow = across < size
    return points[narrow], across[narrow]


def singular_corners(curve: ClosedCurve, size: float, radius: float, order: int) -> Iterator[Source]:
    """Yield the re-entrant corners.

    At a corner of inner angle ω the field is singular as r^(π/ω), at an electrode's end as r^(1/2). Elements are as
    much finer as the singularity is stronger.
    """
    inner = np.pi - curve.turns
    for corner in np.flatnonzero(inner > np.pi + 1e-6):
        exponent = float(np.pi / inner[corner])
        if order == 1:
            grade, finest = plain_lengths(size, radius), size * FINEST ** (2 * (1 - exponent))
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
    arcs : edges that stand for arcs.
    """

    points: Points
    strips: tuple[Indices, ...]
    arcs: tuple[CircleArcs, ...]


def edge_nodes(curve: ClosedCurve, sizes: Size, strips: Lengths, width: float, fewest: int) -> Edge:
    """Spread nodes along an edge.

    Parameters
    ----------
    strips : (l,) lengths along the edge at which the strips' centres lie.
    width : of each strip.
    fewest : edges that each strip has at least.
    """
    breaks = _breaks(curve, strips, width)
    points: list[Points] = []
    owners: list[int] = []
    pieces: list[int] = []
    for begin, end in zip(breaks, np.append(breaks[1:], breaks[0] + curve.perimeter), strict=True):
        middle = (begin + end) / 2 % curve.perimeter
        piece = int(np.searchsorted(curve.begins, middle, side="right")) - 1
        owner = _owner(curve, middle, strips, width)
        least = max(1, int(np.ceil((end - begin) * abs(curve.curvature[piece]) / _TURN_PER_EDGE - 1e-9)))
        if owner >= 0:
            least = max(least, int(np.ceil(fewest * (end - begin) / width - 1e-9)))
        places = np.linspace(begin, end, _SAMPLES)
        chosen = spread(1 / sizes(curve.at(places)), places, at_least=least)[:-1]
        points.append(curve.at(chosen))
        owners += [owner] * len(chosen)
        pieces += [piece] * len(chosen)
    edges = np.column_stack([np.arange(len(owners)), (np.arange(len(owners)) + 1) % len(owners)]).astype(np.int64)
    of_strip, of_piece = np.array(owners), np.array(pieces)
    arcs = [
        CircleArcs(edges[of_piece == piece], _centre(curve, piece), float(1 / abs(curve.curvature[piece])))
        for piece in np.flatnonzero(curve.curvature).tolist()
    ]
    return Edge(np.vstack(points), tuple(edges[of_strip == strip] for strip in range(len(strips))), tuple(arcs))


def _breaks(curve: ClosedCurve, strips: Lengths, width: float) -> Lengths:
    """Lengths at which a node must be, rising: where pieces meet and where strips end."""
    ends = np.concatenate([strips - width / 2, strips + width / 2]) % curve.perimeter
    breaks = np.sort(np.concatenate([curve.begins[:-1], ends]))
    apart = np.diff(np.append(breaks, breaks[0] + curve.perimeter))
    kept: Lengths = breaks[np.roll(apart, 1) > 1e-9 * curve.perimeter]
    return kept


def _owner(curve: ClosedCurve, along: float, strips: Lengths, width: float) -> int:
    """Strip that covers a place on the edge, −1 for none."""
    away = np.abs(strips - along)
    covered = np.flatnonzero(np.minimum(away, curve.perimeter - away) < width / 2)
    return int(covered[0]) if covered.size else -1


def _centre(curve: ClosedCurve, piece: int) -> tuple[float, float]:
    heading, radius = float(curve.heading[piece]), 1 / float(curve.curvature[piece])
    x, y = curve.start[piece].tolist()
    return x - radius * float(np.sin(heading)), y + radius * float(np.cos(heading))
