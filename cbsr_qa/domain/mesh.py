"""Triangle meshes of the sheet."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import real_numbers

#: Farthest a node may be from the sheet's centre [mm]; products of lengths stay far from overflow.
FARTHEST_MM: Final = 1e9
_OFF_CIRCLE = 1e-6  # how far a node may be off its circle, of the radius


@dataclass(frozen=True, slots=True, eq=False)
class CircleArcs:
    """Edges of a mesh that stand for arcs of one circle: the sheet's round edge, or a pin's rim.

    Parameters
    ----------
    edges : (k, 2) int64, pairs of nodes on the circle, less than half a turn apart.
    centre_mm, radius_mm : of the circle.
    """

    edges: NDArray[np.int64]
    centre_mm: tuple[float, float]
    radius_mm: float

    def middles_mm(self, nodes_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Middles of the arcs, (k, 2) [mm]."""
        chord = nodes_mm[self.edges].mean(axis=1) - self.centre_mm
        middles: NDArray[np.float64] = self.centre_mm + chord * (self.radius_mm / np.hypot(*chord.T))[:, None]
        return middles


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles that cover the sheet, with the electrodes' rims where the mesh carries them.

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

    nodes_mm: NDArray[np.float64]
    elements: NDArray[np.int64]
    electrode_edges: tuple[NDArray[np.int64], ...] = ()
    arcs: tuple[CircleArcs, ...] = ()

    def __post_init__(self) -> None:
        check_places(real_numbers(self.nodes_mm, "nodes"))
        if self.elements.size and not 0 <= self.elements.min() <= self.elements.max() < len(self.nodes_mm):
            raise RefusedError(
                "a mesh element names a node that is not in the mesh", remedy="count the mesh's nodes from 0"
            )
        flat = np.flatnonzero(self.areas_mm2 <= 0)
        if flat.size:
            raise RefusedError(
                f"mesh element {flat[0]} (of {flat.size}) is turned or has no area",
                remedy="list its nodes counterclockwise, or leave it out",
            )
        for arcs in self.arcs:
            away = np.hypot(*(self.nodes_mm[arcs.edges.ravel()] - arcs.centre_mm).T)
            if not (np.abs(away - arcs.radius_mm) <= _OFF_CIRCLE * arcs.radius_mm).all():
                raise RefusedError(f"an arc of radius {arcs.radius_mm:g} mm joins nodes that are not on its circle")

    @cached_property
    def corners_mm(self) -> NDArray[np.float64]:
        """Corners of the elements, (e, 3, 2) [mm]."""
        return self.nodes_mm[self.elements]

    @cached_property
    def areas_mm2(self) -> NDArray[np.float64]:
        """Areas of the elements, (e,) [mm²]."""
        first, second, third = np.moveaxis(self.nodes_mm[self.elements], 1, 0)
        one, other = second - first, third - first
        area: NDArray[np.float64] = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
        return area

    @cached_property
    def centroids_mm(self) -> NDArray[np.float64]:
        """Centroids of the elements, (e, 2) [mm]."""
        centroids: NDArray[np.float64] = self.corners_mm.mean(axis=1)
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
        same = np.flatnonzero(edge[order][1:] == edge[order][:-1])
        element = order // 3
        return np.column_stack([element[same], element[same + 1]]).astype(np.int64)

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


def check_places(nodes_mm: NDArray[np.float64]) -> None:
    """Refuse nodes (n, 2) at places that are not finite numbers, or farther away than any sheet reaches.

    Raises
    ------
    RefusedError
        Naming the first.
    """
    wrong = np.flatnonzero(~(np.abs(nodes_mm) <= FARTHEST_MM).all(axis=-1))
    if wrong.size:
        raise RefusedError(
            f"mesh node {wrong[0]} (one of {wrong.size} such) is at {nodes_mm[wrong[0]].tolist()} mm; places are"
            f" finite numbers up to {FARTHEST_MM:g} mm",
            remedy="give nodes in millimetres from the sheet's centre",
        )
