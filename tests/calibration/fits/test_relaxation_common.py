"""One relaxation for all loads: exact recovery, honest errors, no bias where single ones have one, refusals."""

import numpy as np
import pytest

from cbsr_qa.calibration.fits.common_relaxation import common_settling_time, fit_common_relaxation
from cbsr_qa.calibration.fits.relaxation import fit_relaxation
from cbsr_qa.calibration.fits.settling import settling_time
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.results.relaxation import FitStatus

TIME_S = np.arange(1.25, 60.0, 2.5)
#: The material file's loading kernel: settles after 23.1 s · ln(0.55 / 0.15) = 30.0 s.
SHARES, TAUS, TRUE_S = (-0.20, -0.55), (2.5, 23.1), 23.1 * np.log(0.55 / 0.15)


def _traces(levels, noise, seed, *, amplitudes=SHARES, taus=TAUS, time_s=TIME_S, offset=1.0):
    random = np.random.default_rng(seed)
    shape = offset + sum(a * np.exp(-time_s / tau) for a, tau in zip(amplitudes, taus, strict=True))
    return [(time_s, level * shape + noise * random.standard_normal(len(time_s))) for level in levels]


def _settled(common, **options):
    return common_settling_time(common, window_s=61.0, **options)


def test_without_noise_shape_scales_and_offsets_are_exact():
    levels = np.array([1.0, 0.2, 3.0])
    traces = [(time_s, values + k) for k, (time_s, values) in enumerate(_traces(levels, 0.0, 1))]
    common = fit_common_relaxation(traces)
    assert common.fit.status is FitStatus.TWO
    assert common.fit.time_constants_s == pytest.approx(TAUS, rel=1e-6)
    assert common.scales == pytest.approx(-0.75 * levels, rel=1e-6)
    assert common.offsets == pytest.approx([1.0, 1.2, 5.0], rel=1e-6)
    assert common.shares == pytest.approx(np.array(SHARES) / -0.75, rel=1e-5)
    assert common.fit.amplitudes == pytest.approx(np.array(SHARES) * levels.mean(), rel=1e-6)


def test_traces_of_different_lengths_and_beginnings_share_their_shape():
    late, long = TIME_S[3:], np.arange(0.5, 120.0, 1.0)
    traces = [_traces([1.0], 0.0, 1, time_s=time_s)[0] for time_s in (TIME_S, late, long)]
    assert fit_common_relaxation(traces).fit.time_constants_s == pytest.approx(TAUS, rel=1e-6)


def test_loads_a_million_times_apart_in_size_share_their_shape_to_the_last_digits():
    curve = 1.0 + np.exp(-TIME_S[:, None] / np.array(TAUS)) @ np.array(SHARES)
    common = fit_common_relaxation([(TIME_S, size * curve) for size in (1e-3, 1.0, 1e3)])
    np.testing.assert_allclose(common.fit.time_constants_s, TAUS, rtol=1e-11)
    np.testing.assert_allclose(common.scales, np.sum(SHARES) * np.array([1e-3, 1.0, 1e3]), rtol=1e-11)


def test_one_trace_alone_gives_what_its_own_fit_gives():
    (trace,) = _traces([1.0], 0.02, 3)
    alone, common = fit_relaxation(*trace), fit_common_relaxation([trace]).fit
    assert alone.status is common.status is FitStatus.ONE
    assert common.time_constants_s == pytest.approx(alone.time_constants_s, rel=1e-5)
    assert common.offset == pytest.approx(alone.offset, rel=1e-5)
    assert common.time_constant_stderr_s == pytest.approx(alone.time_constant_stderr_s, rel=0.02)


@pytest.mark.rest
def test_the_stated_errors_are_those_seen_over_many_runs():
    found = []
    for seed in range(40):
        common = fit_common_relaxation(_traces([1.0, 0.6, 1.4] * 3, 0.01, seed))
        settling, stderr = _settled(common)
        assert common.fit.status is FitStatus.TWO
        fit = common.fit
        values = (*np.log(fit.time_constants_s), fit.offset, *fit.amplitudes, settling.value_s)
        found.append((values, (*np.sqrt(np.diag(common.covariance))[[3, 4, 0, 1, 2]], stderr)))
    values, stated = (np.array(part) for part in zip(*found, strict=True))
    assert values.std(axis=0, ddof=1) == pytest.approx(np.median(stated, axis=0), rel=0.35)
    assert values[:, -1].mean() == pytest.approx(TRUE_S, abs=0.6)


