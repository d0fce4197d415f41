"""Gauge studies against AIAG's worked example, printed intervals, exact limits and simulated studies."""

import json
from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from certified_groups import certified_table
from hypothesis import given, settings, strategies as st
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.gauge.anova import MeanSquare, Source, gauge_anova, sum_interval
from cbsr_qa.stats.gauge.crossed_study import Study, gauge_range, study
from cbsr_qa.stats.gauge.reference import bias, linearity, stability, straight_line
from cbsr_qa.stats.nelson import d2_d3, d2_star


def arranged(table):
    """A study of a (sensors, stations, trials) array."""
    rows = [(f"n{i:02d}", f"s{j}", value) for (i, j, _), value in np.ndenumerate(table)]
    return study(*zip(*rows, strict=True))


@pytest.fixture(scope="module")
def printed(shared):
    return json.loads((shared / "oracle" / "statistics.json").read_text(encoding="utf-8"))["aiag_grr"]


@pytest.fixture(scope="module")
def example(printed):
    return arranged(np.array([printed[name] for name in "ABC"]).transpose(2, 0, 1))


@pytest.mark.shared
def test_analysis_of_variance_is_aiags(printed, example):
    found, answer = gauge_anova(example), printed["anova"]
    rows = {row.source: row for row in found.table}
    names = {"op": Source.STATION, "part": Source.SENSOR, "interaction": Source.INTERACTION, "rep": Source.TRIAL}
    for index, (name, source) in enumerate(names.items()):
        assert rows[source].sum_of_squares == pytest.approx(answer["SS"][name], abs=5.1e-6)
        assert rows[source].degrees_of_freedom == answer["df"][index]
    assert rows[Source.INTERACTION].f == pytest.approx(answer["F_int"], abs=5.1e-5)
    assert rows[Source.INTERACTION].p == pytest.approx(answer["p_int"], abs=5.1e-5)
    assert found.interaction_pooled
    assert found.interaction_variance is None


@pytest.mark.shared
def test_f_is_against_what_is_pooled(example):
    """Minitab's table of AIAG's example without interaction: F 245.614 and 39.617, error 0.03997."""
    rows = {row.source: row for row in gauge_anova(example).table}
    pooled = rows[Source.POOLED]
    assert (pooled.degrees_of_freedom, pooled.mean_square) == (78, pytest.approx(0.03997, abs=5e-6))
    assert rows[Source.SENSOR].f == pytest.approx(245.614, abs=5e-4)
    assert rows[Source.STATION].f == pytest.approx(39.617, abs=5e-4)


@pytest.mark.rest
@pytest.mark.parametrize("interaction", [0.0, 0.5])
def test_f_of_stations_that_are_alike_is_significant_in_about_five_of_a_hundred_studies(interaction):
    """Pooling by a test of the same values moves the 5 % a little: 3 to 7 % at these sizes."""
    random = np.random.default_rng(87)
    p_values = []
    for _ in range(500):
        table = random.normal(size=(8, 3, 2)) + random.normal(size=(8, 1, 1))
        rows = {
            row.source: row
            for row in gauge_anova(arranged(table + interaction * random.normal(size=(8, 3, 1)))).table
        }
        p_values.append(rows[Source.STATION].p)
    assert 0.02 < np.mean(np.array(p_values) < 0.05) < 0.08


@pytest.mark.parametrize("replicates", [21, 201])
@pytest.mark.parametrize(("offset", "digits"), [(1, 13), (10**6, 8)])
def test_the_gauge_analysis_keeps_the_digits_of_nists_sets(replicates, offset, digits):
    """The nine groups as sensors, one station measured twice over: F of the sensors' table follows from one way."""
    table = np.array(certified_table(offset, replicates))
    rows = [(f"n{i}", f"s{j}", y) for i, values in enumerate(table) for j in (0, 1) for y in values]
    found = {row.source: row for row in gauge_anova(study(*zip(*rows, strict=True))).table}
    assert found[Source.SENSOR].sum_of_squares == pytest.approx(2 * 0.08 * replicates, rel=10.0**-digits)
    assert found[Source.TRIAL].sum_of_squares == pytest.approx(2 * 0.09 * (replicates - 1), rel=10.0**-digits)
    assert found[Source.STATION].sum_of_squares == pytest.approx(0.0, abs=10.0**-digits)


