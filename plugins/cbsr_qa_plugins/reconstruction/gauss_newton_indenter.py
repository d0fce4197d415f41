"""One-step Gauss–Newton with a smoothness as long as the indenter is wide."""

from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction
from cbsr_qa.reconstruct.evidence import target_radius_mm
from cbsr_qa.reconstruct.one_step import OneStep
from cbsr_qa.reconstruct.options import optional_number
from cbsr_qa.reconstruct.priors import Prior
from cbsr_qa.reconstruct.regularisation import Regularisation
from cbsr_qa.reconstruct.smoothness import indenter_smoothness

_NAME = "gauss-newton-indenter"


class GaussNewtonIndenter:
    """x = PJᵀ (JPJᵀ + λ²W⁻¹)⁻¹ y with P a Matérn covariance whose length is the indenter's radius.

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.reconstruct.regularisation.Regularisation`.
    indenter_diameter_mm : of the head [mm]; by default 0.13 of the sheet's diameter, the 13 mm of the 100 mm disc.
    """

    def __init__(
        self,
        *,
        choose: str | None = None,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        indenter_diameter_mm: float | None = None,
    ) -> None:
        chosen = Regularisation.of(_NAME, choose=choose, noise_figure=noise_figure, given=hyperparameter)
        given = optional_number(_NAME, "indenter_diameter_mm", indenter_diameter_mm)

        def prior_of(problem: ImagingProblem) -> Prior:
            return indenter_smoothness(problem.mesh, target_radius_mm(problem) if given is None else given / 2)

        self._step = OneStep(_NAME, prior_of, chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if λ cannot be chosen or is too small, or the length is wrong."""
        return self._step.prepare(problem)
