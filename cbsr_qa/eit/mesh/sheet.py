"""Meshes of a round sheet: graded at the electrodes for voltages, nearly uniform for images."""

from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout, widest_ring_mm, width_problem
from cbsr_qa.domain.sensor.mesh import CircleArcs, Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.mesh.boundary import (
    EDGES_PER_ARC,
    EDGES_PER_PIN,
    FEWEST_SMOOTHLY,
    FINEST,
    SMOOTHING,
    Size,
    edges_round_pin_smoothly,
    finest_of_arc,
    finest_smoothly,
    grade_lengths,
    ring_edges,
    smooth_lengths,
    spread,
)
from cbsr_qa.eit.mesh.outline import outline_image_mesh, outline_sheet_mesh
from cbsr_qa.eit.mesh.triangulate import Outline, Points, fill

_COARSEST = 0.25  # largest edge length, of the radius


def sheet_mesh(sensor_type: SensorType, *, size_mm: float, order: int = 1) -> Mesh:
    """Mesh a sheet for its forward model; or return the sensor type's own mesh.

    Pins are round holes whose rims are the electrodes; arcs are stretches of the edge, refined at their ends. All
    edge lengths scale with ``size_mm``, so that a sequence of sizes shows a clean order of convergence.

    Parameters
    ----------
    size_mm : edge length far from the electrodes [mm], at most a quarter of the radius.
    order : order of the elements on the mesh.

    Raises
    ------
    RefusedError
        If the size is out of range, or the electrodes do not fit the sheet.
    """
    if sensor_type.mesh is not None:
        return sensor_type.mesh.mesh
    _check_size(sensor_type, size_mm)
    layout = sensor_type.electrodes
    if sensor_type.polygon is not None or not isinstance(layout, ElectrodeLayout):
        return outline_sheet_mesh(sensor_type, size_mm, order)
    _check_layout(sensor_type.name, layout, sensor_type.radius_mm)
    return _round_mesh(layout, sensor_type.radius_mm, size_mm, order)


@lru_cache(maxsize=4)
def _round_mesh(layout: ElectrodeLayout, radius_mm: float, size_mm: float, order: int) -> Mesh:
    """Mesh a disc, or return the cached mesh of an equal type."""
    ring = _bound_by_pins if layout.kind is ElectrodeKind.PIN else _bound_by_arcs
    outline, electrode_edges, arcs = ring(layout, radius_mm, size_mm, order)
    nodes, elements = fill(outline, np.zeros((0, 2)), smoothing=SMOOTHING)
    for shared in (nodes, elements, *electrode_edges, *(arc.edges for arc in arcs)):
        shared.flags.writeable = False
    return Mesh(nodes, elements, electrode_edges, arcs)


def image_mesh(sensor_type: SensorType, *, size_mm: float) -> Mesh:
    """Mesh a sheet with near-uniform triangles, without electrodes, for images.

    Parameters
    ----------
    size_mm : edge length [mm], at most a quarter of the radius.

    Raises
    ------
    RefusedError
        If the size is out of range.
    """
    _check_size(sensor_type, size_mm)
    if sensor_type.polygon is not None:
        mesh = outline_image_mesh(sensor_type.polygon, size_mm)
        if sensor_type.mesh is None:
            return mesh
        from cbsr_qa.eit.mesh.files import leave_out_holes  # few sheets have a mesh of their own

        return leave_out_holes(mesh, sensor_type.mesh.mesh)
    radius = sensor_type.radius_mm
    count = int(np.ceil(2 * np.pi * radius / size_mm))
    rim = radius * _unit(2 * np.pi * np.arange(count) / count)
    outline = Outline(
        rim,
        np.full(count, -1, dtype=np.int64),
        lambda points: np.full(len(points), size_mm),
        lambda points: radius - np.hypot(points[:, 0], points[:, 1]),
    )
    lattice = _hexagonal(radius, size_mm)
    start = lattice[np.hypot(lattice[:, 0], lattice[:, 1]) < radius - 0.7 * size_mm]
    nodes, elements = fill(outline, start, smoothing=SMOOTHING)
    return Mesh(nodes, elements)


#: Outline, edges of each electrode, and edges that represent arcs.
_Boundary = tuple[Outline, tuple[Indices, ...], tuple[CircleArcs, ...]]


def _bound_by_pins(layout: ElectrodeLayout, radius: float, size: float, order: int) -> _Boundary:
    centres, pin = layout.positions_mm(), layout.width_mm / 2
    tree = cKDTree(centres)
    gap = radius - layout.ring_radius_mm - pin

    def from_pin(points: Points) -> Array:
        return np.asarray(tree.query(points)[0], dtype=np.float64) - pin

    def clearance(points: Points) -> Array:
        return np.minimum(from_pin(points), radius - np.hypot(points[:, 0], points[:, 1]))

    if order == 1:
        finest_size, grade = min(size * FINEST, 2 * np.pi * pin / EDGES_PER_PIN, gap), grade_lengths(size, radius)
    else:
        finest_size = min(2 * np.pi * pin / edges_round_pin_smoothly(size, radius), gap)
        grade = smooth_lengths(size, radius)

    def sizes(points: Points) -> Array:
        return grade(finest_size, from_pin(points))

    rim_count = int(np.ceil(2 * np.pi * pin / finest_size - 1e-9))
    edge = _rotate_copies(
        _spread_arc(radius, layout.angles_rad()[0], abs(layout.step_rad), sizes)[:-1], layout, radius
    )
    rim = pin * _unit(2 * np.pi * np.arange(rim_count) / rim_count)
    rims = []
    for centre, angle in zip(centres, layout.angles_rad(), strict=True):
        cosine, sine = np.cos(angle), np.sin(angle)
        turned = (cosine * rim[:, 0] - sine * rim[:, 1], sine * rim[:, 0] + cosine * rim[:, 1])
        rims.append(centre + np.column_stack(turned))
    hole = np.concatenate([np.full(len(edge), -1), np.repeat(np.arange(layout.count), rim_count)])
    edges = tuple(len(edge) + k * rim_count + ring_edges(rim_count) for k in range(layout.count))
    arcs = [CircleArcs(e, (x, y), pin) for e, (x, y) in zip(edges, centres.tolist(), strict=True)]
    outline = Outline(np.vstack([edge, *rims]), hole.astype(np.int64), sizes, clearance)
    return outline, edges, (CircleArcs(_close_ring(edge), (0.0, 0.0), radius), *arcs)


