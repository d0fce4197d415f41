"""Control charts against the handbook, exact rates of false alarms, and published average run lengths."""

import json
from math import comb, factorial, sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.control_charts import (
    OUTSIDE,
    Phase,
    Standard,
    cusum,
    ewma,
    individuals,
    means_and_ranges,
    moving_range,
)
from cbsr_qa.stats.nelson import Rule, nelson

UNIT = Standard(0.0, 1.0)


@pytest.fixture(scope="module")
def oracle(shared):
    return json.loads((shared / "oracle" / "statistics.json").read_text(encoding="utf-8"))


@pytest.mark.shared
def test_individuals_are_the_handbooks(oracle):
    printed = oracle["imr_flow"]
    chart, ranges = individuals(printed["data"]), moving_range(printed["data"])
    assert chart.centre == pytest.approx(printed["mean"], abs=1e-12)
    assert ranges.centre == pytest.approx(printed["mrbar"], abs=5e-5)
    # Printed with d₂ = 1.128 and a mean range of four decimals; 3 × 1.8778/1.128 = 4.9941.
    half = 3 * ranges.centre / 1.128
    assert (chart.centre - half, chart.centre + half) == pytest.approx((printed["LCL"], printed["UCL"]), abs=2e-4)
    assert (chart.lower[0], chart.upper[0]) == pytest.approx((printed["LCL"], printed["UCL"]), abs=2e-3)
    assert ranges.upper[0] == pytest.approx(3.267 * printed["mrbar"], abs=2e-3)  # D₄ of two values
    assert chart.in_control
    assert ranges.in_control


@pytest.mark.shared
def test_moving_averages_are_the_handbooks(oracle):
    printed = oracle["ewma"]
    known = Standard(printed["target"], printed["s"])
    chart = ewma(printed["data"], weight=printed["lam"], width=printed["k"], reference=known)
    assert chart.points == pytest.approx(printed["z"][1:], abs=0.01)  # printed to two decimals, and carried on so
    # The handbook prints the limits of a long series.
    assert (chart.lower[-1], chart.upper[-1]) == pytest.approx((printed["LCL"], printed["UCL"]), abs=1e-4)
    assert chart.upper[0] - printed["target"] == pytest.approx(3 * 0.3 * printed["s"], rel=1e-12)
    assert chart.in_control


def test_means_and_ranges_are_the_textbooks_factors():
    """A₂ = 0.577, D₃ = 0 and D₄ = 2.114 of five values; D₃ = 0.223 of ten."""
    random = np.random.default_rng(85)
    table = random.normal(10.0, 2.0, (20, 5))
    means, ranges = means_and_ranges(table.tolist())
    mean_range = float(np.ptp(table, axis=1).mean())
    assert means.upper[0] - means.centre == pytest.approx(0.577 * mean_range, rel=1e-3)
    assert (ranges.lower[0], ranges.upper[0]) == pytest.approx((0, 2.114 * mean_range), rel=1e-3)
    wider = means_and_ranges(random.normal(size=(20, 10)).tolist())[1]
    assert wider.lower[0] == pytest.approx(0.223 * wider.centre, abs=6e-4 * wider.centre)


def test_cumulative_sums_by_hand():
    """Slack ½, threshold 2: 1.5 → 1, 2 → 2.5 (a signal), −3 → 0; below: 0, 0, −2.5 (a signal)."""
    above, below = cusum([1.5, 2.0, -3.0], threshold=2.0, reference=UNIT)
    assert above.points == pytest.approx([1.0, 2.5, 0.0])
    assert below.points == pytest.approx([0.0, 0.0, -2.5])
    assert [signal.index for signal in above.signals] == [1]
    assert [signal.index for signal in below.signals] == [2]
    assert above.signals[0].rule == OUTSIDE