@pytest.mark.shared
def test_components_are_aiags(printed, example):
    answer, found = printed["anova"]["pooled"], gauge_anova(example)
    parts = found.components
    for name, part in {
        "EV": parts.repeatability,
        "AV": parts.reproducibility,
        "GRR": parts.gauge,
        "PV": parts.sensor,
    }.items():
        # Printed from mean squares that were rounded before.
        assert part.variance == pytest.approx(answer[f"var_{name}"], rel=5e-6)
        assert part.percent_study == pytest.approx(answer["pctTV"][name], abs=6e-4)
    assert parts.gauge.percent_contribution == pytest.approx(answer["pctContribution_GRR"], abs=6e-4)
    assert found.categories == answer["ndc_trunc"]


@pytest.mark.shared
def test_averages_and_ranges_are_aiags(printed, example):
    found, answer = gauge_range(example), printed["average_range"]
    assert found.mean_range == pytest.approx(answer["Rbar"], abs=5.1e-8)
    assert found.appraiser_range == pytest.approx(answer["Xdiff"], abs=5.1e-8)
    assert found.sensor_range == pytest.approx(answer["Rp"], abs=5.1e-8)
    of = found.components
    parts = of.repeatability, of.reproducibility, of.gauge, of.sensor, of.total
    for part, name in zip(parts, ("EV", "AV", "GRR", "PV", "TV"), strict=True):
        assert part.deviation == pytest.approx(answer[name], rel=1.5e-4)  # AIAG rounds K to four digits
    shares = [part.percent_study for part in parts[:4]]
    assert shares == pytest.approx(answer["pct"], abs=0.01)
    assert found.categories_uncut == pytest.approx(answer["ndc"], abs=0.006)
    assert found.categories == 5


def test_range_constants_are_the_printed_ones():
    """Printed in every table of control charts: d₂ and d₃; AIAG's K of 3 trials, 3 appraisers and 10 parts."""
    for count, d2, d3 in ((2, 1.128, 0.853), (5, 2.326, 0.864), (10, 3.078, 0.797), (25, 3.931, 0.708)):
        assert d2_d3(count) == pytest.approx((d2, d3), abs=5.1e-4)
    assert d2_d3(2) == pytest.approx((2 / sqrt(np.pi), sqrt(2 - 4 / np.pi)), rel=1e-12)
    assert [1 / d2_d3(3)[0], 1 / d2_star(3, 1), 1 / d2_star(10, 1)] == pytest.approx(
        [0.5908, 0.5231, 0.3146], abs=5e-5
    )
    with pytest.raises(NumericsError, match="1 values"):
        d2_d3(1)


def test_intervals_are_the_printed_ones():
    """Burdick, Borror & Montgomery 2003, thermal impedance: part and gauge variance from rounded mean squares."""
    sensor = sum_interval([MeanSquare(437.33, 9, 1 / 9), MeanSquare(2.70, 18, -1 / 9)], 0.95)
    assert (sensor.low, sensor.high) == pytest.approx((22.69, 161.64), abs=0.01)
    parts = [MeanSquare(19.63, 2, 1 / 30), MeanSquare(2.70, 18, 9 / 30), MeanSquare(0.51, 60, 20 / 30)]
    gauge = sum_interval(parts, 0.95)
    assert (gauge.low, gauge.high) == pytest.approx((1.20, 27.02), abs=0.01)


@pytest.mark.parametrize("sign", [-1, 1])
def test_intervals_are_exact_where_one_source_is_all(sign):
    """With the other mean square at nothing the limits are those of χ²."""
    found = sum_interval([MeanSquare(4.0, 7, 0.5), MeanSquare(1e-12, 5, sign * 0.5)], 0.9)
    exact = [0.5 * 4.0 * 7 / stats.chi2.isf(tail, 7) for tail in (0.05, 0.95)]
    assert (found.low, found.high) == pytest.approx(exact, rel=1e-6)


