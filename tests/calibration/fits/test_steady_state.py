"""Transient compensation: closed forms, agreement with the dense normal equations, limits, refusals."""

import re
from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad
from scipy.stats import t as student

from cbsr_qa.calibration.fits import relaxation_kernel
from cbsr_qa.calibration.fits.relaxation import exponentials, observable_share
from cbsr_qa.calibration.fits.steady_state import (
    HoldsSoFar,
    event_rate_per_min,
    interval,
    learn_kernel,
    predict_steady,
)
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.world import StrainRamp
from cbsr_qa.domain.results.relaxation import RelaxationKernel
from cbsr_qa.domain.sensor.sensor_type import Relaxation
from cbsr_qa.simulate.ramps import transient

WEIGHTS, TAUS_S = np.array([-0.20, -0.55]), np.array([2.5, 23.1])
TIME_S = np.arange(1.25, 60.0, 2.5)
_SPREAD = np.array([[0.04, 0.01, 0.0, 0.02], [0.01, 0.05, 0.01, 0.0], [0.0, 0.01, 0.1, 0.0], [0.02, 0.0, 0.0, 0.1]])


def _kernel(*, loading=True, scatter=(0.02, 0.03), sure=False, **options) -> RelaxationKernel:
    covariance = np.zeros((4, 4)) if sure else 0.1 * _SPREAD @ _SPREAD.T
    between = np.zeros(2) if sure else np.array(scatter)
    return RelaxationKernel(loading, WEIGHTS, TAUS_S, covariance, between, 12.0, 20, **options)


def _curve(time_s, size=1.0, ramp_s=0.0):
    return size * (1 + exponentials(time_s, TAUS_S, ramp_s=ramp_s)[0] @ WEIGHTS)


def _run(loads, noise, scatter, seed, *, ramp_s=0.0, time_s=TIME_S):
    random = np.random.default_rng(seed)
    sizes = random.uniform(0.5, 2.0, loads)
    parts = exponentials(time_s, TAUS_S, ramp_s=ramp_s)[0]
    weights = WEIGHTS * (1 + scatter * random.standard_normal((loads, 2)))
    clean = sizes[:, None] * (1 + weights @ parts.T)
    return [(time_s, values) for values in clean + noise * random.standard_normal(clean.shape)]


def test_time_constants_that_changed_places_are_rising(monkeypatch):
    loads = _run(12, 1e-3, 0.02, 5)
    expected = learn_kernel(loads)
    beginning = relaxation_kernel._beginning
    monkeypatch.setattr(
        relaxation_kernel,
        "_beginning",
        lambda *given: tuple(values.reshape(-1, 2)[:, ::-1].ravel() for values in beginning(*given)),
    )
    found = learn_kernel(loads)
    for name in ("weights", "time_constants_s", "covariance", "scatter"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-9), name


@given(ramp_s=st.floats(1e-6, 30.0), time_s=st.floats(0.0, 100.0))
def test_after_a_ramp_the_exponentials_are_those_of_the_simulated_world(ramp_s, time_s):
    kernel = Relaxation(tuple(WEIGHTS), tuple(TAUS_S), "test")
    expected = transient(StrainRamp(0.0, ramp_s, 1.0), kernel, ramp_s + time_s)
    seen = exponentials(np.array([time_s]), TAUS_S, ramp_s=ramp_s)[0][0] @ WEIGHTS
    assert seen == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("frame_s", [1e-7, 0.25, 2.5, 10.0])
def test_a_frame_is_the_mean_over_its_length(frame_s):
    middle = np.array([7.0])
    for tau, seen in zip(TAUS_S, exponentials(middle, TAUS_S, frame_s=frame_s)[0][0], strict=True):
        mean = quad(lambda time_s, tau=tau: np.exp(-time_s / tau), 7.0 - frame_s / 2, 7.0 + frame_s / 2)[0] / frame_s
        assert seen == pytest.approx(mean, rel=1e-7)


