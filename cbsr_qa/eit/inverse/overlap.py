"""Exact overlap areas between the elements of two meshes."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.forward.elements import reaches_mm

_SLIVER = 1e-12  # of a mean element's area: smaller pieces have no accurate centroid


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Overlaps of the elements of two meshes.

    Parameters
    ----------
    fine, coarse : (p,) int64, the elements.
    areas_mm2 : (p,) areas of the overlaps.
    centroids_mm : (p, 2) centroids of the overlaps.
    """

    fine: Indices
    coarse: Indices
    areas_mm2: Array
    centroids_mm: Array


def overlap_pieces(fine: Mesh, coarse: Mesh) -> Pieces:
    """Cut every fine element by the coarse mesh, so that the pieces of each make up all of its area.

    The part of a fine element outside the coarse mesh (slivers between two polygons of the same circle) is
    distributed in proportion to its parts inside, or assigned to the nearest coarse element without any.
    """
    fine_element, coarse_element = _candidates(fine, coarse)
    area, centroids = _intersections(fine.corners_mm[fine_element], coarse.corners_mm[coarse_element])
    keep = area > _SLIVER * fine.areas_mm2.mean()
    fine_element, coarse_element, area, centroids = (
        fine_element[keep],
        coarse_element[keep],
        area[keep],
        centroids[keep],
    )
    covered_area = np.bincount(fine_element, area, minlength=len(fine.elements))
    uncovered = np.flatnonzero(covered_area <= 0)
    if uncovered.size:
        nearest = cKDTree(coarse.centroids_mm).query(fine.centroids_mm[uncovered])[1]
        fine_element, coarse_element = (
            np.concatenate([fine_element, uncovered]),
            np.concatenate([coarse_element, nearest]),
        )
        area = np.concatenate([area, fine.areas_mm2[uncovered]])
        centroids = np.vstack([centroids, fine.centroids_mm[uncovered]])
        covered_area[uncovered] = fine.areas_mm2[uncovered]
    return Pieces(fine_element, coarse_element, area * (fine.areas_mm2 / covered_area)[fine_element], centroids)


def overlap_fractions(fine: Mesh, coarse: Mesh) -> sparse.csr_matrix:
    """Fraction of each fine element's area in each coarse element; rows sum to one, see :func:`overlap_pieces`.

    Returns
    -------
    (fine elements, coarse elements) sparse.
    """
    pieces = overlap_pieces(fine, coarse)
    share = pieces.areas_mm2 / fine.areas_mm2[pieces.fine]
    return sparse.csr_matrix((share, (pieces.fine, pieces.coarse)), shape=(len(fine.elements), len(coarse.elements)))


def _candidates(fine: Mesh, coarse: Mesh) -> tuple[Indices, Indices]:
    """Pairs of elements whose bounding circles meet."""
    reach = [reaches_mm(mesh) for mesh in (fine, coarse)]
    elements_near = cKDTree(coarse.centroids_mm).query_ball_point(
        fine.centroids_mm, reach[0] + reach[1].max(), return_sorted=True
    )
    fine_element = np.repeat(np.arange(len(elements_near)), [len(elements) for elements in elements_near])
    coarse_element = np.concatenate([np.asarray(elements, dtype=np.int64) for elements in elements_near])
    distance_mm = np.hypot(*(fine.centroids_mm[fine_element] - coarse.centroids_mm[coarse_element]).T)
    meet = distance_mm < reach[0][fine_element] + reach[1][coarse_element]
    return fine_element[meet], coarse_element[meet]


def _intersections(first: Array, second: Array) -> tuple[Array, Array]:
    """Areas (p,) and centroids (p, 2) of overlaps of counterclockwise triangles (p, 3, 2), Sutherland & Hodgman 1974.

    Centroids are meaningless where the area is zero.
    """
    polygon = first
    for corner in range(3):
        start = second[:, corner]
        polygon = _clip(polygon, start, second[:, (corner + 1) % 3] - start)
    following = np.roll(polygon, -1, axis=1)
    origin = polygon[:, :1]
    u, v = polygon - origin, following - origin
    twice = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    area = np.maximum(twice.sum(axis=1) / 2, 0)
    moment = (twice[..., None] * (u + v)).sum(axis=1)
    divisor = np.where(area > 0, 6 * area, 1.0)[:, None]
    return area, origin[:, 0] + moment / divisor


def _clip(polygon: Array, start: Array, along: Array) -> Array:
    """Cut convex polygons (p, k, 2) left of a line: (p, k + 1, 2), where spare corners repeat the last."""
    relative = polygon - start[:, None]
    height = along[:, None, 0] * relative[..., 1] - along[:, None, 1] * relative[..., 0]
    following, next_height = np.roll(polygon, -1, axis=1), np.roll(height, -1, axis=1)
    crosses = (height >= 0) != (next_height >= 0)
    share = np.where(crosses, height / np.where(crosses, height - next_height, 1), 0)
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
