"""Meshes of sheets of any outline with electrodes anywhere: boundary nodes first, then the interior.

The outline is first moved to its own frame, with its first corner at the origin and its first edge along +x, and
rounded to a grid far finer than any drawing, so that a rotated or moved sheet has the same mesh, rotated or moved.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.geometry.curve import ClosedCurve, circle_curve, polygon_curve
from cbsr_qa.domain.geometry.outlines import Disc, SheetOutline, simplify_outline
from cbsr_qa.domain.numbers import Indices, Mask
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, placement_problems, width_problem
from cbsr_qa.domain.sensor.mesh import CircleArcs, Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.mesh.boundary import (
    EDGES_PER_ARC,
    EDGES_PER_PIN,
    FEWEST_SMOOTHLY,
    FINEST,
    SMOOTHING,
    Edge,
    Lengths,
    SizeField,
    Source,
    edge_nodes,
    edges_round_pin_smoothly,
    find_fixed_places,
    find_short_edges,
    finest_of_arc,
    finest_smoothly,
    grade_lengths,
    growth,
    narrow_places,
    ring_edges,
    singular_corners,
    smooth_lengths,
)
from cbsr_qa.eit.mesh.triangulate import Outline, Points, fill

_ROUNDS: Final = 12  # rounds of dividing edges that the triangles would cut
_EDGES_ROUND_CLOSE_PIN: Final = 200  # limit: a pin closer to something has no room
#: Protrusion, over the elements' size, below which an image's outline leaves out a corner.
_OUT_OF_LINE: Final = 0.03


def outline_sheet_mesh(sensor_type: SensorType, size_mm: float, order: int) -> Mesh:
    """Mesh any sheet for its forward model; see :func:`cbsr_qa.eit.mesh.sheet.sheet_mesh`, also for errors."""
    electrodes = sensor_type.electrodes
    for number, problem in placement_problems(electrodes, sensor_type.outline):
        subject = "its ring of electrodes" if number is None else f"electrode {number}"
        raise RefusedError(
            f"sensor type {sensor_type.name!r}: {subject} {problem}", remedy="move it, or make it narrower"
        )
    width_fault = width_problem(electrodes, sensor_type.outline.radius_mm)
    if width_fault is not None:
        raise RefusedError(
            f"sensor type {sensor_type.name!r}: the electrodes' width {width_fault}", remedy="change it"
        )
    frame = _Frame.for_outline(sensor_type.outline)
    curve, radius = frame.curve, frame.radius
    places, width = frame.to_frame(electrodes.positions_mm()), electrodes.width_mm
    if electrodes.kind is ElectrodeKind.PIN:
        contacts = _Contacts(_Pins.place(curve, places, width / 2, size_mm, order), np.zeros(0), 0.0, 1)
    else:
        fewest = EDGES_PER_ARC if order == 1 else FEWEST_SMOOTHLY
        contacts = _Contacts(_Pins.none(), curve.nearest(places)[0], width, fewest)
    sources = (
        *contacts.sources(curve, size_mm, radius, order),
        *singular_corners(curve, size_mm, radius, order),
    )
    sizes = SizeField(size_mm, growth(size_mm, radius), sources, *narrow_places(curve, size_mm))
    return frame.from_frame(_fill(curve, sizes, contacts, np.zeros((0, 2))))


def outline_image_mesh(outline: SheetOutline, size_mm: float) -> Mesh:
    """Mesh any sheet with near-uniform triangles; see :func:`cbsr_qa.eit.mesh.sheet.image_mesh`, also for errors."""
    plain = simplify_outline(outline, _OUT_OF_LINE * size_mm)
    frame = _Frame.for_outline(plain)
    curve = frame.curve
    sizes = SizeField(size_mm, growth(size_mm, frame.radius), (), *narrow_places(curve, size_mm))
    start = _lattice(curve, size_mm)
    distance = curve.nearest(start)[1]
    distance_inside = np.where(curve.contains(start), distance, -distance)
    start = start[distance_inside > 0.7 * size_mm]
    mesh = _fill(curve, sizes, _Contacts(_Pins.none(), np.zeros(0), 0.0, 1), start)
    return frame.from_frame(replace(mesh, electrode_edges=(), arcs=()))


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """Transformation from the sheet's own frame: x = origin + turn · x_own.

    Parameters
    ----------
    curve : the edge, in the own frame.
    """

    origin: Points
    turn: Points
    grid: float
    curve: ClosedCurve

    @classmethod
    def for_outline(cls, outline: SheetOutline) -> Self:
        grid = float(10.0 ** (np.floor(np.log10(outline.radius_mm)) - 10))
        if isinstance(outline, Disc):
            return cls(np.zeros(2), np.eye(2), grid, circle_curve(outline.radius_mm))
        corners = np.array(outline.corners_mm)
        first_side = corners[1] - corners[0]
        cosine, sine = first_side / np.hypot(*first_side)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        turned_corners = np.round((corners - corners[0]) @ turn / grid) * grid
        return cls(corners[0], turn, grid, polygon_curve(turned_corners, outline.corner_radius_mm))

    @property
    def radius(self) -> float:
        """Radius of the disc of equal area, identical for any position of the sheet."""
        return float(np.sqrt(self.curve.area / np.pi))

    def to_frame(self, points: Points) -> Points:
        return np.round((points - self.origin) @ self.turn / self.grid) * self.grid

    def from_frame(self, mesh: Mesh) -> Mesh:
        arcs = tuple(
            CircleArcs(a.edges, (float(x), float(y)), a.radius_mm)
            for a, (x, y) in ((a, self.origin + self.turn @ np.array(a.centre_mm)) for a in mesh.arcs)
        )
        return replace(mesh, nodes_mm=self.origin + mesh.nodes_mm @ self.turn.T, arcs=arcs)


@dataclass(frozen=True, slots=True, eq=False)
class _Pins:
    """Round holes: (p, 2) centres, their radius, (p,) edge length at their rims."""

    centres: Points
    radius: float
    finest: Lengths

    @classmethod
    def none(cls) -> Self:
        return cls(np.zeros((0, 2)), 0.0, np.zeros(0))

    @classmethod
    def place(cls, curve: ClosedCurve, centres: Points, radius: float, size: float, order: int) -> Self:
        """Edge lengths short enough for the edges around a pin and between it and its neighbours."""
        room = curve.nearest(centres)[1] - radius
        if len(centres) > 1:
            next_pin = np.asarray(cKDTree(centres).query(centres, k=[2])[0])[:, 0]
            room = np.minimum(room, next_pin - 2 * radius)
        round_ = 2 * np.pi * radius
        room = np.maximum(room, round_ / _EDGES_ROUND_CLOSE_PIN)
        if order == 1:
            finest = min(size * FINEST, round_ / EDGES_PER_PIN)
        else:
            finest = round_ / edges_round_pin_smoothly(size, float(np.sqrt(curve.area / np.pi)))
        return cls(centres, radius, np.minimum(finest, room))

    def finer(self, which: Indices) -> Self:
        """Return pins with half the edge length round some."""
        finest = self.finest.copy()
        finest[which] /= 2
        return replace(self, finest=finest)

    def rims(self) -> list[Points]:
        counts = np.ceil(2 * np.pi * self.radius / self.finest - 1e-9).astype(int)
        rims = []
        for centre, count in zip(self.centres, counts, strict=True):
            angle = 2 * np.pi * np.arange(count) / count
            rims.append(centre + self.radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        return rims

    def distance(self, points: Points) -> Lengths:
        """Distance of points to the nearest rim, negative in a pin."""
        if not len(self.centres):
            return np.full(len(points), np.inf)
        return np.asarray(cKDTree(self.centres).query(points)[0], dtype=np.float64) - self.radius


@dataclass(frozen=True, slots=True, eq=False)
class _Contacts:
    """Electrodes: pins, or strips by their centres along the edge, their width and fewest edges."""

    pins: _Pins
    strips: Lengths
    width: float
    fewest: int

    def sources(self, curve: ClosedCurve, size: float, radius: float, order: int) -> Iterator[Source]:
        """Yield the singularities of the field: pins, and ends of strips."""
        grade = grade_lengths(size, radius) if order == 1 else smooth_lengths(size, radius)
        for centre, finest in zip(self.pins.centres, self.pins.finest, strict=True):
            yield Source(centre, self.pins.radius, float(finest), grade)
        finest_of = finest_of_arc if order == 1 else finest_smoothly
        for end in curve.points_at(np.concatenate([self.strips - self.width / 2, self.strips + self.width / 2])):
            yield Source(end, 0.0, finest_of(size, radius, self.width), grade)


def _fill(curve: ClosedCurve, sizes: SizeField, contacts: _Contacts, start: Points) -> Mesh:
    edge, pins, sizes = _place_boundary_nodes(curve, sizes, contacts)
    rims = pins.rims()
    points = np.vstack([edge.points, *rims])
    hole = np.repeat(np.arange(-1, len(rims)), [len(edge.points), *map(len, rims)])
    near = _measure_edge_distance(curve, edge.points)

    def clearance(places: Points) -> Lengths:
        return np.minimum(near(places), pins.distance(places))

    outline = Outline(points, hole.astype(np.int64), sizes, clearance, curve.contains)
    nodes, elements = fill(outline, start, smoothing=SMOOTHING)
    first = len(edge.points) + np.cumsum([0, *map(len, rims)])
    rings = [begin + ring_edges(len(rim)) for begin, rim in zip(first[:-1], rims, strict=True)]
    circles = [
        CircleArcs(ring, (x, y), pins.radius) for ring, (x, y) in zip(rings, pins.centres.tolist(), strict=True)
    ]
    mesh = Mesh(nodes, elements, (*edge.strips, *rings), (*edge.arcs, *circles))
    _check_edge(mesh, [ring_edges(len(edge.points)), *rings], sizes.size)
    return mesh


def _place_boundary_nodes(curve: ClosedCurve, sizes: SizeField, contacts: _Contacts) -> tuple[Edge, _Pins, SizeField]:
    """Distribute nodes along the edge and round the pins, closer where triangles would cut either."""
    fixed, pins = find_fixed_places(curve, sizes, contacts.strips, contacts.width), contacts.pins

    def spread() -> Edge:
        return edge_nodes(curve, sizes, fixed, contacts.strips, contacts.width, contacts.fewest)

    edge = spread()
    sizes = sizes.with_narrow(*find_short_edges(edge.points, sizes))
    for _ in range(_ROUNDS):
        edge, rims = spread(), pins.rims()
        rings = [edge.points, *rims]
        cut = _cut_edges(rings)
        if not cut.any():
            break
        starts, ends = np.vstack(rings), np.vstack([np.roll(ring, -1, axis=0) for ring in rings])
        sizes = sizes.with_narrow((starts + ends)[cut] / 2, np.hypot(*(ends - starts)[cut].T) / 2)
        owner = np.repeat(np.arange(-1, len(rims)), [len(ring) for ring in rings])
        pins = pins.finer(np.unique(owner[cut & (owner >= 0)]))
    return edge, pins, sizes


def _cut_edges(rings: list[Points]) -> Mask:
    """Edges of closed lines missing in the Delaunay triangulation of all nodes, one for each node."""
    points = np.vstack(rings)
    triangles = Delaunay(points).simplices
    joined = np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    begins = np.cumsum([0, *(len(ring) for ring in rings)])
    edges = np.vstack([begin + ring_edges(len(ring)) for begin, ring in zip(begins[:-1], rings, strict=True)])
    return ~np.isin(np.sort(edges, axis=1) @ [len(points), 1], joined @ [len(points), 1])


def _check_edge(mesh: Mesh, rings: list[Indices], size: float) -> None:
    counts = np.bincount(mesh.element_edges.ravel(), minlength=len(mesh.edges))
    boundary_keys = mesh.edges[counts == 1] @ [len(mesh.nodes_mm), 1]
    ring_keys = np.sort(np.vstack(rings), axis=1) @ [len(mesh.nodes_mm), 1]
    if counts.max() > 2 or not np.array_equal(np.sort(boundary_keys), np.sort(ring_keys)):
        raise RefusedError(
            f"elements of {size:g} mm cannot follow the sheet's outline",
            remedy="use a smaller element size, or a plainer outline",
        )


def _measure_edge_distance(curve: ClosedCurve, nodes: Points) -> Callable[[Points], Lengths]:
    """Signed distance to the edge: exact near it, and to the nearest node (which is faster) far from it."""
    tree = cKDTree(nodes)
    longest = float(np.hypot(*(nodes - np.roll(nodes, 1, axis=0)).T).max())

    def distance(places: Points) -> Lengths:
        away = np.asarray(tree.query(places)[0], dtype=np.float64)
        near = away < 3 * longest
        away[near] = curve.nearest(places[near])[1]
        return np.where(curve.contains(places), away, -away)

    return distance


def _lattice(curve: ClosedCurve, size: float) -> Points:
    """Equilateral lattice over the curve's pieces, along +x."""
    low, high = curve.start.min(axis=0), curve.start.max(axis=0)
    step = np.array([size, size * np.sqrt(3) / 2])
    columns, rows = np.ceil((high - low) / step).astype(int) + 1
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    x = low[0] + size * (column + 0.5 * (row % 2))
    return np.column_stack([x.ravel(), (low[1] + step[1] * row).ravel()])
