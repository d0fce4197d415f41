"""Regions hold what they state."""

import numpy as np
import pytest

from cbsr_qa.calibration.place.held_out import LeftOut, PressedSheet, coverage_of
from cbsr_qa.calibration.place.mixture import LEVELS, learn_mixture, mahalanobis, mix_places, quantile


@pytest.mark.parametrize("count", [6, 9, 39, 400])
def test_quantiles_hold_the_next_press(count):
    random = np.random.default_rng(count)
    inside = np.zeros(2)
    for _ in range(2000):
        ratio = random.chisquare(2, count)
        inside += [random.chisquare(2) <= quantile(ratio, level) for level in LEVELS]
    # Three standard errors of 2000 tries; where too few were left out for 95 %, the largest ratio seen may hold more.
    assert inside[0] / 2000 == pytest.approx(0.68, abs=0.032)
    assert 0.95 - 0.015 <= inside[1] / 2000 <= 0.98


def test_the_better_estimate_gets_the_larger_share():
    random = np.random.default_rng(1)
    places, noise = random.uniform(-40, 40, (300, 2)), random.standard_normal((2, 300, 2))
    covariance = np.broadcast_to(np.eye(2), (300, 2, 2))
    good, poor = places + noise[0], places + 3 * noise[1]
    # Independent errors of variances 1 and 9: the best share of the second is 1/10, or 9/10.
    assert learn_mixture(good, poor, covariance, places, np.arange(300)).share == pytest.approx(0.1, abs=0.05)
    assert learn_mixture(poor, good, covariance, places, np.arange(300)).share == pytest.approx(0.9, abs=0.05)


def test_regions_follow_frames_that_are_worse():
    """Where the second estimate says that it is unsure, and is, regions grow there and shrink elsewhere."""
    random = np.random.default_rng(2)
    places, size = random.uniform(-40, 40, (2000, 2)), np.where(np.arange(2000) % 4, 0.5, 5.0)
    second = places + size[:, None] * random.standard_normal((2000, 2))
    covariance = size[:, None, None] ** 2 * np.eye(2)
    mixture = learn_mixture(second + 0.01, second, covariance, places, np.arange(2000))
    found, covariances = mix_places(mixture, second + 0.01, second, covariance)
    inside = mahalanobis(places - found, covariances)[:, None] <= mixture.quantiles
    for large in (False, True):
        assert inside[(size > 1) == large].mean(axis=0) == pytest.approx(LEVELS, abs=0.04)


def test_presses_of_one_place_count_as_one():
    """Eight presses at each of twelve places, which err alike there."""
    random = np.random.default_rng(3)
    visits, inside = np.repeat(np.arange(12), 8), np.zeros(2)
    for _ in range(2000):
        ratio = random.chisquare(2, 12)[visits] * random.uniform(0.9, 1.1, 96)
        inside += [random.chisquare(2) <= quantile(ratio, level, visits) for level in LEVELS]
    assert inside[0] / 2000 == pytest.approx(0.68, abs=0.032)
    assert 0.95 - 0.015 <= inside[1] / 2000 <= 0.98  # by presses: 0.88


@pytest.mark.parametrize("places", [9, 41, 121, 901])
def test_no_press_is_judged_by_another_at_its_place(places):
    """The same presses, two at a place one after the other and in two rounds, tell the same."""
    random = np.random.default_rng(places)
    at, error = random.uniform(-40, 40, (places, 2)), random.standard_t(3, (2, places, 2))
    found = {}
    for name, which in (("pairs", np.repeat(np.arange(places), 2)), ("rounds", np.tile(np.arange(places), 2))):
        parts = at[which] + error[0, which], at[which] + error[1, which], np.tile(np.eye(2), (2 * places, 1, 1))
        none = np.zeros(2 * places)
        out = LeftOut(np.arange(2 * places), *parts, none, none)
        mixture, held = out.mixture(at[which]), coverage_of(out, at[which])
        found[name] = np.concatenate([[mixture.share], mixture.quantiles, held.held, [held.mean_mm, held.stderr_mm]])
        sheet = PressedSheet(None, none, at[which])  # only places matter here
        for learned, located in sheet.presses_for_scales():
            assert not set(which[learned]) & set(which[located])
    assert found["pairs"] == pytest.approx(found["rounds"], rel=1e-3)


def test_errors_are_stated_where_only_some_presses_were_left_out():
    """Of more than 800 presses some are not left out."""
    random = np.random.default_rng(4)
    places, some = random.uniform(-40, 40, (60, 2)), np.arange(20, 60, 2)
    errors, none = random.standard_normal((2, 20, 2)), np.zeros(20)
    out = LeftOut(some, *(places[some] + errors), np.tile(np.eye(2), (20, 1, 1)), none, none)
    held = coverage_of(out, places)
    error_mm = np.linalg.norm(held.found_mm - places[some], axis=1)
    assert (held.mean_mm, held.stderr_mm) == pytest.approx((error_mm.mean(), error_mm.std(ddof=1) / 20**0.5))
