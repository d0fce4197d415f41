"""Tolerance limits against printed and certified factors, against closed forms, and against simulated lots."""

import json
from math import sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from cbsr_qa.stats.intervals import count_needed, one_sided_factor, spacings_outside, two_sided_factor
from cbsr_qa.stats.lot_shapes import far_out, fits_worst_of
from cbsr_qa.stats.variance_components import components
from cbsr_qa.stats.worst_value import worst_of


@pytest.fixture(scope="module")
def handbook(shared):
    return json.loads((shared / "oracle" / "statistics.json").read_text())["tolerance"]


def test_factors_are_the_handbooks(handbook):
    n, coverage, confidence = handbook["n"], handbook["P"], handbook["conf"]
    assert two_sided_factor(coverage, confidence, n, n - 1) == pytest.approx(handbook["k2_exact"], abs=5e-5)
    assert one_sided_factor(coverage, confidence, n, n - 1) == pytest.approx(handbook["k1_exact_nct"], abs=5e-5)


def test_the_interval_of_the_handbooks_wafers(handbook):
    """Printed with Howe's approximate factor, which is 0.25 % short of the exact one."""
    n, mean, s = handbook["n"], handbook["mean"], handbook["s"]
    half = two_sided_factor(handbook["P"], handbook["conf"], n, n - 1) * s
    low, high = handbook["two_sided"]
    assert (mean - half, mean + half) == pytest.approx((low, high), abs=2.5e-4)
    assert mean - half < low < high < mean + half


@pytest.mark.parametrize(
    ("n", "coverage", "one", "two"),
    # Odeh & Owen 1980, confidence 95 %.
    [(2, 0.99, 37.094, 46.944), (10, 0.99, 3.981, 4.437), (30, 0.95, 2.220, 2.555), (100, 0.9, 1.527, 1.875)],
)
def test_factors_are_those_of_printed_tables(n, coverage, one, two):
    assert one_sided_factor(coverage, 0.95, n, n - 1) == pytest.approx(one, abs=6e-4)
    assert two_sided_factor(coverage, 0.95, n, n - 1) == pytest.approx(two, abs=6e-4)


def test_with_very_many_values_factors_are_quantiles():
    many = 10_000_000
    assert one_sided_factor(0.99, 0.95, many, many) == pytest.approx(stats.norm.ppf(0.99), abs=2e-3)
    assert two_sided_factor(0.99, 0.95, many, many) == pytest.approx(stats.norm.ppf(0.995), abs=2e-3)


def test_sensors_needed_without_a_distribution_are_wilks():
    assert [count_needed(0.99, 0.95, sides) for sides in (1, 2)] == [299, 473]
    assert [count_needed(0.95, 0.95, sides) for sides in (1, 2)] == [59, 93]
    assert count_needed(0.9, 0.95, 1) == 29


@pytest.mark.parametrize("outside", [1e-4, 1e-6, 1e-12])
def test_millions_of_sensors_are_counted_at_once(outside):
    """Rare values are Poisson: with x = n (1 − coverage), (1 + x) e^(−x) = 0.05 at x = 4.7438645."""
    assert count_needed(1 - outside, 0.95, 2) * outside == pytest.approx(4.743864518, rel=1e-4 + outside)


@given(st.integers(1, 2000), st.sampled_from([0.9, 0.95, 0.99]), st.sampled_from([0.8, 0.95, 0.99]))
def test_as_many_spacings_lie_outside_as_the_confidence_allows_and_no_more(count, coverage, confidence):
    outside = spacings_outside(count, coverage, confidence)
    missed = stats.binom(count, 1 - coverage).cdf
    assert outside == 0 or missed(outside - 1) <= 1 - confidence
    assert missed(outside) > 1 - confidence


@pytest.mark.parametrize("values", [1, 2, 9, 27])
def test_worst_values_are_distributed_as_drawn(values):
    shape = worst_of(values)
    drawn = np.random.default_rng(4).standard_normal((200_000, values)).max(axis=1)
    standard = (drawn - shape.raw_mean) / shape.raw_deviation
    assert standard.mean() == pytest.approx(0, abs=0.01)
    assert standard.std() == pytest.approx(1, abs=0.01)
    assert np.mean(standard <= shape.quantile(0.99)) == pytest.approx(0.99, abs=1e-3)
    x = np.linspace(-8, 12, 4001)
    below = np.concatenate([[0], np.cumsum(0.5 * np.diff(x) * (shape.density(x)[1:] + shape.density(x)[:-1]))])
    assert np.interp(shape.quantile(0.99), x, below) == pytest.approx(0.99, abs=1e-4)
    scores = shape.normal_scores(np.array([-1e3, shape.quantile(0.975), 1e3]))
    assert scores[1] == pytest.approx(stats.norm.ppf(0.975))
    assert np.isfinite(scores).all()