@pytest.mark.rest
def test_loads_together_do_not_settle_too_early_as_single_ones_do():
    single, together = [], []
    for seed in range(16):
        traces = _traces([1.0] * 6 + [0.5, 0.75, 1.5], 0.02, seed)
        fits = [fit_relaxation(*trace) for trace in traces]
        times = [settling_time(fit, window_s=61.0).value_s for fit in fits if fit.status is FitStatus.ONE]
        single.append(np.mean(times))
        together.append(_settled(fit_common_relaxation(traces))[0].value_s)
    assert np.mean(single) < TRUE_S - 3.0
    assert np.mean(together) == pytest.approx(TRUE_S, abs=1.2)


@pytest.mark.rest
def test_a_second_exponential_is_rarely_seen_where_there_is_none():
    fits = [
        fit_common_relaxation(_traces([1.0, 0.5, 2.0] * 3, 0.02, seed, amplitudes=(-0.75,), taus=(15.0,)))
        for seed in range(30)
    ]
    assert sum(common.fit.status is FitStatus.TWO for common in fits) <= 2
    assert all(common.fit.why for common in fits if common.fit.status is FitStatus.ONE)


def test_loads_that_carry_nothing_cost_nothing():
    good = _traces([1.0] * 9, 0.02, 5)
    noise = _traces([0.0] * 9, 0.02, 6)
    alone, mixed = fit_common_relaxation(good), fit_common_relaxation([*good, *noise])
    assert alone.fit.status is mixed.fit.status is FitStatus.TWO
    assert mixed.fit.time_constants_s[1] == pytest.approx(
        alone.fit.time_constants_s[1], abs=alone.fit.time_constant_stderr_s[1]
    )
    assert mixed.traces == 18


@pytest.mark.parametrize("seed", range(8))
def test_an_unloading_slower_than_its_window_is_a_lower_bound(seed):
    traces = _traces([1.0] * 9, 0.04, seed, amplitudes=(0.2, 0.62), taus=(2.5, 120.0), offset=0.0)
    settling, stderr = _settled(fit_common_relaxation(traces), loaded_change=1.0)
    assert settling.censored
    assert settling.value_s == 61.0
    assert stderr is None


def test_noise_and_constants_do_not_relax():
    noise = fit_common_relaxation(_traces([0.0] * 5, 0.02, 8)).fit
    assert (noise.status, noise.amplitudes) == (FitStatus.FLAT, ())
    constant = fit_common_relaxation([(TIME_S, np.full(TIME_S.size, 1e6))] * 3).fit
    assert constant.status is FitStatus.FLAT
    assert constant.offset == 1e6


def test_a_flat_unloading_that_ended_elsewhere_has_not_settled():
    common = fit_common_relaxation(_traces([0.5] * 5, 0.01, 9, amplitudes=(), taus=()))
    assert common.fit.status is FitStatus.FLAT
    assert _settled(common)[0].value_s == 0.0
    away, _ = _settled(common, loaded_change=1.0)
    assert away.censored
    assert "50% of the change under load is left" in away.why


def test_a_straight_drift_is_later_than_the_window():
    common = fit_common_relaxation([(TIME_S, 0.01 * k * TIME_S) for k in (1, 2, 3)])
    assert common.fit.status is FitStatus.DRIFTING
    assert _settled(common)[0].censored


def test_nothing_to_fit_is_rejected_and_bad_times_are_refused():
    empty = fit_common_relaxation([(TIME_S[:4], TIME_S[:4])])
    assert empty.fit.status is FitStatus.REJECTED
    assert "at least 5 points" in empty.fit.why
    assert _settled(empty)[0].value_s is None
    with pytest.raises(NumericsError, match="repeat or step back"):
        fit_common_relaxation([(np.zeros(6), np.arange(6.0))])
