"""Hard cases of reconstruction: almost no and extreme regularisation, noise over twelve decades, limits."""

from dataclasses import replace
from typing import Final

import numpy as np
from mpmath import mp
from scipy import linalg

from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.one_step import RidgeCurves
from cbsr_qa.eit.inverse.priors import noser
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.readings import ReadingFold
from cbsr_qa.eit.inverse.temporal import Correlation, smooth
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import DIGITS, exact_image, relative_difference
from cbsr_qa.studies.hard_cases.sheets import IMAGE_MM, make_usual_problem, make_usual_sensor, prepare_method

AREA: Final = Area("reconstruction")
FIFTY: Final = "the normal equations, solved in fifty digits"
_SUMS: Final = "their sums in fifty digits"
_PROCESS: Final = "the Gaussian process of the block, solved in fifty digits"
_SEED: Final = 20261122


def _changes(problem: ImagingProblem) -> Array:
    """Readings (m,) in which every direction takes part, as noise does; reciprocal ones differ."""
    random = np.random.default_rng(_SEED)
    return random.standard_normal(len(problem.reference))


def ridge(name: str, kind: str, relative: float) -> Answer:
    """Image of a one-step method with a diagonal prior against fifty digits.

    Parameters
    ----------
    kind : kind of :func:`make_usual_problem`.
    relative : λ over the largest singular value of W^½JR^−½.
    """
    problem = make_usual_problem(kind)
    weights = _weights(name, problem)
    fold = ReadingFold.from_problem(problem)
    rows = fold.rows(problem.jacobian)
    sizes = linalg.svdvals(rows / np.sqrt(fold.variance)[:, None] / np.sqrt(weights))
    value = relative * float(sizes[0])
    options = {"components": len(sizes)} if name == "truncated-svd" else {"hyperparameter": value}
    readings = _changes(problem)
    computed = prepare_method(name, problem, options).images(readings[None])[0]
    folded = fold.fold(readings[None])[0]
    exact = exact_image(rows, weights, value, fold.variance, folded)
    condition = ridge_condition(sizes, value)
    return answer_from_condition(relative_difference(computed, exact), condition)


def _weights(name: str, problem: ImagingProblem) -> Array:
    """Diagonal of R, as the method defines it."""
    if name == "truncated-svd":
        return problem.mesh.areas_mm2
    exponent = 0.0 if name == "gauss-newton-tikhonov" else 0.5
    return noser(problem.jacobian, exponent)


def ridge_condition(sizes: Array, value: float) -> float:
    """Relative change of (AᵀA + λ²)⁻¹Aᵀ for a small relative one of A, by singular values, the largest first.

    σ₁ ‖(AAᵀ + λ²)⁻¹‖ / ‖(AAᵀ + λ²)⁻¹A‖
    """
    squares = sizes**2 + value**2
    return float(sizes[0] * (1 / squares).max() / (sizes / squares).max())


def _l_curve(relative: float) -> Answer:
    """xᵀRx of the L-curve at an extreme λ against fifty digits."""
    problem = make_usual_problem()
    sizes = linalg.svdvals(ReadingFold.from_problem(problem).rows(problem.jacobian))
    values, coefficients = sizes**2, np.random.default_rng(_SEED).standard_normal((1, len(sizes)))
    curves = RidgeCurves(values, coefficients)
    s = float(2 * np.log(relative * sizes[0]))
    with mp.workdps(DIGITS):
        ridge2 = mp.exp(mp.mpf(s))
        pairs = [(mp.mpf(a), mp.mpf(b)) for a, b in zip(values.tolist(), coefficients[0].tolist(), strict=True)]
        size = mp.fsum(value / (value + ridge2) ** 2 * z**2 for value, z in pairs)
        residual = mp.fsum((ridge2 / (value + ridge2)) ** 2 * z**2 for value, z in pairs)
        errors = [
            abs(mp.mpf(float(computed)) / truth - 1)
            for computed, truth in ((curves.size(s), size), (curves.residual(s), residual))
        ]
    condition = max(1.0, abs(s))  # of e^s
    return answer_from_condition(float(max(errors)), condition)


