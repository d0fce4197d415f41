"""Univariate statistics against NIST's certified values and exact arithmetic."""

import json
from fractions import Fraction
from itertools import pairwise
from math import sqrt

import numpy as np
import pytest
from certified_groups import certified_table
from hypothesis import given, settings, strategies as st
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.samples import quantile, summary
from cbsr_qa.stats.variance_components import components

NUM_ACC_4 = [10000000.2] + [10000000.1, 10000000.3] * 500

values = st.lists(st.integers(-1000, 1000).map(lambda number: number / 8), min_size=3, max_size=40)


@pytest.fixture(scope="module")
def oracle(shared):
    return json.loads((shared / "oracle" / "statistics.json").read_text(encoding="utf-8"))


def exactly(numbers):
    """Mean, deviation and autocorrelation of the doubles themselves in rational arithmetic, rounded once."""
    fractions = [Fraction(number) for number in numbers]
    mean = sum(fractions) / len(fractions)
    away = [number - mean for number in fractions]
    squares = sum(x * x for x in away)
    lagged = sum(x * y for x, y in pairwise(away)) / squares
    return float(mean), sqrt(squares / (len(fractions) - 1)), float(lagged)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["Michelso", "Mavro"])
def test_certified_to_nine_digits_and_more(oracle, name):
    certified, found = oracle[name], summary(oracle[name]["data"])
    assert found.mean == pytest.approx(certified["mean"], rel=1e-14)
    assert found.deviation == pytest.approx(certified["sd"], rel=1e-12)
    assert found.autocorrelation == pytest.approx(certified["ac1"], rel=1e-12)


@pytest.mark.shared
def test_certified_variance_components(oracle):
    """SiRstv, five instruments of five readings: between is MS_B/5, within MS_W of the one-way analysis."""
    certified = oracle["SiRstv"]
    found = components([[y for own, y in certified["data"] if own == number] for number in range(1, 6)])
    assert 4 * 5 * found.between == pytest.approx(certified["SSB"], rel=1e-9)
    assert found.repeats * found.within == pytest.approx(certified["SSW"], rel=1e-9)
    assert 5 * found.between / found.within == pytest.approx(certified["F"], rel=1e-9)
    assert sqrt(found.within) == pytest.approx(certified["resid_sd"], rel=1e-9)
    assert (found.sensors, found.repeats) == (5, 20)


@pytest.mark.parametrize("replicates", [21, 201, 2001])
@pytest.mark.parametrize(("offset", "digits"), [(1, 13), (10**6, 8), (10**12, 2)])
def test_simulated_sets_of_nist_lose_the_digits_that_doubles_lose(replicates, offset, digits):
    found = components(certified_table(offset, replicates))
    assert replicates * found.between / found.within == pytest.approx(replicates, rel=10.0**-digits)
    assert found.within == pytest.approx(0.09 * (replicates - 1) / (9 * (replicates - 1)), rel=10.0**-digits)


def test_digit_loss_goes_no_further_than_the_doubles_themselves():
    """NumAcc4: 10000000.1 is no double; the deviation of the doubles is 0.1 to eight digits; no sum knows more."""
    found = summary(NUM_ACC_4)
    assert found.mean == 10000000.2
    assert found.deviation == pytest.approx(0.1, rel=1e-8)
    assert found.autocorrelation == pytest.approx(-0.999, rel=1e-9)
    mean, deviation, lagged = exactly(NUM_ACC_4)
    assert (found.mean, found.deviation) == pytest.approx((mean, deviation), rel=2e-16, abs=0)
    assert found.autocorrelation == pytest.approx(lagged, rel=1e-9)


@pytest.mark.rest
@settings(deadline=None)
@given(values)
def test_moments_are_those_of_exact_arithmetic(numbers):
    shifted = [number + 2.0**40 for number in numbers]
    found = summary(shifted)
    if len(set(numbers)) == 1:
        assert (found.deviation, found.autocorrelation) == (0.0, None)
        return
    mean, deviation, lagged = exactly(shifted)
    assert found.mean == pytest.approx(mean, rel=2e-16)
    assert found.deviation == pytest.approx(deviation, rel=1e-14)
    assert found.autocorrelation == pytest.approx(lagged, rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("scale", [1e-200, 1e-3, 1e140])
def test_deviation_scales_with_its_unit(scale):
    assert summary([scale, 2 * scale, 4 * scale]).deviation == pytest.approx(scale * sqrt(7 / 3), rel=1e-14)


def test_the_standard_error_of_a_mean_falls_with_the_root_of_the_count():
    once, again = summary([1.0, 2.0, 4.0]), summary([1.0, 2.0, 4.0] * 100)
    assert once.standard_error == pytest.approx(sqrt(7 / 3) / sqrt(3), rel=1e-14)
    assert again.standard_error == pytest.approx(once.standard_error / 10 * sqrt(200 / 299), rel=1e-12)


def test_one_value_has_a_mean_and_nothing_else():
    found = summary([3.0])
    assert (found.mean, found.deviation, found.autocorrelation, found.standard_error) == (3.0, None, None, None)


@pytest.mark.parametrize(
    ("numbers", "reason"),
    [
        ([], "0 values instead of at least 1"),
        ([1.0, float("nan"), 2.0], "1 of 3 values are missing or infinite, the first at index 1"),
        ([1e200, 1.0], "overflow"),
    ],
)
def test_what_has_no_summary_is_named(numbers, reason):
    with pytest.raises(NumericsError, match=f"E_CoM: .*{reason}"):
        summary(numbers, "E_CoM")


def test_quantile_interval_by_hand():
    """Of ten values the median lies between the second and the ninth with 1 − 2·11/1024 = 97.9 %."""
    found = quantile(range(10, 0, -1), 0.5)
    assert (found.value, found.interval.low, found.interval.high, found.needed) == (5.5, 2.0, 9.0, 6)
    assert quantile(range(5), 0.5).interval is None
    assert quantile(range(6), 0.5).interval.low == 0.0
    assert quantile(range(100), 0.99).needed == 368  # 0.99^368 ≤ 0.025
    assert quantile(range(368), 0.99).interval is not None
    assert quantile(range(367), 0.99).interval is None


@pytest.mark.parametrize("below", [0.1, 0.5, 0.75])
def test_quantile_intervals_cover(below):
    random, true = np.random.default_rng(8), stats.gamma.ppf(below, 2.0)
    lots = random.gamma(2.0, size=(1500, 60))
    covered = np.mean([quantile(lot, below).interval.holds(true) for lot in lots])
    assert 0.94 <= covered <= 0.985  # at least 95 %, give or take 0.6 % of drawing, and not much more
