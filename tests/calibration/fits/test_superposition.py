"""Steps that overlap in time, taken apart, against the closed forms they were made of."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st
from strip_samples import Truth, cycles, steps_of
from tiers import rest_but

from cbsr_qa.calibration.fits.superposition import (
    constants_of,
    fit_step,
    separate_steps,
    separate_with_constants,
    shift_constants,
)
from cbsr_qa.calibration.strip.slow_residue import SlowResidue, changes_of, separate_with_residue, subtract_residue
from cbsr_qa.domain.results.relaxation import FitStatus

STRAINS = np.repeat([0.1, 0.2, 0.3], 3)


@pytest.fixture(scope="module")
def steps():
    return steps_of(Truth(), cycles((0.1, 0.2, 0.3), 3))


@pytest.fixture(scope="module")
def plain(steps):
    return separate_steps(steps)


def noisy(steps, rms, seed):
    random = np.random.default_rng(seed)
    return [replace(one, values=one.values + rms * random.standard_normal(len(one.values))) for one in steps]


def test_without_noise_steps_come_apart_as_they_were_made(steps, plain):
    """Steady changes, time constants and rests, to what sharing one shape over different ramps costs."""
    found, material = plain, Truth().material
    assert {one.fit.status for one in found.common.values()} == {FitStatus.TWO}
    for loading, kernel in ((True, material.loading_relaxation), (False, material.unloading_relaxation)):
        assert constants_of(found.common)[loading] == pytest.approx(kernel.time_constants_s, rel=0.02)
    np.testing.assert_allclose(changes_of(found, steps), 0.6 * STRAINS, rtol=2e-3)
    np.testing.assert_allclose(found.levels[1::2], 0.0, atol=5e-4)


@drawn(20)
@given(st.floats(0.01, 100.0), st.sampled_from([-1.0, 1.0]), st.floats(-1.0, 1.0))
def test_scale_sign_and_offset_carry_through(steps, plain, scale, sign, offset):
    """Separation by given time constants is linear in what was read."""
    common = plain.common
    moved = [replace(one, values=sign * scale * one.values + offset) for one in steps]
    found = separate_with_constants(moved, common, constants_of(common))
    np.testing.assert_allclose(found.levels, sign * scale * plain.levels + offset, rtol=1e-9, atol=1e-9 * scale)


def test_stated_errors_of_levels_are_those_of_the_noise():
    steps = steps_of(Truth(), cycles((0.2,), 3))
    common = separate_steps(steps).common
    constants = constants_of(common)
    drawn = [separate_with_constants(noisy(steps, 2e-3, seed), common, constants) for seed in range(100)]
    levels = np.array([one.levels for one in drawn])
    stated = np.sqrt(np.mean([one.level_stderr**2 for one in drawn], axis=0))
    # Carried-over parts add a little: held to what 100 draws can tell, 7 % each way, and that.
    assert levels.std(axis=0, ddof=1) == pytest.approx(stated, rel=0.25)


@pytest.mark.rest
def test_a_residue_that_outlasts_them_is_found_and_taken_away():
    truth = Truth(residue=0.02)
    steps = noisy(steps_of(truth, cycles((0.1, 0.2, 0.3), 6)), 4e-4, 1)
    expected = 0.6 * np.repeat([0.1, 0.2, 0.3], 6)
    found, residue = separate_with_residue(steps)
    share_error, log_error = np.sqrt(np.diag(residue.covariance))
    assert abs(residue.share - 0.02) < 3 * share_error
    assert abs(np.log(residue.decay_s / 600.0)) < 3 * log_error
    slope = changes_of(found, steps) @ expected / (expected @ expected)
    assert slope == pytest.approx(1.0, abs=5e-3)
    plain = changes_of(separate_steps(steps), steps) @ expected / (expected @ expected)
    assert plain < 0.995  # without it


@pytest.mark.parametrize("seed", rest_but({0}, range(2)))
def test_no_residue_is_found_where_there_is_none(seed):
    steps = noisy(steps_of(Truth(), cycles((0.1, 0.2, 0.3), 4)), 2e-3, seed)
    assert separate_with_residue(steps)[1] is None


def test_what_is_taken_away_of_a_residue_is_its_closed_form():
    planned = cycles((0.2,), 3)
    with_it, without = (steps_of(Truth(residue=share), planned) for share in (0.05, 0.0))
    changes = np.full(3, 0.6 * 0.2)
    residue = SlowResidue(0.05, 600.0, np.eye(2))
    for one, other in zip(subtract_residue(with_it, changes, residue), without, strict=True):
        np.testing.assert_allclose(one.values, other.values, atol=2e-5)  # the ramp of the release is a step here
    assert subtract_residue(with_it, changes, None) == with_it


def test_errors_of_time_constants_move_levels_as_their_covariance_says():
    steps = noisy(steps_of(Truth(), cycles((0.1, 0.2, 0.3), 3)), 2e-3, 5)
    found = separate_steps(steps)
    shifted = shift_constants(found.common)
    assert len(shifted) == 4
    for loading in (True, False):
        moved = np.array([np.log(one[loading] / constants_of(found.common)[loading]) for one in shifted])
        np.testing.assert_allclose(moved.T @ moved, found.common[loading].covariance[3:, 3:], rtol=1e-6, atol=1e-12)


def test_a_trace_with_too_few_points_goes_by_its_end():
    time_s, values = np.arange(3.0), np.array([5.0, 2.0, 1.0])
    (level,), stderr = fit_step((time_s, values), np.zeros(0))
    assert (level, stderr) == (1.0, 0.0)
    coefficients, _ = fit_step((time_s, values), np.array([1.0, 10.0]))
    np.testing.assert_array_equal(coefficients, [1.0, 0.0, 0.0])


def test_nothing_at_all_is_no_residue():
    steps = [replace(one, values=np.zeros_like(one.values)) for one in steps_of(Truth(), cycles((0.2,), 3))]
    found, residue = separate_with_residue(steps)
    assert residue is None
    assert not found.levels.any()
    assert not changes_of(found, steps).any()
