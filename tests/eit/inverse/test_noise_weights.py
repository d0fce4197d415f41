"""Noise of readings from few frames: against known variances, and what weights by it do to images."""

import numpy as np
import pytest
from scipy.stats import chi2
from tiers import rest_but

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.kept import as_filed
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.readings import FEWEST_FRAMES, reading_noise
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind

READINGS = 208


def frames(count, rms, seed=0):
    """Normal noise about levels that drift."""
    random = np.random.default_rng(seed)
    time_s = 2.5 * np.arange(count)
    rms = np.broadcast_to(np.asarray(rms, dtype=float), READINGS)
    drift = 1.0 + random.uniform(-1, 1, READINGS) + np.outer(time_s, random.uniform(-0.1, 0.1, READINGS))
    return drift + rms * random.standard_normal((count, READINGS)), time_s


def excess(variance, true):
    """Variance that weighing by a wrong variance leaves, over the least there is, of a mean of all readings."""
    weight = 1 / variance
    return float((weight**2 * true).sum() / weight.sum() ** 2 * (1 / true).sum())


# --- against known variances -----------------------------------------------------------------------------


@pytest.mark.parametrize("count", [9, 20, 60])
def test_the_common_variance_of_alike_readings_is_the_true_one(count):
    """All readings together have 208·(n − 2) degrees of freedom; logarithms know the mean almost as well."""
    readings, time_s = frames(count, 0.3, seed=count)
    noise = reading_noise(readings, time_s)
    freedom = 0.5 * READINGS * (count - 2)  # half of it: clipping and logarithms cost some
    low, high = chi2.ppf([1e-4, 1 - 1e-4], freedom) / freedom
    assert low < noise.common / 0.09 < high
    assert noise.variance.max() / noise.variance.min() < 1.6
    assert not noise.silent.any()


def test_readings_that_differ_in_earnest_keep_their_own_variance():
    """Two groups, tenfold apart in rms: 99.9 % of readings lie within the bounds of their own χ² law."""
    true = np.where(np.arange(READINGS) < 40, 1.0, 0.01)
    noise = reading_noise(*frames(102, np.sqrt(true), seed=3))
    assert noise.common_freedom < 5
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 100) / 100
    within = (noise.variance / true > 0.9 * low) & (noise.variance / true < 1.1 * high)
    assert within.mean() > 0.98


def test_shrinkage_costs_alike_readings_next_to_nothing_and_gains_where_they_differ():
    spread = np.exp(0.5 * np.random.default_rng(1).standard_normal(READINGS))
    lost_alike, lost_own, gained = [], [], []
    for seed in range(20):
        alike, time_s = frames(20, 0.3, seed)
        own = np.polynomial.polynomial.polyfit(time_s, alike, 1, full=True)[1][0] / 18
        lost_own.append(excess(own, np.ones(READINGS)))
        lost_alike.append(excess(reading_noise(alike, time_s).variance, np.ones(READINGS)))
        weighed = reading_noise(*frames(20, spread, 100 + seed)).variance
        gained.append(excess(weighed, spread**2) / excess(np.ones(READINGS), spread**2))
    assert np.mean(lost_alike) < 1.01 < np.mean(lost_own)
    assert np.mean(gained) < 0.8


@pytest.mark.parametrize("factor", [1e-9, 1e-3, 1e6])
def test_the_unit_of_the_readings_only_scales_the_variances(factor):
    readings, time_s = frames(15, np.linspace(0.1, 2.0, READINGS))
    here, there = reading_noise(readings, time_s), reading_noise(factor * readings, time_s)
    np.testing.assert_allclose(there.variance, factor**2 * here.variance, rtol=1e-9)
    assert there.common_freedom == pytest.approx(here.common_freedom, rel=1e-6)


def test_drift_and_a_glitch_are_no_noise():
    readings, time_s = frames(20, 0.3)
    quiet = reading_noise(readings, time_s).variance
    readings[:, 5] += 3.0 * time_s
    readings[7, 9] += 1000.0
    readings[12, 9] -= 1000.0
    with_glitch = reading_noise(readings, time_s).variance
    np.testing.assert_allclose(with_glitch[5], quiet[5], rtol=0.1)
    assert with_glitch[9] < 5 * quiet[9]  # the plain variance is a million times the others'


def test_no_variance_is_below_that_of_rounding_to_the_converters_step():
    """A third of a step of noise: some readings hardly ever leave their code, and must not count for that."""
    time_s = 2.5 * np.arange(20)
    level = np.random.default_rng(5).uniform(0.0, 1.0, READINGS)
    noisy = level + 0.3 * np.random.default_rng(4).standard_normal((20, READINGS))
    step = 1e-4
    noise = reading_noise(step * np.round(noisy), time_s)
    assert noise.variance.min() >= step**2 / 12 * (1 - 1e-9)
    assert noise.variance.max() / noise.variance.min() < 10


