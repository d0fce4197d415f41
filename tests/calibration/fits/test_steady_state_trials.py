"""Transient compensation on simulated sensors: bias, total error and honesty; benchmarks/steady_state.py has more."""

import numpy as np
import pytest
from steady_trials import Trial, rms, tried


@pytest.mark.rest
@pytest.mark.parametrize(
    ("trial", "worst"),
    [
        pytest.param(Trial(sensors=40, held=40), 0.03, id="0.4 frames/s"),
        pytest.param(Trial(period_s=0.25, sensors=20, held=60), 0.02, id="4 frames/s"),
    ],
)
def test_three_tenths_of_the_settling_time_give_the_steady_state(trial, worst):
    found = tried(trial)
    assert len(found.error) >= 500
    assert abs(found.error.mean()) < 0.01
    assert rms(found.error) < worst
    assert 0.64 <= found.cover(0.68) <= 0.72
    assert 0.93 <= found.cover(0.95) <= 0.97
    assert rms(found.uncompensated) > 0.3
    assert found.misfit.mean() == pytest.approx(1.0, abs=0.15)


@pytest.mark.rest
def test_what_a_release_leaves_is_seen_early():
    found = tried(Trial(sensors=25, held=20, releases=True, seed=3))
    assert abs(found.error.mean()) < 0.01
    assert rms(found.error) < 0.02
    assert 0.62 <= found.cover(0.68) <= 0.76
    assert rms(found.uncompensated) > 0.3


@pytest.mark.rest
def test_one_load_gives_wide_intervals_that_hold():
    found = tried(Trial(sensors=60, held=5, loads=1, seed=4))
    assert found.cover(0.68) >= 0.68
    assert found.cover(0.95) >= 0.95
    assert np.median(found.stderr) > 0.1
