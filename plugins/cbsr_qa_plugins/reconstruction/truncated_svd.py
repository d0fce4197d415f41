"""Truncated singular value decomposition."""

import numpy as np

from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction, ParameterChoice, ParameterCurve
from cbsr_qa.reconstruct.evidence import central_signal
from cbsr_qa.reconstruct.noise_figure import noise_figure as noise_figure_of
from cbsr_qa.reconstruct.options import optional_whole
from cbsr_qa.reconstruct.regularisation import Criterion, Regularisation
from cbsr_qa.reconstruct.truncation import Truncation

_NAME = "truncated-svd"


class TruncatedSvd:
    """x = Σ vₖ uₖᵀW^½ y / σₖ over the k largest singular values of W^½J, in the L² norm of the sheet (Hansen 1987).

    Parameters
    ----------
    choose, noise_figure : how k is chosen, see :class:`~cbsr_qa.reconstruct.regularisation.Regularisation`. A noise
        figure is a bound: the most components that stay within it.
    components : k itself; excludes the others. Pairs of equal singular values are kept or dropped together.

    A count does not carry over to other readings as λ does: with bad channels, or readings weighted by their noise,
    the k of the nominal sensor type would take in components that are all noise. There the most components are kept
    that stay within the noise figure asked for, or within that of k on the nominal problem.
    """

    def __init__(
        self, *, choose: str | None = None, noise_figure: float | None = None, components: int | None = None
    ) -> None:
        given = optional_whole(_NAME, "components", components)
        self._regularisation = Regularisation.of(
            _NAME, choose=choose, noise_figure=noise_figure, given=given, given_as="components"
        )

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If k cannot be chosen, is out of range, or would split a pair; or no k keeps within the noise figure.
        """
        value, how, curve = self._regularisation.choose(problem, Truncation)
        truncation, kept = Truncation(problem), int(value)
        bound = self._bound_elsewhere(problem, value, curve)
        if bound is not None:
            kept = truncation.within(bound)
        matrix = truncation.matrix(kept)
        areas, variance = problem.mesh.areas_mm2, problem.noise_variance
        figure = noise_figure_of(matrix, central_signal(problem), areas, noise_variance=variance)
        if bound is not None:
            how += (
                f"; {int(value)} components there, chosen again on {_readings(problem)}: the most within noise figure"
            )
            how += f" {bound:.2f} are {kept}, with {figure:.2f}"
        choice = ParameterChoice(float(kept), how, figure, "components kept", curve, self._regularisation.decided_by)
        return LinearReconstruction(_NAME, problem, matrix, choice)

    def _bound_elsewhere(self, problem: ImagingProblem, value: float, curve: ParameterCurve | None) -> float | None:
        """Noise figure to keep within where k was chosen on other readings than the problem's; None where not."""
        criterion, nominal = self._regularisation.criterion, problem.nominal
        if criterion is None or nominal is None or curve is None:
            return None
        if problem.noise_variance is None and np.array_equal(problem.used, nominal.used):
            return None
        if criterion is Criterion.NOISE_FIGURE:
            return self._regularisation.noise_figure
        return None if problem.sample is not None else curve.noise_figure_at(value)


def _readings(problem: ImagingProblem) -> str:
    weighted = "" if problem.noise_variance is None else ", weighted by their noise"
    return f"the {len(problem.reference)} readings in use{weighted}"
