"""One-step Gauss–Newton with EIDORS's Laplace prior."""

from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction
from cbsr_qa.reconstruct.one_step import OneStep
from cbsr_qa.reconstruct.priors import laplace
from cbsr_qa.reconstruct.regularisation import Regularisation

_NAME = "gauss-newton-laplace"


class GaussNewtonLaplace:
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R the differences between neighbouring elements (Vauhkonen et al. 1998).

    A constant image costs nothing: how much the sheet changes as a whole is what the readings say, at any λ.

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.reconstruct.regularisation.Regularisation`.
    """

    def __init__(
        self, *, choose: str | None = None, noise_figure: float | None = None, hyperparameter: float | None = None
    ) -> None:
        chosen = Regularisation.of(_NAME, choose=choose, noise_figure=noise_figure, given=hyperparameter)
        self._step = OneStep(_NAME, lambda problem: laplace(problem.mesh), chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if λ cannot be chosen or is too small."""
        return self._step.prepare(problem)
