"""One-step Gauss–Newton with Tikhonov's prior."""

import numpy as np

from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction
from cbsr_qa.reconstruct.one_step import OneStep
from cbsr_qa.reconstruct.priors import Prior
from cbsr_qa.reconstruct.regularisation import Regularisation

_NAME = "gauss-newton-tikhonov"


class GaussNewtonTikhonov:
    """x = (JᵀWJ + λ²I)⁻¹JᵀW y: the smallest image that explains the readings. It moves loads towards the rim.

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.reconstruct.regularisation.Regularisation`.
    """

    def __init__(
        self, *, choose: str | None = None, noise_figure: float | None = None, hyperparameter: float | None = None
    ) -> None:
        chosen = Regularisation.of(_NAME, choose=choose, noise_figure=noise_figure, given=hyperparameter)
        self._step = OneStep(_NAME, lambda problem: Prior.diagonal(np.ones(len(problem.mesh.elements))), chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if λ cannot be chosen or is too small."""
        return self._step.prepare(problem)
