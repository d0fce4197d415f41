"""Share of each element that a load covers, and the conductance change that follows.

Loads of nested outlines stand for heads whose strain is not uniform.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import Footprint, overlap_mm2
from cbsr_qa.domain.geometry.polygons import circle_overlap_mm2
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.forward.elements import FiniteElements

#: Share above which a load covers all of the element.
WHOLE: Final = 1 - 1e-12
_LEVELS: Final = 5  # integration points, for the position of the covered part in a cut element
_MARGIN: Final = 0.5  # how far a spread may leave [0, 1], as the best line through a step does
_STEP = 1e-4  # of an element's size, for numerical derivatives of the distance from an outline


def disc_coverage(mesh: Mesh, x_mm: float, y_mm: float, radius_mm: float) -> tuple[Indices, Array]:
    """Fraction of each element's area inside a circle: (k,) elements the disc touches, rising, and (k,) in (0, 1].

    NumericsError if the radius is not a positive number.
    """
    fraction = circle_overlap_mm2(mesh.corners_mm, (x_mm, y_mm), radius_mm) / mesh.areas_mm2
    touched = np.flatnonzero(fraction > 1e-12)
    return touched, np.minimum(fraction[touched], 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Cover:
    """Coverage of elements by a load, at their integration points.

    Parameters
    ----------
    elements : (k,) int64, rising, the touched ones.
    share : (k,) covered fraction of their area, in (0, 1].
    spread : (k, q) covered fraction about each integration point: its mean is the share. May leave [0, 1], as the
        best linear fit to a step does.
    across : (k, q, 2) unit normal of the load's outline near each point.
    """

    elements: Indices
    share: Array
    spread: Array
    across: Array

    def change(self, conductance: Array, relative: float | Array) -> Array:
        """Change of the conductance of each element.

        A cut element conducts as a stack of layers: conductances add along the outline, resistances across it
        (Farjadpour et al. 2006 for the same in optics).

        Parameters
        ----------
        conductance : (e,) conductance of all elements without the load [S].
        relative : change of the covered material, above −1: one, or (k,).

        Returns
        -------
        (k, q, 2, 2) [S].

        Raises
        ------
        NumericsError
            If the change leaves no conductance, or is not finite.
        """
        relative = np.broadcast_to(np.asarray(relative, dtype=np.float64), self.share.shape)
        bad_indices = np.flatnonzero(~((relative > -1) & (relative < np.inf)))
        if bad_indices.size:
            raise NumericsError(
                f"a relative change of {relative[bad_indices[0]]} leaves no positive conductance",
                remedy="stay over −1",
            )
        spread = self._clip_spread(np.minimum(1.0, 1 + relative) / (2 * np.maximum(np.abs(relative), 0.01)))
        relative = relative[:, None]
        along_factor = 1 + spread * relative
        across_factor = 1 / (1 - spread * relative / (1 + relative))
        lower = np.where(self.share[:, None] < WHOLE, across_factor - along_factor, 0.0)[..., None, None]
        turned = lower * self.across[..., :, None] * self.across[..., None, :]
        change: Array = (along_factor - 1)[..., None, None] * np.eye(2) + turned
        return change * conductance[self.elements, None, None, None]

    def _clip_spread(self, margin: Array) -> Array:
        """The spread, shrunk towards the share until it leaves [0, 1] by no more than the allowed amount."""
        away = self.spread - self.share[:, None]
        above, below = away.max(axis=1), -away.min(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.fmin((1 + margin - self.share) / above, (self.share + margin) / below)
        drawn: Array = self.share[:, None] + np.clip(np.nan_to_num(room, nan=1.0), 0, 1)[:, None] * away
        return drawn


def cover(elements: FiniteElements, footprint: Footprint) -> Cover:
    """Area of each element covered by a load of any outline, exactly; triangles are taken as straight."""
    mesh = elements.mesh
    near_elements = elements_near(elements, footprint)
    share = shares(footprint, mesh.corners_mm[near_elements])
    touched = near_elements[share > 1e-12]
    share = np.minimum(share[share > 1e-12], 1.0)
    points = elements.shapes.points
    spread = np.repeat(share[:, None], len(points), axis=1)
    normals = np.zeros((*spread.shape, 2))
    cut_indices = np.flatnonzero(share < WHOLE)
    corners = mesh.corners_mm[touched[cut_indices]]
    normals[cut_indices] = outline_normals(footprint, corners, points)
    if elements.order == 2:
        spread[cut_indices] += slopes(footprint, corners, share[cut_indices]) @ (points - 1 / 3).T
    return Cover(touched, share, spread, normals)


def shares(footprint: Footprint, corners: Array) -> Array:
    """Share of each triangle's area that a footprint covers, exactly: (k, 3, 2) to (k,)."""
    (ax, ay), (bx, by) = (np.moveaxis(corners[:, corner] - corners[:, 0], -1, 0) for corner in (1, 2))
    covered: Array = overlap_mm2(footprint, corners) / (0.5 * np.abs(ax * by - ay * bx))
    return covered


