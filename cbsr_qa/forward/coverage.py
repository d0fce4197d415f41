"""How much of each element a disc covers, exactly."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.mesh import Mesh

Array = NDArray[np.float64]


def disc_coverage(mesh: Mesh, x_mm: float, y_mm: float, radius_mm: float) -> tuple[NDArray[np.int64], Array]:
    """Fraction of each element's area inside a circle.

    The area of a triangle inside a circle is the sum over its edges, seen from the circle's centre, of a triangle
    where the edge is inside and a sector where it is outside.

    Returns
    -------
    elements : (k,) int64, rising, those the disc touches.
    fraction : (k,) float64 in (0, 1].
    """
    corners = mesh.corners_mm - np.array([x_mm, y_mm])
    reach = np.hypot(corners[..., 0], corners[..., 1]).min(axis=1)
    longest = np.sqrt(((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1))
    near = np.flatnonzero(reach < radius_mm + longest)
    corners = corners[near]
    area = _edge_areas(corners, np.roll(corners, -1, axis=1), radius_mm).sum(axis=1)
    fraction = np.clip(area / mesh.areas_mm2[near], 0, 1)
    touched = fraction > 1e-12
    return near[touched], fraction[touched]


def _edge_areas(start: Array, end: Array, radius: float) -> Array:
    """Signed area between the origin and each directed edge (..., 2), cut by the circle about the origin."""
    along = end - start
    squared = (along**2).sum(axis=-1)
    middle = -(start * along).sum(axis=-1) / squared
    foot = start + middle[..., None] * along
    half = np.sqrt(np.maximum(radius**2 - (foot**2).sum(axis=-1), 0) / squared)
    entry, leave = np.clip(middle - half, 0, 1), np.clip(middle + half, 0, 1)
    first, second = start + entry[..., None] * along, start + leave[..., None] * along
    inside = _cross(first, second) / 2
    outside = radius**2 / 2 * (_angle(start, first) + _angle(second, end))
    area: Array = inside + outside
    return area


def _cross(one: Array, other: Array) -> Array:
    cross: Array = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return cross


def _angle(one: Array, other: Array) -> Array:
    angle: Array = np.arctan2(_cross(one, other), (one * other).sum(axis=-1))
    return angle
