"""The shift of two groups within strata: pairs counted one by one, invariance, and coverage by simulation."""

import numpy as np
import pytest
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.robust import shift
from cbsr_qa.stats.stratified import shift_within

SIZES = [(7, 6), (5, 9), (8, 3)]


def draw_strata(seed, offsets=(0.0, 3.0, -2.0), difference=0.0, draw=np.random.Generator.standard_normal):
    random = np.random.default_rng([840, seed])
    return [
        (offset + difference + draw(random, n), offset + draw(random, m))
        for offset, (n, m) in zip(offsets, SIZES, strict=True)
    ]


def count_pairs(strata, difference):
    """T by comparing every pair."""
    total = 0.0
    for first, second in strata:
        above = np.subtract.outer(first, second) - difference
        pairs = np.sum(above > 0) + 0.5 * np.sum(above == 0)
        total += (pairs - above.size / 2) / (len(first) + len(second) + 1)
    return total


def test_the_statistic_changes_sign_at_the_shift_and_is_normal_at_the_intervals_ends():
    strata = draw_strata(1, difference=0.7)
    found = shift_within(strata)
    deviation = np.sqrt(sum(n * m / (12 * (n + m + 1)) for n, m in SIZES))
    step = 1e-9
    assert count_pairs(strata, found.value - step) >= 0 >= count_pairs(strata, found.value + step)
    reach = stats.norm.isf(0.025) * deviation
    assert count_pairs(strata, found.interval.low - step) > reach >= count_pairs(strata, found.interval.low + step)
    assert count_pairs(strata, found.interval.high - step) >= -reach > count_pairs(strata, found.interval.high + step)
    assert found.p_value == pytest.approx(2 * stats.norm.sf(abs(count_pairs(strata, 0.0)) / deviation))


def test_offsets_of_strata_cancel_and_the_other_direction_is_the_negative():
    plain, moved = (shift_within(draw_strata(2, offsets)) for offsets in ((0, 0, 0), (5, -9, 100)))
    assert moved.value == pytest.approx(plain.value, abs=1e-12)
    assert moved.interval.high == pytest.approx(plain.interval.high, abs=1e-12)
    turned = shift_within([(second, first) for first, second in draw_strata(2, (0, 0, 0))])
    assert turned.value == pytest.approx(-plain.value, abs=1e-12)
    assert (turned.interval.low, turned.interval.high) == pytest.approx((-plain.interval.high, -plain.interval.low))


def test_one_stratum_is_judged_as_two_groups():
    first, second = draw_strata(3)[0]
    empty = np.zeros(0)
    assert shift_within([(first, second), (first, empty), (empty, second)]) == shift(first, second)


@pytest.mark.rest
def test_intervals_hold_whatever_stations_add_and_however_sensors_are_distributed():
    """95 % within three standard errors of 800 draws, of normal and of skewed (exponential) sensors."""
    for draw in (np.random.Generator.standard_normal, np.random.Generator.standard_exponential):
        held = [shift_within(draw_strata(seed, difference=1.0, draw=draw)).interval.holds(1.0) for seed in range(800)]
        assert np.mean(held) == pytest.approx(0.95, abs=0.023)


@pytest.mark.parametrize(
    "strata", [[], [(np.zeros(0), np.ones(3))], [(np.ones(3), np.ones(3)), (np.zeros(2), np.zeros(2))]]
)
def test_what_cannot_be_ranked_is_refused(strata):
    with pytest.raises(NumericsError, match="first − second"):
        shift_within(strata)


@pytest.mark.parametrize("far", [1e6, 1e15, 9.9e37, 1e140])
def test_one_value_far_away_moves_the_shift_no_further_than_one_that_is_merely_largest(far):
    strata = draw_strata(4)
    plain, moved = (
        shift_within([(np.append(strata[0][0], value), strata[0][1]), *strata[1:]]) for value in (50.0, far)
    )
    assert (moved.value, moved.interval, moved.p_value) == (plain.value, plain.interval, plain.p_value)


def test_ends_are_differences_of_values_also_with_ties():
    random = np.random.default_rng(841)
    for _ in range(40):
        found = shift_within(
            [(random.integers(0, 2, 6).astype(float), random.integers(0, 2, 7).astype(float)) for _ in range(2)]
            + [(np.array([0.0, 1.0]), np.array([1.0]))]
        )
        assert found.value in {-1.0, -0.5, 0.0, 0.5, 1.0}
        if found.interval is not None:
            assert {found.interval.low, found.interval.high} <= {-1.0, 0.0, 1.0}
            assert found.interval.holds(found.value)
