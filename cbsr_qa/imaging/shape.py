"""The paper's spatial metrics of a sensed region against the indenter (Eqs 4 to 6)."""

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.image import Blob, Region


def centre_of_mass_error_mm(region: Region, indenter: Footprint) -> float:
    """Return E_CoM = ‖M − F‖, the distance of the region's centre of mass from the indenter's centre [mm].

    Paper Eq 4, read with area weights: unweighted, the centre would depend on the mesh. Read as a mean of element
    distances it would give 4.3 mm for a perfect blob under a 13 mm head, which the paper's 0.67 mm excludes. F of an
    indenter that is not round is the centre of mass of its area.
    """
    return float(np.hypot(*(region.centre_mm() - np.array(indenter.centre_mm))))


def area_overlap_percent(region: Region, indenter: Footprint, mode: str = "exact") -> float:
    """Return A_OL = 50 (A_in/A_FA + A_in/A_b), the mutual overlap of region and indenter [%] (paper Eq 5).

    Parameters
    ----------
    indenter : where it pressed.
    mode : ``"exact"`` clips the region against the indenter's outline; ``"centroid"`` counts elements whose centroid
        lies inside, as the paper does, and jumps with the mesh.

    Raises
    ------
    NumericsError
        If the mode is another, or centroids of a region without elements are asked for.
    """
    if mode == "exact":
        # Green's theorem: the overlap depends on the region's perimeter alone.
        inside = max(float(indenter.area_under_edges_mm2(*region.rim_mm()).sum()), 0.0)
    elif mode == "centroid":
        blob = _of_elements(region, "clipping by centroids")
        mesh = blob.image.mesh
        inside = float(mesh.areas_mm2[blob.elements] @ indenter.contains(mesh.centroids_mm[blob.elements]))
    else:
        raise NumericsError(f"clipping mode {mode!r} is unknown", remedy="use 'exact' or 'centroid'")
    return 50.0 * inside * (1 / indenter.area_mm2 + 1 / region.area_mm2)


def shape_deviation_mm2(region: Region, indenter: Footprint, mode: str = "length") -> float:
    """Return SD, the mean squared distance of the region's perimeter from the indenter's outline [mm²] (paper Eq 6).

    For a round indenter that is the mean of (‖P − F‖ − r)².

    Parameters
    ----------
    indenter : where it pressed.
    mode : ``"length"`` integrates along the perimeter's edges, exactly; ``"nodes"`` is the paper's mean over
        perimeter nodes, which weighs finely meshed stretches more.

    Raises
    ------
    NumericsError
        If the mode is another, or nodes of a region without elements are asked for.
    """
    if mode == "nodes":
        blob = _of_elements(region, "a mean over nodes")
        nodes = np.unique(blob.rim)
        return float(np.mean(indenter.distance_mm(blob.image.mesh.nodes_mm[nodes]) ** 2))
    if mode != "length":
        raise NumericsError(f"perimeter mode {mode!r} is unknown", remedy="use 'length' or 'nodes'")
    start, end = region.rim_mm()
    return float(indenter.squared_distance_mm3(start, end).sum() / np.hypot(*(end - start).T).sum())


def _of_elements(region: Region, what: str) -> Blob:
    if not isinstance(region, Blob):
        raise NumericsError(f"{what} needs a region of whole elements", remedy='set outline = "elements"')
    return region