def test_intervals_of_equal_sources_are_those_of_both_together():
    """Mean squares alike, weighted by their degrees of freedom, are one χ²: so the cross terms are made."""
    nothing = MeanSquare(1e-12, 6, 1.0)
    both = [MeanSquare(2.0, 4, 4.0), MeanSquare(2.0, 9, 9.0)]
    found = sum_interval([*both, replace(nothing, factor=-1.0)], 0.9)
    assert found.low == pytest.approx(2.0 * 13 * 13 / stats.chi2.isf(0.05, 13), rel=1e-6)
    less = sum_interval([nothing, *(replace(part, factor=-part.factor) for part in both)], 0.9)
    assert less.high == pytest.approx(-found.low, rel=1e-6)


@pytest.mark.parametrize("interaction", [0.0, 3.0])
def test_components_add_up(interaction):
    random = np.random.default_rng(81)
    table = random.normal(size=(6, 4, 3)) + 4 * random.normal(size=(6, 1, 1)) + 6 * random.normal(size=(1, 4, 1))
    found = gauge_anova(arranged(table + interaction * random.normal(size=(6, 4, 1))))
    assert found.interaction_pooled == (interaction == 0.0)
    parts = found.components
    between = found.appraiser_variance + (found.interaction_variance or 0.0)
    assert parts.reproducibility.variance == pytest.approx(between)
    assert parts.gauge.variance == pytest.approx(between + parts.repeatability.variance)
    assert parts.total.variance == pytest.approx(parts.gauge.variance + parts.sensor.variance)
    for part in (parts.reproducibility, parts.gauge, parts.sensor, parts.total):
        assert part.variance_interval.low < part.variance < part.variance_interval.high


@pytest.mark.rest
@pytest.mark.parametrize("interaction", [0.0, 0.7])
def test_intervals_cover(interaction):
    random, held = np.random.default_rng(82), []
    for _ in range(300):
        table = (
            2 * random.normal(size=(8, 1, 1))
            + 0.8 * random.normal(size=(1, 4, 1))
            + interaction * random.normal(size=(8, 4, 1))
            + 0.5 * random.normal(size=(8, 4, 3))
        )
        found = gauge_anova(Study(table, tuple("abcdefgh"), tuple("ABCD")))
        gauge, between = 0.25 + 0.64 + interaction**2, 0.64 + interaction**2
        held.append(
            [
                found.components.repeatability.variance_interval.holds(0.25),
                found.components.reproducibility.variance_interval.holds(between),
                found.components.gauge.variance_interval.holds(gauge),
                found.components.sensor.variance_interval.holds(4.0),
                found.components.total.variance_interval.holds(4.0 + gauge),
                found.gauge_percent_contribution_interval.holds(100 * gauge / (4.0 + gauge)),
                found.categories_interval.holds(1.41 * sqrt(4.0 / gauge)),
            ]
        )
    covered = np.mean(held, axis=0)
    assert np.all(covered >= 0.92), covered  # 95 %, two to three standard errors of 300 studies below it
    assert np.all(covered <= 0.99), covered


@pytest.mark.rest
@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-5, 3.0]), st.sampled_from([-1e6, 0.0, 50.0]))
def test_studies_know_no_unit_origin_or_order(seed, scale, origin):
    random = np.random.default_rng(seed)
    table = random.normal(size=(4, 1, 1)) + random.normal(size=(1, 3, 1)) + random.normal(size=(4, 3, 2))
    here, there = gauge_anova(arranged(table)), gauge_anova(arranged(scale * (table[::-1, ::-1, ::-1] + origin)))
    for name in ("repeatability", "reproducibility", "gauge", "sensor", "total"):
        one, two = getattr(here.components, name), getattr(there.components, name)
        assert two.variance == pytest.approx(scale**2 * one.variance, rel=1e-6, abs=1e-8 * scale**2)
        high = scale**2 * one.variance_interval.high
        assert two.variance_interval.high == pytest.approx(high, rel=1e-6, abs=1e-8 * scale**2)


