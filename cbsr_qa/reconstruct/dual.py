"""One-step Gauss–Newton in its dual form: a solve as large as the number of readings, not of elements.

With P = R⁻¹, (JᵀWJ + λ²R)⁻¹JᵀW = PJᵀ (JPJᵀ + λ²W⁻¹)⁻¹. With one eigendecomposition of W^½ JPJᵀ W^½ every λ costs a
product.

Where R has a null space N (a constant image costs nothing under a smoothness prior) R⁻¹ does not exist, yet the image
does as long as the readings see N. It is x = PJᵀW^½ d + N c with any generalised inverse P of R, where the
coefficients d are orthogonal to T = W^½JN (Wahba 1990, section 1.3; universal kriging): with [Q₁ Q₂] the complete
orthogonal factor of T, d = Q₂ (Q₂ᵀAQ₂ + λ²I)⁻¹ Q₂ᵀ W^½y, A = W^½JPJᵀW^½, and c fits Tc to W^½y − Ad. Nothing is added
to R to make it regular, and the part of the readings that N explains is not regularised at all.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.reconstruct.priors import Prior

Array = NDArray[np.float64]

#: Of the dual system; the matrix has ten digits less than the numbers it is made of.
_MOST_CONDITION: Final = 1e10
_LARGEST: Final = 1e50  # of λ: its square, and that of an image it leaves, are doubles
_UNSEEN: Final = 1e-12  # of what the readings could see at most


def dual_matrix(jacobian: Array, prior: Prior | Array, hyperparameter: float, variance: Array | None = None) -> Array:
    """Imaging matrix of one hyperparameter, by one Cholesky factorisation.

    Parameters
    ----------
    jacobian : (m, e).
    prior : of the image; an array is the diagonal of R, (e,) positive.
    hyperparameter : λ.
    variance : (m,) diagonal of W⁻¹, None for ones.

    Returns
    -------
    (e, m) float64.

    Raises
    ------
    NumericsError
        If λ is negative or above 1e50, or so small that the readings do not determine the solve.
    """
    check_hyperparameter(hyperparameter)
    system = _System.of(jacobian, prior, variance)
    normal = system.normal
    normal.flat[:: len(normal) + 1] += hyperparameter**2
    try:
        factor = linalg.cho_factor(normal, lower=True)
    except linalg.LinAlgError:
        factor = None
    if factor is None or _condition(normal, factor[0]) > _MOST_CONDITION:
        raise NumericsError(
            f"hyperparameter {hyperparameter:.3g} is too small: the readings do not determine the image to rounding",
            remedy="raise the hyperparameter, or ask for a noise figure",
        )
    matrix: Array = system.back @ linalg.cho_solve(factor, system.analysis)
    if len(system.free_analysis):
        matrix += system.free @ system.free_analysis
    return matrix


@dataclass(frozen=True, slots=True, eq=False)
class DualSpectrum:
    """The dual form of every hyperparameter at once.

    Parameters
    ----------
    basis : (e, k + f) image of each eigenvector; the last f are of what R leaves free (none where R is regular).
    values : (k,) eigenvalues, rising, not negative.
    analysis : (k + f, m) from readings to eigenvectors. Its rows have unit variance under the readings' noise, and
        no covariance.
    """

    basis: Array
    values: Array
    analysis: Array

    def gains(self, hyperparameter: float) -> Array:
        """Factor of each eigenvector, (k + f,): 1/(Λ + λ²), and 1 for what is not regularised."""
        gains: Array = np.ones(self.basis.shape[1])
        gains[: len(self.values)] /= self.values + hyperparameter**2
        return gains

    def matrix(self, hyperparameter: float) -> Array:
        """Imaging matrix (e, m) of a hyperparameter above zero."""
        check_hyperparameter(hyperparameter)
        matrix: Array = (self.basis * self.gains(hyperparameter)) @ self.analysis
        return matrix


def dual_spectrum(jacobian: Array, prior: Prior | Array, variance: Array | None = None) -> DualSpectrum:
    """Decompose the dual system once; parameters as in :func:`dual_matrix`."""
    system = _System.of(jacobian, prior, variance)
    values, vectors = linalg.eigh(system.normal)
    return DualSpectrum(
        np.hstack([system.back @ vectors, system.free]),
        np.maximum(values, 0),
        np.vstack([vectors.T @ system.analysis, system.free_analysis]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """The dual system before λ: images of the readings' coefficients, and how much of them is seen again.

    Parameters
    ----------
    back : (e, k). normal : (k, k) symmetric. analysis : (k, m), whitened readings, without those N explains.
    free : (e, f), free_analysis : (f, m), what N explains.
    """

    back: Array
    normal: Array
    analysis: Array
    free: Array
    free_analysis: Array

    @classmethod
    def of(cls, jacobian: Array, prior: Prior | Array, variance: Array | None) -> "_System":
        prior = prior if isinstance(prior, Prior) else Prior.diagonal(prior)
        count = len(jacobian)
        root = np.ones(count) if variance is None else 1 / np.sqrt(variance)
        white = jacobian if variance is None else root[:, None] * jacobian
        back = prior.covariance(white.T)
        normal = white @ back
        if prior.free is None:
            return cls(back, normal, np.diag(root), np.zeros((len(back), 0)), np.zeros((0, count)))
        seen = white @ prior.free
        if np.linalg.norm(seen, axis=0).min() <= _UNSEEN * np.linalg.norm(white) * np.linalg.norm(prior.free):
            raise NumericsError(
                "the readings do not see the image the prior leaves free: it cannot be determined",
                remedy="mend the masked channels, or take a prior that leaves nothing free (gauss-newton-noser)",
            )
        return cls._without_free(back, normal, seen, prior.free, root)

    @classmethod
    def _without_free(cls, back: Array, normal: Array, seen: Array, free: Array, root: Array) -> "_System":
        complete, triangle = linalg.qr(seen)
        width = free.shape[1]
        triangle = triangle[:width]
        explained, rest = complete[:, :width], complete[:, width:]
        free = linalg.solve_triangular(triangle, free.T, trans="T").T  # so that its coefficients are Q₁ᵀ of readings
        back = back @ rest - free @ (explained.T @ normal @ rest)
        return cls(back, rest.T @ normal @ rest, rest.T * root, free, explained.T * root)


def check_hyperparameter(value: float) -> None:
    """Refuse λ that is negative or no number, or so large that the image is nothing but rounding."""
    if not 0 <= value <= _LARGEST:
        raise NumericsError(
            f"hyperparameter λ is {value}; it must be a finite number, zero or above, up to {_LARGEST:.0e}",
            remedy="give a λ in that range, or ask for a noise figure",
        )


def _condition(matrix: Array, factor: Array) -> float:
    """Estimate the condition number in the 1-norm from a lower Cholesky factor (LAPACK pocon)."""
    reciprocal, _ = linalg.lapack.dpocon(np.asfortranarray(factor), np.linalg.norm(matrix, 1), uplo="L")
    return float(1 / reciprocal) if reciprocal > 0 else float("inf")
