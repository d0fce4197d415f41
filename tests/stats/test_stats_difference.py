"""Differences of two groups, equivalence, ranks and power against printed values, scipy and simulated groups."""

import json
from itertools import combinations
from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.difference import Contrast, hedges, unbiasing, welch
from cbsr_qa.stats.power_analysis import power, power_of_equivalence, sensors_needed, sensors_to_show_alike
from cbsr_qa.stats.robust import brunner_munzel, differences_of_rank, shift

groups = st.lists(st.integers(-400, 400).map(lambda number: number / 16), min_size=2, max_size=15).filter(
    lambda group: len(set(group)) > 1
)


@pytest.fixture(scope="module")
def printed(shared):
    return json.loads((shared / "oracle" / "statistics.json").read_text(encoding="utf-8"))["tost"]


@pytest.mark.shared
def test_equivalence_is_the_printed_one(printed):
    contrast = welch(printed["g1"], printed["g2"])
    found = contrast.equivalence(printed["eps"])
    assert found.p_value == pytest.approx(printed["welch_p"], rel=1e-9)
    assert contrast.freedom == pytest.approx(printed["welch_df"], rel=1e-11)
    assert (found.interval.low, found.interval.high) == pytest.approx(printed["ci_welch90"], rel=1e-9)
    assert found.equivalent
    assert not contrast.equivalence(printed["eps"], level=0.04).equivalent


@settings(deadline=None)
@given(st.floats(-3, 3), st.floats(0.1, 2), st.floats(2, 60), st.sampled_from([0.5, 1.0, 2.0]))
def test_equivalent_where_the_interval_lies_within_the_margin(value, error, freedom, margin):
    found = Contrast(value, error, freedom).equivalence(margin)
    assert found.equivalent == (-margin <= found.interval.low and found.interval.high <= margin)


@settings(deadline=None)
@given(groups, groups, st.sampled_from([0.5, 1.0, 1e3]), st.sampled_from([-1e5, 0.0, 3.0]))
def test_differences_are_scipys_in_any_unit(first, second, scale, origin):
    one, two = ([scale * x + origin for x in group] for group in (first, second))
    theirs, found = stats.ttest_ind(first, second, equal_var=False), welch(one, two)
    interval = theirs.confidence_interval(0.9)
    assert found.freedom == pytest.approx(theirs.df, rel=1e-8)
    assert found.p_value() == pytest.approx(theirs.pvalue, rel=1e-6, abs=1e-12)
    assert found.interval(0.9).low == pytest.approx(scale * interval.low, rel=1e-6, abs=1e-6 * scale)


def test_unbiasing_factors():
    """Closed forms: Γ(½) = √π, Γ(3/2) = √π/2, Γ(9/2) = 105 √π/16; and Hedges' approximation 1 − 3/(4ν − 1)."""
    closed = [1 / sqrt(pi), sqrt(2 / pi), 24 * 16 / (105 * sqrt(5 * pi))]
    assert [unbiasing(freedom) for freedom in (2, 4, 10)] == pytest.approx(closed, rel=1e-12)
    assert unbiasing(200) == pytest.approx(1 - 3 / 799, abs=1e-6)


def test_effect_sizes_are_unbiased_and_covered():
    random = np.random.default_rng(88)
    found = [hedges(random.normal(1.5, 1.0, 6), random.normal(0.0, 1.0, 9)) for _ in range(1500)]
    mean = np.mean([one.value for one in found])
    assert abs(mean - 1.5) < 4 * 0.62 / sqrt(1500)  # d itself would be off by 6 %, 0.09
    assert 0.935 <= np.mean([one.interval.holds(1.5) for one in found]) <= 0.965


@pytest.mark.parametrize("size", [1e3, 1e7, 1e12])
def test_effects_beyond_all_tables(size):
    """Far apart, only the deviation's own error is left: δ/d is √(χ²/ν), between its 2.5 % and 97.5 % points."""
    found = hedges([size, size + 1, size - 1], [0.0, 1.0, -1.0])
    low, high = np.sqrt(stats.chi2.ppf([0.025, 0.975], 4) / 4)
    ends = found.interval.low / size, found.interval.high / size
    assert ends == pytest.approx((low, high), rel=1e-5)
    assert hedges([0.0, 1.0, -1.0], [size, size + 1, size - 1]).interval.high == pytest.approx(-found.interval.low)


@settings(deadline=None)
@given(groups, groups)
def test_effect_size_turns_with_its_groups(first, second):
    here, there = hedges(first, second), hedges(second, first)
    assert here.value == pytest.approx(-there.value)
    assert here.interval.low == pytest.approx(-there.interval.high, abs=1e-7)
    p = stats.ttest_ind(first, second).pvalue
    if abs(p - 0.05) > 1e-6:
        assert here.interval.holds(0.0) == (p >= 0.05)