@given(
    time_s=st.floats(0.0, 60.0),
    ramp_s=st.sampled_from([0.0, 1e-3, 1.2, 10.0]),
    frame_s=st.sampled_from([0.0, 1e-3, 2.5]),
)
def test_slopes_are_the_derivatives_by_the_logarithm_of_the_time_constants(time_s, ramp_s, frame_s):
    def at(shift):
        return exponentials(np.array([time_s]), TAUS_S * np.exp(shift), ramp_s=ramp_s, frame_s=frame_s)[0][0]

    slopes = exponentials(np.array([time_s]), TAUS_S, ramp_s=ramp_s, frame_s=frame_s)[1][0]
    assert slopes == pytest.approx((at(1e-5) - at(-1e-5)) / 2e-5, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("ramp_s", [0.0, 1.2])
def test_with_a_sure_kernel_three_frames_without_noise_give_the_steady_state(ramp_s):
    seen = predict_steady(TIME_S[:3], _curve(TIME_S[:3], 3.0, ramp_s), 0.01, _kernel(sure=True), ramp_s=ramp_s)
    assert seen.values == pytest.approx([3.0], rel=1e-12)
    bound = 0.01 / np.sqrt((_curve(TIME_S[:3], 1.0, ramp_s) ** 2).sum())
    assert seen.stderr == pytest.approx([bound], rel=1e-9)
    assert seen.misfit == pytest.approx([0.0], abs=1e-8)


@settings(deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), frames=st.integers(1, 24), size=st.floats(-3, 3).filter(lambda a: abs(a) > 0.1)
)
def test_the_prediction_is_generalised_least_squares_with_the_kernels_covariance(seed, frames, size):
    kernel, random = _kernel(), np.random.default_rng(seed)
    time_s, noise = TIME_S[:frames], random.uniform(0.005, 0.03, frames)
    values = _curve(time_s, size) + noise * random.standard_normal(frames)
    found = predict_steady(time_s, values, noise, kernel)
    parts, slopes = exponentials(time_s, TAUS_S)
    design, mean = np.concatenate([parts, slopes * WEIGHTS], axis=1), 1 + parts @ WEIGHTS
    amplitude = size
    of_new_load = kernel.covariance + np.diag([*kernel.scatter**2, *np.zeros_like(kernel.scatter)])
    for _ in range(30):
        covariance = np.diag(noise**2) + amplitude**2 * design @ of_new_load @ design.T
        weights = np.linalg.solve(covariance, mean)
        amplitude = weights @ values / (weights @ mean)
    assert found.values[0] == pytest.approx(amplitude, rel=1e-3)
    assert found.stderr[0] == pytest.approx(1 / np.sqrt(weights @ mean), rel=2e-3)


@pytest.mark.parametrize("noise", [1e-4, 1e-8, 1e-12, 1e-15])
def test_frames_without_noise_give_the_steady_state_to_their_last_digits(noise):
    """By sums of squares it was off by 10 000 of its stated errors at 1e-8, and there was no inverse at 1e-10."""
    found = predict_steady(TIME_S, _curve(TIME_S, 0.7), noise, _kernel())
    assert found.values[0] == pytest.approx(0.7, rel=1e-13)
    assert found.misfit[0] < 1e-3 + (1e-15 / noise) ** 2
    worse = _curve(TIME_S, 0.7) + noise * np.where(np.arange(len(TIME_S)) % 2, 1.0, -1.0)
    told = predict_steady(TIME_S, worse, noise, _kernel())
    assert told.misfit[0] == pytest.approx(1.0, abs=0.35)


def test_settled_traces_give_their_mean():
    late = 300.0 + np.arange(0.0, 40.0, 2.5)
    values = np.random.default_rng(1).normal(2.0, 0.05, (5, late.size))
    found = predict_steady(late, values, 0.05, _kernel())
    assert found.values == pytest.approx(values.mean(axis=1), rel=1e-5)
    assert found.stderr == pytest.approx(0.05 / np.sqrt(late.size), rel=1e-3)
    assert (found.freedom > 1e4).all()


def test_frame_by_frame_is_as_all_at_once_and_gets_surer():
    values = np.array([_curve(TIME_S, 1.0), _curve(TIME_S, -2.0)])
    holds, stderr = HoldsSoFar(_kernel(), 2), []
    for frame, time_s in enumerate(TIME_S):
        now = holds.add(time_s, values[:, frame], 0.02).predict()
        until = slice(0, frame + 1)
        once = predict_steady(TIME_S[until], values[:, until], 0.02, _kernel())
        assert now.values == pytest.approx(once.values, rel=1e-12)
        stderr.append(now.stderr)
    assert (np.diff(stderr, axis=0) < 0).all()


@given(factor=st.floats(-1e3, 1e3).filter(lambda f: abs(f) > 1e-3))
def test_units_do_not_matter(factor):
    values = _curve(TIME_S[:4]) + 0.01 * np.array([1.0, -1.0, 0.5, 0.2])
    one = predict_steady(TIME_S[:4], values, 0.01, _kernel())
    other = predict_steady(TIME_S[:4], factor * values, abs(factor) * 0.01, _kernel())
    assert other.values == pytest.approx(factor * one.values, rel=1e-9)
    assert other.stderr == pytest.approx(abs(factor) * one.stderr, rel=1e-9)
    assert other.freedom == pytest.approx(one.freedom, rel=1e-6)


