"""Triangle meshes of the sheet.

A mesh as a handful of arrays by name: what files, databases and configurations hold of it.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array, real_numbers

#: Largest distance of a node from the sheet's centre [mm]; products of lengths stay far from overflow.
FARTHEST_MM: Final = 1e9
_OFF_CIRCLE = 1e-6  # how far a node may be off its circle, of the radius


@dataclass(frozen=True, slots=True, eq=False)
class CircleArcs:
    """Edges of a mesh that approximate arcs of one circle: the sheet's round edge, or a pin's rim.

    Parameters
    ----------
    edges : (k, 2) int64, pairs of nodes on the circle, less than half a turn apart.
    centre_mm, radius_mm : centre and radius of the circle [mm].
    """

    edges: NDArray[np.int64]
    centre_mm: tuple[float, float]
    radius_mm: float

    def middles_mm(self, nodes_mm: Array) -> Array:
        """Middles of the arcs, (k, 2) [mm]."""
        chord = nodes_mm[self.edges].mean(axis=1) - self.centre_mm
        middles: Array = self.centre_mm + chord * (self.radius_mm / np.hypot(*chord.T))[:, None]
        return middles


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangle mesh of the sheet, with the electrodes' edges if it has any.

    Parameters
    ----------
    nodes_mm : (n, 2) float64 [mm], relative to the sheet's centre.
    elements : (e, 3) int64, counterclockwise.
    electrode_edges : one (k, 2) int64 array of node pairs per electrode; empty for a mesh that only carries images.
    arcs : edges whose true course is an arc; elements of second order follow it, the triangles here are straight.

    Raises
    ------
    RefusedError
        If nodes are not finite real numbers or beyond :data:`FARTHEST_MM`, an element is turned or has no area, names
        a node that is not there, or an arc's node is off its circle.
    """

    nodes_mm: Array
    elements: NDArray[np.int64]
    electrode_edges: tuple[NDArray[np.int64], ...] = ()
    arcs: tuple[CircleArcs, ...] = ()

    def __post_init__(self) -> None:
        check_places(real_numbers(self.nodes_mm, "nodes"))
        if self.elements.size and not 0 <= self.elements.min() <= self.elements.max() < len(self.nodes_mm):
            raise RefusedError("a mesh element names a node outside the mesh", remedy="number nodes from 0")
        flat_elements = np.flatnonzero(self.areas_mm2 <= 0)
        if flat_elements.size:
            raise RefusedError(
                f"mesh element {flat_elements[0]} (of {flat_elements.size}) is clockwise or has no area",
                remedy="list its nodes counterclockwise, or leave it out",
            )
        for arcs in self.arcs:
            away = np.hypot(*(self.nodes_mm[arcs.edges.ravel()] - arcs.centre_mm).T)
            if not (np.abs(away - arcs.radius_mm) <= _OFF_CIRCLE * arcs.radius_mm).all():
                raise RefusedError(f"an arc of radius {arcs.radius_mm:g} mm joins nodes that are not on its circle")

    @cached_property
    def corners_mm(self) -> Array:
        """Corners of the elements, (e, 3, 2) [mm]."""
        return self.nodes_mm[self.elements]

    @cached_property
    def areas_mm2(self) -> Array:
        """Areas of the elements, (e,) [mm²]."""
        first, second, third = np.moveaxis(self.nodes_mm[self.elements], 1, 0)
        first_edge, second_edge = second - first, third - first
        area: Array = (first_edge[:, 0] * second_edge[:, 1] - first_edge[:, 1] * second_edge[:, 0]) / 2
        return area

    @cached_property
    def centroids_mm(self) -> Array:
        """Centroids of the elements, (e, 2) [mm]."""
        centroids: Array = self.corners_mm.mean(axis=1)
        return centroids

    @cached_property
    def edges(self) -> NDArray[np.int64]:
        """Distinct edges as pairs of nodes, the lower first, in rising order: (k, 2) int64."""
        return self._edge_table[0]

    @cached_property
    def element_edges(self) -> NDArray[np.int64]:
        """Indices into :attr:`edges`, (e, 3) int64: edge j of an element joins its corners j and j + 1."""
        return self._edge_table[1]

    @cached_property
    def neighbours(self) -> NDArray[np.int64]:
        """Pairs of elements that share an edge, (p, 2) int64."""
        edge = self.element_edges.ravel()
        order = np.argsort(edge, kind="stable")
        shared_edges = np.flatnonzero(edge[order][1:] == edge[order][:-1])
        element = order // 3
        return np.column_stack([element[shared_edges], element[shared_edges + 1]]).astype(np.int64)

    @cached_property
    def outline(self) -> NDArray[np.int64]:
        """Edges of exactly one element, (k, 2) int64 nodes, the mesh to their left: its edge, and holes' rims."""
        alone = np.bincount(self.element_edges.ravel())[self.element_edges] == 1
        return np.column_stack([self.elements[alone], self.elements[:, [1, 2, 0]][alone]])

    @cached_property
    def _edge_table(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        pairs = np.stack([self.elements, np.roll(self.elements, -1, axis=1)], axis=-1).reshape(-1, 2)
        count = len(self.nodes_mm)
        keys, of_element = np.unique(pairs.min(axis=1) * count + pairs.max(axis=1), return_inverse=True)
        edges = np.column_stack([keys // count, keys % count]).astype(np.int64)
        return edges, of_element.reshape(-1, 3).astype(np.int64)


def check_places(nodes_mm: Array) -> None:
    """Refuse nodes (n, 2) that are not finite, or farther away than any sheet reaches.

    Raises
    ------
    RefusedError
        Naming the first.
    """
    far = np.flatnonzero(~(np.abs(nodes_mm) <= FARTHEST_MM).all(axis=-1))
    if far.size:
        raise RefusedError(
            f"mesh node {far[0]} (one of {far.size} such) is at {nodes_mm[far[0]].tolist()} mm; places are"
            f" finite numbers up to {FARTHEST_MM:g} mm",
            remedy="give nodes in mm from the sheet's centre",
        )


#: All arrays of a mesh.
NAMES = (
    "nodes_mm",
    "elements",
    "electrode_edges",
    "electrode_edge_counts",
    "arc_edges",
    "arc_edge_counts",
    "arc_circles",
)
#: Names of the arrays of whole numbers; the others are float64.
INTEGERS = ("elements", "electrode_edges", "electrode_edge_counts", "arc_edges", "arc_edge_counts")


def mesh_arrays(mesh: Mesh) -> dict[str, NDArray[Any]]:
    """Return a mesh as arrays.

    Returns
    -------
    nodes_mm : (n, 2) float64.
    elements : (e, 3) int64.
    electrode_edges, electrode_edge_counts : (k, 2) and (electrodes,) int64, all electrodes' edges one after another.
    arc_edges, arc_edge_counts, arc_circles : (m, 2) and (a,) int64, (a, 3) float64 of centre and radius.
    """
    return {
        "nodes_mm": mesh.nodes_mm,
        "elements": mesh.elements,
        "electrode_edges": _join_pairs([*mesh.electrode_edges]),
        "electrode_edge_counts": np.array([len(edges) for edges in mesh.electrode_edges], dtype=np.int64),
        "arc_edges": _join_pairs([arcs.edges for arcs in mesh.arcs]),
        "arc_edge_counts": np.array([len(arcs.edges) for arcs in mesh.arcs], dtype=np.int64),
        "arc_circles": np.array([(*a.centre_mm, a.radius_mm) for a in mesh.arcs], dtype=np.float64).reshape(-1, 3),
    }


def mesh_of_arrays(arrays: Mapping[str, Any]) -> Mesh:
    """Return the mesh of :func:`mesh_arrays`, from arrays or nested lists; arcs may be left out.

    Raises
    ------
    RefusedError
        If an array is missing, has another shape or other numbers, or the mesh contradicts itself.
    """
    nodes = _array(arrays, "nodes_mm", 2)
    edges = edge_lists(arrays, "electrode")
    arcs: tuple[CircleArcs, ...] = ()
    if "arc_edges" in arrays:
        circles = _array(arrays, "arc_circles", 3)
        edges_of_arcs = edge_lists(arrays, "arc")
        if len(edges_of_arcs) != len(circles):
            raise RefusedError(f"{len(edges_of_arcs)} lists of a mesh's arcs do not fit {len(circles)} circles")
        arcs = tuple(CircleArcs(e, (x, y), r) for e, (x, y, r) in zip(edges_of_arcs, circles.tolist(), strict=True))
    for part in (*edges, *(a.edges for a in arcs)):
        if part.size and not 0 <= part.min() <= part.max() < len(nodes):
            raise RefusedError("an electrode or an arc names a node that is not in the mesh")
    return Mesh(nodes, _array(arrays, "elements", 3), edges, arcs)


def edge_lists(arrays: Mapping[str, Any], what: str) -> tuple[NDArray[np.int64], ...]:
    """Return the edges of each ``"electrode"`` or ``"arc"``, (k, 2) int64.

    Raises
    ------
    RefusedError
        If they are missing, or their counts say something else.
    """
    edges, counts = _array(arrays, f"{what}_edges", 2), _array(arrays, f"{what}_edge_counts", 0)
    if (counts < 0).any() or int(counts.sum()) != len(edges):
        raise RefusedError(f"{what}_edges holds {len(edges)} edges, the counts say {int(counts.sum())}")
    return tuple(np.split(edges, np.cumsum(counts)[:-1])) if len(counts) else ()


def mesh_digest(mesh: Mesh) -> str:
    """SHA-256 of a mesh's content, hexadecimal."""
    sha = hashlib.sha256()
    for name, array in sorted(mesh_arrays(mesh).items()):
        kind = "<i8" if name in INTEGERS else "<f8"
        sha.update(f"{name}{array.shape}\n".encode())
        sha.update(np.ascontiguousarray(array + 0, dtype=kind).tobytes())  # no −0, which not every file keeps
    return sha.hexdigest()


def _join_pairs(parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.zeros((0, 2), dtype=np.int64)


def _array(arrays: Mapping[str, Any], name: str, columns: int) -> NDArray[Any]:
    """Return a checked array of rows of so many numbers; of single numbers for 0."""
    if name not in arrays:
        raise RefusedError(f"the mesh has no {name}")
    try:
        array = np.asarray(arrays[name])
        whole = name in INTEGERS
        if array.size == 0:
            array = np.zeros((0, columns) if columns else 0, dtype=np.int64 if whole else np.float64)
        if array.dtype.kind not in ("iu" if whole else "iuf"):
            raise RefusedError(f"{name} of the mesh must hold {'whole ' if whole else ''}numbers")
    except ValueError as error:
        raise RefusedError(f"{name} of the mesh has rows of different lengths") from error
    if array.ndim != (2 if columns else 1) or (columns and array.shape[1] != columns):
        raise RefusedError(f"{name} of the mesh has shape {array.shape} instead of (n, {columns or ''})")
    array = array.astype(np.int64 if whole else np.float64)
    if not np.isfinite(array).all():
        raise RefusedError(f"{name} of the mesh holds a number that is not finite")
    return array