@pytest.mark.parametrize(
    ("first", "second", "reason"),
    [
        ([1.0], [1.0, 2.0], "batch 41: 1 value instead of at least 2"),
        ([1.0, 2.0], [], "batch 42: 0 values"),
        ([1.0, 1.0], [2.0, 2.0], r"batch 41 − batch 42: values do not differ within either group.* judge -1 against"),
        ([1.0, float("nan")], [2.0, 3.0], "batch 41: 1 of 2 values are missing"),
    ],
)
@pytest.mark.parametrize("method", [welch, hedges])
def test_what_cannot_be_compared_is_named(first, second, reason, method):
    with pytest.raises(NumericsError, match=reason):
        method(first, second, names=("batch 41", "batch 42"))


def test_margins_that_are_none_are_refused():
    for margin in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(NumericsError, match="margin"):
            Contrast(0.0, 1.0, 5.0).equivalence(margin)


@pytest.mark.parametrize(
    # Computed by G*Power 3.1 and printed in Faul et al. 2007 and its manual: 64 for d = 0.5, 0.8 (power 0.801460).
    ("size", "wanted", "count"),
    [(0.2, 0.8, 394), (0.5, 0.8, 64), (0.8, 0.8, 26), (0.5, 0.9, 86), (0.8, 0.95, 42)],
)
def test_numbers_of_sensors_are_the_published_ones(size, wanted, count):
    assert sensors_needed(size, wanted=wanted) == sensors_needed(-size, wanted=wanted) == count
    assert power(size, count - 1, count - 1) < wanted <= power(size, count, count)


def test_power_is_the_published_and_the_simulated_one():
    assert power(0.5, 64, 64) == pytest.approx(0.8014596, abs=5e-8)
    assert power(0.0, 9, 4) == pytest.approx(0.05, abs=1e-12)
    random = np.random.default_rng(89)
    tests = stats.ttest_ind(random.normal(1.2, 1, (20000, 5)), random.normal(0, 1, (20000, 9)), axis=1)
    assert power(1.2, 5, 9) == pytest.approx(np.mean(tests.pvalue < 0.05), abs=4 * sqrt(0.25 / 20000))


def test_power_at_its_ends():
    assert sensors_needed(50.0) == 2
    assert power(1e6, 3, 3) == pytest.approx(1.0)
    normal = 2 * (stats.norm.ppf(0.975) + stats.norm.ppf(0.8)) ** 2  # what the t test comes to for large groups
    assert sensors_needed(0.01) == pytest.approx(normal / 0.01**2, rel=2e-5)
    for size, reason in ((0.0, "no number of sensors"), (float("nan"), "no number"), (1e-9, "more than 1e")):
        with pytest.raises(NumericsError, match=reason):
            sensors_needed(size)
    with pytest.raises(NumericsError, match="too small for a t test"):
        power(1.0, 1, 1)
    with pytest.raises(NumericsError, match="not above the level"):
        sensors_needed(1.0, wanted=0.05)


@pytest.mark.parametrize(("margin", "first", "second"), [(0.8, 20, 20), (1.2, 6, 15), (0.5, 70, 60), (2.5, 2, 2)])
def test_power_of_equivalence_is_that_of_simulated_groups(margin, first, second):
    random = np.random.default_rng(92)
    here, there = (random.standard_normal((20000, count)) for count in (first, second))
    inside = stats.ttest_ind(here, there, axis=1).confidence_interval(0.9)
    shown = np.mean((inside.low >= -margin) & (inside.high <= margin))
    assert power_of_equivalence(margin, first, second) == pytest.approx(shown, abs=4 * sqrt(0.25 / 20000))


def test_sensors_to_show_alike_are_the_fewest_that_do():
    for margin in (0.1, 0.75, 3.0):
        count = sensors_to_show_alike(margin)
        fewer = power_of_equivalence(margin, count - 1, count - 1) if count > 2 else 0.0
        assert fewer < 0.8 <= power_of_equivalence(margin, count, count)
    # For large groups both are normal: z of 0.95 and of 0.9 (an error of 0.2 on two sides), of 0.975 and of 0.8.
    normal = 2 * (stats.norm.ppf(0.95) + stats.norm.ppf(0.9)) ** 2
    assert sensors_to_show_alike(0.01) == pytest.approx(normal / 0.01**2, rel=2e-5)
    assert power_of_equivalence(50.0, 3, 3) == pytest.approx(1.0)
    assert power_of_equivalence(0.01, 5, 5) < 1e-3
    for margin, reason in ((0.0, "no number of sensors shows"), (-1.0, "no number"), (1e-9, "more than 1e")):
        with pytest.raises(NumericsError, match=reason):
            sensors_to_show_alike(margin)
    with pytest.raises(NumericsError, match="not above the level"):
        sensors_to_show_alike(1.0, wanted=0.05)
    with pytest.raises(NumericsError, match="too small for a t test"):
        power_of_equivalence(1.0, 1, 1)