def test_intervals_are_students():
    found = predict_steady(TIME_S[:3], _curve(TIME_S[:3]), 0.01, _kernel())
    low, high = interval(found, 0.95)
    assert high - low == pytest.approx(2 * student.ppf(0.975, found.freedom) * found.stderr)
    assert (low + high) / 2 == pytest.approx(found.values)


def test_a_hold_that_is_none_does_not_fit():
    moved = _curve(TIME_S[:8])
    moved[4:] += 0.3
    found = predict_steady(TIME_S[:8], np.array([_curve(TIME_S[:8]), moved]), 0.01, _kernel())
    assert found.misfit[0] < 0.01
    assert found.misfit[1] > 5
    assert (found.spare == 7).all()


def test_a_release_ends_at_what_it_leaves():
    transients = exponentials(TIME_S, TAUS_S)[0] @ -WEIGHTS
    kernel = replace(_kernel(loading=False), weights=-WEIGHTS, start_s=2.0)
    values = 0.1 + 1.5 * transients
    values[0] = 40.0  # the spike
    found = predict_steady(TIME_S[:5], values[:5], 0.01, kernel, released=1.5, released_stderr=0.01)
    assert found.values == pytest.approx([0.1], abs=1e-9)
    assert found.spare == [3]
    later = predict_steady(TIME_S[:5], values[:5], 0.01, kernel, released=1.5, at_s=float(TIME_S[-1]))
    assert later.values == pytest.approx([values[-1]], abs=1e-9)
    surer = predict_steady(TIME_S[:5], values[:5], 0.01, kernel, released=1.5)
    assert surer.stderr < found.stderr


def test_the_kernel_is_learned_with_its_scatter():
    found = learn_kernel(_run(60, 0.005, 0.06, 3, ramp_s=1.2), ramp_s=1.2)
    errors = np.sqrt(np.diag(found.covariance))
    values = np.concatenate([found.weights, np.log(found.time_constants_s)])
    assert (np.abs(values - np.concatenate([WEIGHTS, np.log(TAUS_S)])) < 3.5 * errors).all()
    assert (errors < [0.02, 0.02, 0.1, 0.05]).all()
    assert found.scatter == pytest.approx(0.06 * np.abs(found.weights), rel=0.25)
    assert found.loads == 60


def test_exact_traces_give_the_exact_kernel_with_ramps_and_frames():
    ramps = [0.3, 1.2, 1.8, 0.6]
    traces = [
        (TIME_S, size * (1 + exponentials(TIME_S, TAUS_S, ramp_s=ramp, frame_s=2.5)[0] @ WEIGHTS))
        for size, ramp in zip((1.0, -2.0, -0.5, -1.0), ramps, strict=True)
    ]
    found = learn_kernel(traces, ramp_s=ramps, frame_s=2.5)
    assert found.time_constants_s == pytest.approx(TAUS_S, rel=1e-4)
    assert found.weights == pytest.approx(WEIGHTS, rel=1e-3)


@pytest.mark.parametrize("unit", [1e-100, 1e-9, 1e100])
def test_a_kernel_has_no_unit(unit):
    """At 1e100 weights of 8 and 0.1 came out, with time constants of 239 and 684 s."""
    traces = [(TIME_S, unit * size * _curve(TIME_S, 1.0)) for size in (0.9, 1.0, 1.1)]
    kernel = learn_kernel(traces, noise=[1e-4 * unit] * 3)
    np.testing.assert_allclose(kernel.weights, WEIGHTS, rtol=1e-4)
    np.testing.assert_allclose(kernel.time_constants_s, TAUS_S, rtol=1e-4)


def test_releases_of_both_signs_have_one_kernel():
    parts, _ = exponentials(TIME_S, TAUS_S)
    released = [1.0, -1.0, 2.0, -2.0]
    kernel = learn_kernel([(TIME_S, 0.01 + change * parts @ WEIGHTS) for change in released], released=released)
    assert not kernel.why
    np.testing.assert_allclose(kernel.weights, WEIGHTS, rtol=1e-4)
    np.testing.assert_allclose(kernel.time_constants_s, TAUS_S, rtol=1e-4)


def test_one_load_says_nothing_about_the_next():
    one, many = (learn_kernel(_run(loads, 0.01, 0.03, 5)) for loads in (1, 23))
    short = TIME_S[:3], _curve(TIME_S[:3])
    unsure, sure = (predict_steady(*short, 0.01, kernel) for kernel in (one, many))
    assert one.scatter[1] > 0.2 * abs(one.weights[1])
    assert unsure.stderr[0] > 3 * sure.stderr[0]
    assert unsure.stderr[0] > 0.08


