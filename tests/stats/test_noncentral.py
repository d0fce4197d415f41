"""Noncentral t where scipy's own series gives no number."""

import numpy as np
import pytest
from scipy import stats

from cbsr_qa.stats.difference import hedges
from cbsr_qa.stats.intervals import integrate_noncentral_t, noncentrality


@pytest.mark.parametrize(
    ("t", "freedom", "delta"), [(2.0, 5.0, 1.0), (12.0, 40.0, 11.0), (3.0, 400.0, 5.0), (0.5, 9.0, -1.0)]
)
def test_the_integral_agrees_with_the_series(t, freedom, delta):
    assert integrate_noncentral_t(t, freedom, delta) == pytest.approx(stats.nct.cdf(t, freedom, delta), rel=1e-9)


@pytest.mark.parametrize("freedom", [22.0, 6666.0])
@pytest.mark.parametrize("t", [12.0, 65.4, 140.0])
@pytest.mark.parametrize("below", [0.025, 0.975])
def test_a_noncentrality_has_the_probability_it_was_found_for(freedom, t, below):
    delta = noncentrality(t, freedom, below)
    random = np.random.default_rng(12)
    drawn = (random.standard_normal(200_000) + delta) / np.sqrt(random.chisquare(freedom, 200_000) / freedom)
    assert np.mean(drawn < t) == pytest.approx(below, abs=0.002)


def test_effect_sizes_of_thousands_of_sensors_have_an_interval():
    random = np.random.default_rng(13)
    for size in np.arange(0.0, 3.0, 0.1):
        first, second = random.standard_normal((2, 3334))
        found = hedges(first + size, second)
        assert found.interval.low < size + 0.1
        assert found.interval.high > size - 0.1