def test_a_reading_that_never_changes_is_weighed_like_a_common_one():
    readings, time_s = frames(20, 0.3)
    readings[:, 17] = 0.25
    noise = reading_noise(readings, time_s)
    assert np.flatnonzero(noise.silent).tolist() == [17]
    assert noise.variance[17] == noise.common


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda readings: readings[: FEWEST_FRAMES - 1], "5 unloaded frames are too few"),
        (lambda readings: np.where(np.arange(READINGS) < 3, np.nan, readings), "3 readings are non-finite"),
        (lambda readings: np.where(np.arange(READINGS) < 1, np.inf, readings), "1 readings are non-finite"),
        (lambda readings: np.broadcast_to(readings[0], readings.shape), "208 of 208 readings are the same"),
        (np.zeros_like, "208 of 208 readings are the same"),
        (lambda readings: np.where(np.arange(READINGS) < 120, 1.0, readings), "120 of 208 readings are the same"),
    ],
)
def test_what_says_nothing_of_the_noise_is_refused_with_a_way_out(edit, said):
    readings, time_s = frames(12, 0.3)
    readings = edit(readings)
    with pytest.raises(NumericsError, match=said) as refused:
        reading_noise(readings, time_s[: len(readings)])
    assert 'noise_weighting = "equal"' in refused.value.remedy


# --- what weights do to images ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sensor():
    return load_sensor_type("disc-100mm").value


@pytest.mark.parametrize(
    "method",
    rest_but(
        {"gauss-newton-noser", "truncated-svd"},
        ["gauss-newton-noser", "gauss-newton-laplace", "greit", "truncated-svd"],
    ),
)
def test_rounding_of_a_file_changes_an_image_by_about_a_thousandth_of_its_noise(sensor, method):
    exact = discover().factory(Kind.RECONSTRUCTION, method)().prepare(imaging_problem(sensor))
    filed = as_filed(exact)
    assert (filed.matrix != exact.matrix).any()
    change, noise = (np.sqrt((one**2).sum(axis=1)) for one in (filed.matrix - exact.matrix, exact.matrix))
    assert np.sqrt(np.mean(change**2 / noise**2)) < 5e-4
    assert (change < 1.5e-3 * noise).all()


def test_estimated_weights_do_nearly_what_the_true_ones_would(sensor):
    method = discover().factory(Kind.RECONSTRUCTION, "gauss-newton-noser")()
    true = np.exp(np.random.default_rng(2).standard_normal(READINGS))
    estimated = reading_noise(*frames(20, np.sqrt(true), seed=6)).variance
    left = {}
    for name, variance in (("equal", None), ("estimated", estimated), ("true", true)):
        prepared = method.prepare(imaging_problem(sensor, image_size_mm=8.0, noise_variance=variance))
        signal = prepared.problem.jacobian[:, np.hypot(*prepared.problem.mesh.centroids_mm.T) < 8].sum(axis=1)
        noise = prepared.matrix**2 @ true
        left[name] = float(np.sqrt(noise.sum()) / np.linalg.norm(prepared.matrix @ signal))
    assert left["true"] < left["estimated"] < left["equal"]
    assert left["estimated"] < left["true"] + 0.5 * (left["equal"] - left["true"])


def test_lambda_means_the_same_in_any_unit(sensor):
    """The image of frames in volts and in microvolts, and that with equal variances and without any, are the same."""
    method = discover().factory(Kind.RECONSTRUCTION, "gauss-newton-noser")()
    readings, time_s = frames(20, np.linspace(0.1, 1.0, READINGS))
    matrices = []
    for factor in (1.0, 1e6):
        variance = reading_noise(factor * readings, time_s).variance
        problem = imaging_problem(sensor, image_size_mm=8.0, noise_variance=variance)
        assert (1 / problem.noise_variance).mean() == pytest.approx(1, rel=1e-12)
        matrices.append(method.prepare(problem).matrix)
    np.testing.assert_allclose(matrices[1], matrices[0], atol=1e-6 * np.abs(matrices[0]).max())
    plain = method.prepare(imaging_problem(sensor, image_size_mm=8.0))
    alike = method.prepare(imaging_problem(sensor, image_size_mm=8.0, noise_variance=np.full(READINGS, 3e-12)))
    np.testing.assert_allclose(alike.matrix, plain.matrix, atol=1e-9 * np.abs(plain.matrix).max())
    assert alike.choice.value == plain.choice.value == method.prepare(problem).choice.value
