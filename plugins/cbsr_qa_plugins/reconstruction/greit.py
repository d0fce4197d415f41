"""GREIT, trained on targets as wide as the indenter."""

from collections.abc import Sequence

from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.reconstruction import (
    ImagingProblem,
    LinearReconstruction,
    ParameterAnswer,
    ParameterChoice,
    ParameterCurve,
)
from cbsr_qa.reconstruct.dual import check_hyperparameter
from cbsr_qa.reconstruct.greit_matrix import greit_matrix, hyperparameter_for
from cbsr_qa.reconstruct.greit_targets import TargetDesign
from cbsr_qa.reconstruct.options import number, optional_number, shown

_NAME = "greit"
_NOISE_FIGURE = 0.5  # of the method's authors


class Greit:
    """R = D Yᵀ (Y Yᵀ + λ² Σ)⁻¹ from training targets Y and their desired images D (Adler et al. 2009).

    Departs from the original: each row weighs targets near its place in full and others little, all desired images
    have one blur, and rows are shaped until masked images lie where their targets do and are as large.

    Parameters
    ----------
    noise_figure : target (Adler et al. 2009, equal noise on all readings); by default 0.5, the authors' choice. λ is
        chosen on the nominal sensor type; where the readings' noise is known, on the problem itself with its weights.
    hyperparameter : λ itself, noise over signal of a reading; excludes ``noise_figure``.
    indenter_diameter_mm : of the head [mm], at least 1.5 edges of the image's elements; by default 0.13 of the
        sheet's diameter, the 13 mm of the 100 mm disc.
    target_diameters_mm : of the training targets [mm], from a tenth of the head to half of the sheet; by default
        8/13, 1 and 20/13 of the head.
    """

    def __init__(
        self,
        *,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        indenter_diameter_mm: float | None = None,
        target_diameters_mm: Sequence[float] | None = None,
    ) -> None:
        noise_figure = optional_number(_NAME, "noise_figure", noise_figure)
        self._given = optional_number(_NAME, "hyperparameter", hyperparameter)
        if noise_figure is not None and self._given is not None:
            raise NumericsError(
                "greit takes noise_figure or hyperparameter, not both", remedy="leave one of them out"
            )
        if self._given is not None:
            check_hyperparameter(self._given)
        self._noise_figure = _NOISE_FIGURE if noise_figure is None else noise_figure
        self._head_mm = optional_number(_NAME, "indenter_diameter_mm", indenter_diameter_mm)
        self._targets_mm = _diameters(target_diameters_mm)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If the noise figure cannot be reached, λ is too small to determine the image, a target does not fit the
            sheet, no reading feels it, or the image's elements do not resolve the head.
        """
        design = TargetDesign.of(problem, self._head_mm, self._targets_mm)
        value: float | None
        value, how, curve = self._given, "hyperparameter given", None
        if value is None:
            value, how, curve = self._chosen(problem, design)
        made = greit_matrix(problem, design, value)
        criterion = "noise-figure" if self._given is None else "given"
        choice = ParameterChoice(value, how, made.noise_figure, curve=curve, criterion=criterion)
        return LinearReconstruction(_NAME, problem, made.values, choice)

    def _chosen(self, problem: ImagingProblem, design: TargetDesign) -> tuple[float, str, ParameterCurve]:
        """Choose λ for the noise figure; returns it with how it was chosen, and the few λ that were tried."""
        weighted = problem.noise_variance is not None
        base = problem if weighted else problem.nominal or problem
        where = "its own readings, weighted by their noise" if weighted else "the nominal model"
        how = f"noise figure {self._noise_figure:.2f} (Adler et al. 2009) on {where}"
        found = hyperparameter_for(base, design, self._noise_figure)
        answers = (ParameterAnswer("noise-figure", found.value, how),)
        curve = ParameterCurve(found.searched, found.noise_figures, answers, self._noise_figure)
        return found.value, how, curve


def _diameters(given: object) -> tuple[float, ...] | None:
    if given is None:
        return None
    if not isinstance(given, list | tuple) or not given:
        raise ConfigError(f"{_NAME}: target_diameters_mm is {shown(given)}", remedy="allowed: a list of numbers")
    return tuple(number(_NAME, "target_diameters_mm", value) for value in given)
