"""The model of a batch against one normal distribution of all loads."""

from itertools import pairwise

import numpy as np
import pytest

from cbsr_qa.calibration.batch.left_out import leave_each_out
from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import BatchLoads, SensorLoads, correlate_places
from cbsr_qa.calibration.batch.model import learn_batch
from cbsr_qa.calibration.batch.prior import BatchPrior
from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.calibration.sheet.response_processes import combine_loads, condition_family
from cbsr_qa.domain.errors import CalibrationError
from tests.samples.batches import RADIUS_MM, draw_batch, draw_field, draw_map, place_sunflower, press

ROUNDING = 1e-12
THERE_MM = np.array([[0.0, 0.0], [10.0, 5.0], [30.0, -20.0], [0.0, 40.0]])
CHOICES = [
    Hyperparameters(True, 20.0, 0.01, 0.1, 0.15, 0.03),
    Hyperparameters(False, 30.0, 0.0, 0.05, 0.2, 0.0),
    Hyperparameters(True, 25.0, 0.02, 0.2, 0.0, 0.05),
    Hyperparameters(False, 15.0, 0.005, 0.001, 0.1, 0.02),
]


def draw_sensor(random, count, shared):
    """Loads at some places of the batch and some of its own, three of them pressed twice."""
    places = np.concatenate([shared, random.uniform(-40, 40, (count, 2))])
    places = np.concatenate([places, places[:3]])
    bend = random.normal(0, 1, len(places)) if count % 2 else None
    variance = random.uniform(0.01, 0.02, len(places)) ** 2
    return SensorLoads(places, random.normal(0, 0.2, len(places)), variance, bend, 0.3)


@pytest.fixture(scope="module")
def sensors():
    random = np.random.default_rng(1)
    shared = random.uniform(-40, 40, (4, 2))
    return [draw_sensor(random, 2 + number, shared) for number in range(4)]


def dense(choice, sensors, there_mm=THERE_MM[:0]):
    """Covariance of all loads and of the last sensor's map at some places, and their number."""
    of_load = np.repeat(np.arange(len(sensors)), [len(sensor.log_response) for sensor in sensors])
    of = np.concatenate([of_load, np.full(len(there_mm), len(sensors) - 1)])
    every = np.concatenate([*(sensor.places_mm for sensor in sensors), there_mm])
    alike = correlate_places(every, every, choice.length_mm, choice.smooth)
    covariance = choice.common**2 * alike + (of[:, None] == of) * (choice.own**2 * alike + choice.level**2)
    count = len(of_load)
    noise = np.concatenate([sensor.variance for sensor in sensors]) + choice.scatter**2 + ROUNDING
    covariance[:count, :count] += np.diag(noise)
    for number, sensor in enumerate(sensors):
        if sensor.bend is not None:
            bend = np.zeros(len(of))
            bend[np.flatnonzero(of_load == number)] = sensor.bend
            covariance += sensor.bend_stderr**2 * np.outer(bend, bend)
    return covariance, np.concatenate([sensor.log_response for sensor in sensors])


def integrate_level(covariance, values):
    """Log likelihood, mean and its variance with a flat level."""
    solved = np.linalg.solve(covariance, np.column_stack([np.ones(len(values)), values]))
    precision, pull = solved[:, 0].sum(), solved[:, 1].sum()
    misfit = values @ solved[:, 1] - pull**2 / precision
    log_determinant = np.linalg.slogdet(covariance)[1] + np.log(precision) + (len(values) - 1) * np.log(2 * np.pi)
    return -(misfit + log_determinant) / 2, pull / precision, 1 / precision


@pytest.mark.parametrize("choice", CHOICES)
def test_likelihood_is_that_of_one_normal_distribution_of_all_loads(sensors, choice):
    likelihood, _, _ = integrate_level(*dense(choice, sensors))
    assert BatchLikelihood(BatchLoads(sensors)).compute([choice]) == pytest.approx([likelihood], abs=1e-8)


