"""One-step Gauss–Newton with any prior: the code its plugins share."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cbsr_qa.domain import Array, NumericsError
from cbsr_qa.domain.results import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.eit.inverse.choice import (
    Criterion,
    Evidence,
    Regularisation,
    RidgeCurves,
    by_cross_validation,
    by_discrepancy,
    by_l_curve,
    central_signal,
    hyperparameter_for,
    noise_figure,
    noise_figure_of,
    searched,
)
from cbsr_qa.eit.inverse.dual import DualSpectrum, check_hyperparameter, dual_matrix, dual_spectrum
from cbsr_qa.eit.inverse.priors import Prior
from cbsr_qa.eit.inverse.readings import ReadingFold


class OneStep:
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y, solved in its dual form on folded readings.

    Parameters
    ----------
    method : name of the plugin.
    prior_of : makes the prior of a problem's image.
    regularisation : how λ is chosen.

    Raises
    ------
    NumericsError
        If a given λ is negative or not finite.
    """

    def __init__(
        self, method: str, prior_of: Callable[[ImagingProblem], Prior], regularisation: Regularisation
    ) -> None:
        if regularisation.given is not None:
            check_hyperparameter(regularisation.given)
        self._method = method
        self._prior_of = prior_of
        self._regularisation = regularisation

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If λ cannot be chosen, is too small to determine the image, or the prior cannot be made.
        """
        value, how, curve = self._regularisation.choose(problem, lambda base: RidgeSearch(base, self._prior_of(base)))
        fold, prior = ReadingFold.of(problem), self._prior_of(problem)
        matrix = fold.unfold(dual_matrix(fold.rows(problem.jacobian), prior, value, fold.variance))
        areas, variance = problem.mesh.areas_mm2, problem.noise_variance
        figure = noise_figure(matrix, central_signal(problem), areas, noise_variance=variance)
        choice = ParameterChoice(value, how, figure, curve=curve, criterion=self._regularisation.decided_by)
        return LinearReconstruction(self._method, problem, matrix, choice)


class RidgeSearch:
    """λ on one problem: every criterion costs products with its dual spectrum."""

    def __init__(self, problem: ImagingProblem, prior: Prior) -> None:
        self._fold = ReadingFold.of(problem)
        folded = dual_spectrum(self._fold.rows(problem.jacobian), prior, self._fold.variance)
        self._spectrum = replace(folded, analysis=self._fold.unfold(folded.analysis))
        self._signal = central_signal(problem)
        self._areas, self._variance = problem.mesh.areas_mm2, problem.noise_variance

    @property
    def spectrum(self) -> DualSpectrum:
        """Of the folded readings, with an analysis that takes all of them."""
        return self._spectrum

    @property
    def grid(self) -> Array:
        """λ that are looked at."""
        return searched(self._spectrum)

    @property
    def shown(self) -> Array:
        """λ four times as close together: a noise figure costs 0.1 ms."""
        return np.geomspace(self.grid[0], self.grid[-1], 4 * (len(self.grid) - 1) + 1)

    @property
    def discrete(self) -> bool:
        """λ is any positive number."""
        return False

    def noise_figures(self, values: Array) -> Array:
        """Noise figure at each of some λ."""
        figure = noise_figure_of(self._spectrum, self._signal, self._areas, self._variance)
        return np.array([figure(float(value)) for value in values])

    def for_noise_figure(self, target: float) -> float:
        """λ of a noise figure."""
        return hyperparameter_for(target, self._spectrum, self._signal, self._areas, self._variance)

    def by_readings(self, criterion: Criterion, evidence: Evidence) -> float:
        """λ chosen from readings."""
        regularised = self._spectrum.analysis[: len(self._spectrum.values)]
        curves = RidgeCurves(self._spectrum.values, evidence.changes @ regularised.T)
        if criterion is Criterion.GCV:
            return by_cross_validation(curves)
        if criterion is Criterion.L_CURVE:
            return by_l_curve(curves)
        return by_discrepancy(curves, noise_level(evidence, len(self._fold.first)))


def noise_level(evidence: Evidence, readings: int) -> float:
    """Weighted squared residual that noise alone leaves, of all frames and this many independent readings.

    Raises
    ------
    NumericsError
        If nobody knows the noise.
    """
    if evidence.variance is None:
        raise NumericsError(
            "the discrepancy principle needs the noise, and no reading is repeated to estimate it from",
            remedy="choose by another criterion",
        )
    return evidence.variance * readings * len(evidence.changes)
