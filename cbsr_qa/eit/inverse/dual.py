"""One-step Gauss–Newton in dual form: a system of the size of the readings, not of the elements.

With P = R⁻¹, (JᵀWJ + λ²R)⁻¹JᵀW = PJᵀ (JPJᵀ + λ²W⁻¹)⁻¹. After one eigendecomposition of W^½ JPJᵀ W^½ each λ costs one
product. If P = HᵀH has a root with a product, the SVD of H JᵀW^½ is used instead (by QR): the condition number is not
squared, and every λ down to 0 (Moore–Penrose) is possible.

If R has a null space N the image is x = PJᵀW^½ d + N c with any generalised inverse P of R, where the coefficients d
are orthogonal to T = W^½JN (Wahba 1990, section 1.3): with [Q₁ Q₂] the complete orthogonal factor of T, d = Q₂
(Q₂ᵀAQ₂ + λ²I)⁻¹ Q₂ᵀ W^½y, A = W^½JPJᵀW^½, and c fits Tc to W^½y − Ad.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy import linalg

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.priors import Prior

#: Largest condition number of the dual system, or of its root if that is decomposed: ten digits are lost.
_MAX_CONDITION: Final = 1e10
_MAX_HYPERPARAMETER: Final = 1e50  # of λ: its square, and that of an image, remain representable
_UNSEEN: Final = 1e-12  # of the largest possible signal in the readings


def dual_matrix(jacobian: Array, prior: Prior | Array, hyperparameter: float, variance: Array | None = None) -> Array:
    """Imaging matrix (e, m) of one hyperparameter.

    Parameters
    ----------
    jacobian : (m, e).
    prior : prior of the image; an array is the diagonal of R, (e,) positive.
    hyperparameter : λ.
    variance : (m,) diagonal of W⁻¹, None for ones.

    Raises
    ------
    NumericsError
        If λ is negative or above 1e50, or so small that the readings do not determine the solution.
    """
    return dual_spectrum(jacobian, prior, variance).check_and_form_matrix(hyperparameter)


@dataclass(frozen=True, slots=True, eq=False)
class DualSpectrum:
    """Spectral decomposition of the dual form, which solves it for any hyperparameter.

    Parameters
    ----------
    basis : (e, k + f) image of each eigenvector; the last f span what R leaves free (none if R is regular).
    values : (k,) eigenvalues, rising, not negative.
    analysis : (k + f, m) from readings to eigenvectors; rows have unit variance and no covariance under the noise.
    most_condition : condition number of Λ + λ² beyond which rounding dominates the solution.
    """

    basis: Array
    values: Array
    analysis: Array
    most_condition: float = _MAX_CONDITION

    def gains(self, hyperparameter: float) -> Array:
        """Factor of each eigenvector, (k + f,): 1/(Λ + λ²), and 1 for unregularised ones."""
        gains: Array = np.ones(self.basis.shape[1])
        gains[: len(self.values)] /= self.values + hyperparameter**2
        return gains

    def matrix(self, hyperparameter: float) -> Array:
        """Imaging matrix (e, m) of a hyperparameter, which may be zero only if no eigenvalue is."""
        check_hyperparameter(hyperparameter)
        return (self.basis * self.gains(hyperparameter)) @ self.analysis

    def check_and_form_matrix(self, hyperparameter: float) -> Array:
        """Imaging matrix (e, m); NumericsError also if the readings do not determine it at this hyperparameter."""
        check_hyperparameter(hyperparameter)
        least, largest = self.values[[0, -1]] + hyperparameter**2
        if largest > self.most_condition * least:
            raise NumericsError(
                f"hyperparameter {hyperparameter:.3g} is too small: the system is singular to rounding",
                remedy="raise the hyperparameter, or give a noise figure",
            )
        return self.matrix(hyperparameter)


def dual_spectrum(jacobian: Array, prior: Prior | Array, variance: Array | None = None) -> DualSpectrum:
    """Decompose the dual system once; parameters as in :func:`dual_matrix`."""
    return _System.from_problem(jacobian, prior, variance).spectrum()


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """The dual system before λ.

    Parameters
    ----------
    white : (k, e) whitened Jacobian, without what N explains. back : (e, k) P times its transpose.
    half : (n, k) H times its transpose; None if P has no root.
    analysis : (k, m), whitened readings, without the part that N explains.
    free : (e, f), free_analysis : (f, m), for the part that N explains.
    """

    white: Array
    back: Array
    half: Array | None
    analysis: Array
    free: Array
    free_analysis: Array

    @classmethod
    def from_problem(cls, jacobian: Array, prior: Prior | Array, variance: Array | None) -> "_System":
        prior = prior if isinstance(prior, Prior) else Prior.diagonal(prior)
        count = len(jacobian)
        root = np.ones(count) if variance is None else 1 / np.sqrt(variance)
        white = jacobian if variance is None else root[:, None] * jacobian
        if prior.free is None:
            empty_parts = np.zeros((jacobian.shape[1], 0)), np.zeros((0, count))
            return cls._regular(white, prior, np.diag(root), *empty_parts)
        response = white @ prior.free
        if np.linalg.norm(response, axis=0).min() <= _UNSEEN * np.linalg.norm(white) * np.linalg.norm(prior.free):
            raise NumericsError(
                "the readings do not respond to the image component that the prior leaves free",
                remedy="repair the masked channels, or use a prior of full rank (gauss-newton-noser)",
            )
        return cls._eliminate_free(white, prior, response, prior.free, root)

    def normal(self) -> Array:
        return self.white @ self.back

    def spectrum(self) -> DualSpectrum:
        if self.half is None:
            values, vectors = linalg.eigh(self.normal())
            values, most_condition = np.maximum(values, 0), _MAX_CONDITION
        else:
            (triangle,) = linalg.qr(self.half, mode="r")
            _, roots, rows = linalg.svd(triangle[: len(self.white)])
            sizes = np.zeros(len(rows))
            sizes[: len(roots)] = roots
            values, vectors, most_condition = sizes[::-1] ** 2, rows[::-1].T, _MAX_CONDITION**2
        return DualSpectrum(
            np.hstack([self.back @ vectors, self.free]),
            values,
            np.vstack([vectors.T @ self.analysis, self.free_analysis]),
            most_condition,
        )

    @classmethod
    def _regular(cls, white: Array, prior: Prior, analysis: Array, free: Array, free_analysis: Array) -> "_System":
        columns = white.T
        half_columns = None if prior.half is None else prior.half(columns)
        return cls(white, prior.covariance(columns), half_columns, analysis, free, free_analysis)

    @classmethod
    def _eliminate_free(cls, white: Array, prior: Prior, seen: Array, free: Array, root: Array) -> "_System":
        complete, triangle = linalg.qr(seen)
        width = free.shape[1]
        triangle = triangle[:width]
        explained, complement = complete[:, :width], complete[:, width:]
        free = linalg.solve_triangular(triangle, free.T, trans="T").T  # so that its coefficients are Q₁ᵀ of readings
        system = cls._regular(complement.T @ white, prior, complement.T * root, free, explained.T * root)
        back = system.back - free @ (explained.T @ (white @ system.back))
        return replace(system, back=back)


def check_hyperparameter(value: float) -> None:
    """Refuse λ that is negative, not finite, or so large that the image is only rounding."""
    if not 0 <= value <= _MAX_HYPERPARAMETER:
        raise NumericsError(
            f"hyperparameter λ is {value}; it must be a finite number, zero or above, up to"
            f" {_MAX_HYPERPARAMETER:.0e}",
            remedy="give a λ in that range, or give a noise figure",
        )
