"""One-step Gauss–Newton with the NOSER prior, its hyperparameter chosen for a noise figure."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.reconstruct.choice import hyperparameter_for
from cbsr_qa.reconstruct.dual import check_hyperparameter, dual_matrix, dual_spectrum
from cbsr_qa.reconstruct.noise_figure import noise_figure
from cbsr_qa.reconstruct.priors import noser
from cbsr_qa.reconstruct.problem import target_signal

_TARGET_RADIUS = 0.13  # of the sheet's radius: the 13 mm indenter on the 100 mm disc
_TARGET_CONTRAST = 0.01


class GaussNewtonNoser:
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R = diag(JᵀJ)^p (Cheney et al. 1990; Adler & Lionheart 2006).

    Parameters
    ----------
    noise_figure : target (Adler et al. 2009 form) on the nominal model; 1.0 unless a hyperparameter is given. λ is
        chosen with every reading of the sensor type's pattern: a sensor with a bad channel is imaged with the λ
        of all others, or noise figures of sensors could not be compared.
    hyperparameter : λ itself, in the units of the unit model; excludes ``noise_figure``.
    exponent : p, 0 (Tikhonov, moves images towards the rim) to 1 (moves them inwards). 0.5 is EIDORS's; on the
        100 mm disc at noise figure 1 about 0.25 balances the two and places loads best.
    """

    def __init__(
        self,
        *,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        exponent: float = 0.5,
    ) -> None:
        if noise_figure is not None and hyperparameter is not None:
            raise NumericsError("gauss-newton-noser takes noise_figure or hyperparameter, not both")
        if hyperparameter is not None:
            check_hyperparameter(hyperparameter)
        self._noise_figure = 1.0 if noise_figure is None else noise_figure
        self._hyperparameter = hyperparameter
        self._exponent = exponent

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If the noise figure cannot be reached, the hyperparameter is too small to determine the image, the
            exponent is out of range, or an element is felt by no reading.
        """
        value, how = self._chosen(problem.nominal or problem)
        prior = noser(problem.jacobian, self._exponent)
        matrix = dual_matrix(problem.jacobian, prior, value, problem.noise_variance)
        signal = _signal(problem)
        figure = noise_figure(matrix, signal, problem.mesh.areas_mm2, noise_variance=problem.noise_variance)
        return LinearReconstruction("gauss-newton-noser", problem, matrix, ParameterChoice(value, how, figure))

    def _chosen(self, nominal: ImagingProblem) -> tuple[float, str]:
        """Choose λ on the sensor type's own problem; returns it with how it was chosen."""
        if self._hyperparameter is not None:
            return self._hyperparameter, "hyperparameter given"
        prior = noser(nominal.jacobian, self._exponent)
        spectrum = dual_spectrum(nominal.jacobian, prior, nominal.noise_variance)
        areas, variance = nominal.mesh.areas_mm2, nominal.noise_variance
        value = hyperparameter_for(self._noise_figure, spectrum, _signal(nominal), areas, variance)
        return value, (
            f"noise figure {self._noise_figure:.2f} (Adler et al. 2009) on the nominal model, central target of"
            f" {2 * _radius_mm(nominal):g} mm and {_TARGET_CONTRAST:.0%} contrast"
        )


def _radius_mm(problem: ImagingProblem) -> float:
    return _TARGET_RADIUS * problem.sensor_type.radius_mm


def _signal(problem: ImagingProblem) -> NDArray[np.float64]:
    """Changes of the used readings for the central target, (m,)."""
    return target_signal(problem, x_mm=0, y_mm=0, radius_mm=_radius_mm(problem), contrast=_TARGET_CONTRAST)
