"""What must be right about a mesh that was made elsewhere, each with what to do where it is not."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import FARTHEST_MM, Mesh
from cbsr_qa.domain.numbers import array_of, real_numbers

Indices = NDArray[np.int64]
Points = NDArray[np.float64]

_SAME: Final = 1e-9  # of the mesh's size: nodes closer together are one
_SMALLEST_MM: Final = 1e-9  # extent of a mesh
_FLAT: Final = 1e-9  # area over the longest edge squared: thinner elements have no area worth the name


def plane_points(nodes_mm: ArrayLike) -> Points:
    """Return nodes as (n, 2) finite numbers; a third coordinate that is the same for all is left out.

    Raises
    ------
    NumericsError
        If they are of another type or shape, not finite, or of an extent that no sheet has.
    """
    points = real_numbers(nodes_mm, "nodes")
    if points.ndim == 2 and points.shape[1] == 3 and len(points) and np.ptp(points[:, 2]) == 0:
        points = points[:, :2]
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise NumericsError(
            f"nodes of shape {points.shape} are not at least three places (x, y) in a plane",
            remedy="give an array (n, 2) of places in millimetres",
        )
    wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if wrong.size:
        raise NumericsError(
            f"node {wrong[0]} (one of {wrong.size} such) is at a place that is not a finite number",
            remedy="mend it, or leave it and its elements out",
        )
    farthest, extent = float(np.abs(points).max()), float(np.ptp(points, axis=0).max())
    if farthest > FARTHEST_MM or extent < _SMALLEST_MM:
        raise NumericsError(
            f"a mesh of {extent:g} mm that reaches {farthest:g} mm from its origin is no sheet's; allowed are"
            f" {_SMALLEST_MM:g} to {FARTHEST_MM:g} mm",
            remedy="give places in millimetres from the sheet's centre",
        )
    return np.ascontiguousarray(points)


def whole_numbers(numbers: ArrayLike, what: str, tail: tuple[int, ...]) -> Indices:
    """Return rows of nodes as int64: ``tail`` is () for single ones, (2,) for edges, (3,) for triangles."""
    array = array_of(numbers, what)
    counted = array.dtype.kind == "f" and bool(((array == np.floor(array)) & (np.abs(array) < 2**53)).all())
    whole = array.dtype.kind in "iu" or counted
    if not whole or array.ndim != 1 + len(tail) or array.shape[1:] != tail or not len(array):
        wanted = {(): "a list of nodes", (2,): "rows of two nodes", (3,): "rows of three nodes"}[tail]
        raise NumericsError(
            f"{what} of shape {array.shape} and type {array.dtype}; {wanted} are needed, by number",
            remedy="give whole numbers, one row after another",
        )
    return array.astype(np.int64)


def check_range(numbers: Indices, count: int, first: int, what: str) -> None:
    """Refuse rows that name nodes that are not there."""
    wrong = np.flatnonzero(~((numbers >= 0) & (numbers < count)).reshape(len(numbers), -1).all(axis=1))
    if wrong.size:
        row = (numbers[wrong[0]] + first).tolist()
        counted = "first=1" if first == 0 else "first=0"
        raise NumericsError(
            f"{what} {wrong[0]} names nodes {row}; there are {first} to {count - 1 + first}",
            remedy=f"if nodes are counted from {1 - first}, say {counted}",
        )


def check_doubled(points: Points, corners: Indices) -> None:
    """Refuse nodes at one place, among those that elements use."""
    size = float(np.ptp(points, axis=0).max())
    used = np.unique(corners)
    pairs = cKDTree(points[used]).query_pairs(_SAME * size, output_type="ndarray")
    if len(pairs):
        one, other = sorted(used[pairs[0]].tolist())
        raise NumericsError(
            f"nodes {one} and {other} (one of {len(pairs)} such pairs) are at the same place",
            remedy="merge them: elements that touch must share their nodes",
        )


def check_used(points: Points, corners: Indices) -> None:
    """Refuse nodes that belong to no element."""
    used = np.zeros(len(points), dtype=np.bool_)
    used[corners] = True
    idle = np.flatnonzero(~used)
    if idle.size:
        raise NumericsError(
            f"node {idle[0]} (one of {idle.size} such) belongs to no element",
            remedy="leave such nodes out, or say mend=True",
        )


def check_shape(points: Points, corners: Indices) -> None:
    """Refuse elements that are flat or turned."""
    twice = twice_area(points, corners)
    sides = points[corners] - np.roll(points[corners], 1, axis=1)
    longest = (sides**2).sum(axis=2).max(axis=1)
    flat = np.flatnonzero(np.abs(twice) <= _FLAT * longest)
    if flat.size:
        raise NumericsError(
            f"element {flat[0]} (one of {flat.size} such) is flat: its corners lie on one line",
            remedy="leave it out, or mesh the sheet again",
        )
    turned = np.flatnonzero(twice < 0)
    if turned.size:
        raise NumericsError(
            f"element {turned[0]} (one of {turned.size} such) is turned: its corners go clockwise",
            remedy="list them counterclockwise, or say mend=True",
        )


def twice_area(points: Points, corners: Indices) -> NDArray[np.float64]:
    """Twice the signed area of each element, (e,)."""
    a, b, c = (points[corners[:, k]] for k in range(3))
    twice: NDArray[np.float64] = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return twice


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
    """Refuse a mesh whose elements do not all hang together over shared edges."""
    first, second = mesh.neighbours.T
    count = len(mesh.elements)
    graph = sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    pieces, piece = sparse.csgraph.connected_components(graph, directed=False)
    if pieces > 1:
        small = int(np.bincount(piece).min())
        raise NumericsError(
            f"the mesh falls into {pieces} pieces that share no edge, the smallest of {small} elements",
            remedy="use a mesh of one piece; where pieces touch they must share their nodes",
        )


def check_hanging(mesh: Mesh, boundary: Indices) -> None:
    """Refuse nodes that lie on an edge without dividing it: current would not pass there."""
    on_edge = np.unique(boundary)
    size = float(np.ptp(mesh.nodes_mm, axis=0).max())
    for first, second in boundary:
        start, along = mesh.nodes_mm[first], mesh.nodes_mm[second] - mesh.nodes_mm[first]
        off = mesh.nodes_mm[on_edge] - start
        share = off @ along / (along @ along)
        away = np.abs(off[:, 0] * along[1] - off[:, 1] * along[0]) / np.hypot(*along)
        hanging = on_edge[(share > 1e-6) & (share < 1 - 1e-6) & (away < _SAME * size)]
        if hanging.size:
            raise NumericsError(
                f"node {hanging[0]} lies on the edge between nodes {first} and {second} without dividing it",
                remedy="divide the elements there, so that neighbours share whole edges",
            )
