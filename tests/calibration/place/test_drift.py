"""Drift of simulated errors whose truth is known."""

import numpy as np
import pytest

from cbsr_qa.calibration.place.drift import find_drift, session_of

COUNT, READINGS = 120, 40


def errors_of(drift):
    """Errors of variance one about a drift (n, m), and what features are expected."""
    random = np.random.default_rng(1)
    expected = 3 + random.standard_normal((COUNT, READINGS))
    return random.standard_normal((COUNT, READINGS)) + drift * np.ones_like(expected), expected


def drift_of(errors, expected, time_s=None):
    return find_drift(errors, expected, session_of(errors, time_s))


@pytest.mark.parametrize("timed", [True, False])
def test_a_jump_at_the_end_is_a_re_check(timed):
    jump = 2 * np.random.default_rng(2).standard_normal(READINGS)
    errors, expected = errors_of(np.where(np.arange(COUNT)[:, None] < COUNT - 9, 0.0, jump))
    time_s = np.arange(COUNT) + np.where(np.arange(COUNT) < COUNT - 9, 0.0, 1000.0)
    drift = drift_of(errors, expected, time_s if timed else None)
    assert drift.late == 9
    assert drift.horizon == 1
    found = drift.since[: COUNT - 9].mean(axis=0)
    assert np.std(found - jump) < 1 / np.sqrt(9) * 1.5  # nine presses tell a mean to a third of an error
    assert np.abs(drift.since[-9:]).mean() < 1.0  # brought to where eight others are


@pytest.mark.parametrize("odd", [1, 2, 3])
def test_one_odd_press_is_no_re_check(odd):
    errors, expected = errors_of(np.zeros((COUNT, READINGS)))
    errors[-odd] += 8 * np.random.default_rng(4).standard_normal(READINGS)
    drift = drift_of(errors, expected)
    assert drift is None or drift.late == 0


def test_a_walk_is_followed():
    walk = np.cumsum(0.3 * np.random.default_rng(3).standard_normal((COUNT, READINGS)), axis=0)
    drift = drift_of(*errors_of(walk - walk.mean(axis=0)))
    assert drift.late == 0
    left = walk + drift.since - walk[-1]
    assert np.sqrt((left**2).mean()) < 0.5 * np.sqrt(((walk - walk[-1]) ** 2).mean())


def test_presses_in_random_order_show_none():
    assert drift_of(*errors_of(0.0)) is None