# Hollander & Wolfe 1999, table 4.1: permeability of a membrane at term and after 12 to 26 weeks.
TERM = [0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46]
EARLY = [1.15, 0.88, 0.90, 0.74, 1.21]


def test_shift_is_the_textbooks():
    """W = 35, P(U ≥ 35) = 0.1272, estimate 0.305 and the 96 % interval (−0.15, 0.76)."""
    found = shift(TERM, EARLY, confidence=0.96)
    assert (found.statistic, found.exact) == (35, True)
    assert found.p_value == pytest.approx(2 * 0.1272, abs=1e-4)
    assert (found.value, found.interval.low, found.interval.high) == pytest.approx((0.305, -0.15, 0.76))


@pytest.mark.parametrize(("first", "second"), [(1, 4), (4, 3), (5, 6)])
def test_counted_ranks_are_those_of_all_orders(first, second):
    """The p value of every U there can be, from all ways to choose who is who."""
    total = first + second
    chosen = [np.array(indices) for indices in combinations(range(total), first)]
    statistics = np.array([indices.sum() for indices in chosen]) - first * (first - 1) / 2
    for indices in chosen[:: max(len(chosen) // 20, 1)]:
        others = np.setdiff1d(np.arange(total), indices)
        found = shift(indices, others)
        away = abs(found.statistic - first * second / 2)
        assert found.p_value == pytest.approx(np.mean(np.abs(statistics - first * second / 2) >= away - 1e-9))


@settings(deadline=None)
@given(groups, groups)
def test_ranks_are_scipys(first, second):
    found = shift(first, second)
    theirs = stats.mannwhitneyu(first, second, method="exact" if found.exact else "asymptotic")
    assert found.statistic == theirs.statistic
    assert found.p_value == pytest.approx(theirs.pvalue, rel=1e-9)
    turned = shift(second, first)
    assert turned.value == pytest.approx(-found.value)
    if found.interval is not None:
        assert found.interval.low <= found.value <= found.interval.high
        assert turned.interval.low == pytest.approx(-found.interval.high)


def test_shift_intervals_cover_outliers_and_all():
    random = np.random.default_rng(90)
    found = [shift(random.standard_cauchy(15) + 2, random.standard_cauchy(12)) for _ in range(1500)]
    assert 0.94 <= np.mean([one.interval.holds(2.0) for one in found]) <= 0.965
    assert shift([1.0, 2.0], [3.0, 4.0]).interval is None  # no two groups of two have a 95 % interval


def test_many_differences_are_counted_not_made():
    random = np.random.default_rng(91)
    x, y = random.normal(size=1400), random.normal(size=900)
    ranks = (1, 1000, 630000, 1400 * 900)
    made = np.sort(np.subtract.outer(x, y).ravel())
    assert differences_of_rank(x, y, ranks) == pytest.approx([made[rank - 1] for rank in ranks], abs=1e-14)


def test_brunner_and_munzels_own_example():
    """Pain scores after surgery, Brunner & Munzel 2000: statistic 3.1375, ν = 17.683, p = 0.005786, effect 0.789."""
    treated = [1, 2, 1, 1, 1, 1, 1, 1, 1, 1, 2, 4, 1, 1]
    control = [3, 3, 4, 3, 1, 2, 3, 1, 1, 5, 4]
    found = brunner_munzel(treated, control)
    assert (found.statistic, found.freedom) == pytest.approx((3.1375, 17.683), abs=5e-4)
    assert found.p_value == pytest.approx(0.005786, abs=5e-7)
    assert (found.value, found.interval.low, found.interval.high) == pytest.approx(
        (0.78896, 0.59522, 0.98271), abs=1e-5
    )
    assert brunner_munzel(control, treated).value == pytest.approx(1 - found.value)


def test_ranks_that_say_nothing_are_refused():
    with pytest.raises(NumericsError, match="cannot be ranked"):
        shift([1.0, 1.0], [1.0])
    with pytest.raises(NumericsError, match="do not overlap"):
        brunner_munzel([1.0, 2.0], [3.0, 4.0])
    with pytest.raises(NumericsError, match="second: 1 value"):
        brunner_munzel([1.0, 2.0], [3.0])
    with pytest.raises(NumericsError, match="missing"):
        shift([1.0, float("nan")], [1.0])
