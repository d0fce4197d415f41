"""Correlation of successive values: exact small cases, error rates, and the shares beyond limits by simulation."""

import numpy as np
import pytest
from scipy.signal import lfilter

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.control_charts import ewma, individuals
from cbsr_qa.stats.serial_correlation import correlate_successive, ewma_beyond, individuals_beyond


def draw_series(correlation, count, series, seed):
    """Stationary series (series, count) of variance 1 with that correlation of neighbours."""
    random = np.random.default_rng(seed)
    noise = random.standard_normal((series, count)) * np.sqrt(1 - correlation**2)
    noise[:, 0] = random.standard_normal(series)
    return lfilter([1.0], [1.0, -correlation], noise, axis=1)


def test_the_ratio_of_ranks_is_bartels():
    """Ranks in order: Σ of squared differences n − 1 over n (n² − 1)/12, the least that can be."""
    rising = correlate_successive(np.arange(20.0))
    assert rising.p < 1e-9
    alternating = correlate_successive([0.0, 1.0] * 10)
    assert alternating.p > 0.999
    assert alternating.coefficient < -0.5


def test_the_test_depends_on_the_order_of_values_alone():
    values = draw_series(0.4, 25, 1, 3)[0]
    first, stretched = correlate_successive(values), correlate_successive(np.exp(3 * values))
    assert stretched.p == first.p
    assert correlate_successive(5 - 1e6 * values).p == pytest.approx(first.p, rel=1e-12)


def test_equal_values_show_nothing_and_too_few_are_refused():
    assert correlate_successive([2.0] * 12).p == 1.0
    with pytest.raises(NumericsError):
        correlate_successive(range(9))
    with pytest.raises(NumericsError):
        correlate_successive([np.nan] * 12)


@pytest.mark.parametrize("count", [10, 30, 100])
def test_independent_values_are_called_alike_in_five_of_a_hundred_series(count):
    p_values = [correlate_successive(values).p for values in draw_series(0.0, count, 1500, count)]
    assert np.mean(np.array(p_values) < 0.05) == pytest.approx(0.05, abs=0.018)


def test_values_that_depend_on_the_ones_before_are_found():
    found = [correlate_successive(values) for values in draw_series(0.5, 30, 600, 7)]
    assert np.mean([each.p < 0.05 for each in found]) > 0.75
    assert np.mean([each.coefficient for each in found]) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
def test_shares_beyond_the_limits_are_those_of_long_series(correlation):
    (values,) = draw_series(correlation, 200_000, 1, 11)
    chart = individuals(values, rules=())
    beyond = np.mean(np.abs(chart.points - chart.centre) > 3 * chart.deviation)
    assert beyond == pytest.approx(individuals_beyond(correlation), rel=0.15)
    averages = ewma(values, weight=0.2, width=3.0)
    outside = np.mean((averages.points < averages.lower) | (averages.points > averages.upper))
    assert outside == pytest.approx(ewma_beyond(correlation, 0.2, 3.0), rel=0.15, abs=3e-4)
