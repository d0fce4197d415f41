"""λ from readings alone, against independent formulae and on ill-posed problems whose best λ is known."""

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.eit.inverse.dual import DualSpectrum, dual_spectrum
from cbsr_qa.eit.inverse.one_step import (
    RidgeCurves,
    choose_by_cross_validation,
    choose_by_discrepancy,
    choose_by_l_curve,
)

_COUNT = 40


def shaw(count: int) -> tuple[np.ndarray, np.ndarray]:
    """One-dimensional image restoration (Shaw 1972, as in Hansen's Regularization Tools)."""
    step = np.pi / count
    angle = -np.pi / 2 + (np.arange(count) + 0.5) * step
    sums = np.pi * np.add.outer(np.sin(angle), np.sin(angle))
    matrix = step * (np.add.outer(np.cos(angle), np.cos(angle)) * np.sinc(sums / np.pi)) ** 2
    return matrix, 2 * np.exp(-6 * (angle - 0.8) ** 2) + np.exp(-2 * (angle + 0.5) ** 2)


def phillips(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Fredholm equation of Phillips 1962."""
    step = 12 / count
    at = -6 + (np.arange(count) + 0.5) * step

    def bump(x):
        return np.where(np.abs(x) < 3, 1 + np.cos(np.pi * x / 3), 0.0)

    return step * bump(np.subtract.outer(at, at)), bump(at)


def heat(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Inverse heat equation, a Volterra kernel (Carasso 1982)."""
    step = 1 / count
    lag = (np.arange(count) + 0.5) * step
    kernel = step / (2 * np.sqrt(np.pi)) * lag**-1.5 * np.exp(-1 / (4 * lag))
    rows, columns = np.indices((count, count))
    matrix = np.where(rows >= columns, kernel[np.abs(rows - columns)], 0.0)
    return matrix, np.interp(lag, [0, 0.1, 0.25, 0.5, 1], [0, 0.8, 1, 0.2, 0])


def curves_of(spectrum: DualSpectrum, readings: np.ndarray) -> RidgeCurves:
    return RidgeCurves(spectrum.values, np.atleast_2d(readings) @ spectrum.analysis.T)


def ridge_fit(matrix: np.ndarray, hyperparameter: float) -> np.ndarray:
    """(AᵀA + λ²I)⁻¹Aᵀ, the long way round."""
    return np.linalg.solve(matrix.T @ matrix + hyperparameter**2 * np.eye(matrix.shape[1]), matrix.T)


@pytest.fixture(scope="module")
def random_problem():
    random = np.random.default_rng(0)
    matrix = random.standard_normal((25, 60)) * np.geomspace(1, 1e-3, 60)
    variance, weights = random.uniform(0.3, 3.0, 25), random.uniform(0.5, 2.0, 60)
    return matrix, variance, weights, random.standard_normal((4, 25))


@given(exponent=st.floats(-2.5, 0.5))
@drawn(20)
def test_residual_size_and_freedom_are_those_of_the_textbook(random_problem, exponent):
    matrix, variance, weights, readings = random_problem
    spectrum = dual_spectrum(matrix, weights, variance)
    curves, hyperparameter = curves_of(spectrum, readings), 10**exponent
    weight = np.diag(1 / variance)
    fit = np.linalg.solve(matrix.T @ weight @ matrix + hyperparameter**2 * np.diag(weights), matrix.T @ weight)
    images = readings @ fit.T
    left = readings - images @ matrix.T
    s = 2 * np.log(hyperparameter)
    assert curves.residual(s) == pytest.approx((left**2 / variance).sum(), rel=1e-9)
    assert curves.size(s) == pytest.approx((images**2 * weights).sum(), rel=1e-9)
    assert curves.freedom(s) == pytest.approx(25 - np.trace(matrix @ fit), rel=1e-9)


@given(exponent=st.floats(-2.0, 0.5))
@drawn(15)
def test_cross_validation_is_leaving_one_out_where_all_readings_are_alike(exponent):
    """On a circulant problem every reading has the same leverage, and GCV is the sum over refits without each."""
    count, hyperparameter = 18, 10**exponent
    kernel = np.exp(-(np.minimum(np.arange(count), count - np.arange(count)) ** 2) / 4.0)
    matrix = np.stack([np.roll(kernel, k) for k in range(count)])
    readings = np.random.default_rng(7).standard_normal(count)
    missed = 0.0
    for out in range(count):
        kept = np.arange(count) != out
        image = ridge_fit(matrix[kept], hyperparameter) @ readings[kept]
        missed += (readings[out] - matrix[out] @ image) ** 2
    curves = curves_of(dual_spectrum(matrix, np.ones(count)), readings)
    assert count**2 * curves.cross_validation(2 * np.log(hyperparameter)) == pytest.approx(missed, rel=1e-8)


@pytest.mark.parametrize("problem", [shaw, phillips, heat])
def test_curvature_is_that_of_the_curve_by_finite_differences(problem):
    matrix, truth = problem(_COUNT)
    readings = matrix @ truth + 1e-3 * np.random.default_rng(1).standard_normal(_COUNT)
    curves = curves_of(dual_spectrum(matrix, np.ones(_COUNT)), readings)
    step = 1e-3

    def point(s):
        image = ridge_fit(matrix, np.exp(s / 2)) @ readings
        return np.log([np.linalg.norm(readings - matrix @ image), np.linalg.norm(image)])

    for s in 2 * np.log([3e-3, 1e-2, 0.05, 0.3]):
        before, here, after = (point(s + shift * step) for shift in (-1, 0, 1))
        first, second = (after - before) / (2 * step), (after - 2 * here + before) / step**2
        bend = (first[0] * second[1] - second[0] * first[1]) / np.hypot(*first) ** 3
        assert curves.curvature(s) == pytest.approx(bend, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("problem", [shaw, phillips, heat])
@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_choices_come_close_to_the_best_on_classical_problems(problem, noise):
    """Eight frames a choice. GCV aims at the best prediction, discrepancy and L-curve at an image.

    The L-curve is known to smooth too little where the truth is smooth (Vogel 1996): Shaw's is the fair one.
    """
    matrix, truth = problem(_COUNT)
    spectrum = dual_spectrum(matrix, np.ones(_COUNT))
    deviation = noise * np.linalg.norm(matrix @ truth) / np.sqrt(_COUNT)
    image_ratios, prediction_ratios = [], []
    for seed in range(10):
        noisy = matrix @ truth + deviation * np.random.default_rng(seed).standard_normal((8, _COUNT))
        curves = curves_of(spectrum, noisy)
        images = np.stack([noisy @ spectrum.matrix(value).T - truth for value in np.exp(curves.grid[60::3] / 2)])
        best_image = np.linalg.norm(images, axis=(1, 2)).min()
        best_prediction = np.linalg.norm(images @ matrix.T, axis=(1, 2)).min()
        chosen = [
            choose_by_cross_validation(curves),
            choose_by_discrepancy(curves, 8 * _COUNT * deviation**2),
            choose_by_l_curve(curves),
        ]
        wrong = [noisy @ spectrum.matrix(value).T - truth for value in chosen]
        image_ratios.append([np.linalg.norm(each) / best_image for each in wrong])
        prediction_ratios.append([np.linalg.norm(each @ matrix.T) / best_prediction for each in wrong])
    of_image, of_prediction = np.transpose(image_ratios), np.transpose(prediction_ratios)
    assert of_prediction[0].max() < 1.15
    assert np.median(of_image[0]) < 2
    assert of_image[1].max() < 1.6
    assert of_prediction[2].max() < 2.2
    if problem is shaw:
        assert of_image[2].max() < 2.6


def test_discrepancy_leaves_what_noise_is_expected_to(random_problem):
    matrix, variance, weights, readings = random_problem
    curves = curves_of(dual_spectrum(matrix, weights, variance), readings)
    level = 0.3 * float((readings**2 / variance).sum())
    found = choose_by_discrepancy(curves, level)
    weight = np.diag(1 / variance)
    fit = np.linalg.solve(matrix.T @ weight @ matrix + found**2 * np.diag(weights), matrix.T @ weight)
    left = readings - readings @ fit.T @ matrix.T
    assert (left**2 / variance).sum() == pytest.approx(level, rel=1e-8)


def test_several_frames_share_one_parameter():
    """Ten frames settle λ where one of them varies; the same frames twice settle the same λ."""
    matrix, truth = phillips(_COUNT)
    spectrum = dual_spectrum(matrix, np.ones(_COUNT))
    random = np.random.default_rng(5)
    frames = matrix @ truth + 0.03 * random.standard_normal((20, _COUNT))
    together = choose_by_cross_validation(curves_of(spectrum, frames))
    alone = np.log([choose_by_cross_validation(curves_of(spectrum, frame)) for frame in frames])
    halves = np.log([choose_by_cross_validation(curves_of(spectrum, frames[k::2])) for k in range(2)])
    assert np.ptp(halves) < 0.5 * np.ptp(alone)
    assert choose_by_cross_validation(curves_of(spectrum, np.vstack([frames, frames]))) == pytest.approx(
        together, rel=1e-6
    )


def test_criteria_without_an_answer_say_so():
    matrix, truth = shaw(_COUNT)
    spectrum = dual_spectrum(matrix, np.ones(_COUNT))
    exact = curves_of(spectrum, matrix @ truth)
    with pytest.raises(NumericsError, match="no minimum for λ from"):
        choose_by_cross_validation(exact)
    with pytest.raises(NumericsError, match="almost no noise"):
        choose_by_discrepancy(exact, 0.0)
    with pytest.raises(NumericsError, match="do not exceed their noise"):
        choose_by_discrepancy(exact, 1e9)
    # One direction alone: the size falls and the residual rises together, and nothing bends towards the origin.
    with pytest.raises(NumericsError, match="no corner for λ from"):
        choose_by_l_curve(RidgeCurves(np.ones(3), np.array([[1.0, 1.0, 1.0]])))
    with pytest.raises(NumericsError, match="nothing to fit"):
        curves_of(spectrum, np.zeros(_COUNT))
    with pytest.raises(NumericsError, match="not a finite number"):
        curves_of(spectrum, np.full(_COUNT, np.nan))
