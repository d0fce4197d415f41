"""Capability indices, yields and adjusted p values against printed values, exact tails and simulated lots."""

import json
from math import exp, sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import special, stats
from tiers import rest_but

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.difference import benjamini_hochberg, holm
from cbsr_qa.stats.percentile_capability import percentile_index, percentile_index_of_extremes
from cbsr_qa.stats.process_capability import capability, capability_of_extremes, pass_rate


def indices(mean, deviation, count, **limits):
    """Cp and Cpk of values with exactly this mean and deviation."""
    drawn = np.arange(count) - (count - 1) / 2
    found = capability([mean + deviation * drawn / drawn.std(ddof=1)], **limits)
    return found.cp, found.cpk


@pytest.mark.shared
def test_handbook_index(shared):
    printed = json.loads((shared / "oracle" / "statistics.json").read_text(encoding="utf-8"))["cpk"]
    cp, cpk = indices(printed["mean"], printed["s"], 50, lower=printed["LSL"], upper=printed["USL"])
    assert (cp.value, cpk.value) == pytest.approx((printed["Cp"], printed["Cpk"]), rel=1e-14)


def test_interval_of_cp_is_the_chi_square_one():
    cp, _ = indices(0.0, 1.0, 50, lower=-4.0, upper=4.0)
    # χ² of 49 degrees of freedom: 31.555 and 70.222 (printed tables).
    ends = 4 / 3 * sqrt(31.555 / 49), 4 / 3 * sqrt(70.222 / 49)
    assert (cp.low, cp.high) == pytest.approx(ends, rel=2e-5)


@pytest.mark.parametrize("mean", [-2.0, 0.5, 2.0, 12.0])
def test_interval_of_one_limit_has_the_tails_it_says(mean):
    """At each end the observed index is exactly the quantile it should be; also for a mean beyond the limit."""
    _, found = indices(mean, 1.0, 12, lower=0.0)
    scale = 3 * sqrt(12)
    assert stats.nct.cdf(scale * found.value, 11, scale * found.low) == pytest.approx(0.975, abs=1e-8)
    assert stats.nct.cdf(scale * found.value, 11, scale * found.high) == pytest.approx(0.025, abs=1e-8)


@pytest.mark.parametrize("upper", rest_but({None}, [4.0, None]))
def test_intervals_cover(upper):
    lots = np.random.default_rng(80).normal(size=(2000 if upper else 600, 30))  # one limit: two roots a lot
    found = [capability([lot], lower=-3.0, upper=upper) for lot in lots]
    assert 0.93 <= np.mean([one.ppk.low <= 1.0 <= one.ppk.high for one in found]) <= 0.97
    if upper is not None:
        assert 0.935 <= np.mean([one.pp.low <= 7 / 6 <= one.pp.high for one in found]) <= 0.965


@pytest.mark.rest
@pytest.mark.parametrize("upper", [5.0, None])
@pytest.mark.parametrize(("subgroups", "size", "between"), [(3, 10, 1.0), (6, 10, 0.5), (10, 5, 1.0)])
def test_intervals_of_several_subgroups_cover_what_further_ones_show(subgroups, size, between, upper):
    """Subgroups are drawn like further ones; the plain intervals covered Ppk in 63 to 86 % where they differ."""
    random = np.random.default_rng([83, subgroups])
    overall, held = sqrt(1 + between**2), []
    for _ in range(250):
        means = between * random.normal(size=(subgroups, 1))
        found = capability(means + random.normal(size=(subgroups, size)), lower=-5.0, upper=upper)
        held.append([found.cpk.low <= 5 / 3 <= found.cpk.high, found.ppk.low <= 5 / 3 / overall <= found.ppk.high])
        if upper is not None:
            held[-1] += [found.cp.low <= 5 / 3 <= found.cp.high, found.pp.low <= 5 / 3 / overall <= found.pp.high]
    assert np.mean(held, axis=0).min() >= 0.93 - 3 * sqrt(0.05 * 0.95 / 250)  # nearly exact


