"""Exact area of mesh elements inside an outline."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.footprints import Footprint, overlap_mm2
from cbsr_qa.domain.mesh import Mesh


def overlap_area_mm2(mesh: Mesh, elements: NDArray[np.int64], footprint: Footprint) -> NDArray[np.float64]:
    """Return each element's area inside a footprint, exactly, arcs included.

    Parameters
    ----------
    mesh : the elements' mesh.
    elements : (k,) int64 indices into it.

    Returns
    -------
    (k,) float64 [mm²], each between 0 and the element's area.
    """
    # A whole element counts as its own area, to the last digit.
    clipped: NDArray[np.float64] = np.minimum(
        overlap_mm2(footprint, mesh.corners_mm[elements]), mesh.areas_mm2[elements]
    )
    return clipped
