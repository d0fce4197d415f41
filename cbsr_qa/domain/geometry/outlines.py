"""Outlines of sheets: a disc, or any polygon with sharp or rounded corners."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.geometry.curve import ClosedCurve, circle_curve, corner_turns, polygon_curve, rounding_room
from cbsr_qa.domain.geometry.polygons import shoelace_area
from cbsr_qa.domain.numbers import Array

Points = NDArray[np.float64]

#: Sharpest corner: a sharper one would need elements as thin as itself.
SHARPEST_DEG: Final = 10.0
#: Least distance of edges, in radii of the disc of equal area; corners within 1e-4 of it repeat each other.
_NARROWEST: Final = 0.01
#: Largest number of corners of an outline: the checks compare every edge with every other.
MOST_CORNERS: Final = 1000
#: Number of edges that are compared with all others at once.
_AT_ONCE: Final = 256


@dataclass(frozen=True, slots=True)
class Disc:
    """A round sheet about the origin."""

    radius_mm: float

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Lowest and highest x, lowest and highest y."""
        return -self.radius_mm, self.radius_mm, -self.radius_mm, self.radius_mm

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Place of a central load."""
        return 0.0, 0.0

    @property
    def curve(self) -> ClosedCurve:
        return circle_curve(self.radius_mm)

    def clearance_mm(self, points_mm: Points) -> Array:
        """Distance of (n, 2) points to the edge, (n,), negative outside."""
        points = np.asarray(points_mm, dtype=np.float64).reshape(-1, 2)
        return self.radius_mm - np.hypot(points[:, 0], points[:, 1])

    def words(self) -> str:
        """Describe where it ends; follows "the sheet"."""
        return f"ends {self.radius_mm:g} mm from its centre"


@dataclass(frozen=True, slots=True)
class Polygon:
    """A sheet with corners, concave ones allowed.

    Parameters
    ----------
    corners_mm : corners [mm], at least three, in either sense; they are kept counterclockwise, beginning with the
        first.
    corner_radius_mm : radius with which every corner is rounded [mm]; 0 leaves them sharp.

    Raises
    ------
    RefusedError
        If it has fewer than three corners, one twice, one sharper than 10°, crosses itself, encloses no area, is
        narrower than a mesh can follow, or cannot be rounded with that radius.
    """

    corners_mm: tuple[tuple[float, float], ...]
    corner_radius_mm: float = 0.0

    def __post_init__(self) -> None:
        problem = next(polygon_problems(self.corners_mm), None)
        if problem is not None:
            where = "" if problem[0] is None else f"corner {problem[0] + 1} of "
            raise RefusedError(f"{where}the outline {problem[1]}")
        for problem_words in rounding_problems(self.corners_mm, self.corner_radius_mm):
            raise RefusedError(f"the outline's corner radius {problem_words}")
        corners = [(float(x), float(y)) for x, y in self.corners_mm]
        if shoelace_area(np.array(corners)) < 0:
            corners = corners[:1] + corners[:0:-1]
        object.__setattr__(self, "corners_mm", tuple(corners))

    @property
    def radius_mm(self) -> float:
        """Radius of the disc of equal area, by which lengths are scaled."""
        return float(np.sqrt(self.curve.area / np.pi))

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Lowest and highest x, lowest and highest y (of the sharp corners)."""
        x, y = np.array(self.corners_mm).T
        return float(x.min()), float(x.max()), float(y.min()), float(y.max())

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Place of a central load: the origin, unless another place is over twice as far from the edge."""
        return _centre(self)

    @property
    def curve(self) -> ClosedCurve:
        return _curve(self)

    def clearance_mm(self, points_mm: Points) -> Array:
        """Distance of (n, 2) points to the edge, (n,), negative outside."""
        points = np.asarray(points_mm, dtype=np.float64).reshape(-1, 2)
        distance = self.curve.nearest(points)[1]
        return np.where(self.curve.contains(points), distance, -distance)

    def words(self) -> str:
        """Describe where it ends; follows "the sheet"."""
        low_x, high_x, low_y, high_y = self.extent_mm
        return (
            f"is a polygon of {len(self.corners_mm)} corners, x from {low_x:g} to {high_x:g} mm,"
            f" y from {low_y:g} to {high_y:g} mm"
        )


SheetOutline = Disc | Polygon


def polygon_problems(corners_mm: Sequence[Sequence[float]]) -> Iterator[tuple[int | None, str]]:
    """Yield problems of an outline: the corner (from 0; None for the whole) and a description.

    Checks that presuppose a valid property are skipped if it is invalid.
    """
    if len(corners_mm) < 3:
        yield None, f"has {len(corners_mm)} corner{'' if len(corners_mm) == 1 else 's'}; at least 3 are needed"
        return
    if len(corners_mm) > MOST_CORNERS:
        yield None, f"has {len(corners_mm)} corners; at most {MOST_CORNERS} are allowed"
        return
    corners = np.array([[float(x), float(y)] for x, y in corners_mm])
    if not np.isfinite(corners).all():
        yield None, "has a corner that is not a finite number"
        return
    repeated = list(_repeats(corners))
    yield from repeated
    if repeated:
        return
    crossing = _crossing(corners)
    if crossing is not None:
        first, second = crossing
        yield None, f"crosses itself: the edges after corners {first + 1} and {second + 1} meet"
        return
    yield from _shape_problems(corners)


def rounding_problems(corners_mm: Sequence[Sequence[float]], corner_radius_mm: float) -> Iterator[str]:
    """Yield why the corners of a valid outline cannot be rounded with a radius."""
    corners, radius = np.array(corners_mm, dtype=np.float64), float(corner_radius_mm)
    if not 0 <= radius < np.inf:
        yield f"is {radius}; it must be a finite number of at least 0"
    elif radius > 0:
        room = rounding_room(corners)
        if radius > room * (1 + 1e-9):
            yield f"is {radius:g}; the edges leave room for {room:.4g} mm at most"
            return
        curve = polygon_curve(corners if shoelace_area(corners) > 0 else corners[::-1], radius)
        sampled = curve.points_at((curve.begins[:-1, None] + curve.length[:, None] * np.arange(8) / 8).ravel())
        if _crossing(sampled) is not None:
            yield f"is {radius:g}; a rounded corner would cut another edge"


def _repeats(corners: Points) -> Iterator[tuple[int, str]]:
    size = float(np.ptp(corners, axis=0).max())
    for index, corner in enumerate(corners):
        same_corners = np.flatnonzero(np.hypot(*(corners[:index] - corner).T) <= 1e-4 * _NARROWEST * size)
        if same_corners.size:
            closing = index == len(corners) - 1 and same_corners[0] == 0
            remedy = (
                "the last edge closes the outline by itself: leave the corner out" if closing else "leave one out"
            )
            yield index, f"repeats corner {same_corners[0] + 1}; {remedy}"


def _shape_problems(corners: Points) -> Iterator[tuple[int | None, str]]:
    area = abs(shoelace_area(corners))
    size = float(np.sqrt(area / np.pi))
    inside_deg = 180 - np.rad2deg(np.abs(corner_turns(corners)))
    for index in np.flatnonzero(inside_deg < SHARPEST_DEG):
        yield int(index), f"turns back to {inside_deg[index]:.3g}°; at least {SHARPEST_DEG:g}° are needed: cut it off"
    narrowest = _narrowest(corners)
    if narrowest is not None and narrowest[0] < _NARROWEST * size:
        width, first, second = narrowest
        yield (
            None,
            (
                f"is only {width:.3g} mm wide between the edges after corners {first + 1} and {second + 1};"
                f" at least {_NARROWEST * size:.3g} mm are needed"
            ),
        )


def _crossing(corners: Points) -> tuple[int, int] | None:
    """First pair of edges that meet without sharing a corner."""
    low, high = (bound(corners, np.roll(corners, -1, axis=0)) for bound in (np.minimum, np.maximum))
    for begin in range(0, len(corners), _AT_ONCE):
        rows = slice(begin, begin + _AT_ONCE)
        boxes_meet = ((low[rows, None] <= high) & (high[rows, None] >= low)).all(axis=-1)
        first, second = np.nonzero(boxes_meet)
        first += begin
        apart_mask = (second > first + 1) & ~((first == 0) & (second == len(corners) - 1))
        meeting = _first_meeting(corners, first[apart_mask], second[apart_mask])
        if meeting is not None:
            return meeting
    return None


def _first_meeting(corners: Points, first: NDArray[np.int64], second: NDArray[np.int64]) -> tuple[int, int] | None:
    end = np.roll(corners, -1, axis=0)
    a, b, c, d = corners[first], end[first], corners[second], end[second]
    side = [_side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b)]
    crosses = (side[0] * side[1] < 0) & (side[2] * side[3] < 0)
    touches = np.zeros_like(crosses)
    for value, (p, q, point) in zip(side, ((a, b, c), (a, b, d), (c, d, a), (c, d, b)), strict=True):
        touches |= (value == 0) & ((point - p) * (point - q) <= 0).all(axis=1)
    met = np.flatnonzero(crosses | touches)
    return (int(first[met[0]]), int(second[met[0]])) if met.size else None


def _side(start: Points, end: Points, point: Points) -> NDArray[np.int64]:
    """1 where a point is left of a line, −1 right, 0 on it to rounding."""
    along, from_start = end - start, point - start
    cross = along[:, 0] * from_start[:, 1] - along[:, 1] * from_start[:, 0]
    rounding = 1e-12 * np.hypot(*along.T) * (np.hypot(*along.T) + np.hypot(*from_start.T))
    return np.where(np.abs(cross) <= rounding, 0, np.sign(cross)).astype(np.int64)


def _narrowest(corners: Points) -> tuple[float, int, int] | None:
    """Shortest distance between edges that share no corner, and the pair."""
    end = np.roll(corners, -1, axis=0)
    # Pairs of edges that share no corner.
    count = len(corners)
    first, second = np.triu_indices(count, 2)
    apart_mask = ~((first == 0) & (second == count - 1))
    first, second = first[apart_mask], second[apart_mask]
    if not first.size:
        return None
    a, b, c, d = corners[first], end[first], corners[second], end[second]
    distance = np.min([_to_edge(p, *e) for p, e in ((a, (c, d)), (b, (c, d)), (c, (a, b)), (d, (a, b)))], axis=0)
    narrowest = int(distance.argmin())
    return float(distance[narrowest]), int(first[narrowest]), int(second[narrowest])


def _to_edge(point: Points, start: Points, end: Points) -> Array:
    along = end - start
    share = np.clip(((point - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    distance: Array = np.hypot(*(point - start - share[:, None] * along).T)
    return distance


@lru_cache(maxsize=64)
def _curve(polygon: Polygon) -> ClosedCurve:
    return polygon_curve(np.array(polygon.corners_mm), polygon.corner_radius_mm)


@lru_cache(maxsize=64)
def _centre(polygon: Polygon) -> tuple[float, float]:
    low_x, high_x, low_y, high_y = polygon.extent_mm
    centre, step = (
        np.array([(low_x + high_x) / 2, (low_y + high_y) / 2]),
        np.array([high_x - low_x, high_y - low_y]) / 2,
    )
    origin_clearance = float(polygon.clearance_mm(np.zeros((1, 2)))[0])
    offsets = np.stack(np.meshgrid(np.linspace(-1, 1, 33), np.linspace(-1, 1, 33)), axis=-1).reshape(-1, 2)
    for _ in range(12):
        places = centre + offsets * step
        clearance = polygon.clearance_mm(places)
        # Among places that are equally far from the edge the one nearest to the middle of the grid is taken.
        best = int(np.lexsort(((offsets**2).sum(axis=1).round(9), -clearance.round(9)))[0])
        centre, step, deepest = places[best], step / 4, float(clearance[best])
    return (0.0, 0.0) if origin_clearance >= deepest / 2 else (float(centre[0]), float(centre[1]))


def simplify_outline(outline: SheetOutline, tolerance_mm: float) -> SheetOutline:
    """Leave out corners of a polygon that lie within a tolerance of the line between others.

    Rounded outlines and discs are returned as they are.
    """
    if isinstance(outline, Disc) or outline.corner_radius_mm or len(outline.corners_mm) <= 4:
        return outline
    plain = thin_ring(np.array(outline.corners_mm), tolerance_mm)
    return outline if len(plain) < 3 else Polygon(tuple((x, y) for x, y in plain.tolist()))


def thin_ring(points: Points, tolerance: float) -> Points:
    """Leave out points of a closed line that lie within a tolerance of the line through the others.

    Douglas & Peucker (1973), from the first point to the one furthest from it and back.
    """
    furthest = int(np.hypot(*(points - points[0]).T).argmax())
    closed = np.vstack([points, points[:1]])
    kept_indices = _select_points(closed, 0, furthest, tolerance) | _select_points(
        closed, furthest, len(points), tolerance
    )
    return points[sorted(kept_indices - {len(points)})]


def _select_points(points: Points, first: int, last: int, tolerance: float) -> set[int]:
    """Indices of the points that a line from the first to the last needs, both included."""
    kept_indices, open_ = {first, last}, [(first, last)]
    while open_:
        begin, end = open_.pop()
        if end - begin < 2:
            continue
        inner_points = points[begin + 1 : end]
        distance = _to_edge(inner_points, np.broadcast_to(points[begin], inner_points.shape), points[end])
        furthest = begin + 1 + int(distance.argmax())
        if distance.max() > tolerance:
            kept_indices.add(furthest)
            open_ += [(begin, furthest), (furthest, end)]
    return kept_indices
