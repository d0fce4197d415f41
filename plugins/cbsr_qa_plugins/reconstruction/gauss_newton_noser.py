"""One-step Gauss–Newton with the NOSER prior, its hyperparameter chosen for a noise figure."""

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
    noise_figure : target (Adler et al. 2009 form) on the nominal model; 1.0 unless a hyperparameter is given.
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
        prior = noser(problem.jacobian, self._exponent)
        areas = problem.mesh.areas_mm2
        radius_mm = _TARGET_RADIUS * problem.sensor_type.radius_mm
        signal = target_signal(problem, x_mm=0, y_mm=0, radius_mm=radius_mm, contrast=_TARGET_CONTRAST)
        value, how = self._hyperparameter, "hyperparameter given"
        if value is None:
            spectrum = dual_spectrum(problem.jacobian, prior, problem.noise_variance)
            value = hyperparameter_for(self._noise_figure, spectrum, signal, areas, problem.noise_variance)
            how = (
                f"noise figure {self._noise_figure:.2f} (Adler et al. 2009) on the nominal model, central target of"
                f" {2 * radius_mm:g} mm and {_TARGET_CONTRAST:.0%} contrast"
            )
        matrix = dual_matrix(problem.jacobian, prior, value, problem.noise_variance)
        figure = noise_figure(matrix, signal, areas, noise_variance=problem.noise_variance)
        return LinearReconstruction("gauss-newton-noser", problem, matrix, ParameterChoice(value, how, figure))
