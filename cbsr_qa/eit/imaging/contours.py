"""Regions bounded by a contour inside elements, so that masks do not jump by whole elements.

An image with one value per element is converted to one value per node, linear in between; a region is where that
field reaches a share of its maximum. The metrics of :mod:`.shape` are exact for the linear field.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from scipy.sparse import csr_array

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.imaging.blobs import component_labels, groups, threshold

_SPECK: Final = 1e-9  # largest area that is left out, in mean areas of an element
_ALIGNED: Final = 1e-9  # flatness of a line: elements around a node in a flatter arrangement give no slope across it


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
        return float(self._areas_mm2 @ self._sums) / 3

    def centre_mm(self) -> Array:
        """Centre of mass M of the field over the region, exact: (2,) [mm]."""
        return self._centre_mm

    def rim_mm(self) -> tuple[Array, Array]:
        """Starts and ends (k, 2) [mm] of the perimeter's pieces."""
        return self.start_mm, self.end_mm

    @cached_property
    def _centre_mm(self) -> Array:
        # ∫ u x over a triangle is A/12 (Σu Σx + Σ u x).
        shared = (self._areas_mm2[:, None] * (self._sums[:, None] + self.values)).reshape(-1)
        return shared @ self.triangles_mm.reshape(-1, 2) / (12 * self.weight)

    @cached_property
    def _sums(self) -> Array:
        first, second, third = self.values.T
        sums: Array = first + second + third
        return sums

    @cached_property
    def _areas_mm2(self) -> Array:
        u, v = (self.triangles_mm[:, k] - self.triangles_mm[:, 0] for k in (1, 2))
        return (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2


def nodal_values(mesh: Mesh, values: Array) -> Array:
    """Return at each node the linear function that fits the elements around it best, by area: (e,) → (n,).

    It is exact for linear images and of second order in the element size for smooth ones. On the edge of the mesh the
    area-weighted mean is kept.
    """
    return _fit_at_nodes(mesh) @ values


def contour_regions(image: Image, fraction: float) -> tuple[ContourRegion, ...]:
    """Find the connected regions where the field of nodal values reaches a fraction in (0, 1) of its maximum.

    Returns
    -------
    Heaviest first; empty where no node is positive. Specks of a billionth of an element are left out.

    Raises
    ------
    NumericsError
        If the fraction is outside (0, 1).
    """
    return find_contours_by_mask(image, (fraction,))[0]


def find_contours_by_mask(image: Image, fractions: Sequence[float]) -> tuple[tuple[ContourRegion, ...], ...]:
    """Find the regions of several masks: one tuple per mask, otherwise as :func:`contour_regions`."""
    if max(fractions, default=0.5) == 1:
        raise NumericsError("a contour at the maximum itself encloses nothing", remedy="use a mask below 100 %")
    nodal = nodal_values(image.mesh, image.values)
    levels = np.array([threshold(nodal, fraction) for fraction in fractions])
    if not levels.size or levels[0] <= 0:
        return ((),) * len(levels)
    return field_regions(image.mesh, nodal, levels)


def field_regions(mesh: Mesh, nodal: Array, levels: Array) -> tuple[tuple[ContourRegion, ...], ...]:
    """Find the connected regions where a field, linear in every element, is at or above levels.

    ``nodal``: (n,) the field at the nodes; ``levels``: (k,) positive. One tuple per level, heaviest first.
    """
    regions_of: tuple[list[ContourRegion], ...] = tuple([] for _ in levels)
    least = _SPECK * float(mesh.areas_mm2.mean())
    for mask, region in _regions(_Cut(mesh, nodal, levels)):
        if region.area_mm2 > least:
            regions_of[mask].append(region)
    return tuple(tuple(sorted(regions, key=lambda region: -region.weight)) for regions in regions_of)


@lru_cache(maxsize=16)
def _fit_at_nodes(mesh: Mesh) -> csr_array:
    """Weights of :func:`nodal_values`; rows are nodes, columns elements."""
    element, node = np.repeat(np.arange(len(mesh.elements)), 3), mesh.elements.ravel()
    share = mesh.areas_mm2[element] / np.bincount(node, mesh.areas_mm2[element])[node]
    centre = np.column_stack([np.bincount(node, share * coordinate) for coordinate in mesh.centroids_mm[element].T])
    off_x, off_y = (mesh.centroids_mm[element] - centre[node]).T
    move_x, move_y = (mesh.nodes_mm[: len(centre)] - centre).T
    xx, xy, yy = (np.bincount(node, share * product) for product in (off_x**2, off_x * off_y, off_y**2))
    spread = xx * yy - xy**2
    fitted_mask = spread > _ALIGNED * (xx + yy) ** 2
    fitted_mask[mesh.outline] = False
    per_spread = np.where(fitted_mask, 1 / np.where(fitted_mask, spread, 1.0), 0.0)
    slope_x, slope_y = (yy * move_x - xy * move_y) * per_spread, (xx * move_y - xy * move_x) * per_spread
    weight = share * (1 + off_x * slope_x[node] + off_y * slope_y[node])
    return csr_array((weight, (node, element)), shape=(len(mesh.nodes_mm), len(mesh.elements)))


class _Cut:
    """Elements cut at several levels. Corners are numbered level by level: node k at level j is j × nodes + k.

    ``whole``, ``tips``, ``stumps``: (…, 3) corners of elements with three, one and two of them at or above the level,
    the odd one first; ``tip_cuts``, ``stump_cuts``: where the field passes the level from there to the others;
    ``joined``: (k, 2) edges at or above; ``outer``: (k, 2) of the sheet's own edge with an end at or above.
    """

    def __init__(self, mesh: Mesh, nodal: Array, levels: Array) -> None:
        self._nodes_mm, self._nodal, self._levels = mesh.nodes_mm, nodal, levels
        self.above = (nodal >= levels[:, None]).ravel()
        high_mask = nodal >= levels.min()
        triangles = self._copies(mesh.elements[_any(high_mask, mesh.elements)])
        above_mask = self.above[triangles]
        first, second, third = above_mask.T.astype(np.int8)
        count = first + second + third
        self.whole = triangles[count == 3]
        self.tips, self.stumps = (
            _rotate_to_marked_corner(triangles[count == 1], above_mask[count == 1]),
            _rotate_to_marked_corner(triangles[count == 2], ~above_mask[count == 2]),
        )
        self.tip_cuts = [self.crossing(self.tips[:, 0], self.tips[:, k]) for k in (1, 2)]
        self.stump_cuts = [self.crossing(self.stumps[:, k], self.stumps[:, 0]) for k in (1, 2)]
        edges = self._copies(mesh.edges[_all(high_mask, mesh.edges)])
        self.joined = edges[_all(self.above, edges)]
        outer = self._copies(mesh.outline[_any(high_mask, mesh.outline)])
        self.outer = outer[_any(self.above, outer)]

    def _copies(self, nodes: Indices) -> Indices:
        shift = len(self._nodal) * np.arange(len(self._levels))
        return (nodes + shift[:, None, None]).reshape(-1, nodes.shape[1])

    def place(self, corner: Indices) -> Array:
        """Places of corners, (…, 2) [mm]."""
        return self._nodes_mm[corner % len(self._nodal)]

    def value(self, corner: Indices) -> Array:
        return self._nodal[corner % len(self._nodal)]

    def mask(self, corner: Indices) -> Indices:
        """Level index of corners."""
        return corner // len(self._nodal)

    def crossing(self, high: Indices, low: Indices) -> Array:
        """Points where the field passes the level between corners at or above it and corners below it."""
        level, upper, place = self._levels[self.mask(high)], self.value(high), self.place(high)
        share = (upper - level) / (upper - self.value(low))
        return place + share[:, None] * (self.place(low) - place)

    def level(self, corner: Indices) -> Array:
        return self._levels[self.mask(corner)]


def _any(flags: Mask, nodes: Indices) -> Mask:
    """Whether any of some nodes (k, …) is marked: (k,). Column by column, for speed."""
    marked: Mask = np.logical_or.reduce(flags[nodes.T])
    return marked


def _all(flags: Mask, nodes: Indices) -> Mask:
    marked: Mask = np.logical_and.reduce(flags[nodes.T])
    return marked


def _rotate_to_marked_corner(triangles: Indices, odd: Mask) -> Indices:
    """Rotate triangles so that the single marked corner comes first."""
    return np.take_along_axis(triangles, (odd.argmax(axis=1)[:, None] + np.arange(3)) % 3, axis=1)


def _regions(cut: _Cut) -> Iterator[tuple[int, ContourRegion]]:
    """Combine the pieces of each connected region, with the index of its level."""
    corners_mm, values, anchor = _inside(cut)
    start, end, rim_anchor = _rim(cut)
    label = component_labels(len(cut.above), cut.joined)
    rims = groups(label[rim_anchor])
    for number, pieces in groups(label[anchor]).items():
        rim = rims.get(number, pieces[:0])
        mask = int(cut.mask(anchor[pieces[0]]))
        yield mask, ContourRegion(corners_mm[pieces], values[pieces], start[rim], end[rim])


def _inside(cut: _Cut) -> tuple[Array, Array, Indices]:
    """Triangles (t, 3, 2) that reach the level, their values (t, 3), and a corner of each at or above it (t,)."""
    stump_right, stump_left = cut.stump_cuts
    stumps, tip_level, stump_level = cut.place(cut.stumps), cut.level(cut.tips[:, 0]), cut.level(cut.stumps[:, 0])
    corners = [
        cut.place(cut.whole),
        np.stack([cut.place(cut.tips[:, 0]), *cut.tip_cuts], axis=1),
        np.stack([stump_right, stumps[:, 1], stumps[:, 2]], axis=1),
        np.stack([stump_right, stumps[:, 2], stump_left], axis=1),
    ]
    stump_values = cut.value(cut.stumps)
    values = [
        cut.value(cut.whole),
        np.column_stack([cut.value(cut.tips[:, 0]), tip_level, tip_level]),
        np.column_stack([stump_level, stump_values[:, 1:]]),
        np.column_stack([stump_level, stump_values[:, 2], stump_level]),
    ]
    anchor = [cut.whole[:, 0], cut.tips[:, 0], cut.stumps[:, 1], cut.stumps[:, 2]]
    return np.concatenate(corners), np.concatenate(values), np.concatenate(anchor)


def _rim(cut: _Cut) -> tuple[Array, Array, Indices]:
    """Starts and ends (k, 2) of the contours' pieces and of the sheet's edge between them, and a corner above."""
    start_node, end_node = cut.outer.T
    enters, leaves = ~cut.above[start_node], ~cut.above[end_node]
    start, end = cut.place(start_node), cut.place(end_node)
    start[enters] = cut.crossing(end_node[enters], start_node[enters])
    end[leaves] = cut.crossing(start_node[leaves], end_node[leaves])
    starts = np.concatenate([cut.tip_cuts[0], cut.stump_cuts[1], start])
    ends = np.concatenate([cut.tip_cuts[1], cut.stump_cuts[0], end])
    anchor = np.concatenate([cut.tips[:, 0], cut.stumps[:, 1], np.where(enters, end_node, start_node)])
    differs = starts != ends
    has_length = differs[:, 0] | differs[:, 1]
    return starts[has_length], ends[has_length], anchor[has_length]