def elements_near(elements: FiniteElements, footprint: Footprint) -> Indices:
    """Elements whose bounding circle overlaps the footprint's box."""
    outline_mm = footprint.outline_mm()
    middle, half_extent_mm = (
        (outline_mm.max(axis=0) + outline_mm.min(axis=0)) / 2,
        0.51 * np.ptp(outline_mm, axis=0),
    )
    distances_mm = np.abs(elements.mesh.centroids_mm - middle) - half_extent_mm
    return np.flatnonzero((distances_mm <= elements.reaches_mm[:, None]).all(axis=1))


def slopes(footprint: Footprint, corners: Array, share: Array) -> Array:
    """Linear function whose moments over the element are those of its covered part, less the mean: (k, 3)."""
    levels, weights = np.polynomial.legendre.leggauss(_LEVELS)
    triangles = _corners((levels + 1) / 2)
    small = np.einsum("ipcb,kbx->kipcx", triangles, corners)
    covered = overlap_mm2(footprint, small.reshape(-1, 3, 2)).reshape(-1, 3, _LEVELS)
    moments = covered @ weights
    total = np.maximum(moments.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    # ∫ λ_i λ_j over the element is (1 + δ_ij)/12 of its area, so that slopes are twelve times the moments.
    slopes: Array = 12 * share[:, None] * (moments / total - 1 / 3)
    return slopes


def _corners(levels: Array) -> Array:
    """Parts of a triangle where a barycentric coordinate is above a level, by their corners: (3, n, 3, 3)."""
    triangles = np.zeros((3, len(levels), 3, 3))
    for corner in range(3):
        triangles[corner] = np.eye(3)[corner] + (1 - levels)[:, None, None] * (np.eye(3) - np.eye(3)[corner])
    return triangles


def outline_normals(footprint: Footprint, corners: Array, points: Array) -> Array:
    """Gradient of the signed distance from the outline at points of triangles: (k, 3, 2), (q, 3) to (k, q, 2)."""
    places = points @ corners
    size = np.sqrt(np.ptp(corners, axis=1).prod(axis=1))
    step = (_STEP * size)[:, None]
    gradient = np.empty_like(places)
    for axis, direction in enumerate(np.eye(2)):
        distances_mm = []  # negative inside; ahead and behind
        for s in (1, -1):
            moved = (places + s * step[..., None] * direction).reshape(-1, 2)
            side = np.where(footprint.contains(moved), -1.0, 1.0)
            distances_mm.append((side * footprint.distance_mm(moved)).reshape(places.shape[:-1]))
        ahead, behind = distances_mm
        gradient[..., axis] = (ahead - behind) / (2 * step)
    length = np.hypot(gradient[..., 0], gradient[..., 1])
    is_known = length > 0.5  # less at a ridge, where no outline is nearest
    return np.where(is_known[..., None], gradient / np.where(is_known, length, 1)[..., None], 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class NestedCover:
    """Coverage of elements by nested outlines, at their integration points.

    Parameters
    ----------
    elements : (k,) int64, rising, those touched by any outline.
    layers : (k, q, j + 1) share of each layer about each integration point, outside first, inside the smallest last.
    levels : (j + 1,) relative strength in each layer, 0 outside.
    across : (k, q, 2) unit normal of the largest outline near each point.
    """

    elements: Indices
    layers: Array
    levels: Array
    across: Array

    def change(self, conductance: Array, relative: float | Array) -> Array:
        """Change of the conductance of each element, as in :meth:`Cover.change`.

        Parameters
        ----------
        conductance : (e,) conductance of all elements without the load [S].
        relative : change where the level is one, or (k,).

        Returns
        -------
        (k, q, 2, 2) [S].

        Raises
        ------
        NumericsError
            If the change leaves no conductance somewhere, or is not finite.
        """
        relative = np.broadcast_to(np.asarray(relative, dtype=np.float64), self.elements.shape)
        raised = relative[:, None] * self.levels  # (k, j + 1)
        if not (np.isfinite(raised).all() and (raised > -1).all()):
            worst = relative[int(np.argmin(np.nan_to_num(raised.min(axis=1), nan=-np.inf)))]
            raise NumericsError(
                f"a relative change of {worst} leaves no positive conductance where a head presses"
                f" {self.levels.max():.3g} times as hard as on average",
                remedy="press less deep, or use a head with a more even pressure",
            )
        along_change = (self.layers @ raised[..., None])[..., 0]
        resistance_drop = (self.layers @ (raised / (1 + raised))[..., None])[..., 0]  # of the resistance
        across_change = resistance_drop / (1 - resistance_drop)
        turned = (
            (across_change - along_change)[..., None, None] * self.across[..., :, None] * self.across[..., None, :]
        )
        change: Array = along_change[..., None, None] * np.eye(2) + turned
        return change * conductance[self.elements, None, None, None]


def cover_by_nested_outlines(
    elements: FiniteElements, largest: Footprint, centre_mm: tuple[float, float], sizes: Array, weights: Array
) -> NestedCover:
    """Area of each element covered by nested outlines of one shape, exactly; triangles are taken as straight.

    Parameters
    ----------
    largest : the largest outline.
    centre_mm : about which the others are smaller.
    sizes : (j,) sizes of the outlines over the largest's, at most 1, falling.
    weights : (j,) strength that each adds inside it.
    """
    mesh, centre = elements.mesh, np.array(centre_mm)
    near_elements = elements_near(elements, largest)
    # A smaller outline covers an element as the largest one covers a larger element.
    grown_corners = (mesh.corners_mm[near_elements] - centre) / sizes[:, None, None, None] + centre
    share = np.minimum(shares(largest, grown_corners.reshape(-1, 3, 2)).reshape(len(sizes), -1), 1.0)
    is_touched = share.max(axis=0) > 1e-12
    share, grown_corners, near_elements = (
        share[:, is_touched],
        grown_corners[:, is_touched],
        near_elements[is_touched],
    )
    points = elements.shapes.points
    spread = np.repeat(share[..., None], len(points), axis=-1)
    is_cut = (share > 1e-12) & (share < WHOLE)
    if elements.order == 2:
        line = slopes(largest, grown_corners[is_cut], share[is_cut]) @ (points - 1 / 3).T
        spread[is_cut] += _limit_sum(line, share[is_cut])
    normals = np.zeros((len(near_elements), len(points), 2))
    is_ever_cut = is_cut.any(axis=0)
    normals[is_ever_cut] = outline_normals(largest, mesh.corners_mm[near_elements[is_ever_cut]], points)
    # Shares of the layers between outlines, (k, q, j + 1), from those within each outline.
    nested = np.concatenate([np.ones_like(spread[:1]), spread, np.zeros_like(spread[:1])])
    layers = np.ascontiguousarray(np.moveaxis(nested[:-1] - nested[1:], 0, -1))
    return NestedCover(near_elements, layers, np.concatenate([[0.0], np.cumsum(weights)]), normals)


def _limit_sum(line: Array, share: Array) -> Array:
    """Deviations (c, q) from shares (c,), reduced until their sum exceeds [0, 1] by at most the allowed amount."""
    with np.errstate(divide="ignore"):
        above, below = line.max(axis=1), -line.min(axis=1)
        room = np.minimum((1 + _MARGIN - share) / above, (share + _MARGIN) / below)
    limited: Array = np.minimum(room, 1.0)[:, None] * line
    return limited
