"""Two-exponential fits: exact recovery, honest fallbacks, invariances, and named refusals."""

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.calibration.fits.relaxation import fit_relaxation, relaxation_curve
from cbsr_qa.calibration.fits.settling import relaxation_start, settling_time
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.results.relaxation import FitStatus

TIME_S = np.arange(0.0, 60.0, 2.5)


def _curve(offset, amplitudes, taus, time_s=TIME_S):
    return offset + sum(a * np.exp(-time_s / tau) for a, tau in zip(amplitudes, taus, strict=True))


@given(
    offset=st.floats(-5, 5),
    scale=st.floats(1e-6, 1e6),
    fast=st.floats(2.0, 5.0),
    ratio=st.floats(5, 12),
    share=st.floats(0.25, 4),
)
@drawn(40)
def test_well_separated_exponentials_are_recovered_at_any_scale(offset, scale, fast, ratio, share):
    values = scale * _curve(offset, (share, 1.0), (fast, ratio * fast))
    fit = fit_relaxation(TIME_S, values)
    assert fit.status is FitStatus.TWO
    assert fit.time_constants_s == pytest.approx((fast, ratio * fast), rel=1e-4)
    assert fit.offset == pytest.approx(scale * offset, rel=1e-4, abs=1e-4 * scale)


def test_a_huge_offset_costs_no_more_than_its_rounding():
    # 1e6 times the signal leaves 1e-10 of it to rounding.
    plain = _curve(0.0, (-0.2, -0.55), (2.5, 23.1))
    fit = fit_relaxation(TIME_S, plain + 1e6)
    assert fit.status is FitStatus.TWO
    assert fit.time_constants_s == pytest.approx((2.5, 23.1), rel=1e-5)
    assert fit.offset - 1e6 == pytest.approx(0.0, abs=1e-6)


@pytest.mark.rest
def test_standard_errors_are_those_seen_over_many_traces():
    random = np.random.default_rng(20260101)
    clean = _curve(1.0, (-0.3, -0.6), (3.0, 20.0), np.arange(0, 80, 1.0))
    taus, stated, offsets, stated_offset = [], [], [], []
    for _ in range(60):
        fit = fit_relaxation(np.arange(0, 80, 1.0), clean + 2e-3 * random.standard_normal(80))
        assert fit.status is FitStatus.TWO
        taus.append(fit.time_constants_s)
        stated.append(fit.time_constant_stderr_s)
        offsets.append(fit.offset)
        stated_offset.append(fit.offset_stderr)
    assert np.std(taus, axis=0, ddof=1) == pytest.approx(np.mean(stated, axis=0), rel=0.3)
    assert np.mean(taus, axis=0) == pytest.approx([3.0, 20.0], rel=0.03)
    assert np.std(offsets, ddof=1) == pytest.approx(np.mean(stated_offset), rel=0.3)


@pytest.mark.rest
def test_a_second_exponential_is_rarely_seen_where_there_is_none():
    random = np.random.default_rng(7)
    clean = _curve(1.0, (-0.75,), (15.0,))
    fits = [fit_relaxation(TIME_S, clean + 5e-3 * random.standard_normal(TIME_S.size)) for _ in range(60)]
    assert sum(fit.status is FitStatus.TWO for fit in fits) <= 2
    assert all(fit.why for fit in fits if fit.status is FitStatus.ONE)


def test_correlated_residuals_do_not_pass_for_a_second_exponential():
    random = np.random.default_rng(11)
    time_s = np.arange(0.0, 60.0, 0.5)
    confident = 0
    for _ in range(30):
        noise = np.zeros(time_s.size)
        for index in range(1, time_s.size):
            noise[index] = 0.9 * noise[index - 1] + 4e-3 * random.standard_normal()
        fit = fit_relaxation(time_s, _curve(1.0, (-0.75,), (15.0,), time_s) + noise)
        confident += fit.status is FitStatus.TWO
    assert confident <= 6


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-3, 0.2])
def test_time_constants_that_are_alike_become_one(gap):
    random = np.random.default_rng(3)
    values = _curve(1.0, (-0.4, -0.4), (10.0, 10.0 * (1 + gap))) + 1e-4 * random.standard_normal(TIME_S.size)
    fit = fit_relaxation(TIME_S, values)
    assert fit.status is FitStatus.ONE
    assert fit.time_constants_s[0] == pytest.approx(10.0 * (1 + gap / 2), rel=0.02)
    assert fit.why


