"""One-step Gauss–Newton with a Gaussian high-pass prior."""

from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction
from cbsr_qa.reconstruct.one_step import OneStep
from cbsr_qa.reconstruct.options import number
from cbsr_qa.reconstruct.priors import Prior
from cbsr_qa.reconstruct.regularisation import Regularisation
from cbsr_qa.reconstruct.smoothness import high_pass

_NAME = "gauss-newton-high-pass"


class GaussNewtonHighPass:
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R = FᵀF, F a spatial high-pass filter (Adler & Guardo 1996).

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.reconstruct.regularisation.Regularisation`.
    width : of the low-pass filter that F leaves out, at half height, in units of the sheet's diameter. Adler &
        Guardo's default is a tenth.
    """

    def __init__(
        self,
        *,
        choose: str | None = None,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        width: float = 0.1,
    ) -> None:
        chosen = Regularisation.of(_NAME, choose=choose, noise_figure=noise_figure, given=hyperparameter)
        share = number(_NAME, "width", width)

        def prior_of(problem: ImagingProblem) -> Prior:
            return high_pass(problem.mesh, 2 * share * problem.sensor_type.radius_mm)

        self._step = OneStep(_NAME, prior_of, chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if λ cannot be chosen or is too small, or the width is wrong."""
        return self._step.prepare(problem)
