"""Limits from lots of known distribution: what they promise, they hold; what they cannot, they refuse."""

from math import exp, sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from cbsr_qa.stats.golden_lots import Ask, lot_limits, outward
from cbsr_qa.stats.guard_bands import Uncertainty, repeatability, risks, risks_of_bound
from cbsr_qa.stats.intervals import count_needed
from cbsr_qa.stats.lot_shapes import Distribution

UPPER = Ask(0.99, 0.95, lower=False, upper=True)
LOWER = Ask(0.99, 0.95, lower=True, upper=False)
HEAVY = Ask(0.99, 0.95, lower=False, upper=True, distribution=Distribution.HEAVY)
BOTH = Ask(0.99, 0.95, lower=True, upper=True)
NORMAL = Ask(0.99, 0.95, lower=False, upper=True, distribution=Distribution.NORMAL)


def proposed(lot, ask=UPPER):
    """Limits of a lot, (sensors, values) one run each."""
    return lot_limits([[row.min()] for row in lot], [[row.max()] for row in lot], lot.shape[1], ask)


#: Lots of 30 sensors, (30, values): what single values are distributed like.
LOTS = {
    "normal": lambda random: random.normal(5, 1, (30, 1)),
    "nine independent": lambda random: random.normal(5, 1, (30, 9)),
    "nine that go together": lambda random: 9 + random.normal(0, 0.9, (30, 1)) + random.normal(0, 0.4, (30, 9)),
    "nine places that differ": lambda random: (
        np.linspace(9, 12, 9) + random.normal(0, np.linspace(0.5, 1, 9), (30, 9))
    ),
    "log-normal": lambda random: np.exp(random.normal(0, 0.4, (30, 1))),
    "distances": lambda random: random.rayleigh(1, (30, 9)),
}


@pytest.mark.rest
@pytest.mark.parametrize("name", LOTS)
def test_limits_hold_their_share_of_good_sensors_in_as_many_lots_as_promised(name):
    """Content of at least 99 % in at least 95 % of 250 lots, less three standard errors."""
    lots = LOTS[name]
    many = np.random.default_rng(99)
    population = np.concatenate([lots(many).max(axis=1) for _ in range(3000)])
    quantile = float(np.quantile(population, 0.99))
    random = np.random.default_rng(12)
    found = [proposed(lots(random)) for _ in range(250)]
    held = [limits.upper.limit >= quantile for limits in found if limits.upper is not None]
    assert len(held) >= 240  # a right distribution is refuted in a lot of a hundred
    assert np.mean(held) >= 0.95 - 3 * sqrt(0.95 * 0.05 / len(held))


@pytest.mark.rest
def test_two_bounds_hold_the_middle_of_a_normal_population():
    random = np.random.default_rng(13)
    found = [proposed(random.normal(0, 1, (20, 1)), BOTH) for _ in range(250)]
    content = [stats.norm.cdf(f.upper.limit) - stats.norm.cdf(f.lower.limit) for f in found if f.upper is not None]
    assert np.mean(np.array(content) >= 0.99) >= 0.95 - 3 * sqrt(0.95 * 0.05 / 250)


def test_limits_do_not_fail_good_sensors_and_do_find_bad_ones():
    random = np.random.default_rng(1)
    found = [proposed(random.normal(5, 1, (200, 1)), NORMAL).upper for _ in range(40)]
    median = np.median([bound.limit for bound in found if bound is not None])
    assert 5 + stats.norm.ppf(0.99) < median < 5 + stats.norm.ppf(0.997)


def test_a_lower_limit_mirrors_an_upper_one():
    lot = np.random.default_rng(3).normal(0, 1, (25, 4))
    upper, lower = proposed(lot).upper, proposed(-lot, LOWER).lower
    assert lower.limit == pytest.approx(-upper.limit)
    assert lower.factor == pytest.approx(upper.factor)


@given(st.floats(0.01, 100), st.floats(-1000, 1000))
def test_limits_follow_the_unit(scale, shift):
    lot = np.random.default_rng(4).normal(0, 1, (15, 1))
    here, there = proposed(lot, NORMAL).upper, proposed(shift + scale * lot, NORMAL).upper
    assert there.factor == pytest.approx(here.factor)
    distance = scale * abs(here.limit - here.worst_mean)
    assert there.limit == pytest.approx(shift + scale * here.limit, abs=0.021 * distance)  # rounded, both


def test_of_distributions_that_are_not_refuted_the_widest_is_taken_and_the_other_named():
    lot = np.random.default_rng(5).normal(5, 1, (12, 1))
    bound = proposed(lot).upper
    narrower = min(bound.narrower, key=lambda other: other.limit)
    assert {bound.distribution, *(other.distribution for other in bound.narrower)} == {
        Distribution.NORMAL,
        Distribution.LOG_NORMAL,
        Distribution.SEVERAL,
    }
    assert narrower.distribution is Distribution.NORMAL
    alone = proposed(lot, NORMAL).upper
    assert max(other.limit for other in bound.narrower) <= bound.limit
    assert alone.limit == pytest.approx(narrower.limit, rel=0.01)
    assert alone.limit >= narrower.limit