ZIGZAG = [0.4, -0.5, 0.6, 0.5, -0.4, -0.6, 0.3, 0.45, -0.55]
#: Series on which one rule speaks, at the last point and nowhere else.
ALONE = {
    Rule.BEYOND: [0.4, -1.2, 0.6, 3.1],
    Rule.SAME_SIDE: [-0.5, 0.6, 0.2, 0.4, 0.3, 0.5, 0.45, 0.7, 0.1, 0.2],
    Rule.TREND: [0.5, -1.4, -1.2, -0.3, 0.2, 0.4, 0.9],
    Rule.ALTERNATING: [1.2 * (-1) ** index + 0.4 * (-1) ** (index // 3) for index in range(14)],
    Rule.TWO_OF_THREE: [0.4, -0.5, 2.1, -0.3, 2.2],
    Rule.FOUR_OF_FIVE: [0.4, -0.5, 1.1, 1.2, -0.3, 1.3, 1.15],
    Rule.HUGGING: [1.5, *ZIGZAG, -0.45, 0.5, 0.3, -0.2, -0.4, 0.6],
    Rule.AVOIDING: [0.2, 1.1, 1.3, -1.2, -1.4, -1.1, 1.2, 1.3, -1.3],
}


@pytest.mark.parametrize("rule", list(Rule), ids=lambda rule: rule.name)
@pytest.mark.parametrize("sign", [1, -1])
def test_each_rule_speaks_alone(rule, sign):
    series = [sign * value for value in ALONE[rule]]
    chart = individuals(series, reference=UNIT)
    assert [(signal.rule, signal.index) for signal in chart.signals] == [(rule.value, len(series) - 1)]
    assert not individuals(series[:-1], reference=UNIT).signals
    others = [other for other in Rule if other is not rule]
    assert not individuals(series, reference=UNIT, rules=others).signals


def rates():
    """Exact probability that a rule speaks at a point of an undisturbed process, far from its start."""
    beyond = stats.norm.sf([1, 2, 3])
    inside = 1 - 2 * beyond[0]
    zigzag = [1]  # Entringer numbers up to E₁₄ by the boustrophedon
    for _ in range(14):
        zigzag = [0, *np.cumsum(zigzag[::-1]).tolist()]
    three_of_four = sum(comb(4, k) * beyond[0] ** k * (1 - beyond[0]) ** (4 - k) for k in (3, 4))
    return {
        Rule.BEYOND: 2 * beyond[2],
        Rule.SAME_SIDE: 2 / 2**9,
        Rule.TREND: 2 / factorial(6),
        Rule.ALTERNATING: 2 * zigzag[-1] / factorial(14),
        Rule.TWO_OF_THREE: 2 * beyond[1] * (1 - (1 - beyond[1]) ** 2),
        Rule.FOUR_OF_FIVE: 2 * beyond[0] * three_of_four,
        Rule.HUGGING: inside**15,
        Rule.AVOIDING: (1 - inside) ** 8,
    }


def test_false_alarms_are_as_rare_as_they_are():
    found = nelson(np.random.default_rng(86).normal(size=1_000_000))
    for rule, rate in rates().items():
        # Patterns overlap: a run that goes on repeats its signal, which makes them up to 5 times as uneven.
        assert np.mean(found[rule][20:]) == pytest.approx(rate, abs=4 * sqrt(5 * rate / 1e6)), rule


def run_length(random, first_signal, *, shift, runs, longest):
    """Mean number of points up to the first signal, and its standard error."""
    lengths = [first_signal(random.normal(shift, 1.0, longest)) for _ in range(runs)]
    return np.mean(lengths), np.std(lengths) / sqrt(runs)


def first_of(*charts):
    return 1 + min(signal.index for chart in charts for signal in chart.signals)


@pytest.mark.parametrize(
    ("rules", "shift", "published"),
    # Champ & Woodall 1987, table 1: the 3σ rule alone, with two of three, with four of five.
    [
        ([Rule.BEYOND], 1.0, 43.89),
        ([Rule.BEYOND, Rule.TWO_OF_THREE], 0.0, 225.44),
        ([Rule.BEYOND, Rule.FOUR_OF_FIVE], 0.0, 166.05),
    ],
)
def test_run_lengths_of_rules_are_the_published_ones(rules, shift, published):
    def first(series):
        return first_of(individuals(series, reference=UNIT, rules=rules))

    mean, error = run_length(np.random.default_rng(87), first, shift=shift, runs=1200, longest=3000)
    assert mean == pytest.approx(published, abs=3.5 * error)
    assert error < 0.035 * published


@pytest.mark.rest
@pytest.mark.parametrize(
    ("threshold", "shift", "published"),
    # Montgomery, Introduction to Statistical Quality Control, table 9.3 (k = ½), after Hawkins.
    [(4.0, 0.0, 168.0), (4.0, 1.0, 8.38), (5.0, 1.0, 10.4), (5.0, 2.0, 4.01)],
)
def test_run_lengths_of_cumulative_sums_are_the_published_ones(threshold, shift, published):
    def first(series):
        return first_of(*cusum(series, threshold=threshold, reference=UNIT))

    longest = 2500 if shift == 0 else 300
    mean, error = run_length(np.random.default_rng(88), first, shift=shift, runs=1200, longest=longest)
    assert mean == pytest.approx(published, abs=3.5 * error)


@pytest.mark.rest
@pytest.mark.parametrize(
    ("weight", "width", "shift", "published"), [(0.1, 2.814, 1.0, 10.3), (0.25, 2.998, 2.0, 3.6)]
)
def test_run_lengths_of_moving_averages_are_the_published_ones(weight, width, shift, published):
    """Lucas & Saccucci 1990, table 3, with steady limits: plans of 500 points between false alarms."""

    def first(series):
        chart = ewma(series, weight=weight, width=width, reference=UNIT)
        outside = np.flatnonzero(np.abs(chart.points) > width * sqrt(weight / (2 - weight)))
        return outside[0] + 1 if outside.size else np.inf

    mean, error = run_length(np.random.default_rng(89), first, shift=shift, runs=4000, longest=200)
    assert mean == pytest.approx(published, abs=3.5 * error + 0.05)


def test_phases_are_told_apart():
    random = np.random.default_rng(90)
    before = random.normal(size=40)
    before[7] = 9.0
    after = np.array([0.1, -0.2, 12.0, 0.1])
    chart = individuals([*before, *after], reference=40, rules=[Rule.BEYOND])
    assert chart.reference == 40
    assert chart.deviation == pytest.approx(np.abs(np.diff(before)).mean() * sqrt(np.pi) / 2)
    assert [signal.index for signal in chart.signals_in_phase(Phase.REFERENCE)] == [7]
    assert [signal.index for signal in chart.signals_in_phase(Phase.MONITORED)] == [42]
    assert not chart.in_control
    assert individuals([*before, 0.1, -0.2], reference=40, rules=[Rule.BEYOND]).in_control
    ranges = moving_range([*before, *after], reference=40)
    assert {signal.index for signal in ranges.signals_in_phase(Phase.REFERENCE)} == {6, 7}
    assert {signal.index for signal in ranges.signals_in_phase(Phase.MONITORED)} == {41, 42}


def test_sums_start_anew_with_phase_two():
    values = [0.0, 1.0, 0.0, 3.0, 3.0, 0.5, 0.2]
    for chart in (ewma(values, weight=0.5, reference=5), cusum(values, reference=5)[0]):
        alone = Standard(float(np.mean(values[:5])), chart.deviation)
        fresh = (ewma(values[5:], weight=0.5, reference=alone), cusum(values[5:], reference=alone)[0])
        same = fresh[0] if chart.name == "EWMA" else fresh[1]
        assert chart.points[5:] == pytest.approx(same.points)
        assert chart.upper[5:] == pytest.approx(same.upper)


@settings(deadline=None)
@given(
    st.lists(st.integers(-20, 20), min_size=4, max_size=60).filter(lambda values: len(set(values)) > 1),
    st.sampled_from([0.5, 8.0]),
    st.sampled_from([-64.0, 0.0, 1024.0]),
)
def test_signals_know_no_unit_or_origin(values, scale, origin):
    moved = [scale * value + origin for value in values]
    known = Standard(0.25, 3.0)
    there = Standard(0.25 * scale + origin, 3.0 * scale)
    for chart in (individuals, ewma, lambda x, reference: cusum(x, reference=reference)[1]):
        assert chart(values, reference=known).signals == chart(moved, reference=there).signals
    mirrored = individuals([-value for value in values], reference=Standard(-0.25, 3.0))
    assert mirrored.signals == individuals(values, reference=known).signals
    found = individuals(moved)
    assert found.centre == pytest.approx(scale * np.mean(values) + origin)
    assert found.deviation == pytest.approx(scale * individuals(values).deviation)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: individuals([]), "0 values"),
        (lambda: individuals([1.0]), "reference period is 1 points; allowed are 2 to 1"),
        (lambda: individuals([1.0, 1.0, 2.0], reference=2), "all 2 values of the reference period are 1"),
        (lambda: individuals([1.0, float("nan")]), "missing"),
        (lambda: individuals([1.0, 2.0], reference=3), "reference period is 3 points; allowed are 2 to 2"),
        (lambda: individuals([1.0, 2.0], reference=Standard(0.0, 0.0)), "deviation is 0; limits need"),
        (lambda: means_and_ranges([[1.0, 2.0], [1.0]]), "sizes 1, 2"),
        (lambda: means_and_ranges([[1.0], [2.0]]), "one value have no range"),
        (lambda: means_and_ranges([[1.0, 1.0], [2.0, 2.0]]), "deviation is 0; limits need"),
        (lambda: means_and_ranges([]), "sizes none"),
        (lambda: ewma([1.0, 2.0], weight=0.0), "weight 0"),
        (lambda: cusum([1.0, 2.0], threshold=0.0), "threshold 0"),
    ],
)
def test_charts_that_are_none_are_named(make, reason):
    with pytest.raises(NumericsError, match=reason):
        make()


def test_no_points_give_no_signal():
    assert not any(flags.any() for flags in nelson(np.zeros(0)).values())
