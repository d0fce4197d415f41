"""One-step Gauss–Newton with any prior, and the criteria that choose its λ from readings.

With eigenvalues Λ of W^½JPJᵀW^½ and z the readings' coefficients,

    ‖W^½(y − Jx)‖² = Σ (λ²/(Λ + λ²))² z²,   xᵀRx = Σ Λ/(Λ + λ²)² z²,   trace(I − H) = Σ λ²/(Λ + λ²)

over the regularised part of the readings. For several frames with one λ, their z² add up.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.dual import DualSpectrum, dual_spectrum
from cbsr_qa.eit.inverse.noise_figures import (
    Evidence,
    central_signal,
    hyperparameter_for,
    noise_figure,
    noise_figure_of,
    round_figure,
    search_grid,
)
from cbsr_qa.eit.inverse.priors import Prior
from cbsr_qa.eit.inverse.readings import ReadingFold
from cbsr_qa.eit.inverse.regularisation import Criterion, Regularisation

_LOWEST: Final = 1e-6  #: λ searched, relative to the root of the largest eigenvalue
_HIGHEST: Final = 1e3
_STEPS: Final = 361  #: logarithmic; 40 a decade
_STILL: Final = 1e-6  # slope of the residual, at the ends of the search
_REMEDY: Final = "choose by noise figure, or give the hyperparameter itself"


def ridge_reconstruction(
    method: str,
    problem: ImagingProblem,
    prior_of: Callable[[ImagingProblem], Prior],
    regularisation: Regularisation,
) -> tuple[LinearReconstruction, DualSpectrum]:
    """Prepare x = (JᵀWJ + λ²R)⁻¹JᵀW y, solved in its dual form on folded readings.

    Parameters
    ----------
    method : name of the plugin.
    prior_of : makes the prior of a problem's image.
    regularisation : choice of λ.

    Returns
    -------
    The reconstruction, and the problem's spectrum, which solves it for any λ.

    Raises
    ------
    NumericsError
        If λ is out of range, cannot be chosen or is too small to determine the image, or the prior cannot be made.
    """
    search = RidgeSearch(problem, prior_of(problem))
    value, how, curve = regularisation.choose(
        problem, lambda base: search if _share_system(base, problem) else RidgeSearch(base, prior_of(base))
    )
    matrix = search.spectrum.check_and_form_matrix(value)
    areas, variance = problem.mesh.areas_mm2, problem.noise_variance
    figure = noise_figure(matrix, central_signal(problem), areas, noise_variance=variance)
    choice = ParameterChoice(value, how, figure, curve=curve, criterion=regularisation.decided_by)
    return LinearReconstruction(method, problem, matrix, choice), search.spectrum


def _share_system(one: ImagingProblem, other: ImagingProblem) -> bool:
    """Whether two problems differ at most in their readings: one decomposition then serves both."""
    if one is other:
        return True
    return (
        one.noise_variance is None
        and other.noise_variance is None
        and np.array_equal(one.used, other.used)
        and np.array_equal(one.reference, other.reference)
        and np.array_equal(one.jacobian, other.jacobian)
    )


class RidgeSearch:
    """λ on one problem: every criterion needs only products with its dual spectrum."""

    def __init__(self, problem: ImagingProblem, prior: Prior) -> None:
        self._fold = ReadingFold.from_problem(problem)
        folded = dual_spectrum(self._fold.rows(problem.jacobian), prior, self._fold.variance)
        self._spectrum = replace(folded, analysis=self._fold.unfold(folded.analysis))
        self._signal = central_signal(problem)
        self._areas, self._variance = problem.mesh.areas_mm2, problem.noise_variance

    @property
    def spectrum(self) -> DualSpectrum:
        """Spectrum of the folded readings, with an analysis that takes all readings."""
        return self._spectrum

    @property
    def shown(self) -> Array:
        """λ four times as close together as those searched."""
        grid = search_grid(self._spectrum)
        return np.geomspace(grid[0], grid[-1], 4 * (len(grid) - 1) + 1)

    @property
    def discrete(self) -> bool:
        """False: λ is any positive number."""
        return False

    def noise_figures(self, values: Array) -> Array:
        figure = noise_figure_of(self._spectrum, self._signal, self._areas, self._variance)
        return np.array([figure(float(value)) for value in values])

    def for_noise_figure(self, target: float) -> float:
        return hyperparameter_for(target, self._spectrum, self._signal, self._areas, self._variance)

    def choose_from_readings(self, criterion: Criterion, evidence: Evidence) -> float:
        regularised = self._spectrum.analysis[: len(self._spectrum.values)]
        curves = RidgeCurves(self._spectrum.values, evidence.changes @ regularised.T)
        if criterion is Criterion.GCV:
            return choose_by_cross_validation(curves)
        if criterion is Criterion.L_CURVE:
            return choose_by_l_curve(curves)
        return choose_by_discrepancy(curves, noise_level(evidence, len(self._fold.first)))


def noise_level(evidence: Evidence, readings: int) -> float:
    """Weighted squared residual that noise leaves over all frames; NumericsError if the noise is unknown."""
    if evidence.variance is None:
        raise NumericsError(
            "the discrepancy principle needs the noise, and no reading is repeated to estimate it from",
            remedy="choose by another criterion",
        )
    return evidence.variance * readings * len(evidence.changes)


class RidgeCurves:
    """Residual, size and degrees of freedom over s = ln λ².

    Parameters
    ----------
    values : (k,) eigenvalues Λ, not negative.
    coefficients : (n, k) coefficients of n frames of readings, in units of their noise up to a common factor.

    Raises
    ------
    NumericsError
        If a coefficient is not finite, or all are zero.
    """

    def __init__(self, values: Array, coefficients: Array) -> None:
        energy = (coefficients**2).sum(axis=0)
        if not np.isfinite(energy).all():
            raise NumericsError("a reading to choose λ from is not a finite number", remedy="leave its channel out")
        if not energy.any():
            raise NumericsError(
                "the readings to choose λ from do not differ from their reference: nothing to fit",
                remedy="choose by noise figure, or on readings of a load",
            )
        self._values, self._energy = values, energy
        largest = float(np.sqrt(values.max()))
        self.grid: Array = 2 * np.linspace(np.log(_LOWEST * largest), np.log(_HIGHEST * largest), _STEPS)

    def residual(self, s: Array | float) -> Array:
        """Weighted squared residual of all frames."""
        remaining_share = self._remaining_share(s)
        return np.asarray(remaining_share**2 @ self._energy)

    def size(self, s: Array | float) -> Array:
        """xᵀRx of all frames."""
        ridge = np.exp(np.asarray(s))[..., None]
        return np.asarray((self._values / (self._values + ridge) ** 2) @ self._energy)

    def freedom(self, s: Array | float) -> Array:
        """Degrees of freedom of one frame's residual."""
        return np.asarray(self._remaining_share(s).sum(axis=-1))

    def cross_validation(self, s: Array | float) -> Array:
        """GCV function (Golub, Heath & Wahba 1979): residual over squared degrees of freedom."""
        return self.residual(s) / self.freedom(s) ** 2

    def curvature(self, s: Array | float) -> Array:
        """Curvature of ln‖x‖ over ln‖residual‖, positive at a corner towards the origin (Hansen 1992).

        With t = λ², η = xᵀRx, ρ = residual and S_j = ΣΛz²/(Λ + t)^j: dη/dt = −2S₃, dρ/dt = 2tS₃.
        """
        ridge = np.exp(np.asarray(s))
        total = self._values + ridge[..., None]
        third, fourth = (self._values / total**power @ self._energy for power in (3, 4))
        size, residual = self.size(s), self.residual(s)
        # Derivatives along s of η and ρ, then of half their logarithms.
        eta, rho = -2 * ridge * third, 2 * ridge**2 * third
        eta2 = eta + 6 * ridge**2 * fourth
        rho2 = 2 * rho - 6 * ridge**3 * fourth
        x1, y1 = rho / residual / 2, eta / size / 2
        x2, y2 = rho2 / residual / 2 - 2 * x1**2, eta2 / size / 2 - 2 * y1**2
        curvature: Array = (x1 * y2 - x2 * y1) / (x1**2 + y1**2) ** 1.5
        return curvature

    def _remaining_share(self, s: Array | float) -> Array:
        ridge = np.exp(np.asarray(s))[..., None]
        return np.asarray(ridge / (self._values + ridge))


