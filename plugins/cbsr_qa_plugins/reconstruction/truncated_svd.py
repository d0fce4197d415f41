"""Truncated singular value decomposition."""

from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.reconstruct.evidence import central_signal
from cbsr_qa.reconstruct.noise_figure import noise_figure as noise_figure_of
from cbsr_qa.reconstruct.options import whole
from cbsr_qa.reconstruct.regularisation import Regularisation
from cbsr_qa.reconstruct.truncation import Truncation

_NAME = "truncated-svd"


class TruncatedSvd:
    """x = Σ vₖ uₖᵀW^½ y / σₖ over the k largest singular values of W^½J, in the L² norm of the sheet (Hansen 1987).

    Parameters
    ----------
    choose, noise_figure : how k is chosen, see :class:`~cbsr_qa.reconstruct.regularisation.Regularisation`. A noise
        figure is a bound: the most components that stay within it.
    components : k itself; excludes the others. Pairs of equal singular values are kept or dropped together.
    """

    def __init__(
        self, *, choose: str | None = None, noise_figure: float | None = None, components: int | None = None
    ) -> None:
        given = whole(_NAME, "components", components)
        self._regularisation = Regularisation.of(
            _NAME, choose=choose, noise_figure=noise_figure, given=given, given_as="components"
        )

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If k cannot be chosen, is out of range, or would split a pair.
        """
        value, how, curve = self._regularisation.choose(problem, Truncation)
        truncation = Truncation(problem)
        kept = int(value) if self._regularisation.given is not None else truncation.at_most(int(value))
        matrix = truncation.matrix(kept)
        areas, variance = problem.mesh.areas_mm2, problem.noise_variance
        figure = noise_figure_of(matrix, central_signal(problem), areas, noise_variance=variance)
        choice = ParameterChoice(float(kept), how, figure, "components kept", curve, self._regularisation.decided_by)
        return LinearReconstruction(_NAME, problem, matrix, choice)