@pytest.mark.parametrize("value", [0.0, 1.0, -1e6, 1e-300])
def test_a_constant_trace_is_flat(value):
    fit = fit_relaxation(TIME_S, np.full(TIME_S.size, value))
    assert fit.status is FitStatus.FLAT
    assert fit.offset == pytest.approx(value)
    assert fit.amplitudes == ()


def test_a_trace_within_the_given_band_is_flat_and_noise_alone_is_not():
    noise = 0.01 * np.random.default_rng(2).standard_normal(TIME_S.size)
    assert fit_relaxation(TIME_S, 1 + noise, flat_within=0.15).status is FitStatus.FLAT
    refused = fit_relaxation(TIME_S, 1 + noise)
    assert refused.status is FitStatus.REJECTED
    assert "0.85" in refused.why


def test_the_gate_is_the_callers():
    random = np.random.default_rng(4)
    values = _curve(0.0, (1.0,), (10.0,)) + 0.12 * random.standard_normal(TIME_S.size)
    lax, strict = (fit_relaxation(TIME_S, values, r_squared_gate=gate) for gate in (0.5, 0.99))
    assert lax.status is FitStatus.ONE
    assert strict.status is FitStatus.REJECTED
    assert strict.r_squared == lax.r_squared < 0.99


def test_a_trace_shorter_than_its_slow_time_constant_claims_no_second_one_it_cannot_see():
    random = np.random.default_rng(5)
    values = _curve(1.0, (-0.5, -0.5), (3.0, 500.0)) + 2e-3 * random.standard_normal(TIME_S.size)
    fit = fit_relaxation(TIME_S, values)
    if fit.status is FitStatus.TWO:
        assert fit.time_constant_stderr_s[1] > 0.02 * fit.time_constants_s[1]
        assert abs(fit.time_constants_s[1] - 500.0) < 5 * fit.time_constant_stderr_s[1]
    assert all(np.isfinite(fit.time_constant_stderr_s))


