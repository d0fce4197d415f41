"""Hard cases of reconstruction: almost no and extreme regularisation, noise over twelve decades, limits."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
from mpmath import mp
from numpy.typing import NDArray
from scipy import linalg

from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.results import ImagingProblem
from cbsr_qa.eit.inverse import Correlation, ReadingFold, imaging_problem, noser, smoothed
from cbsr_qa.eit.inverse.choice import RidgeCurves
from cbsr_qa.studies.hard_cases.case import Answer, HardCase, conditioned_bound
from cbsr_qa.studies.hard_cases.exact import exact_image
from cbsr_qa.studies.hard_cases.sheets import IMAGE_MM, prepared, usual_problem, usual_sensor

Array = NDArray[np.float64]

_AREA: Final = "reconstruction"
_FIFTY: Final = "the normal equations, solved in fifty digits"
_SEED: Final = 20261122
_DIGITS: Final = 50


def _changes(problem: ImagingProblem) -> Array:
    """Readings (m,) in which every direction takes part, as noise does; reciprocal ones differ."""
    random = np.random.default_rng(_SEED)
    return random.standard_normal(len(problem.reference))


def ridge(name: str, kind: str, relative: float, **options: Any) -> Answer:
    """Image of a one-step method with a diagonal prior against fifty digits.

    Parameters
    ----------
    name : of the plugin. kind : of :func:`usual_problem`.
    relative : λ over the largest singular value of W^½JR^−½.
    """
    problem = usual_problem(kind)
    weights = _weights(name, problem)
    fold = ReadingFold.of(problem)
    rows = fold.rows(problem.jacobian)
    sizes = linalg.svdvals(rows / np.sqrt(fold.variance)[:, None] / np.sqrt(weights))
    value = relative * float(sizes[0])
    given = {"components": len(sizes)} if name == "truncated-svd" else {"hyperparameter": value}
    readings = _changes(problem)
    found = prepared(name, problem, {**given, **options}).images(readings[None])[0]
    folded = fold.fold(readings[None])[0]
    exact = exact_image(rows, weights, value, fold.variance, folded)
    condition = ridge_condition(sizes, value)
    return Answer(_apart(found, exact), conditioned_bound(condition), condition)


def _weights(name: str, problem: ImagingProblem) -> Array:
    """Diagonal of R, as the method defines it."""
    if name == "truncated-svd":
        return problem.mesh.areas_mm2
    exponent = 0.0 if name == "gauss-newton-tikhonov" else 0.5
    return noser(problem.jacobian, exponent)


def ridge_condition(sizes: Array, value: float) -> float:
    """Relative change of (AᵀA + λ²)⁻¹Aᵀ for a small relative one of A: σ₁ ‖(AAᵀ + λ²)⁻¹‖ / ‖(AAᵀ + λ²)⁻¹A‖.

    Parameters
    ----------
    sizes : singular values of A, the largest first. value : λ.
    """
    squares = sizes**2 + value**2
    return float(sizes[0] * (1 / squares).max() / (sizes / squares).max())


def _apart(found: Array, exact: Array) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def _adjoint() -> Answer:
    """λ → ∞: λ² x → R⁻¹Jᵀy, with a remainder of σ₁²/λ²."""
    problem = usual_problem()
    weights = noser(problem.jacobian, 0.5)
    readings = _changes(problem)
    value = 1e9 * float(linalg.norm(problem.jacobian / np.sqrt(weights), 2))
    found = value**2 * prepared("gauss-newton-noser", problem, {"hyperparameter": value}).images(readings[None])[0]
    fold = ReadingFold.of(problem)
    limit = (fold.rows(problem.jacobian).T @ (fold.fold(readings[None])[0] / fold.variance)) / weights
    condition = float(np.linalg.norm(np.abs(problem.jacobian).T @ np.abs(readings) / weights) / np.linalg.norm(limit))
    return Answer(_apart(found, limit), conditioned_bound(condition), condition)


def _fewer_units() -> Answer:
    """R(cJ, cλ) y = R(J, λ) y / c: a sensor in other units gives the same image of readings in these."""
    problem, scale = usual_problem(), 1e12
    other = replace(problem, jacobian=scale * problem.jacobian, reference=scale * problem.reference)
    readings = _changes(problem)
    name, value = "gauss-newton-tikhonov", 1e-4
    one = prepared(name, problem, {"hyperparameter": value}).images(readings[None])[0]
    two = prepared(name, other, {"hyperparameter": scale * value}).images(scale * readings[None])[0]
    condition = ridge_condition(linalg.svdvals(problem.jacobian), value)
    return Answer(_apart(two, one), conditioned_bound(condition), condition)


def _nothing(problem: ImagingProblem) -> Answer:
    """Largest value of the images of a frame that is its reference, over all methods for differences but GREIT."""
    names = (
        "gauss-newton-noser", "gauss-newton-tikhonov", "gauss-newton-laplace", "gauss-newton-indenter",
        "gauss-newton-high-pass", "temporal", "total-variation",
    )  # fmt: skip
    methods = [prepared(name, problem, {"hyperparameter": 1e-3}) for name in names]
    methods += [prepared("truncated-svd", problem, {}), prepared("linear-back-projection", problem, {})]
    none = np.zeros((2, len(problem.reference)))
    largest = max(float(np.abs(method.images(none)).max()) for method in methods)
    return Answer(largest, 0.0, note=f"{len(methods)} methods; the bound is zero")


def _l_curve(relative: float) -> Answer:
    """xᵀRx of the L-curve at an extreme λ against fifty digits."""
    problem = usual_problem()
    sizes = linalg.svdvals(ReadingFold.of(problem).rows(problem.jacobian))
    values, coefficients = sizes**2, np.random.default_rng(_SEED).standard_normal((1, len(sizes)))
    curves = RidgeCurves(values, coefficients)
    s = float(2 * np.log(relative * sizes[0]))
    with mp.workdps(_DIGITS):
        ridge2 = mp.exp(mp.mpf(s))
        pairs = [(mp.mpf(a), mp.mpf(b)) for a, b in zip(values.tolist(), coefficients[0].tolist(), strict=True)]
        size = mp.fsum(value / (value + ridge2) ** 2 * z**2 for value, z in pairs)
        residual = mp.fsum((ridge2 / (value + ridge2)) ** 2 * z**2 for value, z in pairs)
        errors = [
            abs(mp.mpf(float(found)) / truth - 1)
            for found, truth in ((curves.size(s), size), (curves.residual(s), residual))
        ]
    condition = max(1.0, abs(s))  # of e^s
    return Answer(float(max(errors)), conditioned_bound(condition), condition)


def _lasting(frames: float) -> Answer:
    """Images of a block that belongs together for ages against the Gaussian process they are, in fifty digits."""
    count, ridge2 = 12, 1e-9
    values = np.geomspace(1e-12, 1.0, 5)
    readings = np.random.default_rng(_SEED).standard_normal((count, len(values)))
    found = smoothed(readings, values, ridge2, Correlation(frames))
    exact = np.empty_like(found)
    conditions = []
    with mp.workdps(_DIGITS):
        between = mp.exp(-1 / mp.mpf(frames))
        for column, value in enumerate(values.tolist()):
            prior = mp.matrix(count, count)
            for i in range(count):
                for j in range(count):
                    prior[i, j] = between ** abs(i - j)
            system = mp.mpf(value) * prior + mp.mpf(ridge2) * mp.eye(count)
            smoother = prior * system**-1
            exact[:, column] = [float(one) for one in smoother * mp.matrix(readings[:, column].tolist())]
            felt = np.abs(np.array(smoother.tolist(), dtype=np.float64)) @ np.abs(readings[:, column])
            conditions.append(np.linalg.norm(felt) / np.linalg.norm(exact[:, column]))
    condition = float(max(conditions))
    error = np.linalg.norm(found - exact, axis=0) / np.linalg.norm(exact, axis=0)
    return Answer(float(error.max()), conditioned_bound(condition), condition)


def _flat() -> Answer:
    """Total variation with a weight beyond all readings: the constant that explains them best, (J1)·y / |J1|²."""
    problem = usual_problem()
    readings = problem.jacobian @ np.linspace(0.5, 1.5, len(problem.mesh.elements))
    image = prepared("total-variation", problem, {"hyperparameter": 1e200}).images(readings[None])[0]
    with mp.workdps(_DIGITS):
        ones = [mp.fsum(row) for row in problem.jacobian.tolist()]
        exact = float(mp.fdot(ones, readings.tolist()) / mp.fdot(ones, ones))
    condition = float(np.abs(problem.jacobian).sum() / np.abs(problem.jacobian.sum(axis=1)).sum())
    return Answer(float(np.abs(image / exact - 1).max()), conditioned_bound(condition), condition)


def _greit_limit() -> Answer:
    """GREIT's rows are scaled to the target's amplitude: for λ → ∞ they no longer depend on it, to 1/λ²."""
    problem, readings = usual_problem(), _changes(usual_problem())
    one, other = (
        prepared("greit", problem, {"hyperparameter": value}).images(readings[None])[0] for value in (1e10, 1e20)
    )
    condition = float(np.linalg.norm(readings) * np.sqrt(len(one)) / np.linalg.norm(one))
    return Answer(_apart(one, other), conditioned_bound(max(condition, 1.0)), max(condition, 1.0))


def _too_little_variation() -> Answer:
    problem = usual_problem()
    readings = problem.jacobian @ np.linspace(0.5, 1.5, len(problem.mesh.elements))
    prepared("total-variation", problem, {"hyperparameter": 1e-30}).images(readings[None])
    return Answer(0.0, 0.0)


def _prepare(name: str, options: Mapping[str, Any]) -> Answer:
    prepared(name, usual_problem(), options)
    return Answer(0.0, 0.0)


def _unequal() -> Answer:
    sensor = usual_sensor()
    variance = np.ones(sensor.pattern.shape)
    variance[3, 8] = 1e13
    imaging_problem(sensor, noise_variance=variance, image_size_mm=IMAGE_MM)
    return Answer(0.0, 0.0)


def _silent_frames() -> Answer:
    """Choose λ by cross-validation from frames that equal their reference."""
    problem = usual_problem()
    sampled = imaging_problem(usual_sensor(), sample=np.zeros((3, len(problem.reference))), image_size_mm=IMAGE_MM)
    prepared("gauss-newton-noser", sampled, {"choose": "gcv"})
    return Answer(0.0, 0.0)


def _case(name: str, hard: str, run: Callable[[], Answer], truth: str = _FIFTY) -> HardCase:
    return HardCase(name, _AREA, hard, truth, run)


def _refusal(name: str, hard: str, run: Callable[[], Answer], truth: str) -> HardCase:
    return HardCase(name, _AREA, hard, f"the refusal, {truth}", run, refuses=NumericsError)


_NUMBERS: Final = (
    _case(
        "no-regularisation-tikhonov",
        "λ = 0: every reading is explained, by the image of least norm. Singular values span six decades.",
        partial(ridge, "gauss-newton-tikhonov", "whole", 0.0),
    ),
    _case(
        "no-regularisation-noser",
        "λ = 0 with a prior that weighs elements by their sensitivity.",
        partial(ridge, "gauss-newton-noser", "whole", 0.0),
    ),
    _case(
        "regularisation-of-a-millionth",
        "λ of a ten thousandth of the largest singular value: where the normal equations have half of the digits.",
        partial(ridge, "gauss-newton-noser", "whole", 1e-4),
    ),
    _case(
        "every-singular-value-kept",
        "Truncated SVD without truncation: the smallest singular values decide the image.",
        partial(ridge, "truncated-svd", "whole", 0.0),
    ),
    _case(
        "noise-over-twelve-decades",
        "Readings whose noise variances lie twelve decades apart.",
        partial(ridge, "gauss-newton-noser", "noisy", 1e-3),
    ),
    _case(
        "three-electrodes-off",
        "The readings of three electrodes are missing, and λ is next to nothing.",
        partial(ridge, "gauss-newton-noser", "masked", 1e-5),
    ),
    _case(
        "nothing-but-regularisation",
        "λ a thousand million times the largest singular value: the image vanishes.",
        _adjoint,
        "λ²x = R⁻¹JᵀWy in the limit, to 1e-18",
    ),
    _case(
        "greit-of-nothing-but-regularisation",
        "GREIT with λ = 10¹⁰: its rows vanish and are scaled back to the target's amplitude.",
        _greit_limit,
        "the image at λ = 10²⁰: the limit",
    ),
    _case(
        "total-variation-of-nothing-but-smoothness",
        "Total variation with α = 10²⁰⁰: no jump is worth its price.",
        _flat,
        "the constant that explains the readings best, in fifty digits",
    ),
    _case(
        "sensor-in-picovolts",
        "A model whose voltages are 1e12 times those of another.",
        _fewer_units,
        "R(cJ, cλ) = R(J, λ)/c, exactly",
    ),
    _case(
        "frame-equal-to-its-reference",
        "Nothing has changed: an image of rounding errors would show a load.",
        lambda: _nothing(usual_problem()),
        "an image of zeros, exactly",
    ),
    _case(
        "l-curve-at-a-large-parameter",
        "Size and residual of an image at λ a thousand times the largest singular value.",
        partial(_l_curve, 999.0),
        "their sums in fifty digits",
    ),
    _case(
        "l-curve-at-a-small-parameter",
        "Size and residual of an image at λ a millionth of the largest singular value.",
        partial(_l_curve, 1.01e-6),
        "their sums in fifty digits",
    ),
    _case(
        "frames-alike-for-ages",
        "Frames that stay alike for a thousand million frames: 1 − a² is next to nothing.",
        partial(_lasting, 1e9),
        "the Gaussian process of the block, solved in fifty digits",
    ),
    _case(
        "frames-alike-for-one",
        "Almost independent frames, of signals up to 1e9 times their noise.",
        partial(_lasting, 0.05),
        "the Gaussian process of the block, solved in fifty digits",
    ),
)

_REFUSED: Final = (
    _refusal(
        "parameter-beyond-doubles",
        "λ = 1e60, whose square leaves an image of rounding errors only.",
        partial(_prepare, "gauss-newton-noser", {"hyperparameter": 1e60}),
        "by λ and its range",
    ),
    _refusal(
        "greit-without-regularisation",
        "GREIT with λ = 0: more training targets than readings can tell apart.",
        partial(_prepare, "greit", {"hyperparameter": 0.0}),
        "by λ and the least that is allowed",
    ),
    _refusal(
        "total-variation-next-to-none",
        "Total variation with α = 10⁻³⁰, below a rounding of what it is added to.",
        _too_little_variation,
        "by what the image lacks",
    ),
    _refusal(
        "half-a-pair-of-singular-values",
        "Truncation between two equal singular values, which would prefer a direction.",
        partial(_prepare, "truncated-svd", {"components": 2}),
        "by the counts that split no pair",
    ),
    _refusal(
        "noise-beyond-twelve-decades",
        "One reading is stated to be 1e13 times noisier than the others.",
        _unequal,
        "by the reading",
    ),
    _refusal(
        "parameter-from-frames-without-change",
        "λ is to be chosen by cross-validation, on frames that equal their reference.",
        _silent_frames,
        "with what to choose by instead",
    ),
)

CASES: Final[tuple[HardCase, ...]] = (*_NUMBERS, *_REFUSED)