def test_tolerance_shares_and_cut_components():
    table = np.array([[[0.0, 2.0], [2.0, 0.0]], [[3.0, 1.0], [1.0, 3.0]], [[5.0, 3.0], [3.0, 5.0]]])
    found = gauge_anova(arranged(table), tolerance=24.0)
    assert found.appraiser_variance == 0.0
    assert any("station variance is negative" in note for note in found.notes)
    repeat = found.components.repeatability
    assert repeat.percent_tolerance == pytest.approx(100 * 6 * repeat.deviation / 24)
    interval = repeat.percent_tolerance_interval
    # Twelve values in six cells: 6 degrees of freedom of the runs and, pooled or not, an exact χ².
    freedom = 6 + 2 * found.interaction_pooled
    ends = [repeat.deviation * sqrt(freedom / stats.chi2.isf(tail, freedom)) * 25 for tail in (0.025, 0.975)]
    assert (interval.low, interval.high) == pytest.approx(ends)
    by_range = gauge_range(arranged(table), tolerance=24.0)
    assert by_range.notes
    assert by_range.components.gauge.percent_tolerance_interval is None
    assert gauge_anova(arranged(table)).components.repeatability.percent_tolerance is None


@pytest.mark.parametrize(
    ("drop", "reason"),
    [
        (lambda rows: rows[1:], "sensor n00 has 1 run on station s0, others have 2"),
        (lambda rows: [row for row in rows if row[1] == "s0"], "1 station instead of at least 2"),
        (lambda rows: [row for row in rows if row[0] == "n00"] * 2, "1 sensor instead of at least 2"),
        (lambda rows: rows[::2], "1 run a sensor and station"),
        (lambda rows: [(a, b, 1.0) for a, b, _ in rows], "repeated runs do not differ"),
        (lambda rows: [(a, b, float("nan")) for a, b, _ in rows], "missing"),
    ],
)
def test_studies_that_are_none_are_named(drop, reason):
    table = np.random.default_rng(83).normal(size=(8, 3, 2))
    rows = [(f"n{i:02d}", f"s{j}", value) for (i, j, _), value in np.ndenumerate(table)]
    with pytest.raises(NumericsError, match=f"gauge study: .*{reason}"):
        study(*zip(*drop(rows), strict=True))
    with pytest.raises(NumericsError, match="tolerance is 0"):
        gauge_anova(arranged(table), tolerance=0.0)


#: AIAG MSA 4th edition, chapter III, section B: five parts of 2, 4, 6, 8 and 10, twelve trials each.
LINEARITY = {
    2.0: [2.7, 2.5, 2.4, 2.5, 2.7, 2.3, 2.5, 2.5, 2.4, 2.4, 2.6, 2.4],
    4.0: [5.1, 3.9, 4.2, 5.0, 3.8, 3.9, 3.9, 3.9, 3.9, 4.0, 4.1, 3.8],
    6.0: [5.8, 5.7, 5.9, 5.9, 6.0, 6.1, 6.0, 6.1, 6.4, 6.3, 6.0, 6.1],
    8.0: [7.6, 7.7, 7.8, 7.7, 7.8, 7.8, 7.8, 7.7, 7.8, 7.5, 7.6, 7.7],
    10.0: [9.1, 9.3, 9.5, 9.3, 9.4, 9.5, 9.5, 9.5, 9.6, 9.2, 9.3, 9.4],
}


def test_linearity_is_aiags():
    """Printed: bias = 0.736667 − 0.131667 × reference, R² = 71.4 %, s = 0.23954; not acceptable."""
    references = [known for known, readings in LINEARITY.items() for _ in readings]
    found = linearity(references, [reading for readings in LINEARITY.values() for reading in readings])
    assert (found.intercept.value, found.line.slope) == pytest.approx((0.736667, -0.131667), abs=5.1e-7)
    assert (found.line.explained, found.line.residual) == pytest.approx((0.714, 0.23954), abs=6e-4)
    assert found.line.rise().statistic() == pytest.approx(-12.043, abs=1e-3)
    assert found.intercept.statistic() == pytest.approx(10.158, abs=1e-3)
    assert not found.acceptable()