def _lasting(frames: float) -> Answer:
    """Images of a block that belongs together for ages against the Gaussian process they are, in fifty digits."""
    count, ridge2 = 12, 1e-9
    values = np.geomspace(1e-12, 1.0, 5)
    readings = np.random.default_rng(_SEED).standard_normal((count, len(values)))
    computed = smooth(readings, values, ridge2, Correlation(frames))
    exact = np.empty_like(computed)
    conditions = []
    with mp.workdps(DIGITS):
        frame_correlation = mp.exp(-1 / mp.mpf(frames))
        for column, value in enumerate(values.tolist()):
            prior = mp.matrix(count, count)
            for i in range(count):
                for j in range(count):
                    prior[i, j] = frame_correlation ** abs(i - j)
            system = mp.mpf(value) * prior + mp.mpf(ridge2) * mp.eye(count)
            smoother = prior * system**-1
            exact[:, column] = [float(value) for value in smoother * mp.matrix(readings[:, column].tolist())]
            absolute_terms = np.abs(np.array(smoother.tolist(), dtype=np.float64)) @ np.abs(readings[:, column])
            conditions.append(np.linalg.norm(absolute_terms) / np.linalg.norm(exact[:, column]))
    condition = float(max(conditions))
    error = np.linalg.norm(computed - exact, axis=0) / np.linalg.norm(exact, axis=0)
    return answer_from_condition(float(error.max()), condition)


@AREA.against(FIFTY)
def no_regularisation_tikhonov() -> Answer:
    """λ = 0: every reading is explained, by the image of least norm. Singular values span six decades."""
    return ridge("gauss-newton-tikhonov", "whole", 0.0)


@AREA.against(FIFTY)
def no_regularisation_noser() -> Answer:
    """λ = 0 with a prior that weighs elements by their sensitivity."""
    return ridge("gauss-newton-noser", "whole", 0.0)


@AREA.against(FIFTY)
def regularisation_of_a_millionth() -> Answer:
    """λ of a ten thousandth of the largest singular value: where the normal equations have half of the digits."""
    return ridge("gauss-newton-noser", "whole", 1e-4)


@AREA.against(FIFTY)
def every_singular_value_kept() -> Answer:
    """Truncated SVD without truncation: the smallest singular values decide the image."""
    return ridge("truncated-svd", "whole", 0.0)


@AREA.against(FIFTY)
def noise_over_twelve_decades() -> Answer:
    """Readings whose noise variances lie twelve decades apart."""
    return ridge("gauss-newton-noser", "noisy", 1e-3)


@AREA.against(FIFTY)
def three_electrodes_off() -> Answer:
    """The readings of three electrodes are missing, and λ is next to nothing."""
    return ridge("gauss-newton-noser", "masked", 1e-5)


@AREA.against("λ²x = R⁻¹JᵀWy in the limit, to 1e-18")
def nothing_but_regularisation() -> Answer:
    """λ a thousand million times the largest singular value: the image vanishes."""
    problem = make_usual_problem()
    weights = noser(problem.jacobian, 0.5)
    readings = _changes(problem)
    value = 1e9 * float(linalg.norm(problem.jacobian / np.sqrt(weights), 2))
    computed = (
        value**2 * prepare_method("gauss-newton-noser", problem, {"hyperparameter": value}).images(readings[None])[0]
    )
    fold = ReadingFold.from_problem(problem)
    limit = (fold.rows(problem.jacobian).T @ (fold.fold(readings[None])[0] / fold.variance)) / weights
    condition = float(np.linalg.norm(np.abs(problem.jacobian).T @ np.abs(readings) / weights) / np.linalg.norm(limit))
    return answer_from_condition(relative_difference(computed, limit), condition)


@AREA.against("the image at λ = 10²⁰: the limit")
def greit_of_nothing_but_regularisation() -> Answer:
    """GREIT with λ = 10¹⁰: its rows vanish and are scaled back to the target's amplitude."""
    problem, readings = make_usual_problem(), _changes(make_usual_problem())
    large, larger = (
        prepare_method("greit", problem, {"hyperparameter": value}).images(readings[None])[0]
        for value in (1e10, 1e20)
    )
    condition = float(np.linalg.norm(readings) * np.sqrt(len(large)) / np.linalg.norm(large))
    return answer_from_condition(relative_difference(large, larger), max(condition, 1.0))


@AREA.against("the constant that explains the readings best, in fifty digits")
def total_variation_of_nothing_but_smoothness() -> Answer:
    """Total variation with α = 10²⁰⁰: no jump is worth its price."""
    problem = make_usual_problem()
    readings = problem.jacobian @ np.linspace(0.5, 1.5, len(problem.mesh.elements))
    image = prepare_method("total-variation", problem, {"hyperparameter": 1e200}).images(readings[None])[0]
    with mp.workdps(DIGITS):
        ones = [mp.fsum(row) for row in problem.jacobian.tolist()]
        exact = float(mp.fdot(ones, readings.tolist()) / mp.fdot(ones, ones))
    condition = float(np.abs(problem.jacobian).sum() / np.abs(problem.jacobian.sum(axis=1)).sum())
    return answer_from_condition(float(np.abs(image / exact - 1).max()), condition)


