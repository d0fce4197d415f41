"""Priors: the R of (JᵀWJ + λ²R), in the form the dual system needs: P = R⁻¹ as a product with columns."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu
from scipy.spatial.distance import cdist

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """A prior of the image.

    Parameters
    ----------
    covariance : (e, k) → (e, k), the product with P = R⁻¹, or with a symmetric generalised inverse of R.
    free : (e, f) null space of R, images without cost; None without any.
    half : (e, k) → (n, k), the product with a root H of P = HᵀH; None without one.
    """

    covariance: Callable[[Array], Array]
    free: Array | None = None
    half: Callable[[Array], Array] | None = None

    @classmethod
    def diagonal(cls, weights: Array) -> Self:
        """Prior without coupling of neighbours: R = diag(weights), (e,) positive."""
        root = np.sqrt(weights)[:, None]
        return cls(lambda columns: columns / weights[:, None], half=lambda columns: columns / root)


def noser(jacobian: Array, exponent: float) -> Array:
    """Diagonal (e,) of the NOSER prior, diag(JᵀJ)^p (Cheney et al. 1990; exponents below 1 are EIDORS's).

    Parameters
    ----------
    jacobian : (m, e). exponent : p in 0 (Tikhonov's identity) … 1.

    Raises
    ------
    NumericsError
        If p is out of range, or an element affects no reading.
    """
    if not 0 <= exponent <= 1:
        raise NumericsError(
            f"NOSER exponent is {exponent}; it must lie between 0 and 1",
            remedy="give an exponent from 0 (Tikhonov's prior) to 1; 0.5 is usual",
        )
    squared = np.einsum("me,me->e", jacobian, jacobian)
    if not (squared > 0).all():
        raise NumericsError(
            f"{int((squared <= 0).sum())} image elements affect none of the remaining readings",
            remedy="repair the masked channels",
        )
    weights: Array = squared**exponent
    return weights


def laplace_matrix(mesh: Mesh) -> sparse.csc_matrix:
    """Laplace prior of EIDORS: twice the graph Laplacian of elements that share an edge, (e, e) sparse.

    xᵀRx = 2 Σ (x_i − x_j)² over neighbours; edge lengths and distances do not enter (Vauhkonen et al. 1998).
    """
    differences = neighbour_differences(mesh)
    return sparse.csc_matrix(2 * (differences.T @ differences))


def neighbour_differences(mesh: Mesh) -> sparse.csr_matrix:
    """Differences (edges, e) between elements that share an edge."""
    edge = np.arange(len(mesh.neighbours))
    ones = np.ones(len(edge))
    first, second = mesh.neighbours.T
    entries = np.concatenate([ones, -ones]), (np.concatenate([edge, edge]), np.concatenate([first, second]))
    return sparse.csr_matrix(entries, shape=(len(edge), len(mesh.elements)))


def laplace(mesh: Mesh) -> Prior:
    """Prior of :func:`laplace_matrix`, R = 2 DᵀD with D the differences between neighbours; constants have no cost.

    P is the inverse with the last element held at zero; √2 DP is a root of it.
    """
    differences = np.sqrt(2.0) * neighbour_differences(mesh)
    factors = splu(
        laplace_matrix(mesh)[:-1, :-1].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )

    def covariance(columns: Array) -> Array:
        solution = np.zeros_like(columns, order="F")
        solution[:-1] = factors.solve(np.asfortranarray(columns[:-1]))
        return solution

    def half(columns: Array) -> Array:
        product: Array = differences @ covariance(columns)
        return product

    return Prior(covariance, np.ones((len(mesh.elements), 1)), half)


#: The filter is a dense matrix; one of this many elements takes 800 MB and half a minute.
_MOST_FILTERED: Final = 10_000
_ROWS_AT_ONCE: Final = 512
_SHORTEST: Final = 1e-6  #: length, of an element's edge
_NARROWEST: Final = 0.5  #: width of the filter, likewise
_LONGEST: Final = 10.0  #: of either, of the sheet's extent


def indenter_smoothness(mesh: Mesh, length_mm: float) -> Prior:
    """Matérn covariance of smoothness 3/2, P_ij = (1 + r) e^(−r) with r = √3 |c_i − c_j| / length.

    Parameters
    ----------
    length_mm : correlation length [mm], a millionth of an element's edge to ten times the sheet; the head's radius
        fits.

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

    G is a Gaussian low-pass filter, weighted by the elements' areas and normalised on each element, so that a
    constant image has no cost. With w the left null vector of F, P = F₁⁻¹ (I − wwᵀ/wᵀw) F₁⁻ᵀ, F₁ = F + 1wᵀ/wᵀ1.

    Parameters
    ----------
    width_mm : width of the kernel at half height [mm], half of an element's edge to ten times the sheet.

    Raises
    ------
    NumericsError
        If the width is out of that range, or the mesh has so many elements that F does not fit.
    """
    _check_length(mesh, width_mm, least=_NARROWEST)
    count, areas = len(mesh.elements), mesh.areas_mm2
    if count > _MOST_FILTERED:
        raise NumericsError(
            f"the high-pass prior is a dense filter: {count} elements; at most {_MOST_FILTERED} are allowed",
            remedy="use larger image elements or another prior",
        )
    squared = cdist(mesh.centroids_mm, mesh.centroids_mm, "sqeuclidean")
    kernel = np.exp(squared * (-4 * np.log(2) / width_mm**2)) * areas
    sums = kernel.sum(axis=1)
    null_vector = areas * sums  # wᵀF = 0, as the kernel is symmetric before it is weighted and normalised
    regular = np.eye(count) - kernel / sums[:, None] + null_vector / null_vector.sum()
    factors = linalg.lu_factor(regular, overwrite_a=True, check_finite=False)
    unit = (null_vector / np.linalg.norm(null_vector))[:, None]

    def half(columns: Array) -> Array:
        product: Array = linalg.lu_solve(factors, columns, trans=1)
        product -= unit @ (unit.T @ product)
        return product

    def covariance(columns: Array) -> Array:
        return linalg.lu_solve(factors, half(columns))

    return Prior(covariance, np.ones((count, 1)), half)


def _check_length(mesh: Mesh, value: float, *, least: float) -> None:
    """Refuse a length that is out of range; ``least`` is of the mean element's edge."""
    shortest = least * float(np.sqrt(4 / np.sqrt(3) * mesh.areas_mm2.mean()))
    longest = _LONGEST * float(np.ptp(mesh.nodes_mm, axis=0).max())
    if not shortest <= value <= longest:
        raise NumericsError(
            f"a prior's length is {value:.3g} mm; it must be a positive finite number, {shortest:.2g} to"
            f" {longest:.2g} mm on this image",
            remedy="give a width or diameter in that range, or change the size of image elements",
        )
