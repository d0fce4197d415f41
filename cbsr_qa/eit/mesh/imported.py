"""Imported meshes: validation, and placement of electrodes.

Each requirement on an imported mesh is refused with a remedy.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Indices, array_of, real_numbers
from cbsr_qa.domain.sensor.mesh import FARTHEST_MM, Mesh
from cbsr_qa.eit.mesh.triangulate import Points, twice_area

_SAME: Final = 1e-9  # of the mesh's size: closer nodes coincide
_SMALLEST_MM: Final = 1e-9  # extent of a mesh
_FLAT: Final = 1e-9  # area over the longest edge squared: thinner elements are degenerate


def plane_points(nodes_mm: ArrayLike) -> Points:
    """Return nodes as (n, 2) finite numbers with the extent of a sheet; a constant third coordinate is dropped."""
    points = real_numbers(nodes_mm, "nodes")
    if points.ndim == 2 and points.shape[1] == 3 and len(points) and np.ptp(points[:, 2]) == 0:
        points = points[:, :2]
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise NumericsError(
            f"nodes of shape {points.shape} are not at least three places (x, y) in a plane",
            remedy="give an array (n, 2) of places in millimetres",
        )
    bad_nodes = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad_nodes.size:
        raise NumericsError(
            f"node {bad_nodes[0]} (one of {bad_nodes.size} such) has a non-finite position",
            remedy="correct it, or leave it and its elements out",
        )
    farthest, extent = float(np.abs(points).max()), float(np.ptp(points, axis=0).max())
    if farthest > FARTHEST_MM or extent < _SMALLEST_MM:
        raise NumericsError(
            f"the mesh is {extent:g} mm wide and reaches {farthest:g} mm from its origin; allowed are"
            f" {_SMALLEST_MM:g} to {FARTHEST_MM:g} mm",
            remedy="give places in millimetres from the sheet's centre",
        )
    return np.ascontiguousarray(points)


def whole_numbers(numbers: ArrayLike, what: str, tail: tuple[int, ...]) -> Indices:
    """Return rows of nodes as int64: ``tail`` is () for single ones, (2,) for edges, (3,) for triangles."""
    array = array_of(numbers, what)
    counted = array.dtype.kind == "f" and bool(((array == np.floor(array)) & (np.abs(array) < 2**53)).all())
    is_whole = array.dtype.kind in "iu" or counted
    if not is_whole or array.ndim != 1 + len(tail) or array.shape[1:] != tail or not len(array):
        form = {(): "a list of nodes", (2,): "rows of two nodes", (3,): "rows of three nodes"}[tail]
        raise NumericsError(
            f"{what} of shape {array.shape} and type {array.dtype}; {form} are needed, by number",
            remedy="give whole numbers, one row after another",
        )
    return array.astype(np.int64)


def check_range(numbers: Indices, count: int, first: int, what: str) -> None:
    """Refuse rows with nodes that do not exist."""
    bad_rows = np.flatnonzero(~((numbers >= 0) & (numbers < count)).reshape(len(numbers), -1).all(axis=1))
    if bad_rows.size:
        numbers_given = (numbers[bad_rows[0]] + first).tolist()
        option = "first=1" if first == 0 else "first=0"
        raise NumericsError(
            f"{what} {bad_rows[0]} names nodes {numbers_given}; nodes are numbered {first} to {count - 1 + first}",
            remedy=f"if nodes are counted from {1 - first}, say {option}",
        )


def check_doubled(points: Points, corners: Indices) -> None:
    """Refuse coinciding nodes among those that elements use."""
    size = float(np.ptp(points, axis=0).max())
    used_nodes = np.unique(corners)
    pairs = cKDTree(points[used_nodes]).query_pairs(_SAME * size, output_type="ndarray")
    if len(pairs):
        first, second = sorted(used_nodes[pairs[0]].tolist())
        raise NumericsError(
            f"nodes {first} and {second} (one of {len(pairs)} such pairs) are at the same place",
            remedy="merge them: elements that touch must share their nodes",
        )


def check_used(points: Points, corners: Indices) -> None:
    """Refuse nodes that belong to no element."""
    is_used = np.zeros(len(points), dtype=np.bool_)
    is_used[corners] = True
    idle_nodes = np.flatnonzero(~is_used)
    if idle_nodes.size:
        raise NumericsError(
            f"node {idle_nodes[0]} (one of {idle_nodes.size} such) belongs to no element",
            remedy="leave such nodes out, or say fix=True",
        )


def check_shape(points: Points, corners: Indices) -> None:
    """Refuse flat or clockwise elements."""
    twice = twice_area(points, corners)
    sides = points[corners] - np.roll(points[corners], 1, axis=1)
    longest = (sides**2).sum(axis=2).max(axis=1)
    flat_elements = np.flatnonzero(np.abs(twice) <= _FLAT * longest)
    if flat_elements.size:
        raise NumericsError(
            f"element {flat_elements[0]} (one of {flat_elements.size} such) is flat: its corners lie on one line",
            remedy="leave it out, or mesh the sheet again",
        )
    turned_elements = np.flatnonzero(twice < 0)
    if turned_elements.size:
        raise NumericsError(
            f"element {turned_elements[0]} (one of {turned_elements.size} such) is turned: its corners go clockwise",
            remedy="list them counterclockwise, or say fix=True",
        )


def boundary_edges(mesh: Mesh) -> Indices:
    """Edges of exactly one element, (b, 2); an edge of three is refused."""
    counts = np.bincount(mesh.element_edges.ravel(), minlength=len(mesh.edges))
    crowded = np.flatnonzero(counts > 2)
    if crowded.size:
        first, second = mesh.edges[crowded[0]]
        raise NumericsError(
            f"{counts[crowded[0]]} elements share the edge between nodes {first} and {second}",
            remedy="a sheet's edge has an element on either side at most: leave out elements that lie on others",
        )
    boundary: Indices = mesh.edges[counts == 1]
    return boundary


def check_in_one_piece(mesh: Mesh) -> None:
    """Refuse a mesh whose elements are not all connected over shared edges."""
    first, second = mesh.neighbours.T
    count = len(mesh.elements)
    graph = sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    pieces, piece = csgraph.connected_components(graph, directed=False)
    if pieces > 1:
        small = int(np.bincount(piece).min())
        raise NumericsError(
            f"the mesh falls into {pieces} pieces that share no edge, the smallest of {small} elements",
            remedy="use a mesh of one piece; where pieces touch they must share their nodes",
        )


def check_hanging(mesh: Mesh, boundary: Indices) -> None:
    """Refuse nodes on an edge that they do not divide: current would not pass there."""
    on_edge = np.unique(boundary)
    size = float(np.ptp(mesh.nodes_mm, axis=0).max())
    for first, second in boundary:
        start, edge_vector = mesh.nodes_mm[first], mesh.nodes_mm[second] - mesh.nodes_mm[first]
        offsets_mm = mesh.nodes_mm[on_edge] - start
        share = offsets_mm @ edge_vector / (edge_vector @ edge_vector)
        distances_mm = np.abs(offsets_mm[:, 0] * edge_vector[1] - offsets_mm[:, 1] * edge_vector[0]) / np.hypot(
            *edge_vector
        )
        hanging = on_edge[(share > 1e-6) & (share < 1 - 1e-6) & (distances_mm < _SAME * size)]
        if hanging.size:
            raise NumericsError(
                f"node {hanging[0]} lies on the edge between nodes {first} and {second} without dividing it",
                remedy="divide the elements there, so that neighbours share whole edges",
            )


_LEAST_COVERED: Final = 0.5  # share of an electrode's width that must be edges of the mesh


@dataclass(frozen=True, slots=True)
class ElectrodeAt:
    """An electrode by its place: every edge of the boundary with its middle within half the width.

    Parameters
    ----------
    x_mm, y_mm : middle of a strip, or of the hole that a pin is.
    width_mm : length of a strip, or diameter of a pin.
    """

    x_mm: float
    y_mm: float
    width_mm: float


#: One electrode: its nodes in any order (k,), its edges as pairs of nodes (k, 2), or its place.
ElectrodeGiven = ElectrodeAt | ArrayLike


def import_mesh(
    nodes_mm: ArrayLike,
    elements: ArrayLike,
    electrodes: Sequence[ElectrodeGiven] = (),
    *,
    first: int = 0,
    fix: bool = False,
) -> Mesh:
    """Check an imported mesh, and find its electrodes' edges.

    Parameters
    ----------
    nodes_mm : (n, 2) [mm]; (n, 3) with a constant third coordinate.
    elements : (e, 3) nodes of each triangle.
    electrodes : each by its nodes, its edges or its place; in the order of their numbers. Nodes and edges are counted
        as in ``elements``.
    first : number of the first node, 1 where software counts from one (MATLAB, EIDORS, gmsh).
    fix : reverse clockwise elements and leave out unused nodes, instead of refusing them.

    Raises
    ------
    NumericsError
        If arrays have other shapes or name missing nodes; two nodes coincide; a node is unused; an element is
        clockwise or flat; three elements share an edge; a node hangs on an edge; the mesh falls into pieces; an
        electrode is outside the mesh, not on its boundary, has no edges, or shares one. Messages count nodes,
        elements and electrodes from 0.
    """
    points = plane_points(nodes_mm)
    corners = whole_numbers(elements, "elements", (3,)) - first
    check_range(corners, len(points), first, "element")
    given_electrodes = [
        electrode if isinstance(electrode, ElectrodeAt) else _numbers(electrode, k, first)
        for k, electrode in enumerate(electrodes)
    ]
    check_doubled(points, corners)
    if fix:
        points, corners, given_electrodes = _fix_mesh(points, corners, given_electrodes)
    check_used(points, corners)
    check_shape(points, corners)
    mesh = Mesh(points, corners)
    boundary = boundary_edges(mesh)
    check_in_one_piece(mesh)
    check_hanging(mesh, boundary)
    edges = [_edges_of(electrode, number, mesh, boundary) for number, electrode in enumerate(given_electrodes)]
    _check_shared(edges)
    return Mesh(points, corners, tuple(edges))


def _numbers(given: ArrayLike, number: int, first: int) -> Indices:
    """Nodes (k,) or edges (k, 2) of an electrode, counted from 0."""
    array = array_of(given, f"nodes of electrode {number}")
    if not array.size:
        raise NumericsError(
            f"electrode {number} has no nodes or edges", remedy="give it some, or leave it and its pairs out"
        )
    return whole_numbers(array, f"electrode {number}:", (2,) if array.ndim == 2 else ()) - first


def _fix_mesh(
    points: Points, corners: Indices, given: list[ElectrodeAt | Indices]
) -> tuple[Points, Indices, list[ElectrodeAt | Indices]]:
    is_turned = twice_area(points, corners) < 0
    corners = corners.copy()
    corners[is_turned] = corners[is_turned][:, ::-1]
    used_nodes = np.unique(corners)
    new_numbers = np.full(len(points), -1, dtype=np.int64)
    new_numbers[used_nodes] = np.arange(len(used_nodes))
    renumbered: list[ElectrodeAt | Indices] = []
    for number, electrode in enumerate(given):
        if not isinstance(electrode, ElectrodeAt):
            check_range(electrode, len(points), 0, f"electrode {number}: entry")
            if (new_numbers[electrode] < 0).any():
                raise NumericsError(
                    f"electrode {number} names a node that belongs to no element", remedy="name nodes of the sheet"
                )
        renumbered.append(electrode if isinstance(electrode, ElectrodeAt) else new_numbers[electrode])
    return points[used_nodes], new_numbers[corners], renumbered


def _edges_of(given: ElectrodeAt | Indices, number: int, mesh: Mesh, boundary: Indices) -> Indices:
    if isinstance(given, ElectrodeAt):
        return _edges_at(given, number, mesh, boundary)
    check_range(given, len(mesh.nodes_mm), 0, f"electrode {number}: entry")
    if given.ndim == 1:
        return _edges_between(given, number, boundary)
    keys = _keys(boundary, mesh)
    strays = np.flatnonzero(~np.isin(_keys(given, mesh), keys))
    if strays.size:
        first, second = given[strays[0]]
        raise NumericsError(
            f"electrode {number}: nodes {first} and {second} are no edge of the mesh's boundary",
            remedy="an electrode is on the sheet's edge, or on the rim of a hole in it",
        )
    return given


def _edges_between(nodes: Indices, number: int, boundary: Indices) -> Indices:
    edges: Indices = boundary[np.isin(boundary, nodes).all(axis=1)]
    alone = np.setdiff1d(nodes, edges)
    if alone.size:
        fault = "is not on the mesh's boundary" if not np.isin(alone[0], boundary) else "has no other beside it"
        raise NumericsError(
            f"electrode {number}: node {alone[0]} {fault}; an electrode's nodes are joined by edges of the boundary",
            remedy="name all its nodes; for an electrode that is a single point use"
            " cbsr_qa.eit.forward.model.point_model",
        )
    return edges


def _edges_at(place: ElectrodeAt, number: int, mesh: Mesh, boundary: Indices) -> Indices:
    centre_mm, ends = np.array([place.x_mm, place.y_mm]), mesh.nodes_mm[boundary]
    to_middle = np.hypot(*(ends.mean(axis=1) - centre_mm).T)
    covered_edges: Indices = boundary[to_middle <= place.width_mm / 2 * (1 + 1e-9)]
    covered_mm = float(np.hypot(*(mesh.nodes_mm[covered_edges[:, 1]] - mesh.nodes_mm[covered_edges[:, 0]]).T).sum())
    if covered_mm >= _LEAST_COVERED * place.width_mm:
        return covered_edges
    electrode_name = f"electrode {number} at ({place.x_mm:zg}, {place.y_mm:zg}) mm"
    edge_vectors = ends[:, 1] - ends[:, 0]
    share = np.clip(((centre_mm - ends[:, 0]) * edge_vectors).sum(axis=1) / (edge_vectors**2).sum(axis=1), 0, 1)
    distance_mm = float(np.hypot(*(centre_mm - ends[:, 0] - share[:, None] * edge_vectors).T).min())
    if distance_mm > place.width_mm:
        raise NumericsError(
            f"{electrode_name} is not on the mesh's boundary, which is {distance_mm:.4g} mm away",
            remedy="move it to the sheet's edge or to a hole, or check the mesh's unit of length (millimetres)",
        )
    raise NumericsError(
        f"{electrode_name} covers {covered_mm:.4g} mm of the mesh's boundary; it is {place.width_mm:g} mm wide",
        remedy="use smaller elements there, with nodes at the electrode's ends",
    )


def _check_shared(electrodes: list[Indices]) -> None:
    owner: dict[tuple[int, int], int] = {}
    for number, edges in enumerate(electrodes):
        for first, second in np.sort(edges, axis=1).tolist():
            other = owner.setdefault((first, second), number)
            if other != number:
                raise NumericsError(
                    f"electrodes {other} and {number} share the edge between nodes {first} and {second}",
                    remedy="electrodes may not overlap",
                )


def _keys(edges: Indices, mesh: Mesh) -> Indices:
    keys: Indices = np.sort(edges, axis=1) @ np.array([len(mesh.nodes_mm), 1])
    return keys
