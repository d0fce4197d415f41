"""One more load at fixed hyperparameters: its rank-one update against a map that was given the load."""

from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.calibration.sheet.response_map import ResponseMap, learn_response
from cbsr_qa.calibration.sheet.response_processes import combine_loads, compute_covariance, condition_family

RADIUS_MM = 50.0
CANDIDATES_MM = np.array([[10.0, -30.0], [-25.0, 12.0], [3.0, 4.0]])
TARGETS_MM = np.array([[0.0, 0.0], [20.0, 20.0], [-35.0, 5.0], [3.0, 4.0]])
VARIANCE = 3e-4


def loads(count=9, seed=1):
    generator = np.random.default_rng(seed)
    places = generator.uniform(-35, 35, (count, 2))
    places[-1] = CANDIDATES_MM[2]  # one candidate was pressed before
    return places, generator.normal(0, 0.2, count), generator.uniform(1e-5, 1e-3, count)


def variance_with(response, number, place, places, variance, bend):
    """Variance at the targets of a member that has one more load; the value of the load does not matter."""
    member = response.members[number]
    columns = np.ones((len(variance), 1)) if bend is None else np.column_stack([np.ones(len(variance)), bend])
    columns = np.vstack([columns, np.eye(columns.shape[1])[0]])
    where = np.vstack([places, place])
    known = np.zeros((1, 1)) if bend is None else np.diag([0.0, 1 / 0.02**2])
    unique, which = np.unique(where, axis=0, return_inverse=True)
    every = np.append(variance, VARIANCE) + member.scatter**2 + 1e-12
    data = {member.scatter: combine_loads(which.ravel(), np.column_stack([columns, columns[:, 0]]), every, known)}
    alike = compute_covariance(unique, unique, member.length_mm, member.smooth)
    family = condition_family(data, alike, member.smooth, member.length_mm)
    at = [family.member(d, 0).deviation for d in range(len(family.score))].index(member.deviation)
    return ResponseMap(unique, (family.member(at, 0),), np.ones(1)).predict(TARGETS_MM)[1]


@pytest.mark.parametrize("with_bend", [False, True])
def test_variance_is_that_of_the_map_with_the_press(with_bend):
    places, values, variance = loads()
    bend = np.linspace(-1, 1, len(values)) if with_bend else None
    response = learn_response(places, values, variance, radius_mm=RADIUS_MM, bend=bend, bend_stderr=0.02)
    after = response.variance_after(CANDIDATES_MM, TARGETS_MM, VARIANCE)
    for number in range(0, len(response.members), 29):
        for candidate, place in enumerate(CANDIDATES_MM):
            added = variance_with(response, number, place, places, variance, bend)
            np.testing.assert_allclose(after[number, candidate], added, rtol=1e-6, atol=1e-12)


def test_a_press_never_adds_variance_and_mixes_as_the_prediction_does():
    places, values, variance = loads(seed=2)
    response = learn_response(places, values, variance, radius_mm=RADIUS_MM)
    means, now = response.predict_members(TARGETS_MM)
    assert (response.variance_after(CANDIDATES_MM, TARGETS_MM, VARIANCE) <= now[:, None] + 1e-15).all()
    mean, total = response.predict(TARGETS_MM)
    np.testing.assert_allclose(response.weights @ (now + (means - mean) ** 2), total)


def test_the_covariance_of_places_with_themselves_is_their_variance():
    places, values, variance = loads(seed=3)
    response = learn_response(places, values, variance, radius_mm=RADIUS_MM)
    own = np.diagonal(response.covariance(TARGETS_MM, TARGETS_MM), axis1=1, axis2=2)
    np.testing.assert_allclose(own, response.predict_members(TARGETS_MM)[1], rtol=1e-7, atol=1e-13)


def test_fifty_presses_of_one_place_leave_its_scatter_and_nothing_negative():
    places, values, variance = loads(seed=4)
    where = np.vstack([places, np.tile(CANDIDATES_MM[1], (50, 1))])
    more = np.append(values, np.full(50, 0.1)), np.append(variance, np.full(50, VARIANCE))
    response = learn_response(where, *more, radius_mm=RADIUS_MM)
    after = response.variance_after(CANDIDATES_MM, TARGETS_MM, VARIANCE)
    assert (after >= 0).all()
    single = replace(response, members=response.members[:1], weights=np.ones(1))
    at_place = single.variance_after(CANDIDATES_MM[1:2], CANDIDATES_MM[1:2], VARIANCE)[0, 0, 0]
    assert at_place <= (VARIANCE + single.members[0].scatter ** 2) / 50
