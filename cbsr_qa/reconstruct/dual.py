"""One-step Gauss–Newton in its dual form: a solve as large as the number of readings, not of elements.

(JᵀWJ + λ²R)⁻¹JᵀW = R⁻¹Jᵀ (J R⁻¹ Jᵀ + λ²W⁻¹)⁻¹. With one eigendecomposition of W^½ J R⁻¹ Jᵀ W^½ every λ costs a
product.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cbsr_qa.domain.errors import NumericsError

Array = NDArray[np.float64]


def dual_matrix(jacobian: Array, prior: Array, hyperparameter: float, noise_variance: Array | None = None) -> Array:
    """Imaging matrix of one hyperparameter, by one Cholesky factorisation.

    Parameters
    ----------
    jacobian : (m, e).
    prior : (e,) diagonal of R, positive.
    hyperparameter : λ.
    noise_variance : (m,) diagonal of W⁻¹, None for ones.

    Returns
    -------
    (e, m) float64.

    Raises
    ------
    NumericsError
        If λ is negative or not finite, or so small that the readings do not determine the solve.
    """
    check_hyperparameter(hyperparameter)
    back = jacobian.T / prior[:, None]
    normal = jacobian @ back
    ridge = hyperparameter**2 * (np.ones(len(jacobian)) if noise_variance is None else noise_variance)
    normal.flat[:: len(normal) + 1] += ridge
    try:
        factor = linalg.cho_factor(normal, lower=True)
    except linalg.LinAlgError:
        factor = None
    if factor is None or _condition(normal, factor[0]) > 1 / (10 * np.finfo(float).eps):
        raise NumericsError(
            f"hyperparameter {hyperparameter:.3g} is too small: the readings do not determine the image to rounding",
            remedy="raise the hyperparameter, or ask for a noise figure",
        )
    matrix: Array = linalg.cho_solve(factor, back.T).T
    return matrix


@dataclass(frozen=True, slots=True, eq=False)
class DualSpectrum:
    """The dual form of every hyperparameter at once.

    Parameters
    ----------
    basis : (e, m) image of each eigenvector, R⁻¹JᵀW^½Q.
    values : (m,) eigenvalues, rising, not negative.
    analysis : (m, m) QᵀW^½, from readings to eigenvectors.
    """

    basis: Array
    values: Array
    analysis: Array

    def matrix(self, hyperparameter: float) -> Array:
        """Imaging matrix (e, m) of a hyperparameter above zero."""
        check_hyperparameter(hyperparameter)
        matrix: Array = (self.basis / (self.values + hyperparameter**2)) @ self.analysis
        return matrix


def dual_spectrum(jacobian: Array, prior: Array, noise_variance: Array | None = None) -> DualSpectrum:
    """Decompose the dual system once; parameters as in :func:`dual_matrix`."""
    root = np.ones(len(jacobian)) if noise_variance is None else 1 / np.sqrt(noise_variance)
    back = (root[:, None] * jacobian).T / prior[:, None]
    values, vectors = linalg.eigh(root[:, None] * (jacobian @ back))
    return DualSpectrum(back @ vectors, np.maximum(values, 0), vectors.T * root)


def check_hyperparameter(value: float) -> None:
    """Refuse λ that is negative or not a finite number."""
    if not np.isfinite(value) or value < 0:
        raise NumericsError(f"hyperparameter λ is {value}; it must be a finite number, zero or above")


def _condition(matrix: Array, factor: Array) -> float:
    """Estimate the condition number in the 1-norm from a lower Cholesky factor (LAPACK pocon)."""
    reciprocal, _ = linalg.lapack.dpocon(np.asfortranarray(factor), np.linalg.norm(matrix, 1), uplo="L")
    return float(1 / reciprocal) if reciprocal > 0 else float("inf")
