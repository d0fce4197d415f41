"""Regions bounded by a contour inside the elements, for images whose masks would jump by whole elements.

An image of one value per element becomes one value per node (:func:`nodal_values`), linear in between; a region is
where that field reaches a share of its maximum. ``contour_regions(image, fraction)`` returns them heaviest first;
E_CoM, A_OL and SD of :mod:`cbsr_qa.imaging.shape` take them as they take blobs, and all three are then exact for the
linear field. ``nearest_blob`` of :mod:`cbsr_qa.imaging.blobs` picks the sensed one.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.image import Image
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.imaging.masks import threshold

Array = NDArray[np.float64]

_SPECK: Final = 1e-9  # of a mean element's area


@dataclass(frozen=True, eq=False)
class ContourRegion:
    """A connected part of a sheet where a field, linear in every element, is at or above a level.

    Parameters
    ----------
    triangles_mm : (t, 3, 2) float64, counterclockwise pieces that make up the region.
    values : (t, 3) float64, the field at their corners, relative.
    start_mm, end_mm : (k, 2) float64, straight pieces of the perimeter, the region to their left.
    """

    triangles_mm: Array
    values: Array
    start_mm: Array
    end_mm: Array

    @cached_property
    def area_mm2(self) -> float:
        """Area A_b [mm²]."""
        return float(self._areas_mm2.sum())

    @cached_property
    def weight(self) -> float:
        """Integral of the field over the region [mm²]."""
        return float(self._areas_mm2 @ self.values.mean(axis=1))

    def centre_mm(self) -> Array:
        """Centre of mass M of the field over the region, exact: (2,) [mm]."""
        # ∫ u x over a triangle is A/12 (Σu Σx + Σ u x).
        corners, values = self.triangles_mm, self.values
        moment = values.sum(axis=1)[:, None] * corners.sum(axis=1) + (values[..., None] * corners).sum(axis=1)
        centre: Array = self._areas_mm2 @ moment / 12 / self.weight
        return centre

    def rim_mm(self) -> tuple[Array, Array]:
        """Starts and ends (k, 2) [mm] of the perimeter's pieces."""
        return self.start_mm, self.end_mm

    @cached_property
    def _areas_mm2(self) -> Array:
        one, other = (self.triangles_mm[:, k] - self.triangles_mm[:, 0] for k in (1, 2))
        areas: Array = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
        return areas


def nodal_values(mesh: Mesh, values: Array) -> Array:
    """Return the area-weighted mean of the elements around each node: (e,) → (n,).

    The field linear between them has the image's integral, exactly (a projection with the mass matrix lumped).
    """
    count, nodes = len(mesh.nodes_mm), mesh.elements.ravel()
    around = np.bincount(nodes, np.repeat(mesh.areas_mm2, 3), minlength=count)
    total = np.bincount(nodes, np.repeat(mesh.areas_mm2 * values, 3), minlength=count)
    nodal: Array = total / np.where(around > 0, around, 1.0)
    return nodal


def contour_regions(image: Image, fraction: float) -> tuple[ContourRegion, ...]:
    """Find the connected regions where the field of nodal values reaches a fraction of its maximum.

    Parameters
    ----------
    image : response-signed, noise floor subtracted.
    fraction : p in (0, 1).

    Returns
    -------
    Heaviest first; empty where no node is positive. Specks of a billionth of an element, whose figures would be
    rounding, are left out.

    Raises
    ------
    NumericsError
        If the fraction is outside (0, 1).
    """
    if fraction == 1:
        raise NumericsError("a contour at the maximum itself encloses nothing", remedy="take a mask below 100 %")
    mesh, nodal = image.mesh, nodal_values(image.mesh, image.values)
    level = threshold(nodal, fraction)
    if level <= 0:
        return ()
    above = nodal >= level
    pieces, label = _clipped(mesh, nodal, level, above), _components(mesh, above)
    of_piece, of_edge = label[pieces.anchor], label[pieces.edge_anchor]
    has_length = (pieces.start_mm != pieces.end_mm).any(axis=1)
    regions = []
    for number in np.unique(of_piece):
        part, edge = of_piece == number, (of_edge == number) & has_length
        regions.append(
            ContourRegion(pieces.corners_mm[part], pieces.values[part], pieces.start_mm[edge], pieces.end_mm[edge])
        )
    least = _SPECK * float(mesh.areas_mm2.mean())
    return tuple(sorted((r for r in regions if r.area_mm2 > least), key=lambda region: -region.weight))