def choose_by_cross_validation(curves: RidgeCurves) -> float:
    """λ of the lowest GCV function; NumericsError if it has no minimum in the range searched."""
    minimum = int(np.argmin(curves.cross_validation(curves.grid)))
    return _refine_minimum(
        curves, minimum, lambda s: float(np.log(curves.cross_validation(s))), "generalised cross-validation"
    )


def choose_by_l_curve(curves: RidgeCurves) -> float:
    """λ of the sharpest corner of the L-curve; NumericsError if it has none in the range searched."""
    curvature = curves.curvature(curves.grid)
    # At both ends one of the two logarithms is constant and the quotient is rounding.
    is_steep = np.abs(np.gradient(np.log(curves.residual(curves.grid)), curves.grid)) > _STILL
    curvature = np.where(is_steep & np.isfinite(curvature), curvature, -np.inf)
    corner = int(np.argmax(curvature))
    if not curvature[corner] > 0:
        raise NumericsError(f"the L-curve has no corner {_range(curves)}", remedy=_REMEDY)
    return _refine_minimum(curves, corner, lambda s: -float(curves.curvature(s)), "the L-curve")


def choose_by_discrepancy(curves: RidgeCurves, level: float) -> float:
    """λ at which the residual of all frames is ``level``, number of readings times noise variance (Morozov 1966).

    NumericsError if no λ in the searched range leaves so much: the readings are only noise, or have none.
    """
    low, high = (float(curves.residual(end)) for end in (curves.grid[0], curves.grid[-1]))
    if not low < level < high:
        reason = "the readings do not exceed their noise" if level >= high else "there is almost no noise"
        raise NumericsError(
            f"the discrepancy principle has no answer {_range(curves)}: {reason} (residual {np.sqrt(low):.3g} to"
            f" {np.sqrt(high):.3g}, noise {np.sqrt(max(level, 0.0)):.3g})",
            remedy=_REMEDY,
        )
    root = brentq(lambda s: float(np.log(curves.residual(s) / level)), curves.grid[0], curves.grid[-1], xtol=1e-12)
    return round_figure(float(np.exp(root / 2)))


def _refine_minimum(curves: RidgeCurves, where: int, cost: Callable[[float], float], criterion: str) -> float:
    """Polish a minimum found on the grid."""
    if where in (0, len(curves.grid) - 1):
        raise NumericsError(f"{criterion} has no minimum {_range(curves)}", remedy=_REMEDY)
    bounds = (float(curves.grid[where - 1]), float(curves.grid[where + 1]))
    best = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-9})
    return round_figure(float(np.exp(best.x / 2)))


def _range(curves: RidgeCurves) -> str:
    low, high = np.exp(curves.grid[[0, -1]] / 2)
    return f"for λ from {low:.2g} to {high:.2g}"
