"""Estimates against references that are not known exactly: what is known adds, and intervals hold the truth."""

import numpy as np
import pytest
from scipy import stats
from tiers import rest_but

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.difference import Contrast
from cbsr_qa.stats.gauge.reference import bias
from cbsr_qa.stats.intervals import Referenced

CONFIDENCES = (0.8, 0.9, 0.95, 0.99)


@pytest.mark.parametrize("count", rest_but({2, 10}, [2, 3, 4, 10]))
@pytest.mark.parametrize("confidence", CONFIDENCES)
def test_a_stated_uncertainty_never_narrows(count, confidence):
    readings = np.random.default_rng(5).normal(2.2, 0.07, count)
    stated = [0.0, *np.geomspace(1e-4, 10, 60)]
    found = [bias(readings, 2.6, uncertainty=u) for u in stated]
    widths = [one.interval(confidence).high - one.interval(confidence).low for one in found]
    assert np.all(np.diff(widths) > 0)
    assert np.all(np.diff([one.p_value() for one in found]) > 0)
    # Where little is read and much is known, it is the reference's own interval.
    assert widths[-1] == pytest.approx(2 * 10 * stats.norm.isf((1 - confidence) / 2), rel=0.1)


@pytest.mark.parametrize(
    ("count", "deviation", "known"), [(3, 0.07, 0.02), (2, 1.0, 0.5), (3, 1.0, 1.0), (10, 1.0, 0.3)]
)
def test_intervals_hold_the_truth_as_often_as_they_say(count, deviation, known):
    """Drawn 100 000 times each: a standard error of 0.07 % at 95 %. Never less than said; of two up to 7 % more."""
    random = np.random.default_rng(7)
    readings = deviation * random.normal(size=(100_000, count))
    away = np.abs(readings.mean(axis=1) + known * random.normal(size=len(readings)))
    scatter = readings.std(axis=1, ddof=1) / count**0.5
    for confidence in CONFIDENCES:
        # Half widths of unit errors give those of all draws: no loop over them.
        half = [Referenced(0.0, 1.0, count - 1, 0.0).interval(confidence).high, stats.norm.isf((1 - confidence) / 2)]
        one = Referenced(0.0, scatter[0], count - 1, known).interval(confidence).high
        halves = np.hypot(half[0] * scatter, half[1] * known)
        assert halves[0] == pytest.approx(one, rel=1e-12)
        held = float(np.mean(away <= halves))
        assert confidence - 0.003 <= held <= confidence + 0.07, (confidence, held)


@pytest.mark.parametrize("known", [0.0, 1e-6, 0.3, 5.0])
@pytest.mark.parametrize("value", [0.0, 1e-9, 0.2, 3.0, 60.0])
def test_p_is_that_of_the_interval_that_just_reaches(known, value):
    found = Referenced(value, 0.4, 2, known)
    p = found.p_value()
    assert 0 <= p <= 1
    if 0 < p < 1 - 1e-6:
        assert found.interval(1 - p).low == pytest.approx(0.0, abs=1e-6 * max(value, 1e-3))
    assert (p < 0.05) is (not found.interval(0.95).holds(0.0))


def test_an_exact_reference_is_students_t():
    one, other = Referenced(0.3, 0.1, 4), Contrast(0.3, 0.1, 4)
    assert one.p_value() == pytest.approx(other.p_value(), rel=1e-12)
    assert one.interval(0.9) == other.interval(0.9)
    assert one.statistic(0.1) == pytest.approx(other.statistic(0.1))
    with pytest.raises(NumericsError, match="confidence is 95"):
        one.interval(95)


def test_what_cannot_be_told_from_zero_has_p_zero():
    assert Referenced(1e6, 1e-3, 5000, 1e-3).p_value() == 0.0