def test_what_can_be_negative_is_not_log_normal():
    bound = proposed(np.random.default_rng(6).normal(0.1, 1, (12, 1))).upper
    assert {"log-normal", "Weibull"}.isdisjoint(family.family for family in bound.families)
    assert {fit.distribution for fit in bound.tests} == {Distribution.NORMAL, Distribution.SEVERAL}


def test_without_a_distribution_small_lots_are_refused_with_how_many_it_takes():
    lot = np.random.default_rng(7).choice([1.0, 9.0], (80, 1)) + np.random.default_rng(8).normal(0, 0.1, (80, 1))
    found = proposed(lot)
    assert found.upper is None
    assert "not normal (p = " in found.why
    assert "nor log-normal" in found.why
    assert f"need {count_needed(0.99, 0.95, 1)} sensors; there are 80" in found.why


@pytest.mark.rest
def test_without_a_distribution_the_extreme_of_a_large_lot_holds():
    random = np.random.default_rng(9)
    ask = Ask(0.9, 0.95, lower=False, upper=True, distribution=Distribution.ANY)
    held = []
    for _ in range(300):
        lot = random.choice([1.0, 9.0], (40, 1)) + random.exponential(1, (40, 1))
        bound = proposed(lot, ask).upper
        assert bound.limit >= np.sort(lot[:, 0])[-1] - 1e-9  # 40 sensors: the largest itself
        held.append(1 - 0.5 * (exp(-max(bound.limit - 1, 0)) + exp(-max(bound.limit - 9, 0))) >= 0.9)
    assert np.mean(held) >= 0.95 - 3 * sqrt(0.95 * 0.05 / 300)


def test_a_sensor_far_from_the_others_is_named_and_stays_in():
    lot = np.random.default_rng(10).normal(5, 0.2, (20, 1))
    without = proposed(lot).upper
    lot[7] = 6.9
    found = proposed(lot)
    assert found.far_out == (7,)
    assert found.upper is None or found.upper.limit > without.limit


@pytest.mark.parametrize(
    ("runs", "why"),
    [
        ([[1.0], [2.0]], "too few sensors: 2"),
        ([[0.3]] * 9, "every sensor has 0.3"),
        ([[1.0, 3.0]] * 6, "every sensor has 2"),
        (1e-300 * np.arange(1.0, 9.0)[:, None], "too small to be squared"),
        (1e200 * np.arange(1.0, 9.0)[:, None], "too large to be squared"),
    ],
)
def test_lots_that_say_nothing_are_refused(runs, why):
    for ask in (UPPER, BOTH):
        assert why in lot_limits(runs, runs, 1, ask).why


@pytest.mark.parametrize(
    "lot",
    [
        np.repeat([1.0, 2.0], [29, 1]),
        np.repeat([1.0, 2.0], [15, 15]),
        np.round(np.random.default_rng(20).normal(5, 1, 30)),
        np.round(np.random.default_rng(21).normal(5, 1, 100), 1),
        np.random.default_rng(22).normal(5, 1, 5),
        np.array([1.0, 1.0, 2.0]),
        np.array([0.0, 0.0, 1e-9, 1.0, 1e6]),
        np.random.default_rng(23).standard_cauchy(60),
        np.concatenate([np.random.default_rng(24).normal(5, 1, 40), [1e6]]),
    ],
    ids=["one differs", "two values", "whole numbers", "tenths", "five", "three", "decades", "Cauchy", "far away"],
)
@pytest.mark.parametrize("ask", [UPPER, BOTH, HEAVY], ids=["upper", "both", "heavy"])
def test_a_hard_lot_has_a_finite_limit_beyond_its_middle_or_says_what_it_takes(lot, ask):
    found = proposed(lot[:, None], ask)
    if found.why:
        assert "sensors; there are" in found.why
        return
    for bound, sign in ((found.lower, -1), (found.upper, 1)):
        if bound is not None:
            assert np.isfinite(bound.limit)
            assert sign * bound.limit > sign * np.median(lot)
            assert sum(family.share for family in bound.families) in (0.0, pytest.approx(1.0))


def test_ten_thousand_sensors_need_no_distribution():
    lot = np.random.default_rng(26).standard_t(3, (10_000, 1))
    bound = proposed(lot).upper
    assert bound.distribution is Distribution.ANY
    assert stats.t(3).ppf(0.99) < bound.limit < stats.t(3).ppf(0.993)