def test_no_exponential_is_claimed_where_traces_are_flat():
    random = np.random.default_rng(7)
    flat = learn_kernel([(TIME_S, size + 0.01 * random.standard_normal(TIME_S.size)) for size in (1.0, 2.0, 1.5)])
    assert not flat.why
    assert (np.abs(flat.weights) < 3 * np.sqrt(np.diag(flat.covariance))[:2] + 1e-3).all()
    found = predict_steady(TIME_S[:3], np.ones(3), 0.01, flat)
    assert abs(found.values[0] - 1) < 2 * found.stderr[0]


@pytest.mark.parametrize(
    ("traces", "why"),
    [
        ([(TIME_S[:5], TIME_S[:5])], "no trace"),
        ([(TIME_S, 0.01 * k * TIME_S) for k in (1, 2, 3)], "still drifting"),
        (
            _run(4, 1.0, 0.0, 1) and [(TIME_S, np.random.default_rng(k).normal(0, 1, 24)) for k in range(4)],
            "stands out",
        ),
    ],
)
def test_where_there_is_no_kernel_nothing_is_predicted(traces, why):
    kernel = learn_kernel(traces)
    assert why in kernel.why
    with pytest.raises(NumericsError, match=why):
        predict_steady(TIME_S[:3], np.ones(3), 0.1, kernel)


_TWO = TIME_S[:2], [1.0, 1.0], 0.1


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: predict_steady(TIME_S[:2], [1.0, np.nan], 0.1, _kernel()), "not a finite number"),
        (lambda: predict_steady(TIME_S[:2], [1.0, 1.0], 0.0, _kernel()), "not positive"),
        (lambda: predict_steady(-TIME_S[:2], [1.0, 1.0], 0.1, _kernel()), "no frame"),
        (lambda: predict_steady(*_TWO, _kernel(), released=1.0), "kernel of loadings"),
        (lambda: predict_steady(*_TWO, _kernel(loading=False)), "no released change"),
        (lambda: predict_steady(*_TWO, _kernel(loading=False), released=np.inf), "released change or"),
        (lambda: predict_steady(*_TWO, _kernel(), at_s=-1.0), "no change at -1"),
        (lambda: learn_kernel([(TIME_S, TIME_S)], ramp_s=[1.0, 2.0]), "2 ramps"),
        (lambda: learn_kernel([(TIME_S, TIME_S)], ramp_s=np.inf), "no finite number"),
        (lambda: interval(predict_steady(*_TWO, _kernel()), 1.0), "level"),
        (lambda: event_rate_per_min(0.0, 0.0), "no event rate"),
        (lambda: event_rate_per_min(30.0, np.nan), "no event rate"),
        (lambda: observable_share(np.array([1e-3]), frame_s=2.5), "says nothing about a time constant"),
    ],
)
def test_bad_input_is_refused_in_words(call, said):
    with pytest.raises(NumericsError, match=said):
        call()


def test_the_event_rate_follows_from_the_settling_times():
    assert event_rate_per_min(30.0, 36.0, ramp_s=1.2) == pytest.approx(60 / (45 + 54 + 2.4))
    assert event_rate_per_min(30.0, 36.0, held=0.3, rested=0.3) == pytest.approx(60 / (9 + 10.8))


def test_the_snippet_of_the_page_holds():
    page = Path(__file__).resolve().parents[3] / "docs" / "explanation" / "transient-compensation.md"
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1
    exec(blocks[0], {})


@pytest.mark.parametrize("share", [1e-9, 1e-5, 0.9e-4, 1.1e-4, 0.01, 0.49, 0.51])
def test_short_ramps_and_frames_lose_no_digits(share):
    """(1 − e^(−x))/x = Σ (−x)ᵏ/(k + 1)! and sinh(x)/x; below 1e-4 all but the first terms were left out."""
    ramp, frame = (
        observable_share(np.array([1.0]), **given) for given in ({"ramp_s": share}, {"frame_s": 2 * share})
    )
    with mpmath.workdps(50):
        exact = mpmath.mpf(share)
        values = [-mpmath.expm1(-exact) / exact, mpmath.sinh(exact) / exact]
        slopes = [(mpmath.exp(-exact) * (1 + exact) - 1) / -mpmath.expm1(-exact), exact * mpmath.coth(exact) - 1]
    np.testing.assert_allclose([ramp[0][0], frame[0][0]], np.array(values, dtype=float), rtol=1e-15)
    np.testing.assert_allclose([ramp[1][0], frame[1][0]], np.array(slopes, dtype=float), rtol=1e-14)
