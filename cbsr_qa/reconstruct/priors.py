"""What is expected of an image before it is measured, the R of (JᵀWJ + λ²R), in the form the dual system needs.

That form is P = R⁻¹ as a product with columns. Diagonal priors are a division; the Laplace prior is one sparse
factorisation; the priors with a length (:mod:`cbsr_qa.reconstruct.smoothness`) are built from P or its root.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import Mesh

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """A prior of the image.

    Parameters
    ----------
    covariance : (e, k) → (e, k), the product with P = R⁻¹; with a symmetric generalised inverse of R that is exact
        on columns orthogonal to ``free``, where R is singular.
    free : (e, f) null space of R, images that cost nothing; None where there is none.
    half : (e, k) → (n, k), the product with a root H of P = HᵀH. Where a prior has one, the dual system is decomposed
        without being formed, which would square its condition number. None where it has none.
    """

    covariance: Callable[[Array], Array]
    free: Array | None = None
    half: Callable[[Array], Array] | None = None

    @classmethod
    def diagonal(cls, weights: Array) -> Self:
        """Prior that knows nothing of neighbours: R = diag(weights), (e,) positive."""
        root = np.sqrt(weights)[:, None]
        return cls(lambda columns: columns / weights[:, None], half=lambda columns: columns / root)


def noser(jacobian: Array, exponent: float) -> Array:
    """Diagonal of the NOSER prior, diag(JᵀJ)^p (Cheney et al. 1990; exponents below 1 are EIDORS's).

    p = 0 is Tikhonov's identity, p = 1 makes the penalty as strong where the readings are sensitive as elsewhere.

    Parameters
    ----------
    jacobian : (m, e). exponent : p in 0 … 1.

    Returns
    -------
    (e,) float64, positive.

    Raises
    ------
    NumericsError
        If p is out of range, or an element is felt by no reading at all.
    """
    if not 0 <= exponent <= 1:
        raise NumericsError(
            f"NOSER exponent {exponent} is not in 0 … 1",
            remedy="give an exponent from 0 (Tikhonov's prior) to 1; 0.5 is usual",
        )
    squared = np.einsum("me,me->e", jacobian, jacobian)
    if not (squared > 0).all():
        raise NumericsError(
            f"{int((squared <= 0).sum())} image elements are felt by no reading that is left",
            remedy="mend the masked channels",
        )
    weights: Array = squared**exponent
    return weights


def laplace_matrix(mesh: Mesh) -> sparse.csc_matrix:
    """Laplace prior of EIDORS: twice the graph Laplacian of elements that share an edge, (e, e) sparse.

    xᵀRx = 2 Σ (x_i − x_j)² over neighbours; edge lengths and distances do not enter, so on graded meshes it is no
    discrete Laplacian (Vauhkonen et al. 1998 weigh alike).
    """
    differences = _differences(mesh)
    return sparse.csc_matrix(2 * (differences.T @ differences))


def _differences(mesh: Mesh) -> sparse.csr_matrix:
    """Differences (edges, e) between elements that share an edge."""
    edge = np.arange(len(mesh.neighbours))
    ones = np.ones(len(edge))
    first, second = mesh.neighbours.T
    entries = np.concatenate([ones, -ones]), (np.concatenate([edge, edge]), np.concatenate([first, second]))
    return sparse.csr_matrix(entries, shape=(len(edge), len(mesh.elements)))


def laplace(mesh: Mesh) -> Prior:
    """Prior of :func:`laplace_matrix`; a constant image costs nothing.

    P is the inverse with the last element held at zero. It differs from any other generalised inverse by constants,
    which the dual form determines from the readings. R = 2 DᵀD with D the differences between neighbours; √2 DP is a
    root of P.
    """
    differences = np.sqrt(2.0) * _differences(mesh)
    factors = splu(
        laplace_matrix(mesh)[:-1, :-1].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )

    def covariance(columns: Array) -> Array:
        held = np.zeros_like(columns, order="F")
        held[:-1] = factors.solve(np.asfortranarray(columns[:-1]))
        return held

    def half(columns: Array) -> Array:
        product: Array = differences @ covariance(columns)
        return product

    return Prior(covariance, np.ones((len(mesh.elements), 1)), half)
