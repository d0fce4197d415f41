"""Priors with a length: the Gaussian high-pass filter and the indenter's own smoothness."""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.spatial.distance import cdist

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.reconstruct.priors import Prior

Array = NDArray[np.float64]

#: The filter is a dense matrix; one of this many elements takes 800 MB and half a minute.
_MOST_FILTERED: Final = 10_000
_ROWS_AT_ONCE: Final = 512
_SHORTEST: Final = 1e-6  #: length, of an element's edge
_NARROWEST: Final = 0.5  #: width of the filter, likewise
_LONGEST: Final = 10.0  #: of either, of the sheet's extent


def indenter_smoothness(mesh: Mesh, length_mm: float) -> Prior:
    """Matérn covariance of smoothness 3/2, P_ij = (1 + r) e^(−r) with r = √3 |c_i − c_j| / length.

    A load is as wide as the head that makes it: with the head's radius as the length, what is smoother than a load
    costs nothing more and what is rougher costs much. Its images have one derivative; the Gaussian covariance, which
    has all of them, places loads a quarter worse at the same noise figure.

    Parameters
    ----------
    length_mm : correlation length [mm], a millionth of an element's edge to ten times the sheet.

    Raises
    ------
    NumericsError
        If the length is out of that range.
    """
    _check_length(mesh, length_mm, least=_SHORTEST)
    places = mesh.centroids_mm * (np.sqrt(3) / length_mm)

    def covariance(columns: Array) -> Array:
        product = np.empty(columns.shape)
        for start in range(0, len(places), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            distance = cdist(places[rows], places)
            product[rows] = ((1 + distance) * np.exp(-distance)) @ columns
        return product

    return Prior(covariance)


def high_pass(mesh: Mesh, width_mm: float) -> Prior:
    """Gaussian high-pass prior R = FᵀF, F = I − G (Adler & Guardo 1996).

    G is a Gaussian low-pass filter of this width at half height, weighted by the elements' areas and normalised on
    each element, also near the edge, so that a constant image passes and costs nothing (EIDORS's filter knows no
    areas). With w the left null vector of F, P = F₁⁻¹ (I − wwᵀ/wᵀw) F₁⁻ᵀ, F₁ = F + 1wᵀ/wᵀ1.

    Parameters
    ----------
    width_mm : at half height [mm], half of an element's edge to ten times the sheet; a narrower filter would pass
        nothing between elements, and F be nothing but rounding. Adler & Guardo take a tenth of the sheet's diameter.

    Raises
    ------
    NumericsError
        If the width is out of that range, or the mesh has so many elements that F does not fit.
    """
    _check_length(mesh, width_mm, least=_NARROWEST)
    count, areas = len(mesh.elements), mesh.areas_mm2
    if count > _MOST_FILTERED:
        raise NumericsError(
            f"the high-pass prior is a dense filter; {count} elements are more than {_MOST_FILTERED}",
            remedy="image on larger elements, or take another prior",
        )
    squared = cdist(mesh.centroids_mm, mesh.centroids_mm, "sqeuclidean")
    kernel = np.exp(squared * (-4 * np.log(2) / width_mm**2)) * areas
    sums = kernel.sum(axis=1)
    left = areas * sums  # wᵀF = 0, as the kernel is symmetric before it is weighted and normalised
    regular = np.eye(count) - kernel / sums[:, None] + left / left.sum()
    factors = linalg.lu_factor(regular, overwrite_a=True, check_finite=False)
    unit = (left / np.linalg.norm(left))[:, None]

    def half(columns: Array) -> Array:
        product: Array = linalg.lu_solve(factors, columns, trans=1)
        product -= unit @ (unit.T @ product)
        return product

    def covariance(columns: Array) -> Array:
        product: Array = linalg.lu_solve(factors, half(columns))
        return product

    return Prior(covariance, np.ones((count, 1)), half)


def _check_length(mesh: Mesh, value: float, *, least: float) -> None:
    """Refuse a length that is out of range; ``least`` is of the mean element's edge."""
    shortest = least * float(np.sqrt(4 / np.sqrt(3) * mesh.areas_mm2.mean()))
    longest = _LONGEST * float(np.ptp(mesh.nodes_mm, axis=0).max())
    if not shortest <= value <= longest:
        raise NumericsError(
            f"a prior's length is {value:.3g} mm; it must be a positive finite number, {shortest:.2g} to"
            f" {longest:.2g} mm on this image",
            remedy="give a width or diameter in that range, or image on other elements",
        )