def test_numbers_of_any_size_are_judged_or_refused_and_never_overflow():
    lot = np.random.default_rng(17).normal(5, 1, (12, 1))
    assert "too large" in proposed(1e160 * lot).why
    tiny, plain = proposed(1e-200 * lot, NORMAL), proposed(lot, NORMAL)
    assert tiny.upper is None or tiny.upper.limit == pytest.approx(1e-200 * plain.upper.limit, rel=0.01)
    decades = 10.0 ** np.random.default_rng(18).uniform(-140, 140, (4, 1))
    bound = proposed(decades, Ask(0.99, 0.95, False, True, Distribution.LOG_NORMAL)).upper
    assert bound is None or np.isfinite(bound.limit)


def test_second_runs_of_a_sensor_tell_repeatability_and_do_not_count_as_sensors():
    random = np.random.default_rng(11)
    sensors = random.normal(5, 0.5, 12)
    once = [[x + 0.1 * random.standard_normal()] for x in sensors]
    twice = [[*run, x + 0.1 * random.standard_normal()] for run, x in zip(once, sensors, strict=True)]
    single, double = lot_limits(once, once, 1, UPPER).upper, lot_limits(twice, twice, 1, UPPER).upper
    assert double.parts.sensors == single.parts.sensors == 12
    assert abs(double.factor - single.factor) < 0.3
    found = repeatability(twice, "repeats")
    assert found.freedom == 12
    assert found.standard == pytest.approx(0.1, rel=0.5)
    assert found.expanded > 2 * found.standard
    assert repeatability(once, "repeats") is None
    few = [*twice[:3], *once[3:]]
    assert lot_limits(few, few, 1, UPPER).upper.limit == single.limit  # three repeats tell too little


@given(st.floats(-50, 50), st.floats(0.001, 20), st.sampled_from([-1, 1]))
def test_limits_are_rounded_outwards_by_a_hundredth_at_most(mean, distance, sign):
    limit = mean + sign * distance
    rounded = outward(limit, mean, sign)
    assert sign * (rounded - limit) >= -1e-8 * max(abs(limit), distance)
    assert abs(rounded - limit) <= 0.0101 * distance + 1e-9


def test_limits_have_few_digits():
    assert outward(3.40371, 1.9, 1) == 3.41
    assert outward(-0.18953, 0.0, -1) == -0.19
    assert outward(12345.6, 0.0, 1) == 12400


@pytest.mark.parametrize(("guard", "uncertainty"), [(0.0, 0.3), (0.4, 0.3), (0.6, 0.3), (0.1, 1.5)])
def test_risks_are_those_of_two_normal_variables(guard, uncertainty):
    """JCGM 106, clause 9: true and measured value are jointly normal; each risk is a corner of their distribution."""
    limit, spread = 2.0, 1.2
    found = risks_of_bound(lambda x: stats.norm.pdf(x, 0.5, spread), limit, guard, uncertainty)
    covariance = [[spread**2, spread**2], [spread**2, spread**2 + uncertainty**2]]
    both = stats.multivariate_normal([0.5, 0.5], covariance).cdf([limit, limit - guard])
    accepted = stats.norm.cdf(limit - guard, 0.5, sqrt(spread**2 + uncertainty**2))
    assert found.consumer == pytest.approx(accepted - both, abs=1e-5)
    assert found.producer == pytest.approx(stats.norm.cdf(limit, 0.5, spread) - both, abs=1e-5)


def test_a_guard_band_moves_risk_from_the_consumer_to_the_producer():
    bound = proposed(np.random.default_rng(14).normal(5, 1, (60, 1))).upper
    stated = Uncertainty(0.3, None, "stated")
    without, with_guard = risks(bound, 0.0, stated), risks(bound, stated.expanded, stated)
    assert with_guard.consumer < without.consumer
    assert with_guard.producer > without.producer
    assert without.consumer + without.producer < 0.05


def test_risks_agree_with_sensors_that_are_drawn():
    random = np.random.default_rng(15)
    lot = random.normal(5, 1, (400, 1))
    bound = proposed(lot, Ask(0.9, 0.5, lower=False, upper=True, distribution=Distribution.NORMAL)).upper
    found = risks(bound, 0.3, Uncertainty(0.4, None, "stated"))
    true = random.normal(bound.worst_mean, sqrt(bound.worst_deviation**2 - 0.16), 400_000)
    seen = true + random.normal(0, 0.4, 400_000)
    assert found.consumer == pytest.approx(np.mean((true > bound.limit) & (seen <= bound.limit - 0.3)), abs=1e-3)
    assert found.producer == pytest.approx(np.mean((true <= bound.limit) & (seen > bound.limit - 0.3)), abs=1e-3)


def test_no_risk_is_made_up_where_the_uncertainty_explains_the_lot():
    bound = proposed(np.random.default_rng(16).normal(5, 1, (30, 1))).upper
    assert risks(bound, 0.0, Uncertainty(3.0, None, "stated")) is None
    ordered = Ask(0.9, 0.5, lower=False, upper=True, distribution=Distribution.ANY)
    bound = proposed(np.random.default_rng(16).normal(5, 1, (30, 1)), ordered).upper
    assert risks(bound, 0.1, Uncertainty(0.1, None, "stated")) is None
