"""Exact area of triangles inside a circle."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import Mesh


def overlap_area_mm2(
    mesh: Mesh, elements: NDArray[np.int64], centre_mm: tuple[float, float], radius_mm: float
) -> NDArray[np.float64]:
    """Return each element's area inside a disc, exactly, arcs included.

    By Green's theorem the area is a sum over the triangle's directed edges: the part of an edge inside the circle
    adds the triangle it spans with the centre, the parts outside add circular sectors.

    Parameters
    ----------
    mesh : the elements' mesh.
    elements : (k,) int64 indices into it.
    centre_mm, radius_mm : of the disc.

    Returns
    -------
    (k,) float64 [mm²], each between 0 and the element's area.

    Raises
    ------
    NumericsError
        If the radius is not a positive number.
    """
    if not 0 < radius_mm < float("inf"):
        raise NumericsError(f"the radius of a disc is {radius_mm} mm; it must be a positive number")
    start = mesh.corners_mm[elements] - np.asarray(centre_mm)
    area = area_under_edges(start, np.roll(start, -1, axis=1), radius_mm).sum(axis=1)
    clipped: NDArray[np.float64] = np.clip(area, 0.0, mesh.areas_mm2[elements])
    return clipped


def area_under_edges(start: NDArray[np.float64], end: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Signed area between the origin and directed edges inside a circle about the origin, (…, 2) → (…)."""
    along = end - start
    length_squared = _dot(along, along)
    middle = -_dot(start, along) / length_squared
    # |start × along|² / |along|² is the squared distance of the line; this form keeps its digits near tangency.
    half = np.sqrt(np.maximum(radius**2 - _cross(start, along) ** 2 / length_squared, 0.0) / length_squared)
    enters = start + np.clip(middle - half, 0.0, 1.0)[..., None] * along
    leaves = start + np.clip(middle + half, 0.0, 1.0)[..., None] * along
    sectors = radius**2 * (_angle(start, enters) + _angle(leaves, end))
    area: NDArray[np.float64] = (sectors + _cross(enters, leaves)) / 2
    return area


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    dot: NDArray[np.float64] = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    return dot


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    cross: NDArray[np.float64] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return cross


def _angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    angle: NDArray[np.float64] = np.arctan2(_cross(a, b), _dot(a, b))
    return angle
