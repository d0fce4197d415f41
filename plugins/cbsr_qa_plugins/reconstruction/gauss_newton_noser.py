"""One-step Gauss–Newton with the NOSER prior."""

from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction
from cbsr_qa.reconstruct.one_step import OneStep
from cbsr_qa.reconstruct.options import number
from cbsr_qa.reconstruct.priors import Prior, noser
from cbsr_qa.reconstruct.regularisation import Regularisation

_NAME = "gauss-newton-noser"


class GaussNewtonNoser:
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R = diag(JᵀJ)^p (Cheney et al. 1990; Adler & Lionheart 2006).

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.reconstruct.regularisation.Regularisation`. λ is chosen with every reading of the sensor
        type's pattern: a sensor with a bad channel is imaged with the λ of all others, or noise figures of sensors
        could not be compared.
    exponent : p, 0 (Tikhonov, moves images towards the rim) to 1 (moves them inwards). 0.5 is EIDORS's; on the
        100 mm disc at noise figure 1 about 0.25 balances the two and places loads best.
    """

    def __init__(
        self,
        *,
        choose: str | None = None,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        exponent: float = 0.5,
    ) -> None:
        chosen = Regularisation.of(_NAME, choose=choose, noise_figure=noise_figure, given=hyperparameter)
        power = number(_NAME, "exponent", exponent)
        self._step = OneStep(_NAME, lambda problem: Prior.diagonal(noser(problem.jacobian, power)), chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If λ cannot be chosen or is too small to determine the image, or an element is felt by no reading.
        """
        return self._step.prepare(problem)