def _bound_by_arcs(layout: ElectrodeLayout, radius: float, size: float, order: int) -> _Boundary:
    half_angle = layout.width_mm / radius / 2
    ends = layout.angles_rad()[:, None] + np.array([-half_angle, half_angle])
    tree = cKDTree(radius * _unit(ends.ravel()))
    if order == 1:
        fewest_edges, finest_size, grade = (
            EDGES_PER_ARC,
            finest_of_arc(size, radius, layout.width_mm),
            grade_lengths(size, radius),
        )
    else:
        fewest_edges, finest_size = FEWEST_SMOOTHLY, finest_smoothly(size, radius, layout.width_mm)
        grade = smooth_lengths(size, radius)

    def sizes(points: Points) -> Array:
        return grade(finest_size, np.asarray(tree.query(points)[0], dtype=np.float64))

    start = float(ends[0, 0])
    arc = _spread_arc(radius, start, 2 * half_angle, sizes, at_least=fewest_edges)
    space = _spread_arc(radius, start + 2 * half_angle, abs(layout.step_rad) - 2 * half_angle, sizes)
    edge = _rotate_copies(np.concatenate([arc[:-1], space[:-1]]), layout, radius)
    period = len(edge) // layout.count
    arc_nodes = np.arange(len(arc) - 1)
    edges = tuple((np.column_stack([arc_nodes, arc_nodes + 1]) + k * period) % len(edge) for k in range(layout.count))
    outline = Outline(
        edge,
        np.full(len(edge), -1, dtype=np.int64),
        sizes,
        lambda points: radius - np.hypot(points[:, 0], points[:, 1]),
    )
    return outline, edges, (CircleArcs(_close_ring(edge), (0.0, 0.0), radius),)


def _close_ring(edge: Points) -> Indices:
    """Edges of the sheet's edge counterclockwise, for either order of its stretches."""
    order = np.argsort(np.arctan2(edge[:, 1], edge[:, 0]), kind="stable")
    return np.column_stack([order, np.roll(order, -1)])


def _spread_arc(radius: float, start: float, span: float, sizes: Size, *, at_least: int = 2) -> Array:
    """Angles along an arc, both ends included, with the given distances between them."""
    angles = start + np.linspace(0, span, 2001)
    density = radius / sizes(radius * _unit(angles))
    return spread(density, angles, at_least=at_least)


def _rotate_copies(angles: Array, layout: ElectrodeLayout, radius: float) -> Points:
    """Nodes of one electrode's stretch of the edge, repeated for every electrode, in order."""
    all_angles = angles + layout.step_rad * np.arange(layout.count)[:, None]
    return radius * _unit(all_angles.ravel())


def _unit(angles: Array) -> Points:
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _hexagonal(radius: float, size: float) -> Points:
    """Equilateral lattice over a square of this half width, one node in the centre."""
    count = int(np.ceil(radius / size * 2 / np.sqrt(3))) + 1
    row, column = np.meshgrid(np.arange(-count, count + 1), np.arange(-2 * count, 2 * count + 1), indexing="ij")
    x = size * (column + 0.5 * (row % 2))
    return np.column_stack([x.ravel(), (size * np.sqrt(3) / 2 * row).ravel()])


def _check_size(sensor_type: SensorType, size_mm: float) -> None:
    largest = _COARSEST * sensor_type.radius_mm
    if not 0 < size_mm <= largest:
        raise RefusedError(
            f"mesh size {size_mm} mm does not fit sensor type {sensor_type.name!r};"
            f" it must be above 0 and at most a quarter of the radius, {largest:g} mm"
        )


def _check_layout(name: str, layout: ElectrodeLayout, radius: float) -> None:
    width_fault = width_problem(layout, radius)
    if width_fault is not None:
        raise RefusedError(
            f"sensor type {name!r}: the electrodes' width {width_fault}", remedy="change it or the ring"
        )
    widest = widest_ring_mm(layout.width_mm, radius)
    if layout.kind is ElectrodeKind.PIN and layout.ring_radius_mm > widest:
        raise RefusedError(
            f"sensor type {name!r}: pins of {layout.width_mm} mm on a ring of radius"
            f" {layout.ring_radius_mm} mm do not lie inside the sheet of radius {radius} mm, clear of its edge",
            remedy=f"use a ring of at most {widest:g} mm",
        )
    if layout.kind is ElectrodeKind.ARC and abs(layout.ring_radius_mm - radius) > 1e-6 * radius:
        raise RefusedError(
            f"sensor type {name!r}: electrodes.ring_radius_mm is {layout.ring_radius_mm};"
            f" arcs lie on the sheet's edge, at its radius of {radius} mm",
            remedy=f"set it to {radius}",
        )