def test_a_subgroup_more_of_the_same_narrows_and_one_that_differs_widens_the_interval_of_ppk():
    random = np.random.default_rng(84)
    alike, apart = random.normal(size=(6, 10)), random.normal(size=(6, 10)) + 3 * np.arange(6)[:, None]
    width = [
        (one.ppk.high - one.ppk.low) / one.ppk.value
        for one in (capability(lot, lower=-20.0) for lot in (alike, apart))
    ]
    assert width[0] < width[1]
    assert capability(alike, lower=-20.0).cp is None


@pytest.mark.parametrize(
    ("lot", "refuted", "telling"),
    [
        (np.random.default_rng(85).normal(size=60), False, True),
        (np.exp(0.5 * np.random.default_rng(86).normal(size=60)), True, True),
        (np.exp(0.5 * np.random.default_rng(87).normal(size=8)), False, False),
    ],
)
def test_normality_is_refuted_or_not_and_few_values_are_said_to_tell_nothing(lot, refuted, telling):
    found = capability([lot], lower=-9.0).normality
    assert (found.refuted, found.telling) == (refuted, telling)
    assert capability([[1.0, 2.0]], lower=0.0).normality is None


def test_percentiles_of_log_normal_values_tell_what_sigma_does_not():
    """Log-normal values of shape 0.5, limit at mean + 3 σ: Ppk 1.00 means 1350 ppm of normal ones; 15 400 are."""
    values = np.exp(0.5 * special.ndtri((np.arange(200) + 0.5) / 200))
    mean, deviation = exp(0.125), sqrt((exp(0.25) - 1) * exp(0.25))
    upper = mean + 3 * deviation
    true = (upper - 1) / (exp(1.5) - 1)
    assert true == pytest.approx(0.56, abs=0.01)
    assert 1 - stats.norm.cdf(np.log(upper) / 0.5) == pytest.approx(15_400e-6, rel=0.01)
    found = percentile_index([values], lower=None, upper=upper, confidence=0.95)
    assert found.low < true < found.high < capability([values], upper=upper).ppk.value
    assert found.value == pytest.approx(true, rel=0.1)


def test_percentiles_of_normal_values_give_about_the_index_of_sigma():
    values = special.ndtri((np.arange(100) + 0.5) / 100)
    plain = capability([values], lower=-4.0, upper=4.5)
    found = percentile_index([values], lower=-4.0, upper=4.5, confidence=0.95)
    assert found.value == pytest.approx(plain.ppk.value, rel=0.05)
    assert found.low < plain.ppk.low
    assert found.high == pytest.approx(plain.ppk.high, rel=0.05)
    mirrored = percentile_index([-values], lower=-4.5, upper=4.0, confidence=0.95)
    assert mirrored.value == pytest.approx(found.value, rel=1e-3)


@pytest.mark.parametrize(
    ("groups", "reason"),
    [
        ([[1.0, 2.0, 3.0]], "percentiles need 10 values; there are 3"),
        ([[1.0] * 8 + [2.0, 3.0, 4.0]], "more than half of the values are the same"),
        ([list(range(10)), list(range(50, 60))], "subgroups differ"),
    ],
)
def test_where_percentiles_tell_nothing_it_is_said(groups, reason):
    assert percentile_index(groups, lower=0.0, upper=None, confidence=0.95).startswith(reason)


def test_both_sides_of_several_loads_have_the_lesser_index_by_percentiles():
    random = np.random.default_rng(88)
    least, greatest = random.normal(-1, 1, 30), random.normal(1, 1, 30)
    found = percentile_index_of_extremes([least], [greatest], lower=-6.0, upper=4.0, confidence=0.95)
    alone = percentile_index([greatest], lower=None, upper=4.0, confidence=0.975)
    assert (found.value, found.high) == (alone.value, alone.high)
    few = percentile_index_of_extremes([least[:5]], [greatest[:5]], lower=-6.0, upper=4.0, confidence=0.95)
    assert few.startswith("percentiles need 10")


@pytest.mark.rest
@pytest.mark.parametrize("count", [30, 100])
def test_intervals_by_percentiles_cover(count):
    random, held = np.random.default_rng([89, count]), []
    shapes = (
        (lambda: np.exp(0.5 * random.normal(size=count)), lambda p: exp(0.5 * special.ndtri(p))),
        (lambda: random.normal(size=count), special.ndtri),
        (lambda: random.weibull(1.5, count), stats.weibull_min(1.5).ppf),
    )
    for draw, quantile in shapes:
        upper, middle, far = (quantile(share) for share in (0.99, 0.5, 0.99865))
        for _ in range(60):
            found = percentile_index([draw()], lower=None, upper=upper, confidence=0.95)
            held.append(found.low <= (upper - middle) / (far - middle) <= found.high)
    assert np.mean(held) >= 0.93 - 3 * sqrt(0.07 * 0.93 / len(held))