@AREA.against("R(cJ, cλ) = R(J, λ)/c, exactly")
def sensor_in_picovolts() -> Answer:
    """A model whose voltages are 1e12 times those of another."""
    problem, scale = make_usual_problem(), 1e12
    other = replace(problem, jacobian=scale * problem.jacobian, reference=scale * problem.reference)
    readings = _changes(problem)
    name, value = "gauss-newton-tikhonov", 1e-4
    usual = prepare_method(name, problem, {"hyperparameter": value}).images(readings[None])[0]
    scaled = prepare_method(name, other, {"hyperparameter": scale * value}).images(scale * readings[None])[0]
    condition = ridge_condition(linalg.svdvals(problem.jacobian), value)
    return answer_from_condition(relative_difference(scaled, usual), condition)


@AREA.against("an image of zeros, exactly")
def frame_equal_to_its_reference() -> Answer:
    """Nothing has changed: an image of rounding errors would show a load."""
    problem = make_usual_problem()
    names = (
        "gauss-newton-noser", "gauss-newton-tikhonov", "gauss-newton-laplace", "gauss-newton-indenter",
        "gauss-newton-high-pass", "temporal", "total-variation",
    )  # fmt: skip
    methods = [prepare_method(name, problem, {"hyperparameter": 1e-3}) for name in names]
    methods += [prepare_method("truncated-svd", problem, {}), prepare_method("linear-back-projection", problem, {})]
    none = np.zeros((2, len(problem.reference)))
    largest = max(float(np.abs(method.images(none)).max()) for method in methods)
    return Answer(largest, 0.0, note=f"{len(methods)} methods; the bound is zero")


@AREA.against(_SUMS)
def l_curve_at_a_large_parameter() -> Answer:
    """Size and residual of an image at λ a thousand times the largest singular value."""
    return _l_curve(999.0)


@AREA.against(_SUMS)
def l_curve_at_a_small_parameter() -> Answer:
    """Size and residual of an image at λ a millionth of the largest singular value."""
    return _l_curve(1.01e-6)


@AREA.against(_PROCESS)
def frames_alike_for_ages() -> Answer:
    """Frames that stay alike for a thousand million frames: 1 − a² is next to nothing."""
    return _lasting(1e9)


@AREA.against(_PROCESS)
def frames_alike_for_one() -> Answer:
    """Almost independent frames, of signals up to 1e9 times their noise."""
    return _lasting(0.05)


@AREA.refuses(ConfigError, "the refusal, by λ and its range")
def parameter_beyond_doubles() -> None:
    """λ = 1e60, whose square leaves an image of rounding errors only."""
    prepare_method("gauss-newton-noser", make_usual_problem(), {"hyperparameter": 1e60})


@AREA.refuses(NumericsError, "the refusal, by λ and the least that is allowed")
def greit_without_regularisation() -> None:
    """GREIT with λ = 0: more training targets than readings can tell apart."""
    prepare_method("greit", make_usual_problem(), {"hyperparameter": 0.0})


@AREA.refuses(NumericsError, "the refusal, by what the image lacks")
def total_variation_next_to_none() -> None:
    """Total variation with α = 10⁻³⁰, below a rounding of what it is added to."""
    problem = make_usual_problem()
    readings = problem.jacobian @ np.linspace(0.5, 1.5, len(problem.mesh.elements))
    prepare_method("total-variation", problem, {"hyperparameter": 1e-30}).images(readings[None])


@AREA.refuses(NumericsError, "the refusal, by the counts that split no pair")
def half_a_pair_of_singular_values() -> None:
    """Truncation between two equal singular values, which would prefer a direction."""
    prepare_method("truncated-svd", make_usual_problem(), {"components": 2})


@AREA.refuses(NumericsError, "the refusal, by the reading")
def noise_beyond_twelve_decades() -> None:
    """One reading is stated to be 1e13 times noisier than the others."""
    sensor = make_usual_sensor()
    variance = np.ones(sensor.pattern.shape)
    variance[3, 8] = 1e13
    imaging_problem(sensor, noise_variance=variance, image_size_mm=IMAGE_MM)


@AREA.refuses(NumericsError, "the refusal, with what to choose by instead")
def parameter_from_frames_without_change() -> None:
    """λ is to be chosen by cross-validation, on frames that equal their reference."""
    problem = make_usual_problem()
    sampled = imaging_problem(
        make_usual_sensor(), sample=np.zeros((3, len(problem.reference))), image_size_mm=IMAGE_MM
    )
    prepare_method("gauss-newton-noser", sampled, {"choose": "gcv"})
