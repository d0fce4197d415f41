"""Nested gauge studies against printed tables and in simulated coverage."""

import numpy as np
import pytest
from tiers import rest_but

from benchmarks.nested_gauge import DESIGNS, measure
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.gauge.nested import nested_anova, nested_study, uneven_parts

#: Three appraisers, five parts, two runs: sums of squares (appraiser, part, repeated runs), and the printed table.
PRINTED = {
    # Minitab's help, "Example of a gage R&R study (nested)" (GAGENEST), tolerance 10.
    "Minitab": {
        "squares": (0.0142, 22.0552, 19.3400),
        "f": (0.00385, 1.42549),
        "p": (0.996, 0.255),
        "variances": (1.28933, 1.28933, 0.0, 0.27430, 1.56364),
        "contributions": (82.46, 82.46, 0.0, 17.54, 100.0),
        "study": (90.81, 90.81, 0.0, 41.88, 100.0),
        "tolerance": (68.13, 68.13, 0.0, 31.42, 75.03),
        "categories": 1,
    },
    # JASP's quality control module 0.16, unit test "Gauge r&R (Nested)" of msaGaugeNN.
    "JASP": {
        "squares": (4.36266666666668, 37.606, 1.21),
        "f": (0.696059139499019, 38.849173553719),
        "p": (0.51759708068839, 4.4622407258139e-09),
        "variances": (0.0806666666666667, 0.0806666666666667, 0.0, 1.52658333333333, 1.60725),
        "contributions": (5.01892466428164, 5.01892466428164, 0.0, 94.9810753357184, 100.0),
        "study": (22.4029566447861, 22.4029566447861, 0.0, 97.458234816622, 100.0),
        "tolerance": None,
        "categories": 6,
    },
}
PARTS = ("gauge", "repeatability", "reproducibility", "sensor", "total")


def arrange(table, **nouns):
    """Name the values (parts, appraisers, trials) of a study."""
    rows = [
        (f"P{column}{row}", f"O{column}", value)
        for row, of_row in enumerate(table)
        for column, of_cell in enumerate(of_row)
        for value in of_cell
    ]
    return nested_study(*zip(*rows, strict=True), **nouns)


def with_squares(appraiser, part, trial, p=5, o=3, r=2):
    """Values whose sums of squares are exactly these."""

    def scale(pattern, squares):
        return pattern * np.sqrt(squares / np.sum(pattern**2)) if squares else pattern * 0

    random = np.random.default_rng(14)
    of_appraisers = random.normal(size=(1, o, 1)) + np.zeros((p, o, r))
    of_parts = random.normal(size=(p, o, 1)) + np.zeros((p, o, r))
    of_trials = random.normal(size=(p, o, r))
    of_appraisers -= of_appraisers.mean()
    of_parts -= of_parts.mean(axis=0, keepdims=True)
    of_trials -= of_trials.mean(axis=2, keepdims=True)
    return 100 + scale(of_appraisers, appraiser) + scale(of_parts, part) + scale(of_trials, trial)


@pytest.mark.parametrize("source", PRINTED)
def test_the_printed_table_comes_out(source):
    printed = PRINTED[source]
    tolerance = 10.0 if printed["tolerance"] else None
    found = nested_anova(arrange(with_squares(*printed["squares"])), tolerance=tolerance)
    rounding = {"rel": 2e-3 if source == "Minitab" else 1e-9, "abs": 5e-5 if source == "Minitab" else 1e-9}
    assert [row.degrees_of_freedom for row in found.table] == [2, 12, 15]
    assert [row.f for row in found.table[:2]] == pytest.approx(printed["f"], **rounding)
    assert [row.p for row in found.table[:2]] == pytest.approx(printed["p"], **rounding)
    components = [getattr(found.components, name) for name in PARTS]
    assert [one.variance for one in components] == pytest.approx(printed["variances"], **rounding)
    assert [one.percent_contribution for one in components] == pytest.approx(printed["contributions"], **rounding)
    assert [one.percent_study for one in components] == pytest.approx(printed["study"], **rounding)
    if printed["tolerance"]:
        assert [one.percent_tolerance for one in components] == pytest.approx(printed["tolerance"], **rounding)
    assert found.categories == printed["categories"]
    assert found.notes == ("the estimated station variance is negative and is set to zero",)


def test_sums_of_squares_add_up_to_the_total():
    study = arrange(np.random.default_rng(3).normal(size=(4, 3, 5)))
    table = nested_anova(study).table
    assert sum(row.sum_of_squares for row in table) == pytest.approx(
        np.sum((study.values - study.values.mean()) ** 2)
    )
    assert sum(row.degrees_of_freedom for row in table) == study.values.size - 1


@pytest.mark.parametrize(("appraiser", "part", "trial"), rest_but({1.0}, DESIGNS))
def test_intervals_hold(appraiser, part, trial):
    """Of 300 studies of 5 parts, 4 stations and 2 runs; 95 % intervals of variances and of the gauge's share."""
    shares = measure(appraiser, part, trial, 300)
    assert min(shares.values()) >= 0.92, shares
    assert shares["repeatability"] <= 0.98


def rows_of(**runs):
    """Runs as part="appraiser:count"."""
    parts, stations = [], []
    for part, where in runs.items():
        for one in where.split():
            station, count = one.split(":")
            parts += [part] * int(count)
            stations += [station] * int(count)
    return parts, stations


@pytest.mark.parametrize(
    ("runs", "why"),
    [
        ({"P1": "A:2 B:2", "P2": "A:2", "P3": "B:2"}, "sensor P1 was run on A and B"),
        ({"P1": "A:2", "P2": "A:2", "P3": "B:2", "P4": "B:3"}, "sensor P4 on B has 3 runs instead of 2"),
        ({"P1": "A:3", "P2": "A:3", "P3": "B:3", "P4": "B:1"}, "sensor P4 on B has 1 run instead of 3"),
        (
            {"P1": "A:2", "P2": "A:2", "P3": "A:2", "P4": "B:2", "P5": "B:2"},
            "station B has 2 sensors instead of 3|station A has 3",
        ),
        ({"P1": "A:4", "P2": "B:4"}, "1 sensor of station A instead of at least 2"),
        ({"P1": "A:2", "P2": "A:2", "P3": "A:2", "P4": "A:2"}, "1 station instead of at least 2"),
        ({f"P{k}": f"{'AB'[k % 2]}:1" for k in range(8)}, "1 run of a sensor instead of at least 2"),
    ],
)
def test_what_is_missing_is_named(runs, why):
    parts, stations = rows_of(**runs)
    with pytest.raises(NumericsError, match=why):
        nested_study(parts, stations, np.arange(len(parts)) ** 1.5)


def test_every_problem_is_listed():
    parts, stations = rows_of(P1="A:2", P2="A:2", P3="B:1", P4="B:2", P5="C:2")
    assert uneven_parts(parts, stations, "batch", "operator") == (
        "batch P3 by B has 1 run instead of 2",
        "operator C has 1 batch instead of 2",
    )


def test_runs_that_do_not_differ_are_refused():
    with pytest.raises(NumericsError, match="repeated runs do not differ at all"):
        arrange(np.arange(6.0).reshape(2, 3, 1) + np.zeros((2, 3, 2)))
