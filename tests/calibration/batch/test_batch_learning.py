"""The map of a sensor by its batch and its own loads: what it answers, and a sensor that is not like its batch."""

from dataclasses import replace

import numpy as np
import pytest
from batches import RADIUS_MM, draw_batch, draw_field, draw_map, place_sunflower, press

from cbsr_qa.calibration.batch.learning import BatchLearner, is_strange
from cbsr_qa.calibration.batch.likelihood import BatchLikelihood
from cbsr_qa.calibration.batch.loads import SensorLoads
from cbsr_qa.calibration.batch.model import learn_batch
from cbsr_qa.calibration.batch.prior import BatchPrior, Likeness
from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.domain.errors import CalibrationError

CANDIDATES_MM = np.array([[10.0, -30.0], [-25.0, 12.0], [3.0, 4.0]])
TARGETS_MM = np.array([[0.0, 0.0], [20.0, 20.0], [-35.0, 5.0], [3.0, 4.0]])
VARIANCE = 3e-4


@pytest.fixture(scope="module")
def drawn():
    """A batch's model, its common map, and the random numbers for more of its sensors."""
    random = np.random.default_rng(31)
    sensors, common = draw_batch(random, 0.9)
    return learn_batch(sensors, radius_mm=RADIUS_MM), common, random


def add_load(loads, place_mm):
    """One more load; its value does not matter to any variance of one member."""
    return SensorLoads(
        np.vstack([loads.places_mm, place_mm]),
        np.append(loads.log_response, 0.1),
        np.append(loads.variance, VARIANCE),
    )


def test_covariance_and_means_of_members_mix_to_the_prediction(drawn):
    model, common, random = drawn
    loads = press(random, draw_map(random, common, 0.9), place_sunflower(6))
    found = model.prior.learn_response(loads)
    means, variances = found.predict_members(TARGETS_MM)
    assert found.weights.sum() == pytest.approx(1.0)
    covariances = found.covariance(TARGETS_MM, TARGETS_MM)
    assert np.diagonal(covariances, axis1=1, axis2=2) == pytest.approx(variances, rel=1e-6, abs=1e-12)
    mean, total = found.predict(TARGETS_MM)
    assert found.weights @ (variances + (means - mean) ** 2) == pytest.approx(total)


def test_variance_after_a_press_is_that_of_the_map_with_it(drawn):
    model, common, random = drawn
    loads = press(random, draw_map(random, common, 0.9), place_sunflower(6))
    likelihood = BatchLikelihood(model.loads)
    for choice in model.choices[::29]:
        prior = BatchPrior(likelihood, [choice], [1.0])
        after = prior.learn_response(loads).variance_after(CANDIDATES_MM, TARGETS_MM, VARIANCE)[0]
        for candidate, place_mm in enumerate(CANDIDATES_MM):
            added = prior.learn_response(add_load(loads, place_mm)).predict(TARGETS_MM)[1]
            assert after[candidate] == pytest.approx(added, rel=1e-6, abs=1e-12)


def test_a_sensor_of_the_batch_is_learned_with_it_and_says_what_it_owes(drawn):
    model, common, random = drawn
    loads = press(random, draw_map(random, common, 0.9), place_sunflower(6))
    learner = BatchLearner(model.prior, "d" * 64)
    found = learner(loads.places_mm, loads.log_response, loads.variance, radius_mm=RADIUS_MM)
    assert (found.batch.model, found.batch.alike) == ("d" * 64, True)
    assert 0 < found.batch.share < 1
    alone = learn_response(loads.places_mm, loads.log_response, loads.variance, radius_mm=RADIUS_MM)
    assert found.predict(TARGETS_MM)[1].mean() < 0.5 * alone.predict(TARGETS_MM)[1].mean()


def test_a_sensor_of_another_batch_is_learned_alone(drawn):
    model, _, random = drawn
    loads = press(random, draw_map(random, draw_field(random), 0.9), place_sunflower(9))
    found = BatchLearner(model.prior, "d" * 64)(
        loads.places_mm, loads.log_response, loads.variance, radius_mm=RADIUS_MM
    )
    alone = learn_response(loads.places_mm, loads.log_response, loads.variance, radius_mm=RADIUS_MM)
    assert (found.batch.alike, found.batch.share) == (False, 0.0)
    assert found.batch.p_value < 0.05
    for ours, own in zip(found.predict(TARGETS_MM), alone.predict(TARGETS_MM), strict=True):
        assert np.array_equal(ours, own)


def test_only_a_sensor_improbable_in_both_ways_is_named():
    assert is_strange(Likeness(0.01, -1.0))
    assert not is_strange(Likeness(0.01, 1.0))
    assert not is_strange(Likeness(0.2, -1.0))


def test_two_loads_do_not_show_whether_a_sensor_is_like_its_batch(drawn):
    model, _, _ = drawn
    learner = BatchLearner(model.prior, "d" * 64)
    with pytest.raises(CalibrationError, match="3 are needed"):
        learner(CANDIDATES_MM[:2], np.zeros(2), np.full(2, 1e-4), radius_mm=RADIUS_MM)


@pytest.mark.rest
def test_sensors_of_the_batch_are_rarely_named_and_others_nearly_always(drawn):
    """Of 60 each at ρ = 0.9 and nine presses: a twentieth is expected, and all but one in a hundred."""
    model, common, random = drawn
    places_mm = place_sunflower(9)
    like = [press(random, draw_map(random, common, 0.9), places_mm) for _ in range(60)]
    strange = [press(random, draw_map(random, draw_field(random), 0.9), places_mm) for _ in range(60)]
    assert sum(is_strange(model.prior.test_likeness(loads)) for loads in like) <= 8
    assert sum(is_strange(model.prior.test_likeness(loads)) for loads in strange) >= 57


@pytest.mark.rest
def test_with_nothing_in_common_the_batch_does_no_harm():
    """In pairs over sensors of batches at ρ = 0."""
    there_mm, squared = place_sunflower(60), []
    for seed in range(3):
        random = np.random.default_rng([33, seed])
        sensors, common = draw_batch(random, 0.0)
        learner = BatchLearner(learn_batch(sensors, radius_mm=RADIUS_MM).prior, "")
        for _ in range(6):
            response = draw_map(random, common, 0.0)
            loads = press(random, response, place_sunflower(9))
            given = loads.places_mm, loads.log_response, loads.variance
            truth = response(there_mm)
            maps = learner(*given, radius_mm=RADIUS_MM), learn_response(*given, radius_mm=RADIUS_MM)
            squared.append([np.mean((one.predict(there_mm)[0] - truth) ** 2) for one in maps])
    with_batch, without = np.sqrt(np.mean(squared, axis=0))
    assert with_batch < 1.02 * without


def test_bend_is_learned_with_the_map(drawn):
    """A bend that loads of very different stress show is found, and uncertain by less than its prior."""
    model, common, random = drawn
    response, places_mm = draw_map(random, common, 0.9), place_sunflower(12)
    bend = np.where(np.arange(12) % 2 == 0, 4.0, -2.0)
    plain = press(random, response, places_mm)
    bent = replace(plain, log_response=plain.log_response + 0.02 * bend, bend=bend, bend_stderr=0.05)
    value, variance = model.prior.learn_response(bent).bend
    assert abs(value - 0.02) < 4 * np.sqrt(variance)
    assert np.sqrt(variance) < 0.01
