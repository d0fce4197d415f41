"""How much of each element of one mesh lies in each element of another, exactly."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from cbsr_qa.domain.mesh import Mesh

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def overlap_fractions(fine: Mesh, coarse: Mesh) -> sparse.csr_matrix:
    """Fraction of each fine element's area in each coarse element.

    Rows sum to one: what a fine element has outside the coarse mesh (slivers between two polygons of the same circle)
    is counted in proportion to what it has inside, or goes to the nearest coarse element where nothing is inside.

    Returns
    -------
    (fine elements, coarse elements) sparse.
    """
    first, second = _candidates(fine, coarse)
    area = _intersection_areas(fine.corners_mm[first], coarse.corners_mm[second])
    inside = np.bincount(first, area, minlength=len(fine.elements))
    lost = np.flatnonzero(inside <= 0)
    if lost.size:
        nearest = cKDTree(coarse.centroids_mm).query(fine.centroids_mm[lost])[1]
        first, second = np.concatenate([first, lost]), np.concatenate([second, nearest])
        area, inside[lost] = np.concatenate([area, np.ones(lost.size)]), 1
    keep = area > 0
    entries = (area[keep] / inside[first[keep]], (first[keep], second[keep]))
    return sparse.csr_matrix(entries, shape=(len(fine.elements), len(coarse.elements)))


def _candidates(fine: Mesh, coarse: Mesh) -> tuple[Indices, Indices]:
    """Pairs of elements whose bounding circles meet."""
    reach = [_reach(mesh) for mesh in (fine, coarse)]
    near = cKDTree(coarse.centroids_mm).query_ball_point(
        fine.centroids_mm, reach[0] + reach[1].max(), return_sorted=True
    )
    first = np.repeat(np.arange(len(near)), [len(found) for found in near])
    second = np.concatenate([np.asarray(found, dtype=np.int64) for found in near])
    apart = np.hypot(*(fine.centroids_mm[first] - coarse.centroids_mm[second]).T)
    meet = apart < reach[0][first] + reach[1][second]
    return first[meet], second[meet]


def _reach(mesh: Mesh) -> Array:
    offset = mesh.corners_mm - mesh.centroids_mm[:, None]
    reach: Array = np.hypot(offset[..., 0], offset[..., 1]).max(axis=1)
    return reach


def _intersection_areas(first: Array, second: Array) -> Array:
    """Areas of intersection of pairs of counterclockwise triangles (p, 3, 2), by Sutherland & Hodgman 1974: (p,)."""
    polygon = first
    for corner in range(3):
        start = second[:, corner]
        polygon = _clipped(polygon, start, second[:, (corner + 1) % 3] - start)
    following = np.roll(polygon, -1, axis=1)
    origin = polygon[:, :1]
    one, other = polygon - origin, following - origin
    area: Array = (one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]).sum(axis=1) / 2
    return np.maximum(area, 0)


def _clipped(polygon: Array, start: Array, along: Array) -> Array:
    """Cut convex polygons (p, k, 2) left of a line: (p, k + 1, 2), where spare corners repeat the last."""
    relative = polygon - start[:, None]
    height = along[:, None, 0] * relative[..., 1] - along[:, None, 1] * relative[..., 0]
    following, after = np.roll(polygon, -1, axis=1), np.roll(height, -1, axis=1)
    crosses = (height >= 0) != (after >= 0)
    share = np.where(crosses, height / np.where(crosses, height - after, 1), 0)
    crossing = polygon + share[..., None] * (following - polygon)
    pairs, corners = height.shape
    slots = np.stack([polygon, crossing], axis=2).reshape(pairs, 2 * corners, 2)
    filled = np.stack([height >= 0, crosses], axis=2).reshape(pairs, 2 * corners)
    order = np.argsort(~filled, axis=1, kind="stable")[:, : corners + 1]
    last = np.maximum(filled.sum(axis=1) - 1, 0)
    place = np.minimum(np.arange(corners + 1), last[:, None])
    chosen = np.take_along_axis(order, place, axis=1)
    cut: Array = np.take_along_axis(slots, chosen[..., None], axis=1)
    cut[~filled.any(axis=1)] = 0
    return cut