def test_two_limits_that_judge_several_loads_have_the_indices_of_both_sides():
    least, greatest = [[1.0, 3.0], [2.0, 4.0]], [[5.0, 8.0], [5.0, 8.0]]
    found = capability_of_extremes(least, greatest, lower=-6.0, upper=20.0)
    low, high = sqrt(2.0), sqrt(4.5)
    assert found.cpk.value == pytest.approx(min((2.5 + 6) / (3 * low), (20 - 6.5) / (3 * high)))
    assert found.cp.value == pytest.approx((26 - 4.0) / (3 * low + 3 * high))
    # Moved to the best place, the process reaches Cp on both sides: by δ with both rooms alike in deviations.
    move = (low * (20 - 6.5) - high * (2.5 + 6)) / (low + high)
    shift = lambda groups: [[value + move for value in group] for group in groups]  # noqa: E731
    moved = capability_of_extremes(shift(least), shift(greatest), lower=-6.0, upper=20.0)
    assert moved.cpk.value == pytest.approx(moved.cp.value) == pytest.approx(found.cp.value)
    assert found.ppk.value == pytest.approx(
        min(8.5 / np.std(np.ravel(least), ddof=1), 13.5 / np.std(np.ravel(greatest), ddof=1)) / 3
    )


def test_one_load_a_run_gives_the_usual_indices():
    lot = np.random.default_rng(81).normal(size=(3, 10))
    usual, found = capability(lot, lower=-4.0, upper=3.0), capability_of_extremes(lot, lot, lower=-4.0, upper=3.0)
    for name in ("cp", "cpk", "pp", "ppk"):
        assert getattr(found, name).value == pytest.approx(getattr(usual, name).value)


def test_intervals_of_both_sides_hold_at_least_the_stated_share():
    random = np.random.default_rng(82)
    lots = 1 + 0.5 * random.normal(size=(120, 25, 1)) + random.normal(size=(120, 25, 6))
    loads = 1 + 0.5 * random.normal(size=(200_000, 1)) + random.normal(size=(200_000, 6))
    low, high = loads.min(axis=1), loads.max(axis=1)
    cpk = min((low.mean() + 5) / low.std(), (6 - high.mean()) / high.std()) / 3
    cp = (11 - (high - low).mean()) / (3 * low.std() + 3 * high.std())
    found = [capability_of_extremes([lot.min(axis=1)], [lot.max(axis=1)], lower=-5.0, upper=6.0) for lot in lots]
    # Extremes are not normal, and Bonferroni's intervals are wide: at least the stated share, not exactly it.
    assert np.mean([one.ppk.low <= cpk <= one.ppk.high for one in found]) >= 0.93
    assert np.mean([one.pp.low <= cp <= one.pp.high for one in found]) >= 0.94


def test_short_and_long_term_are_told_apart():
    groups = [[0.0, 2.0], [10.0, 12.0], [20.0, 22.0]]
    found = capability(groups, lower=-10.0, upper=30.0)
    assert found.within == pytest.approx(sqrt(2.0))
    assert found.overall == pytest.approx(np.std(np.ravel(groups), ddof=1))
    assert found.cpk.value == pytest.approx(19 / (3 * sqrt(2)))
    assert found.ppk.value < found.cpk.value
    alone = capability([np.ravel(groups)], lower=-10.0)
    assert alone.cpk == alone.ppk
    assert alone.cp is alone.pp is None


