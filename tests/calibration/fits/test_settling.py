"""Settling times against closed forms, and means with censoring."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cbsr_qa.calibration.fits.settling import estimate_restricted_mean, settling_time
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit


def _fit(offset, amplitudes=(), taus=(), status=None):
    kinds = {0: FitStatus.FLAT, 1: FitStatus.ONE, 2: FitStatus.TWO}
    errors = tuple(0.1 for _ in taus)
    return RelaxationFit(status or kinds[len(taus)], offset, amplitudes, taus, 0.01, errors, 0.99, "said")


@given(st.floats(0.2, 5), st.floats(1, 12), st.floats(0.01, 0.19))
def test_one_exponential_settles_after_tau_times_the_logarithm(amplitude, tau, tolerance):
    found = settling_time(_fit(1.0, (-amplitude,), (tau,)), window_s=600.0, tolerance=tolerance)
    assert found.value_s == pytest.approx(tau * np.log(amplitude / tolerance), rel=1e-9)
    assert not found.censored
    assert found.band == pytest.approx(tolerance)


def test_the_step_band_is_of_the_relaxing_part():
    found = settling_time(_fit(1.0, (-0.5,), (10.0,)), window_s=60.0, band="step")
    assert found.value_s == pytest.approx(10 * np.log(1 / 0.15))


def test_unloading_takes_the_band_of_the_loaded_change():
    found = settling_time(_fit(0.0, (0.62,), (25.4,)), window_s=60.0, loaded_change=1.0)
    assert found.value_s == pytest.approx(25.4 * np.log(0.62 / 0.15))
    assert found.value_s == pytest.approx(36.0, abs=0.1)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-9, 1e-6])
def test_opposite_exponentials_that_are_alike(gap):
    """0.5 e^(−t/τ) whatever way it is shared out, to the rounding of the shares."""
    fit = _fit(1.0, (1.0, -0.5), (20.0, 20.0 * (1 + gap)))
    found = settling_time(fit, window_s=100.0).value_s
    assert found == pytest.approx(20.0 * np.log(0.5 / 0.15), rel=1e-12 + 2 * gap)


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.5, 10), st.floats(1.2, 20))
def test_the_answer_is_that_of_a_dense_search(one, other, fast, ratio):
    fit = _fit(1.0, (one, other), (fast, fast * ratio))
    found = settling_time(fit, window_s=60.0)
    time_s = np.linspace(0, 60, 6001)
    outside = np.abs(one * np.exp(-time_s / fast) + other * np.exp(-time_s / (fast * ratio))) > 0.15
    assert found.censored == outside[-1]
    # The true last exit lies between the last point seen outside and the next one.
    last_s = float(time_s[outside][-1]) if outside.any() else 0.0
    assert found.value_s is not None
    assert last_s - 1e-6 <= found.value_s <= last_s + 0.0101


def test_a_trace_that_does_not_settle_in_its_window_is_censored():
    found = settling_time(_fit(1.0, (-0.9,), (60.0,)), window_s=60.0)
    assert found.censored
    assert found.value_s == 60.0
    assert "not settled within 60 s" in found.why


def test_a_drifting_trace_is_later_than_its_window():
    drifting = replace(_fit(0.4), status=FitStatus.DRIFTING)
    found = settling_time(drifting, window_s=60.0)
    assert (found.value_s, found.censored, found.why) == (60.0, True, "said")


@pytest.mark.parametrize(
    "fit",
    [_fit(0.45), _fit(0.3, (0.5,), (12.0,)), _fit(-0.3, (1.0,), (12.0,))],
    ids=["flat", "fast, ends above", "fast, ends below"],
)
def test_an_unloading_that_has_not_come_back_has_not_settled(fit):
    found = settling_time(fit, window_s=60.0, loaded_change=1.0)
    assert found.censored
    assert found.value_s == 60.0
    assert "of the change under load is left" in found.why


def test_behind_a_spike_nothing_settles_earlier_than_the_fit_begins():
    assert settling_time(_fit(0.0, (0.1,), (30.0,)), window_s=60.0, loaded_change=1.0, start_s=7.5).value_s == 7.5
    late = settling_time(_fit(0.0, (0.6,), (20.0,)), window_s=60.0, loaded_change=1.0, start_s=7.5)
    assert late.value_s == pytest.approx(20 * np.log(0.6 / 0.15))


def test_a_rejected_fit_and_a_missing_band_have_no_number():
    rejected = settling_time(_fit(1.0, (1.0,), (5.0,), FitStatus.REJECTED), window_s=60.0)
    assert rejected.value_s is None
    assert "said" in rejected.why
    nothing = settling_time(_fit(0.0, (1.0,), (5.0,)), window_s=60.0)
    assert nothing.value_s is None
    assert "no steady change" in nothing.why


@pytest.mark.parametrize(
    ("settings", "said"),
    [({"band": "peak"}, "'steady' or 'step'"), ({"window_s": 0.0}, "positive"), ({"tolerance": 0.0}, "positive")],
)
def test_impossible_settings_are_refused(settings, said):
    with pytest.raises(NumericsError, match=said):
        settling_time(_fit(1.0), **({"window_s": 60.0} | settings))


# --- means with censoring ------------------------------------------------------------------------------------


@given(st.lists(st.floats(0, 100), min_size=1, max_size=20))
def test_without_censoring_it_is_the_plain_mean_and_deviation(times):
    mean, deviation = estimate_restricted_mean(times, [False] * len(times))
    assert mean == pytest.approx(np.mean(times), abs=1e-9)
    assert deviation == pytest.approx(np.std(times), abs=1e-5)


def test_times_that_agree_to_a_hundred_millionth_have_their_deviation():
    mean, deviation = estimate_restricted_mean([30.0 + 3e-7, 30.0 - 3e-7], [False, False])
    assert mean == pytest.approx(30.0, rel=1e-15)
    assert deviation == pytest.approx(3e-7, rel=1e-7)


def test_kaplan_and_meier_by_hand():
    # At 30 one of three left settles: S = 1, 3/4 is not touched by the one lost at 20.
    mean, _ = estimate_restricted_mean([10.0, 20.0, 30.0, 40.0], [False, True, False, False])
    assert mean == pytest.approx(10 + 20 * 0.75 + 10 * 0.375)


@given(st.lists(st.tuples(st.floats(0, 100), st.booleans()), min_size=1, max_size=12))
def test_calling_a_time_censored_never_shortens_the_mean(pairs):
    times = [time for time, _ in pairs]
    plain, _ = estimate_restricted_mean(times, [False] * len(times))
    marked, deviation = estimate_restricted_mean(times, [mark for _, mark in pairs])
    assert marked >= plain - 1e-9
    assert deviation >= 0


def test_no_time_has_no_mean():
    with pytest.raises(NumericsError, match="no mean"):
        estimate_restricted_mean([], [])