@pytest.mark.parametrize("choice", CHOICES)
def test_a_further_sensor_s_map_is_that_of_regression_on_all_loads(sensors, choice):
    covariance, values = dense(choice, sensors, THERE_MM)
    count = len(values)
    _, level, level_variance = integrate_level(covariance[:count, :count], values)
    gain = np.linalg.solve(covariance[:count, :count], covariance[:count, count:]).T
    left = 1 - gain.sum(axis=1)
    mean = level + gain @ (values - level)
    spread = covariance[count:, count:] - gain @ covariance[:count, count:] + level_variance * np.outer(left, left)
    prior = BatchPrior(BatchLikelihood(BatchLoads(sensors[:-1])), [choice], [1.0])
    found = prior.learn_response(sensors[-1])
    assert found.predict(THERE_MM)[0] == pytest.approx(mean, abs=1e-8)
    assert found.predict(THERE_MM)[1] == pytest.approx(np.diag(spread), rel=1e-6)
    assert found.average(THERE_MM) == pytest.approx((mean.mean(), spread.mean()), rel=1e-6)


def test_common_map_without_own_maps_is_that_of_one_sheet(sensors):
    """With ϖ and τ zero all loads are of one sheet, whose map is known."""
    choice = Hyperparameters(True, 20.0, 0.01, 0.0, 0.15, 0.0)
    plain = [SensorLoads(sensor.places_mm, sensor.log_response, sensor.variance) for sensor in sensors]
    covariance, values = dense(choice, plain, THERE_MM)
    count = len(values)
    _, level, _ = integrate_level(covariance[:count, :count], values)
    mean = level + covariance[count:, :count] @ np.linalg.solve(covariance[:count, :count], values - level)
    prior = BatchPrior(BatchLikelihood(BatchLoads(plain)), [choice], [1.0])
    assert prior.predict(THERE_MM)[0] == pytest.approx(mean, abs=1e-8)


def test_maps_with_nothing_in_common_are_independent_but_for_the_level(sensors):
    """At ρ = 0 and a vague level of each sensor the likelihood is a product over sensors, but for the level's."""
    vague = 1e3
    choice = Hyperparameters(True, 20.0, 0.01, 0.2, 0.0, vague)
    together = BatchLikelihood(BatchLoads(sensors)).compute([choice])[0]
    alone = [BatchLikelihood(BatchLoads([sensor])).compute([choice])[0] for sensor in sensors]
    count = len(sensors)
    of_level = (count - 1) * np.log(2 * np.pi) / 2 + (count - 1) * np.log(vague) + np.log(count) / 2
    assert together == pytest.approx(sum(alone) - of_level, abs=1e-3)


@pytest.mark.parametrize("smooth", [True, False])
def test_one_sensor_is_weighed_as_its_own_map_is(sensors, smooth):
    """Only the sum of ω² and ϖ² matters then: likelihoods differ as those of the sensor's own map do."""
    sensor, length_mm = (
        SensorLoads(*(getattr(sensors[0], name) for name in ("places_mm", "log_response", "variance"))),
        20.0,
    )
    loads = BatchLoads([sensor])
    data = {
        scatter: combine_loads(
            np.unique(sensor.places_mm, axis=0, return_inverse=True)[1].ravel(),
            np.column_stack([np.ones(len(sensor.variance)), sensor.log_response]),
            sensor.variance + scatter**2 + ROUNDING,
            np.zeros((1, 1)),
        )
        for scatter in (0.005, 0.02)
    }
    places = np.unique(sensor.places_mm, axis=0)
    family = condition_family(data, correlate_places(places, places, length_mm, smooth), smooth, length_mm)
    deviations = np.array([0.01, 0.02, 0.035, 0.06, 0.1, 0.15, 0.22, 0.32, 0.45])
    prior = np.log(deviations) - np.log1p((deviations / 0.2) ** 2)
    known = family.score - prior[:, None] + np.array([0.005, 0.02]) / 0.02
    choices = [
        Hyperparameters(smooth, length_mm, scatter, 0.6 * deviation, 0.8 * deviation, 0.0)
        for deviation in deviations.tolist()
        for scatter in data
    ]
    found = BatchLikelihood(loads).compute(choices).reshape(known.shape)
    assert found - found[0, 0] == pytest.approx(known - known[0, 0], abs=1e-6)


@pytest.fixture(scope="module")
def batch():
    return draw_batch(np.random.default_rng(3), 0.9)


