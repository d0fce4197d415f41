"""A sensor's map by its batch: what it answers, and when the batch does not count."""

import numpy as np
import pytest
from batches import RADIUS_MM, draw_field, draw_map, place_sunflower, press
from kept_batches import STRENGTH, keep_sample, learn_sample

from cbsr_qa.calibration.batch.kept import keep_kernel, make_kernel, make_prior
from cbsr_qa.calibration.batch.learning import BatchLearner
from cbsr_qa.calibration.batch.loads import SensorLoads
from cbsr_qa.calibration.sheet.response_map import ResponseMap, learn_response
from cbsr_qa.domain.errors import CalibrationError

TARGETS_MM = np.array([[0.0, 0.0], [20.0, 20.0], [-35.0, 5.0], [3.0, 4.0]])
CANDIDATES_MM = np.array([[10.0, -30.0], [-25.0, 12.0], [3.0, 4.0]])


@pytest.fixture(scope="module")
def prior():
    return learn_sample().prior


@pytest.fixture(scope="module")
def learner(prior):
    return BatchLearner(prior, "d" * 64)


def like_its_batch(random, count=8):
    """Loads drawn from the batch's own predictive distribution: its common map, and a small one of the sensor's own."""
    places = place_sunflower(count)
    common, _ = learn_sample().prior.predict(places)
    own = draw_field(random)(places) * 0.05
    loads = press(random, lambda at: common + own, places)
    return loads.places_mm, loads.log_response, loads.variance


def of_another_batch(random, count=8):
    loads = press(random, draw_map(random, draw_field(random), 0.9), place_sunflower(count))
    return loads.places_mm, loads.log_response, loads.variance


def test_the_members_mix_to_the_prediction_and_their_covariance_has_their_variance(learner):
    learned = learner(*like_its_batch(np.random.default_rng(1)), radius_mm=RADIUS_MM)
    means, variances = learned.predict_members(TARGETS_MM)
    mean, variance = learned.predict(TARGETS_MM)
    np.testing.assert_allclose(learned.weights @ means, mean)
    np.testing.assert_allclose(learned.weights @ (variances + (means - mean) ** 2), variance)
    own = np.diagonal(learned.covariance(TARGETS_MM, TARGETS_MM), axis1=1, axis2=2)
    np.testing.assert_allclose(own, variances, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("candidate", range(len(CANDIDATES_MM)))
def test_one_more_press_leaves_the_variance_of_the_map_that_has_it(prior, candidate):
    places, values, variance = like_its_batch(np.random.default_rng(2))
    before = prior.learn_response(SensorLoads(places, values, variance))
    at_mm = CANDIDATES_MM[candidate : candidate + 1]
    expected = before.predict(at_mm)[0]  # so that the weights change least
    more = SensorLoads(np.vstack([places, at_mm]), np.append(values, expected), np.append(variance, 3e-4))
    after = before.variance_after(CANDIDATES_MM, TARGETS_MM, 3e-4)[:, candidate]
    _, with_press = prior.learn_response(more).predict_members(TARGETS_MM)
    # Which members are kept depends on the value of the press: those of largest weight are in both.
    for member in after[np.argsort(-before.weights)[:3]]:
        assert np.abs(with_press - member).max(axis=1).min() < 1e-9


def test_a_sensor_like_its_batch_is_surer_than_alone_and_says_what_it_owes(learner):
    loads = like_its_batch(np.random.default_rng(3), count=5)
    learned, alone = learner(*loads, radius_mm=RADIUS_MM), learn_response(*loads, radius_mm=RADIUS_MM)
    assert learned.batch is not None
    assert learned.batch.alike
    assert 0 < learned.batch.share < 1
    assert learned.predict(TARGETS_MM)[1].mean() < 0.5 * alone.predict(TARGETS_MM)[1].mean()


def test_a_sensor_of_another_batch_has_the_map_of_its_own_loads(learner):
    random = np.random.default_rng(4)
    named = 0
    for _ in range(20):
        loads = of_another_batch(random)
        learned = learner(*loads, radius_mm=RADIUS_MM)
        if isinstance(learned, ResponseMap):
            named += 1
            assert learned.batch is not None
            assert not learned.batch.alike
            assert learned.batch.share == 0
            alone = learn_response(*loads, radius_mm=RADIUS_MM)
            np.testing.assert_array_equal(learned.predict(TARGETS_MM), alone.predict(TARGETS_MM))
    assert named >= 16


def test_too_few_loads_are_refused(learner):
    with pytest.raises(CalibrationError, match="2 loads do not show whether a sensor is like its batch"):
        learner(*like_its_batch(np.random.default_rng(5), count=2), radius_mm=RADIUS_MM)


def test_what_is_kept_makes_the_same_prior_and_kernel(prior):
    for found, wanted in zip(make_prior(keep_sample()).predict(TARGETS_MM), prior.predict(TARGETS_MM), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert keep_kernel(make_kernel(STRENGTH)) == STRENGTH
