"""Searches around the hard cases: the same truths and bounds, where hypothesis takes them."""

import numpy as np
from drawn import drawn
from hypothesis import example, given, strategies as st
from scipy.optimize import brentq

from cbsr_qa.calibration.fits.relaxation import fit_relaxation
from cbsr_qa.calibration.fits.settling import settling_time
from cbsr_qa.eit.imaging.blobs import percentage_mask
from cbsr_qa.studies.hard_cases.cases import (
    calibration as calibration_cases,
    geometry as geometry_cases,
    loads as load_cases,
    relaxation as relaxation_cases,
    time as time_cases,
)

STRAINS = np.array([0.05, 0.10, 0.15, 0.20, 0.25, 0.30])


def powers(low: float, high: float) -> st.SearchStrategy[float]:
    """Powers of ten, evenly in the exponent."""
    return st.floats(low, high).map(lambda exponent: float(10.0**exponent))


def within(answer):
    assert np.isfinite(answer.error)
    assert answer.error <= answer.bound, (
        f"{answer.error:.3g} > {answer.bound:.3g} at condition {answer.condition:.3g}"
    )


@drawn(15)
@given(offset=powers(-2, 6), unit=powers(-9, 9), second=powers(-6, 6), sign=st.sampled_from([-1.0, 1.0]))
def test_offsets_and_units_cost_a_relaxation_only_its_condition(offset, unit, second, sign):
    within(relaxation_cases.fit_known_curve(offset, (sign * 0.3, 0.2), (5.0, 30.0), unit=unit, second=second))


@drawn(20)
@given(gap=powers(-12, 0), share=st.floats(0.1, 0.9))
def test_time_constants_ever_more_alike_settle_when_their_curve_does(gap, share):
    """One exponential stands for two less than a factor of 2 apart: off by their distance squared, 8 % at 2."""
    taus = np.array([12.0, 12.0 * (1 + gap)])
    amplitudes = 0.5 * np.array([share, 1 - share])
    time_s = 2.5 * np.arange(25.0)
    fit = fit_relaxation(time_s, 1 + np.exp(-time_s[:, None] / taus) @ amplitudes)
    truth = brentq(lambda t: np.exp(-t / taus) @ amplitudes - 0.15, 0, 60)
    found = settling_time(fit, window_s=60.0).value_s
    assert abs(found / truth - 1) < 0.15 * gap**2 + 1e-9
    assert gap > 0.99 or len(fit.amplitudes) == 1


@drawn(60)
@given(gap=powers(-8, -2))
def test_cancelling_exponentials_settle_to_their_condition(gap):
    within(relaxation_cases.settle_known_curve((-0.4 / gap, 0.4 / gap + 0.5), (20.0, 20.0 * (1 + gap))))


@drawn(30)
@given(noise=powers(-15, -1))
def test_no_noise_is_too_small_for_a_steady_state(noise):
    within(relaxation_cases.steady_without_noise(noise))


@drawn(60)
@given(share=powers(-9, 2))
@example(share=4.567148636596522)  # the slope's terms cancel
def test_ramps_and_frames_of_any_length_are_exact(share):
    within(time_cases.short_ramp(share))


@drawn(150)
@given(
    gap=powers(-15, 0.5),
    sign=st.sampled_from([-1.0, 1.0]),
    turn=st.floats(0, 2 * np.pi),
    long=powers(-3, 3),
    first=st.sampled_from([0.0, 10.0, 1e6]),
)
def test_triangles_that_all_but_touch_a_circle(gap, sign, turn, long, first):
    """A tip, or a side, this far inside or outside of the circle, from any side, at any distance from the origin."""
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    near = 6.5 + sign * gap
    tip = np.array([[near, 0.0], [near + long, -long / 2], [near + long, long / 2]])
    side = np.array([[near, long], [near, -long], [near + long, 0.0]])
    for corners in (tip, side):
        within(geometry_cases.circle(first + corners @ turned, (first, first)))


@drawn(60)
@given(width=powers(-9, 1), first=powers(-1, 6))
def test_needles_of_any_width_anywhere(width, first):
    if first / width < 1e12:  # the needle still is one of doubles
        within(geometry_cases.needle(width, first))


@drawn(25)
@given(corners=st.integers(3, 20_000))
def test_rims_ever_closer_to_the_indenters(corners):
    within(geometry_cases.rim_of(corners))


@drawn(60)
@given(level=powers(-3, 5), spread=powers(-3, 3), scatter=st.floats(0, 0.02), weight=powers(-6, 0))
def test_lines_of_any_spread_on_any_level(level, spread, scatter, weight):
    change = 0.6 * STRAINS + scatter * np.cos(40 * STRAINS)
    within(calibration_cases.line(level + spread * STRAINS, change, np.array([1, weight, 1, 1, 1, 1])))


@drawn(6)
@given(size=powers(-9, 0), variance=powers(-14, -2))
def test_maps_of_loads_ever_closer_together(size, variance):
    places = size * calibration_cases.NINE[:5]
    values = 0.1 * np.array([0.3, -0.2, 0.1, 0.0, 0.2]) * size
    within(calibration_cases.response(places, values, np.full(5, variance)))


@drawn(100)
@given(strength=st.floats(-100, 1.97), log_response=st.floats(-30, 30))
def test_forces_at_any_response(strength, log_response):
    within(load_cases.force_of(strength, log_response))


@drawn(60)
@given(
    numerators=st.lists(st.integers(1, 999), min_size=1, max_size=8),
    scale=powers(-12, 12),
    percent=st.integers(1, 100),
)
def test_ties_at_any_mask_are_those_of_fractions(numerators, scale, percent):
    steps = np.array([1000, *numerators])
    kept = percentage_mask(steps * scale / 1000, percent / 100)
    np.testing.assert_array_equal(kept, 100 * steps >= percent * 1000)
