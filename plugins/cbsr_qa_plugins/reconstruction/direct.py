"""Methods that are one matrix by themselves: GREIT, linear back-projection, truncated SVD."""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field

from cbsr_qa.eit.inverse.greit.matrix import greit_matrix, hyperparameter_for
from cbsr_qa.eit.inverse.greit.targets import TargetDesign
from cbsr_qa.eit.inverse.noise_figures import central_signal, noise_figure
from cbsr_qa.eit.inverse.regularisation import Criterion, Regularisation
from cbsr_qa.eit.inverse.truncation import Truncation
from cbsr_qa.plugin import (
    Array,
    ImagingProblem,
    LinearReconstruction,
    NumericsError,
    ParameterAnswer,
    ParameterChoice,
    ParameterCurve,
    PluginOptions,
    Problem,
    WithOptions,
)
from cbsr_qa_plugins.reconstruction._shared import Hyperparameter, ParameterOptions, Positive, find_contradictions

_NAME = "linear-back-projection"
_LEAST_READING = 1e-6  # of the largest: a reading that the model says is zero has no relative change


class LinearBackProjection:
    """Every element gets the mean relative change of the readings, weighted by their sensitivity to it (Kotre 1989).

    x_e = Σ S_me (y_m/v_m) / √ΣS_me² with S_me = J_me/v_m and v the reference readings: the transposed sensitivity
    in the place of its inverse, the successor of the back-projection along equipotentials of Barber & Brown 1984.
    Kotre divides by Σ|S_me|, which near electrodes that are left out answers a load with the wrong sign.
    Nothing is inverted, so nothing is regularised: images are blurred, and their amplitude is not that of the change.
    It has no options, and does not weigh readings by their noise.
    """

    weighs_noise = False

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        reference = problem.reference
        known = np.abs(reference) > _LEAST_READING * np.abs(reference).max()
        relative = np.where(known, 1 / np.where(known, reference, 1.0), 0.0)
        sensitivity = relative[:, None] * problem.jacobian
        felt = np.sqrt(np.einsum("me,me->e", sensitivity, sensitivity))
        if not (felt > 0).all():
            raise NumericsError(
                f"{int((felt <= 0).sum())} image elements are felt by no reading that is left",
                remedy="repair the masked channels",
            )
        matrix = (relative[:, None] * sensitivity).T / felt[:, None]
        areas, variance = problem.mesh.areas_mm2, problem.noise_variance
        figure = noise_figure(matrix, central_signal(problem), areas, noise_variance=variance)
        choice = ParameterChoice(
            0.0, "nothing is regularised, and nothing chosen", figure, "no parameter", criterion="none"
        )
        return LinearReconstruction(_NAME, problem, matrix, choice)


_NAME_TRUNCATED_SVD = "truncated-svd"


class TruncatedSvd(WithOptions):
    """x = Σ vₖ uₖᵀW^½ y / σₖ over the k largest singular values of W^½J, in the L² norm of the sheet (Hansen 1987).

    Parameters
    ----------
    choose : criterion for k; by default noise-figure.
    noise_figure : bound, for the criterion of that name: the most components that stay within it; by default 1.
    components : k itself; excludes the others. Pairs of equal singular values are kept or dropped together.

    A count does not carry over to other readings as λ does: with bad channels, or readings weighted by their noise,
    the k of the nominal sensor type would take in components that are all noise. There the most components are kept
    that stay within the noise figure asked for, or within that of k on the nominal problem.
    """

    class Options(ParameterOptions):
        given_as = "components"
        components: Annotated[int, Field(ge=1, le=10**15)] | None = None

    options: Options

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        regularisation = self.options.regularisation()
        value, how, curve = regularisation.choose(problem, Truncation)
        truncation, components = Truncation(problem), int(value)
        bound = _noise_figure_bound(regularisation, problem, value, curve)
        if bound is not None:
            components = truncation.count_components(bound)
        matrix = truncation.matrix(components)
        areas, variance = problem.mesh.areas_mm2, problem.noise_variance
        figure = noise_figure(matrix, central_signal(problem), areas, noise_variance=variance)
        if bound is not None:
            weighted = "" if variance is None else ", weighted by their noise"
            how += (
                f"; {int(value)} components there, chosen again on the {len(problem.reference)} readings in"
                f" use{weighted}: the most within noise figure {bound:.2f} are {components}, with {figure:.2f}"
            )
        choice = ParameterChoice(float(components), how, figure, "components kept", curve, regularisation.decided_by)
        return LinearReconstruction(_NAME_TRUNCATED_SVD, problem, matrix, choice)


def _noise_figure_bound(
    regularisation: Regularisation, problem: ImagingProblem, value: float, curve: ParameterCurve | None
) -> float | None:
    """Noise figure to keep within where k was chosen on other readings than the problem's; None where not."""
    criterion, nominal = regularisation.criterion, problem.nominal
    if criterion is None or nominal is None or curve is None:
        return None
    if problem.noise_variance is None and np.array_equal(problem.used, nominal.used):
        return None
    if criterion is Criterion.NOISE_FIGURE:
        return regularisation.noise_figure
    return None if problem.sample is not None else curve.noise_figure_at(value)


_NAME_GREIT = "greit"
_NOISE_FIGURE = 0.5  # of the method's authors


class Greit(WithOptions):
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

    class Options(PluginOptions):
        noise_figure: Positive | None = None
        hyperparameter: Hyperparameter | None = None
        indenter_diameter_mm: Positive | None = None
        target_diameters_mm: Annotated[tuple[Positive, ...], Array, Field(min_length=1)] | None = None

        def problems(self) -> Iterator[Problem]:
            yield from find_contradictions(self, "hyperparameter", ("noise_figure",))

    options: Options

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        design = TargetDesign.for_problem(
            problem, self.options.indenter_diameter_mm, self.options.target_diameters_mm
        )
        value: float | None
        value, how, curve = self.options.hyperparameter, "hyperparameter given", None
        if value is None:
            value, how, curve = self._choose_parameter(problem, design)
        made = greit_matrix(problem, design, value)
        criterion = "noise-figure" if curve is not None else "given"
        choice = ParameterChoice(value, how, made.noise_figure, curve=curve, criterion=criterion)
        return LinearReconstruction(_NAME_GREIT, problem, made.values, choice)

    def _choose_parameter(self, problem: ImagingProblem, design: TargetDesign) -> tuple[float, str, ParameterCurve]:
        """Choose λ for the noise figure; returns it with how it was chosen, and the few λ that were tried."""
        weighted, target = problem.noise_variance is not None, self.options.noise_figure or _NOISE_FIGURE
        base = problem if weighted else problem.nominal or problem
        where = "its own readings, weighted by their noise" if weighted else "the nominal model"
        how = f"noise figure {target:.2f} (Adler et al. 2009) on {where}"
        choice = hyperparameter_for(base, design, target)
        answers = (ParameterAnswer("noise-figure", choice.value, how),)
        curve = ParameterCurve(choice.searched, choice.noise_figures, answers, target)
        return choice.value, how, curve