def test_largest_of_two_normal_numbers_has_its_textbook_moments():
    assert worst_of(2).raw_mean == pytest.approx(1 / sqrt(np.pi))
    assert worst_of(2).raw_deviation == pytest.approx(sqrt(1 - 1 / np.pi))


def test_one_run_a_sensor_is_the_plain_sample():
    values = np.random.default_rng(1).normal(5, 2, 12)
    parts = components([[x] for x in values])
    assert (parts.mean, parts.deviation) == pytest.approx((values.mean(), values.std(ddof=1)))
    assert parts.quantile_factor(0.99, 0.95) == pytest.approx(one_sided_factor(0.99, 0.95, 12, 11))
    assert parts.interval_factor(0.99, 0.95) == pytest.approx(two_sided_factor(0.99, 0.95, 12, 11))
    assert parts.within is None


def test_balanced_components_are_those_of_the_analysis_of_variance(shared):
    oracle = json.loads((shared / "oracle" / "statistics.json").read_text())["dyestuff"]
    parts = components(list(oracle["data"].values()))
    assert parts.mean == pytest.approx(oracle["mean"])
    assert parts.within == pytest.approx(oracle["MS"]["within"])
    assert 5 * parts.between == pytest.approx(oracle["MS"]["between"])
    total = oracle["REML"]["var_batch"] + oracle["REML"]["var_resid"]
    assert parts.deviation**2 == pytest.approx(total, rel=1e-5)


def test_a_sensor_that_was_run_often_weighs_no_more():
    parts = components([[1.0] * 50, [3.0], [5.0]])
    assert parts.mean == pytest.approx(3.0)


@pytest.mark.rest
@pytest.mark.parametrize("between", [0.0, 0.5, 0.9])
def test_repeated_runs_do_not_make_a_lot_look_larger(between):
    """Content of at least 99 % in at least 95 % of lots, less three standard errors of 300 lots."""
    random = np.random.default_rng(int(10 * between))
    held = []
    for _ in range(300):
        sensors = sqrt(between) * random.standard_normal((10, 1))
        parts = components(sensors + sqrt(1 - between) * random.standard_normal((10, 3)))
        held.append(parts.mean + parts.quantile_factor(0.99, 0.95) * parts.deviation >= stats.norm.ppf(0.99))
    assert np.mean(held) >= 0.95 - 3 * sqrt(0.95 * 0.05 / 300)


@pytest.mark.rest
def test_intervals_from_repeated_runs_hold_their_share():
    random = np.random.default_rng(8)
    held = []
    for _ in range(300):
        parts = components(sqrt(0.6) * random.standard_normal((12, 1)) + sqrt(0.4) * random.standard_normal((12, 2)))
        half = parts.interval_factor(0.99, 0.95) * parts.deviation
        content = stats.norm.cdf(parts.mean + half) - stats.norm.cdf(parts.mean - half)
        held.append(content >= 0.99)
    assert np.mean(held) >= 0.95 - 3 * sqrt(0.95 * 0.05 / 300)


@pytest.mark.parametrize("values", [1, 9])
def test_the_right_shape_is_seldom_refuted_and_a_wrong_one_often(values):
    random = np.random.default_rng(2)
    right = [fits_worst_of(random.standard_normal((30, values)).max(axis=1), values, 0.05) for _ in range(400)]
    assert np.mean([fit.refuted for fit in right]) == pytest.approx(0.05, abs=0.035)
    wrong = [fits_worst_of(random.exponential(1, (60, 1))[:, 0] ** 2, values, 0.05) for _ in range(50)]
    assert np.mean([fit.refuted for fit in wrong]) > 0.95


def test_what_lies_far_out_is_found_and_nothing_else():
    assert far_out([1.0, 1.1, 0.9, 1.05, 0.95, 4.0]) == (5,)
    assert far_out([1.0, 1.1, 0.9, 1.05, 0.95]) == ()
    assert far_out([1.0, 1.0, 1.0, 1.0, 9.0]) == ()  # without a spread there is no scale to be far out on
