"""Choice of a regularisation parameter (λ, or a count): by one criterion, with the choices of all for comparison."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Protocol

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem, ParameterAnswer, ParameterCurve
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.noise_figures import SMALL_CONTRAST, Evidence, evidence_of, target_radius_mm


class Criterion(StrEnum):
    """Criterion that chooses a parameter without knowing the true image."""

    NOISE_FIGURE = "noise-figure"  #: Adler et al. 2009 form; depends only on the model
    GCV = "gcv"  #: generalised cross-validation, Golub, Heath & Wahba 1979
    L_CURVE = "l-curve"  #: the corner of image size over residual, Hansen 1992
    DISCREPANCY = "discrepancy"  #: the residual is as large as the noise, Morozov 1966


_DESCRIPTIONS: Final = {
    Criterion.GCV: "generalised cross-validation",
    Criterion.L_CURVE: "corner of the L-curve",
    Criterion.DISCREPANCY: "residual as large as the noise (discrepancy principle)",
}


class ParameterSearch(Protocol):
    """Search for a reconstruction method's parameter on one problem."""

    @property
    def shown(self) -> Array:
        """Values dense enough to draw a curve, (k,) rising; all possible ones for a count."""
        ...

    @property
    def discrete(self) -> bool:
        """Whether the parameter is a count."""
        ...

    def noise_figures(self, values: Array) -> Array:
        """Return the noise figure at each of some values: (k,) both."""
        ...

    def for_noise_figure(self, target: float) -> float:
        """Return the value with this noise figure; NumericsError, which names the reachable range, if none has it."""
        ...

    def choose_from_readings(self, criterion: Criterion, evidence: Evidence) -> float:
        """Return the value by a criterion based on readings; NumericsError if the criterion gives none."""
        ...


@dataclass(frozen=True, slots=True)
class Regularisation:
    """Options of a plugin for its parameter.

    Parameters
    ----------
    criterion : None if the value is given.
    noise_figure : target, for the criterion of that name.
    given : the value itself, or None.
    given_as : name of the option that gives it.
    """

    criterion: Criterion | None
    noise_figure: float
    given: float | None
    given_as: str

    @property
    def decided_by(self) -> str:
        """Name of the deciding rule: a criterion, or ``"given"``."""
        return "given" if self.criterion is None else self.criterion.value

    def choose(
        self, problem: ImagingProblem, search_on: Callable[[ImagingProblem], ParameterSearch]
    ) -> tuple[float, str, ParameterCurve | None]:
        """Choose the value.

        A noise figure, and any criterion without measured changes, uses the sensor type's nominal problem; measured
        changes are used with their own readings and noise.

        Parameters
        ----------
        search_on : returns the method's search on a problem.

        Returns
        -------
        The value, the choice in words, and the choices of all criteria; None for these if the value is given.

        Raises
        ------
        NumericsError
            If the criterion gives no value.
        """
        if self.criterion is None:
            assert self.given is not None
            return self.given, f"{self.given_as} given", None
        uses_changes = self.criterion is not Criterion.NOISE_FIGURE and problem.sample is not None
        searched_problem = problem if uses_changes else problem.nominal or problem
        search, evidence = search_on(searched_problem), evidence_of(searched_problem)
        answers, refusals = [], {}
        for criterion in Criterion:
            description = self._describe(criterion, searched_problem, evidence)
            try:
                if criterion is Criterion.NOISE_FIGURE:
                    value = search.for_noise_figure(self.noise_figure)
                else:
                    value = search.choose_from_readings(criterion, evidence)
                answers.append(ParameterAnswer(criterion, value, description))
            except NumericsError as error:
                answers.append(ParameterAnswer(criterion, None, error.reason))
                refusals[criterion] = error
        if self.criterion in refusals:
            raise refusals[self.criterion]
        chosen = next(answer for answer in answers if answer.criterion == self.criterion)
        assert chosen.value is not None
        # Noise figures over the searched range, with every choice among the values.
        values = np.union1d(search.shown, [answer.value for answer in answers if answer.value is not None])
        figures = search.noise_figures(values)
        curve = ParameterCurve(values, figures, tuple(answers), self.noise_figure, search.discrete)
        return chosen.value, chosen.words, curve

    def _describe(self, criterion: Criterion, problem: ImagingProblem, evidence: Evidence) -> str:
        if criterion is Criterion.NOISE_FIGURE:
            return (
                f"noise figure {self.noise_figure:.2f} (Adler et al. 2009) on the nominal model, central target of"
                f" {2 * target_radius_mm(problem):.3g} mm and {SMALL_CONTRAST:.0%} contrast"
            )
        return f"{_DESCRIPTIONS[criterion]} on {evidence.words}"