def test_order_of_sensors_changes_nothing(batch):
    sensors, _ = batch
    one, other = learn_batch(sensors, radius_mm=RADIUS_MM), learn_batch(sensors[::-1], radius_mm=RADIUS_MM)
    assert (one.rho.value, one.rho.low, one.rho.high) == pytest.approx(
        (other.rho.value, other.rho.low, other.rho.high), abs=1e-6
    )
    assert one.prior.predict(THERE_MM)[0] == pytest.approx(other.prior.predict(THERE_MM)[0], abs=1e-6)


def test_rho_lies_in_its_interval_at_both_ends_and_between():
    for rho in (0.0, 0.5, 0.9):
        sensors, _ = draw_batch(np.random.default_rng([5, round(100 * rho)]), rho)
        found = learn_batch(sensors, radius_mm=RADIUS_MM).rho
        assert found.low <= rho <= found.high
        assert found.low <= found.value <= found.high


def test_identical_sensors_have_everything_in_common():
    sensors, _ = draw_batch(np.random.default_rng(8), 0.5)
    found = learn_batch([sensors[0]] * 6, radius_mm=RADIUS_MM).rho
    assert (found.low > 0.99, found.high) == (True, 1.0)


@pytest.mark.parametrize("what", ["one place", "one load each", "noise alone"])
def test_loads_that_say_nothing_of_what_is_shared_leave_everything_open(what):
    random = np.random.default_rng(10)
    places = {"one place": np.zeros((20, 2)), "one load each": np.zeros((1, 2)), "noise alone": place_sunflower(9)}[
        what
    ]
    noise = 0.3 if what == "noise alone" else 0.01
    loads = [
        SensorLoads(
            places,
            0.1 * random.standard_normal() + noise * random.standard_normal(len(places)),
            np.full(len(places), noise**2),
        )
        for _ in range(5)
    ]
    found = learn_batch(loads, radius_mm=RADIUS_MM).rho
    assert found.low == 0.0
    assert found.high > 0.95
    assert 0.2 < found.value < 0.8


def test_a_sensor_of_another_batch_stands_out():
    random = np.random.default_rng(9)
    sensors, _ = draw_batch(random, 0.9)
    sensors[3] = press(random, draw_map(random, draw_field(random), 0.9), place_sunflower(16))
    p_values = [likeness.p_value for likeness, _ in leave_each_out(learn_batch(sensors, radius_mm=RADIUS_MM))]
    assert np.argmin(p_values) == 3
    assert p_values[3] == 1 / 1000 < min(p_values[:3] + p_values[4:])


def test_four_presses_and_the_batch_predict_better_than_four_presses(batch):
    sensors, common = batch
    random, there = np.random.default_rng(4), place_sunflower(60)
    prior = learn_batch(sensors, radius_mm=RADIUS_MM).prior
    squared = []
    for _ in range(6):
        response = draw_map(random, common, 0.9)
        loads = press(random, response, place_sunflower(4))
        mean, variance = prior.learn_response(loads).predict(there)
        alone, _ = learn_response(loads.places_mm, loads.log_response, loads.variance, radius_mm=RADIUS_MM).predict(
            there
        )
        truth = response(there)
        squared.append(
            [np.mean((mean - truth) ** 2), np.mean((alone - truth) ** 2), np.mean((mean - truth) ** 2 / variance)]
        )
    with_batch, without, normalised = np.mean(squared, axis=0)
    assert with_batch < 0.4 * without
    assert 0.4 < normalised < 2.5


def test_error_falls_and_the_batch_s_share_grows_with_presses(batch):
    sensors, common = batch
    random = np.random.default_rng(6)
    prior, response = learn_batch(sensors, radius_mm=RADIUS_MM).prior, draw_map(random, common, 0.9)
    maps = [prior.learn_response(press(random, response, place_sunflower(16)[:count])) for count in (4, 9, 16)]
    errors = [float(np.mean(found.predict(THERE_MM)[1])) for found in maps]
    assert all(later < earlier for earlier, later in pairwise(errors))
    shares = [found.batch_share(THERE_MM) for found in maps]
    assert all(np.all((share >= 0) & (share <= 1)) for share in shares)


def test_a_load_that_is_no_number_is_refused():
    with pytest.raises(CalibrationError, match="not finite"):
        SensorLoads(np.zeros((3, 2)), np.array([0.0, np.nan, 0.0]), np.zeros(3))
