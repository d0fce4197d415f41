"""Closed curves of straight segments and circular arcs: a sheet's edge by arc length."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ClosedCurve:
    """A closed curve without self-intersections, counterclockwise, in pieces of constant curvature.

    Parameters
    ----------
    start : (k, 2) start of each piece.
    heading : (k,) its direction there [rad].
    length : (k,) along it; the last piece ends where the first begins.
    curvature : (k,) one over its radius, positive where it turns left, 0 where it is straight; no piece turns by
        more than half a circle.
    """

    start: Points
    heading: Array
    length: Array
    curvature: Array

    @property
    def begins(self) -> Array:
        """Arc length at which each piece begins, and the total: (k + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.length)])

    @property
    def perimeter(self) -> float:
        return float(self.begins[-1])

    @property
    def area(self) -> float:
        """Area inside: of the polygon through the pieces' ends, and of the segments between arcs and chords."""
        ends = np.roll(self.start, -1, axis=0)
        polygon = float((self.start[:, 0] * ends[:, 1] - self.start[:, 1] * ends[:, 0]).sum()) / 2
        turn = self.curvature * self.length
        bent = self.curvature != 0
        segments = (turn[bent] - np.sin(turn[bent])) / (2 * self.curvature[bent] ** 2)
        return polygon + float(segments.sum())

    @property
    def turns(self) -> Array:
        """Jump of the direction where each piece begins, (k,) [rad], positive to the left."""
        leaves = np.roll(self.heading + self.curvature * self.length, 1)
        jump = self.heading - leaves
        return np.asarray((jump + np.pi) % (2 * np.pi) - np.pi, dtype=np.float64)

    def points_at(self, along: Array) -> Points:
        """Points at arc lengths along the curve, modulo its length: (n,) → (n, 2)."""
        begins = self.begins
        along = np.asarray(along, dtype=np.float64) % begins[-1]
        piece = np.minimum(np.searchsorted(begins, along, side="right") - 1, len(self.length) - 1)
        return self._on(piece, along - begins[piece])

    def nearest(self, points: Points) -> tuple[Array, Array]:
        """Nearest point on the curve.

        Parameters
        ----------
        points : (n, 2).

        Returns
        -------
        along : (n,) length at which it is.
        distance : (n,) not below 0.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        least_distance, along = np.full(len(points), np.inf), np.zeros(len(points))
        for piece, begin in enumerate(self.begins[:-1]):
            step = self._foot(piece, points)
            foot = self._on(np.full(len(points), piece), step)
            distance = np.hypot(*(points - foot).T)
            nearer = distance < least_distance
            least_distance[nearer], along[nearer] = distance[nearer], begin + step[nearer]
        return along, least_distance

    def contains(self, points: Points) -> NDArray[np.bool_]:
        """Whether points lie inside, (n, 2) → (n,): an odd number of the polygon and the arcs' segments hold them."""
        x, y = np.asarray(points, dtype=np.float64).reshape(-1, 2).T
        inside_mask = np.zeros(len(x), dtype=np.bool_)
        piece_ends = np.roll(self.start, -1, axis=0)
        for (x0, y0), (x1, y1), curvature, heading in zip(
            self.start, piece_ends, self.curvature, self.heading, strict=True
        ):
            rise, run = y1 - y0, x1 - x0
            side = run * (y - y0) - rise * (x - x0)  # positive left of the chord
            # A point exactly on a chord counts as slightly to its right in x, so both tests put it on one side.
            right_mask = (side < 0) | ((side == 0) & (rise > 0 or (rise == 0 and run < 0)))
            inside_mask ^= ((y0 > y) != (y1 > y)) & (right_mask if rise < 0 else ~right_mask)
            if curvature:
                from_centre = np.hypot(x - x0 + np.sin(heading) / curvature, y - y0 - np.cos(heading) / curvature)
                inside_mask ^= (from_centre < 1 / abs(curvature)) & (right_mask if curvature > 0 else ~right_mask)
        return inside_mask

    def _on(self, piece: NDArray[np.int64], step: Array) -> Points:
        half_turn = self.curvature[piece] * step / 2
        chord = step * np.sinc(half_turn / np.pi)
        direction = self.heading[piece] + half_turn
        on: Points = self.start[piece] + chord[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
        return on

    def _foot(self, piece: int, points: Points) -> Array:
        """Length along one piece, straight or bent, to its point nearest to each of some points: (n,)."""
        length, curvature, heading = self.length[piece], self.curvature[piece], self.heading[piece]
        unit_heading = np.array([np.cos(heading), np.sin(heading)])
        if curvature == 0:
            straight: Array = np.clip((points - self.start[piece]) @ unit_heading, 0, length)
            return straight
        centre = self.start[piece] + np.array([-unit_heading[1], unit_heading[0]]) / curvature
        from_centre = points - centre
        begin = self.start[piece] - centre
        angle = np.arctan2(
            begin[0] * from_centre[:, 1] - begin[1] * from_centre[:, 0], from_centre @ begin
        ) * np.sign(curvature)
        turned, whole_turn = angle % (2 * np.pi), abs(curvature) * length
        beyond = np.where(2 * np.pi - turned < turned - whole_turn, 0.0, length)
        return np.where(turned <= whole_turn, turned / abs(curvature), beyond)


def polygon_curve(corners: Points, radius: float = 0.0) -> ClosedCurve:
    """Curve through corners, each rounded with one radius.

    Parameters
    ----------
    corners : (k, 2) counterclockwise.
    radius : radius of every corner; 0 leaves them sharp. It must fit: see :func:`rounding_room`.
    """
    edge = np.roll(corners, -1, axis=0) - corners
    heading: Array = np.arctan2(edge[:, 1], edge[:, 0])
    length: Array = np.hypot(edge[:, 0], edge[:, 1])
    if radius == 0:
        return ClosedCurve(corners.copy(), heading, length, np.zeros(len(corners)))
    turn = corner_turns(corners)
    cut: Array = radius * np.tan(np.abs(turn) / 2)
    unit_heading = np.column_stack([np.cos(heading), np.sin(heading)])
    # Two pieces per corner: the straight stretch that leads to it, and its arc.
    straight_length: Array = np.roll(length, 1) - cut - np.roll(cut, 1)
    heading_before: Array = np.roll(heading, 1)
    leaves: Points = np.roll(corners, 1, axis=0) + np.roll(cut, 1)[:, None] * np.roll(unit_heading, 1, axis=0)
    enters: Points = corners - cut[:, None] * np.roll(unit_heading, 1, axis=0)
    pieces = ClosedCurve(
        np.stack([leaves, enters], axis=1).reshape(-1, 2),
        np.stack([heading_before, heading_before], axis=1).ravel(),
        np.stack([straight_length, radius * np.abs(turn)], axis=1).ravel(),
        np.stack([0 * turn, np.sign(turn) / radius], axis=1).ravel(),
    )
    kept_mask = pieces.length > 1e-9 * length.sum()
    return ClosedCurve(
        pieces.start[kept_mask], pieces.heading[kept_mask], pieces.length[kept_mask], pieces.curvature[kept_mask]
    )


def circle_curve(radius: float) -> ClosedCurve:
    """Circle about the origin, from +x on."""
    angle = np.linspace(0, 2 * np.pi, 4, endpoint=False)
    start = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return ClosedCurve(start, angle + np.pi / 2, np.full(4, np.pi / 2 * radius), np.full(4, 1 / radius))


def corner_turns(corners: Points) -> Array:
    """Turning angle at each corner of a polygon, (k,) [rad], positive to the left."""
    edge = np.roll(corners, -1, axis=0) - corners
    edge_before = np.roll(edge, 1, axis=0)
    cross = edge_before[:, 0] * edge[:, 1] - edge_before[:, 1] * edge[:, 0]
    return np.asarray(np.arctan2(cross, (edge_before * edge).sum(axis=1)), dtype=np.float64)


def rounding_room(corners: Points) -> float:
    """Largest radius with which all corners of a polygon can be rounded along their edges."""
    length = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    needed = np.tan(np.abs(corner_turns(corners)) / 2)
    both = needed + np.roll(needed, -1)
    return float(np.min(length / np.maximum(both, 1e-300)))
