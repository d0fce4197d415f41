"""Exact area of mesh elements inside a circle."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.geometry import circle_overlap_mm2
from cbsr_qa.domain.mesh import Mesh


def overlap_area_mm2(
    mesh: Mesh, elements: NDArray[np.int64], centre_mm: tuple[float, float], radius_mm: float
) -> NDArray[np.float64]:
    """Return each element's area inside a disc, exactly, arcs included.

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
    overlap = circle_overlap_mm2(mesh.corners_mm[elements], centre_mm, radius_mm)
    # A whole element counts as its own area, to the last digit.
    clipped: NDArray[np.float64] = np.minimum(overlap, mesh.areas_mm2[elements])
    return clipped
