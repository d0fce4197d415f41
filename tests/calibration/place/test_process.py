"""The Gaussian process from features to places, and templates of presses without some of them."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, pressed_sheet
from scipy.optimize import check_grad

from cbsr_qa.calibration.place.features import compute_squared_distances, features_of, pattern_turns
from cbsr_qa.calibration.place.process import (
    _AT_ONCE,
    _Likelihood,
    condition_on_presses,
    leave_out,
    likely_scales,
    list_edge_hyperparameters,
    locate,
)
from cbsr_qa.calibration.place.templates import NO_PRESS, TemplateLearning, _posterior
from cbsr_qa.domain.results.learned_place import FeatureScaling

TURNS = pattern_turns(adjacent_pairs(8), 8)


@pytest.fixture(scope="module")
def presses():
    random = np.random.default_rng(3)
    features = random.standard_normal((14, TURNS.permuted.shape[1]))
    return features, 10 * features[:, :2] + random.standard_normal((14, 2))


@pytest.fixture(scope="module")
def scales(presses):
    return likely_scales(TURNS, *presses)


def test_gradient_of_the_likelihood(presses):
    likelihood = _Likelihood(TURNS, *presses)
    logs = likelihood.start() + np.random.default_rng(4).uniform(-1, 1, len(likelihood.start()))
    slope = np.linalg.norm(likelihood(logs)[1])
    assert check_grad(lambda x: likelihood(x)[0], lambda x: likelihood(x)[1], logs, epsilon=1e-6) < 1e-5 * slope


def test_the_search_makes_presses_more_likely(presses):
    likelihood = _Likelihood(TURNS, *presses)
    found = likely_scales(TURNS, *presses)
    logs = np.log([found.own_variance, found.turning_variance, found.noise_variance])
    orbits = [found.turning[TURNS.orbits() == number][0] for number in range(TURNS.orbits().max() + 1)]
    assert (
        likelihood(np.concatenate([logs, np.log(found.own), np.log(orbits)]))[0] < likelihood(likelihood.start())[0]
    )


def test_presses_left_out_are_located_as_by_the_others_alone(presses, scales):
    features, places = presses
    blocks = np.array_split(np.arange(14), 4)
    predicted = leave_out(*condition_on_presses(scales, TURNS, features, places), blocks)
    for block in blocks:
        others = np.setdiff1d(np.arange(14), block)
        process, _ = condition_on_presses(scales, TURNS, features[others], places[others])
        assert locate(process, TURNS, features[block]) == pytest.approx(predicted[block], abs=1e-8)


def test_many_frames_are_located_as_each_alone(presses, scales):
    features, places = presses
    process, _ = condition_on_presses(scales, TURNS, features, places)
    frames = np.random.default_rng(6).standard_normal((1000, features.shape[1]))
    assert len(frames) * len(TURNS) * len(features) > 3 * _AT_ONCE
    together = locate(process, TURNS, frames)
    for number in range(0, 1000, 37):
        assert together[number] == pytest.approx(locate(process, TURNS, frames[number : number + 1])[0], abs=1e-9)


def test_the_turning_part_turns_places_with_readings(presses, scales):
    features, places = presses
    turning = replace(scales, own_variance=0.0)
    process, _ = condition_on_presses(turning, TURNS, features, places)
    frame = np.random.default_rng(5).standard_normal((2, features.shape[1]))
    for number, turn in enumerate(TURNS.turns):
        there = locate(process, TURNS, TURNS.turn_forth(frame, number))
        assert there == pytest.approx(locate(process, TURNS, frame) @ turn.T, abs=1e-9)


def test_a_hyperparameter_at_the_edge_of_its_range_is_named(presses, scales):
    assert list_edge_hyperparameters(scales, *presses) == []
    assert list_edge_hyperparameters(replace(scales, noise_variance=1e8), *presses) == ["noise"]


@pytest.mark.parametrize(
    "without_these",
    [pytest.param([3], marks=pytest.mark.rest), [0, 7, 8, 39], pytest.param(range(20), marks=pytest.mark.rest)],
)
def test_templates_without_presses_are_those_of_the_others(without_these):
    sheet = pressed_sheet(40, seed=3, noise=0.05)
    turns = pattern_turns(sheet.pairs, 16)
    features = features_of(sheet.changes, FeatureScaling(0.7, 0.5, np.full(len(sheet.pairs), np.inf)))
    others = np.setdiff1d(np.arange(40), without_these)
    of_all = TemplateLearning(turns, features, sheet.places_mm, 50.0)
    of_others = TemplateLearning(turns, features[others], sheet.places_mm[others], 50.0)
    without, alone = of_all.leave_out_block(np.array(without_these)), of_others.leave_out_block(NO_PRESS)
    np.testing.assert_allclose(without.uncertainty, alone.uncertainty, rtol=0, atol=1e-9)
    for name in ("whitening", "templates"):
        expected = getattr(alone, name)
        np.testing.assert_allclose(getattr(without, name), expected, rtol=5e-7, atol=5e-9 * np.abs(expected).max())


def test_misfits_of_presses_left_out_are_those_at_their_places():
    """On a fine grid a template beside a press is as that at its place."""
    sheet = pressed_sheet(60, seed=3, noise=0.5)
    turns = pattern_turns(sheet.pairs, 16)
    features = features_of(sheet.changes, FeatureScaling(0.7, 0.5, np.full(len(sheet.pairs), np.inf)))
    learning, block = TemplateLearning(turns, features, sheet.places_mm, 46.0), np.arange(20, 40)
    templates = learning.leave_out_block(block)
    _, squared = _posterior(templates, features[block])
    at_places = squared * (1 + templates.uncertainty) / features.shape[1]
    nearest = compute_squared_distances(sheet.places_mm[block], templates.grid_mm).argmin(axis=1)
    expected = at_places[np.arange(20), nearest]
    assert np.median(learning.misfits_left_out(block) / expected) == pytest.approx(1, abs=0.05)
