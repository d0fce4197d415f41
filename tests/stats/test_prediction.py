"""Prediction intervals hold as many further values as they say, and refuse what predicts nothing."""

import numpy as np
import pytest
from tiers import rest_but

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.intervals import predict


@pytest.mark.parametrize("count", rest_but({3}, [3, 20]))
@pytest.mark.parametrize("confidence", rest_but({0.9}, [0.9, 0.99]))
def test_the_interval_holds_the_next_value_as_often_as_it_says(count, confidence):
    random, trials = np.random.default_rng(11), 4000
    values = 5.0 + 0.3 * random.standard_normal((trials, count + 1))
    held = np.mean([predict(row[:-1], confidence=confidence).holds(row[-1]) for row in values])
    assert held == pytest.approx(confidence, abs=4 * np.sqrt(confidence * (1 - confidence) / trials))


def test_five_values_reach_as_far_as_the_table_of_t_says():
    # t of 97.5 % and 4 degrees of freedom is 2.7764 in every table; times √(1 + 1/5) that is 3.0414.
    found = predict([1.0, 2.0, 3.0, 4.0, 5.0], confidence=0.95)
    assert (found.high - found.mean) / found.deviation == pytest.approx(3.0414, abs=1e-3)
    assert (found.count, found.mean, found.deviation) == (5, 3.0, pytest.approx(np.sqrt(2.5)))


@pytest.mark.parametrize(
    ("values", "confidence", "said"),
    [
        ([1.0, 2.0], 0.95, "2 values instead of at least 3"),
        ([1.0, np.nan, 2.0], 0.95, "missing or infinite"),
        ([1.0, 2.0, 3.0], 1.0, "confidence is 1"),
    ],
)
def test_what_predicts_nothing_is_refused(values, confidence, said):
    with pytest.raises(NumericsError, match=said):
        predict(values, confidence=confidence)