@settings(deadline=None)
@given(
    st.lists(st.integers(-80, 80), min_size=3, max_size=20).filter(lambda lot: len(set(lot)) > 1),
    st.sampled_from([0.25, 3.0, 1e6]),
    st.sampled_from([-1e6, 0.0, 17.0]),
)
def test_indices_have_no_unit_and_mirror(lot, scale, shift):
    here = capability([lot], lower=-90.0, upper=100.0)
    there = capability([[scale * x + shift for x in lot]], lower=-90 * scale + shift, upper=100 * scale + shift)
    mirrored = capability([[-x for x in lot]], lower=-100.0, upper=90.0)
    for other in (there, mirrored):
        assert other.cpk.value == pytest.approx(here.cpk.value, rel=1e-6)
        assert other.cp.low == pytest.approx(here.cp.low, rel=1e-6)


@pytest.mark.parametrize(
    ("groups", "limits", "reason"),
    [
        ([[1.0, 2.0]], {}, "at least one limit"),
        ([[1.0, 2.0]], {"lower": 2.0, "upper": 1.0}, "lower limit 2.0 is not below"),
        ([[1.0]], {"lower": 0.0}, "1 value instead of at least 2"),
        ([], {"lower": 0.0}, "0 values"),
        ([[1.0, 1.0]], {"lower": 0.0}, "no variance"),
        ([[1.0], [2.0]], {"lower": 0.0}, "every subgroup has one value"),
        ([[1.0, 1.0], [2.0, 2.0]], {"lower": 0.0}, "within the subgroups do not differ"),
        ([[1.0, float("nan")]], {"lower": 0.0}, "subgroup 1: 1 of 2 values are missing"),
    ],
)
def test_what_has_no_capability_is_named(groups, limits, reason):
    with pytest.raises(NumericsError, match=f"A_OL.*{reason}"):
        capability(groups, what="A_OL", **limits)


def test_intervals_of_a_yield_are_the_printed_ones():
    """Newcombe 1998, table I: 81/263 and 15/148, 0/20, 1/29; to the four digits printed."""
    printed = [
        (81, 263, (0.2553, 0.3662)),
        (15, 148, (0.0624, 0.1605)),
        (0, 20, (0.0, 0.1611)),
        (1, 29, (0.0061, 0.1718)),
    ]
    for passed, count, wilson in printed:
        found = pass_rate(passed, count)
        assert (found.wilson.low, found.wilson.high) == pytest.approx(wilson, abs=6e-5)


@settings(deadline=None)
@given(st.integers(1, 300), st.data())
def test_yield_intervals_mirror_and_hold_the_share(count, data):
    passed = data.draw(st.integers(0, count))
    found, other = pass_rate(passed, count), pass_rate(count - passed, count)
    here, there = found.wilson, other.wilson
    assert 0 <= here.low <= found.value <= here.high <= 1
    assert here.low == pytest.approx(1 - there.high, abs=1e-12)


def test_shares_of_nothing_are_refused():
    with pytest.raises(NumericsError, match="0 of 0"):
        pass_rate(0, 0)
    with pytest.raises(NumericsError, match="confidence is 95"):
        pass_rate(1, 2, confidence=95)


#: Benjamini & Hochberg 1995, section 3.2 (thrombolysis): four are rejected, Bonferroni rejects three.
PUBLISHED = [
    0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344,
    0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0,
]  # fmt: skip


def test_published_p_values():
    assert np.sum(benjamini_hochberg(PUBLISHED) <= 0.05) == 4
    assert np.sum(holm(PUBLISHED) <= 0.05) == 3
    assert benjamini_hochberg(PUBLISHED)[:4] == pytest.approx([0.0015, 0.003, 0.0095, 0.035625])
    assert holm(PUBLISHED)[:4] == pytest.approx([0.0015, 0.0056, 0.0247, 0.1140])


@settings(deadline=None)
@given(st.lists(st.integers(0, 1000).map(lambda number: number / 1000), max_size=30), st.randoms())
def test_adjusted_values_follow_their_tests(p_values, random):
    order = list(range(len(p_values)))
    random.shuffle(order)
    for method in (holm, benjamini_hochberg):
        adjusted = method(p_values)
        assert np.all(adjusted >= p_values)
        assert np.all(adjusted <= 1)
        assert method([p_values[index] for index in order]) == pytest.approx(adjusted[order])


def test_p_values_that_are_none_are_refused():
    with pytest.raises(NumericsError, match=r"1\.2 is not between"):
        holm([0.1, 1.2])
    with pytest.raises(NumericsError, match="missing"):
        benjamini_hochberg([0.1, float("nan")])
