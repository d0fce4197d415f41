"""How much of each element a disc covers, exactly."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.geometry import circle_overlap_mm2
from cbsr_qa.domain.mesh import Mesh


def disc_coverage(
    mesh: Mesh, x_mm: float, y_mm: float, radius_mm: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Fraction of each element's area inside a circle.

    Returns
    -------
    elements : (k,) int64, rising, those the disc touches.
    fraction : (k,) float64 in (0, 1].

    Raises
    ------
    NumericsError
        If the radius is not a positive number.
    """
    fraction = circle_overlap_mm2(mesh.corners_mm, (x_mm, y_mm), radius_mm) / mesh.areas_mm2
    touched = np.flatnonzero(fraction > 1e-12)
    return touched, np.minimum(fraction[touched], 1.0)