@dataclass(frozen=True, eq=False)
class _Pieces:
    """What is left of elements cut at a level, each piece with a node (its anchor) that tells its region."""

    corners_mm: Array
    values: Array
    anchor: NDArray[np.int64]
    start_mm: Array
    end_mm: Array
    edge_anchor: NDArray[np.int64]


def _clipped(mesh: Mesh, nodal: Array, level: float, above: NDArray[np.bool_]) -> _Pieces:
    """Cut the elements that reach the level."""
    count = above[mesh.elements].sum(axis=1)
    whole = mesh.elements[count == 3]
    # One corner above: it comes first. One corner below: that one comes first.
    tips = _led_by(mesh.elements[count == 1], above)
    stumps = _led_by(mesh.elements[count == 2], ~above)
    tip_right, tip_left = (_crossing(mesh, nodal, level, tips[:, 0], tips[:, k]) for k in (1, 2))
    stump_right, stump_left = (_crossing(mesh, nodal, level, stumps[:, k], stumps[:, 0]) for k in (1, 2))
    node, tip, stump = mesh.nodes_mm, np.full(len(tips), level), np.full(len(stumps), level)
    corners = [
        node[whole],
        np.stack([node[tips[:, 0]], tip_right, tip_left], axis=1),
        np.stack([stump_right, node[stumps[:, 1]], node[stumps[:, 2]]], axis=1),
        np.stack([stump_right, node[stumps[:, 2]], stump_left], axis=1),
    ]
    values = [
        nodal[whole],
        np.column_stack([nodal[tips[:, 0]], tip, tip]),
        np.column_stack([stump, nodal[stumps[:, 1]], nodal[stumps[:, 2]]]),
        np.column_stack([stump, nodal[stumps[:, 2]], stump]),
    ]
    start, end, outer = _along_the_edge(mesh, nodal, level, above)
    return _Pieces(
        np.concatenate(corners),
        np.concatenate(values),
        np.concatenate([whole[:, 0], tips[:, 0], stumps[:, 1], stumps[:, 2]]),
        np.concatenate([tip_right, stump_left, start]),
        np.concatenate([tip_left, stump_right, end]),
        np.concatenate([tips[:, 0], stumps[:, 1], outer]),
    )


def _led_by(elements: NDArray[np.int64], first: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Turn elements so that the one corner that is marked comes first."""
    lead = first[elements].argmax(axis=1)
    turned: NDArray[np.int64] = np.take_along_axis(elements, (lead[:, None] + np.arange(3)) % 3, axis=1)
    return turned


def _crossing(mesh: Mesh, nodal: Array, level: float, high: NDArray[np.int64], low: NDArray[np.int64]) -> Array:
    """Where the field passes the level between nodes at or above it and nodes below it."""
    share = (nodal[high] - level) / (nodal[high] - nodal[low])
    crossing: Array = mesh.nodes_mm[high] + share[:, None] * (mesh.nodes_mm[low] - mesh.nodes_mm[high])
    return crossing


def _along_the_edge(
    mesh: Mesh, nodal: Array, level: float, above: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Parts of the sheet's own edge that reach the level: starts, ends, and a node of each."""
    first, last = mesh.outline.T
    first, last = first[above[first] | above[last]], last[above[first] | above[last]]
    start, end = mesh.nodes_mm[first].copy(), mesh.nodes_mm[last].copy()
    enters, leaves = ~above[first], ~above[last]
    start[enters] = _crossing(mesh, nodal, level, last[enters], first[enters])
    end[leaves] = _crossing(mesh, nodal, level, first[leaves], last[leaves])
    return start, end, np.where(above[first], first, last)


def _components(mesh: Mesh, above: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number the connected regions by their nodes: two nodes above the level join over the edge between them."""
    edges = mesh.edges[above[mesh.edges].all(axis=1)]
    count = len(mesh.nodes_mm)
    graph = csr_array((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(count, count))
    label: NDArray[np.int64] = connected_components(graph, directed=False)[1].astype(np.int64)
    return label