def test_a_straight_drift_is_slower_than_its_window_and_not_extrapolated():
    values = 0.01 * TIME_S
    fit = fit_relaxation(TIME_S, values)
    assert fit.status is FitStatus.DRIFTING
    assert (fit.amplitudes, fit.time_constants_s) == ((), ())
    assert values[-len(values) // 4] <= fit.offset <= values[-1]
    assert fit.r_squared > 0.85


def test_a_time_constant_beyond_the_window_that_nobody_can_tell_is_a_drift():
    random = np.random.default_rng(21)
    clean = _curve(1.0, (-0.8,), (300.0,))
    fits = [fit_relaxation(TIME_S, clean + 6e-3 * random.standard_normal(TIME_S.size)) for _ in range(40)]
    assert sum(fit.status is FitStatus.DRIFTING for fit in fits) >= 15
    settled = [settling_time(fit, window_s=60.0) for fit in fits if fit.status is not FitStatus.REJECTED]
    assert min(found.value_s for found in settled) > 55.0


def test_a_non_monotone_relaxation_keeps_both_signs():
    fit = fit_relaxation(TIME_S, _curve(1.0, (1.0, -0.8), (3.0, 20.0)))
    assert fit.status is FitStatus.TWO
    assert fit.amplitudes == pytest.approx((1.0, -0.8), rel=1e-6)


@pytest.mark.parametrize("count", [0, 1, 4])
def test_too_few_points_are_rejected(count):
    fit = fit_relaxation(TIME_S[:count], _curve(1.0, (1.0,), (5.0,))[:count])
    assert fit.status is FitStatus.FLAT if count == 1 else FitStatus.REJECTED
    assert np.isfinite(fit.offset)


def test_five_points_allow_one_exponential_only():
    fit = fit_relaxation(TIME_S[:5], _curve(1.0, (1.0, 1.0), (1.0, 9.0))[:5])
    assert fit.status is FitStatus.ONE
    assert "too few points" in fit.why


def test_float32_values_are_taken():
    values = _curve(1.0, (-0.2, -0.55), (2.5, 23.1)).astype(np.float32)
    assert fit_relaxation(TIME_S.astype(np.float32), values).time_constants_s == pytest.approx((2.5, 23.1), rel=1e-3)


@pytest.mark.parametrize(
    ("amplitudes", "taus"), [((0.3, 0.2), (8.0, 20.0)), ((1e-4, 0.2), (5.0, 30.0)), ((0.3, 0.2), (5.0, 70.0))]
)
def test_a_fit_without_noise_is_as_exact_as_its_condition_allows(amplitudes, taus):
    """The search alone stopped 5e4 to 1e6 times further from the truth than rounding puts it."""
    time_s = np.arange(0.0, 62.5, 2.5)
    fit = fit_relaxation(time_s, _curve(1.0, amplitudes, taus, time_s))
    parts = np.exp(-time_s[:, None] / np.array(taus))
    design = np.column_stack([np.ones_like(time_s), parts, parts * time_s[:, None] / np.array(taus) * amplitudes])
    each = np.linalg.norm(np.linalg.pinv(design), axis=1) / [1.0, *amplitudes, 1.0, 1.0]
    bound = 100 * each * np.finfo(float).eps * np.linalg.norm(_curve(1.0, amplitudes, taus, time_s))
    found = np.array([fit.offset, *fit.amplitudes, *fit.time_constants_s])
    assert (np.abs(found / np.array([1.0, *amplitudes, *taus]) - 1) <= bound).all()


_DECAY = _curve(1.0, (0.3, 0.2), (5.0, 30.0))


@pytest.mark.parametrize(
    ("time_s", "values", "said"),
    [
        ([0.0, 1.0, 1.0, 2.0, 3.0], np.arange(5.0), "sample 2 at 1 s"),
        ([0.0, 1.0, 2.0, 1.5, 3.0], np.arange(5.0), "sample 3 at 1.5 s"),
        (TIME_S + 1.7e9, _DECAY, r"begins 1\.7e\+09 s after the end of the ramp"),
        *((TIME_S, size * _DECAY, "its square is outside the range of numbers") for size in (1e-200, 1e-145)),
        *((TIME_S, size * _DECAY, "its square is outside the range of numbers") for size in (1e145, 1e300)),
        (TIME_S, np.ones(3), "cannot have"),
    ],
)
def test_what_is_no_trace_is_refused(time_s, values, said):
    with pytest.raises(NumericsError, match=said):
        fit_relaxation(np.array(time_s), values)


def test_the_curve_is_the_model():
    fit = fit_relaxation(TIME_S, _curve(1.0, (-0.2, -0.55), (2.5, 23.1)))
    later = np.array([0.0, 7.0, 200.0])
    assert relaxation_curve(fit, later) == pytest.approx(_curve(1.0, (-0.2, -0.55), (2.5, 23.1), later), rel=1e-8)


_SPIKED = _curve(0.0, (-0.4,), (12.0,)) + 2e-3 * np.random.default_rng(9).standard_normal(TIME_S.size)
_SPIKED[:4] += np.array([0.3, -0.1, -0.35, -0.45]) - _curve(0.0, (-0.4,), (12.0,))[:4]


@pytest.mark.parametrize(
    ("values", "start"),
    [
        (_SPIKED, 4),  # falls through the end level, then peaks at sample 3
        (np.concatenate([[0.5, 0.8, 1.2], _curve(0.0, (1.0,), (12.0,))[3:]]), 3),  # of the same sign
        (_curve(0.0, (0.6,), (12.0,)), 0),
        (np.zeros(20), 0),
        (np.ones(3), 0),
    ],
)
def test_unloading_starts_behind_the_spike(values, start):
    assert relaxation_start(values) == start
