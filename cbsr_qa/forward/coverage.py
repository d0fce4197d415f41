"""How much of each element an indenter covers, exactly."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.footprints import Footprint, RoundFootprint, overlap_mm2
from cbsr_qa.domain.mesh import Mesh


def coverage(mesh: Mesh, footprint: Footprint) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Fraction of each element's area inside a footprint.

    Returns
    -------
    elements : (k,) int64, rising, those it touches.
    fraction : (k,) float64 in (0, 1].
    """
    fraction = overlap_mm2(footprint, mesh.corners_mm) / mesh.areas_mm2
    touched = np.flatnonzero(fraction > 1e-12)
    return touched, np.minimum(fraction[touched], 1.0)


def disc_coverage(
    mesh: Mesh, x_mm: float, y_mm: float, radius_mm: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Fraction of each element's area inside a circle, as :func:`coverage`.

    Raises
    ------
    NumericsError
        If the radius is not a positive number.
    """
    return coverage(mesh, RoundFootprint(x_mm, y_mm, radius_mm))