@pytest.mark.rest
def test_uncertain_references_widen_the_line_as_much_as_they_scatter_it():
    """Each reference is off by its own error, the same for all its readings: intervals must hold the truth."""
    random = np.random.default_rng(86)
    true, u, held = np.array([2.0, 4.0, 6.0, 8.0, 10.0]), 0.2, []
    for _ in range(2000):
        stated = true + u * random.normal(size=5)
        readings = np.repeat(0.3 + 0.9 * true, 12) + 0.1 * random.normal(size=60)
        known = [(12, value, u) for value in stated]
        found = linearity(np.repeat(stated, 12).tolist(), readings.tolist(), known=known)
        held.append((found.rise().interval().holds(-0.1), found.evaluate(4.0).interval().holds(-0.1)))
        assert found.line.rise().value == found.rise().value
    # Scatter within the references' errors is in the line's own residual too: wide rather than narrow.
    assert np.all(np.mean(held, axis=0) >= 0.935)
    naive = linearity(np.repeat(stated, 12).tolist(), readings.tolist())
    assert naive.rise().standard_error < found.rise().standard_error / 2


def test_bias_is_aiags():
    """Fifteen readings of a reference of 6.00, printed: 0.0067, s 0.2120, t 0.1218, interval −0.1107 to 0.1241."""
    readings = [5.8, 5.7, 5.9, 5.9, 6.0, 6.1, 6.0, 6.1, 6.4, 6.3, 6.0, 6.1, 6.2, 5.6, 6.0]
    found = bias(readings, 6.0)
    assert found.value == pytest.approx(0.0067, abs=5e-5)
    assert found.standard_error * sqrt(15) == pytest.approx(0.2120, abs=5.1e-5)
    assert found.statistic() == pytest.approx(0.1218, abs=5.1e-5)
    assert (found.interval().low, found.interval().high) == pytest.approx((-0.1107, 0.1241), abs=6e-5)


def test_stability_finds_a_drift_and_no_other():
    random = np.random.default_rng(84)
    days = 738000.0 + random.permutation(60)
    steady = 5.0 + 0.1 * random.normal(size=60)
    held = stability(days, steady, 5.0)
    assert held.drift.interval(0.99).holds(0.0)
    assert held.bias.interval(0.99).holds(0.0)
    moved = stability(days, steady + 0.02 * (days - days.min()), 5.0)
    assert moved.drift.value == pytest.approx(held.drift.value + 0.02, rel=1e-9)
    assert moved.drift.interval().low > 0
    assert not moved.chart.in_control
    assert moved.chart.points[-1] == steady[np.argmax(days)] + 0.02 * 59 - 5.0


@settings(deadline=None)
@given(st.sampled_from([0.0, 1e9]), st.integers(0, 2**32 - 1))
def test_lines_are_numpys(origin, seed):
    random = np.random.default_rng(seed)
    x, y = np.arange(9.0), random.normal(size=9)
    found, theirs = straight_line(x + origin, y), stats.linregress(x, y)
    assert found.rise().value == pytest.approx(theirs.slope, rel=1e-7, abs=1e-12)
    assert found.rise().standard_error == pytest.approx(theirs.stderr, rel=1e-7)
    assert found.evaluate(origin).standard_error == pytest.approx(theirs.intercept_stderr, rel=1e-7)
    assert found.rise().p_value() == pytest.approx(theirs.pvalue, rel=1e-5)


def test_references_that_say_nothing_are_named():
    with pytest.raises(NumericsError, match="all readings have one reference"):
        linearity([2.0, 2.0, 2.0], [2.1, 2.2, 2.0])
    with pytest.raises(NumericsError, match="lie on a line"):
        linearity([1.0, 2.0, 3.0], [1.5, 2.5, 3.5])
    with pytest.raises(NumericsError, match="there is no variance"):
        bias([5.0, 5.0], 5.0)
    with pytest.raises(NumericsError, match="there is no slope"):
        stability([1.0, 1.0, 1.0], [1.0, 2.0, 3.0], 2.0)
    with pytest.raises(NumericsError, match="3 reference values for 4"):
        linearity([1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 5.0])
