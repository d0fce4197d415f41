"""Fleets as columns: batches that coincide with periods or software, wrong clocks, and values nobody can use."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from compared_fleets import page_of, run_of as run_at, table_of

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.studies.compare.comparison import compare
from cbsr_qa.studies.compare.groups import design_of, group_runs
from cbsr_qa.studies.compare.report import compare_outcome
from cbsr_qa.studies.compare.terms import By, Period, Policy, Terms

BEGAN = datetime(2026, 1, 5, tzinfo=UTC)
NOW = BEGAN + timedelta(days=100)
NOISE_MM = 0.3
BATCH_MM = 2.0
DAYS = Terms(By.PERIOD, period=Period.DAY)


def run_of(number, batch, station="A", day=0, **changes):
    return run_at(number, batch, station, BEGAN + timedelta(days=day, minutes=number), **changes)


def without(table, dropped):
    """Leave rows of values out: pairs of run and metric."""
    pairs = set(dropped)
    kept = np.array([pair not in pairs for pair in zip(table.run.tolist(), table.kind.tolist(), strict=True)])
    columns = {name: getattr(table, name)[kept] for name in ("run", "kind", "value", "state")}
    return replace(table, **columns)


def fleet(seed, plan):
    """Draw runs of a plan of (batch, station, day): a batch "42" reads BATCH_MM more, nothing else differs."""
    random = np.random.default_rng(seed)
    runs = [run_of(number, *row) for number, row in enumerate(plan)]
    return runs, NOISE_MM * random.standard_normal(len(runs)) + [BATCH_MM * (run.batch == "42") for run in runs]


def crossed(sensors=6):
    """Batch 41 runs mostly on day 0 and 42 mostly on day 1, some of both on both, at two stations."""
    plan = []
    for station in "AB":
        for batch, days in (("41", (0, 0, 1)), ("42", (0, 1, 1))):
            plan += [(batch, station, day) for day in days for _ in range(sensors)]
    return plan


def test_a_batch_is_not_taken_for_the_day_it_was_tested_on():
    found = [compare(table_of(*fleet(seed, crossed())), DAYS, NOW).of_metrics[0].differences[0] for seed in range(40)]
    assert {(one.group, one.reference) for one in found} == {("2026-01-06", "2026-01-05")}
    # No day differs; the mean of a day does by a third of the batches' difference, and a t test claims it.
    assert abs(np.mean([one.difference for one in found])) < 0.1
    assert sum(one.low <= 0.0 <= one.high for one in found) >= 35
    assert all(one.naive.difference > 0.4 for one in found)
    # One in twenty shows a lack of fit by chance.
    assert sum(one.model.startswith("fixed: group and each station's batches") for one in found) >= 35


def test_days_that_are_batches_are_not_compared():
    plan = [(batch, station, day) for day, batch in enumerate(("41", "42")) for station in "AB" for _ in range(8)]
    made = compare(table_of(*fleet(1, plan)), DAYS, NOW)
    (one,) = made.of_metrics[0].differences
    assert one.difference is None
    assert one.warnings[0] == (
        "periods and batches cannot be told apart: 2026-01-06 is batch 42 only; 2026-01-05 is batch 41 only; "
        "run some sensors of one batch at one station in both"
    )
    assert one.naive.difference == pytest.approx(BATCH_MM, abs=0.4)
    assert not any("not compared with groups" in note for note in made.of_metrics[0].notes)


def test_software_that_is_a_batch_is_not_compared_with_the_other():
    runs, values = fleet(2, [("41", "A", 0), ("42", "A", 0), ("41", "B", 0), ("42", "B", 0)] * 6)
    runs = [replace(run, software=(("cbsr-qa", "2.0" if run.batch == "42" else "1.0"),)) for run in runs]
    (one,) = compare(table_of(runs, values), Terms(By.SOFTWARE), NOW).of_metrics[0].differences
    assert one.difference is None
    assert one.warnings[0].startswith(
        "software versions and batches cannot be told apart: cbsr-qa 2.0 is batch 42 only"
    )


def test_days_at_stations_of_their_own_and_days_that_share_no_batch_at_a_station_are_told_as_such():
    plan = [("41", "A", 0), ("42", "A", 0), ("41", "B", 1), ("42", "B", 1)] * 4
    (one,) = compare(table_of(*fleet(3, plan)), DAYS, NOW).of_metrics[0].differences
    assert one.warnings[0].startswith("periods and stations cannot be told apart: 2026-01-06 is B only")
    plan = [("41", "A", 0), ("42", "B", 0), ("41", "B", 1), ("42", "A", 1)] * 4
    (one,) = compare(table_of(*fleet(3, plan)), DAYS, NOW).of_metrics[0].differences
    assert one.warnings[0].startswith(
        "periods cannot be separated from batches and stations: 2026-01-06 is batch 42 at A"
    )


def test_what_a_difference_of_periods_rests_on_is_said_and_stations_are_compared_beside():
    runs, values = fleet(4, crossed())
    made = compare(table_of(runs, values + [1.0 * (run.station == "B") for run in runs]), DAYS, NOW)
    assert "compared with 2026-01-05: 2026-01-06 (batch 41, 42)" in " ".join(made.warnings)
    (station,) = made.of_metrics[0].stations
    assert (station.station, station.reference) == ("B", "A")
    assert station.low <= 1.0 <= station.high
    with_batches = compare(
        table_of(runs, values + [1.0 * (run.station == "B") for run in runs]), Terms(By.STATION), NOW
    )
    assert station.difference == with_batches.of_metrics[0].differences[0].difference
    html = page_of(compare_outcome(made))
    assert "Differences of stations from the one with most runs, adjusted for batches" in html
    one_batch = [replace(run, batch="41") for run in runs]
    alone = compare(table_of(one_batch, values), DAYS, NOW)
    assert alone.of_metrics[0].differences[0].model.startswith("fixed: group and station")
    assert not any("batch" in said for said in alone.warnings)


def test_the_earliest_period_is_the_reference_unless_one_is_named():
    runs, values = fleet(5, [("41", "A", 0)] * 3 + [("41", "A", 1)] * 9)
    assert compare(table_of(runs, values), DAYS, NOW).reference == "2026-01-05"
    named = replace(DAYS, groups=("2026-01-06", "2026-01-05"))
    assert compare(table_of(runs, values), named, NOW).reference == "2026-01-06"


def test_a_clock_wrong_by_a_year_is_told_by_the_identifiers_where_stations_test_batches_of_their_own():
    runs, values = fleet(6, [("41", "A", 0), ("42", "B", 0), ("43", "C", 0)] * 5)
    year = timedelta(days=365)
    wrong = [replace(run, started_at=run.started_at - year) if run.station == "B" else run for run in runs]
    (said,) = (one for one in compare(table_of(wrong, values), Terms(By.BATCH), NOW).warnings if "clock" in one)
    assert said.startswith(
        "The clock of station B was wrong, or that of the computer that named the runs: 5 runs (S-001, "
    )
    assert "state 2025-01-05 to 2025-01-05, and were named 365 days later" in said
    months = compare(table_of(wrong, values), Terms(By.PERIOD), NOW).warnings
    assert any("Periods are taken from these clocks" in one for one in months)
    assert not any("clock" in one for one in compare(table_of(runs, values), Terms(By.BATCH), NOW).warnings)


def test_identifiers_say_nothing_of_clocks_where_a_fleet_was_stored_all_at_once():
    runs, values = fleet(6, [("41", "A", 0), ("42", "B", 30)] * 5)
    copied = [replace(run, made_at=BEGAN + timedelta(days=60)) for run in runs]
    assert not any("clock" in one for one in compare(table_of(copied, values), Terms(By.BATCH), NOW).warnings)


@pytest.mark.parametrize("value", [1e200, -1e200, np.inf, -np.inf])
def test_a_value_nothing_can_be_made_of_is_left_out_with_its_sensor_named_and_the_rest_compared(value):
    runs, values = fleet(7, [("41", "A", 0), ("42", "A", 0)] * 6)
    both = np.column_stack([values, values])
    both[3, 1] = value
    made = compare(table_of(runs, both, ("gap", "noise")), Terms(By.BATCH), NOW)
    gap, noise = made.of_metrics
    assert [one.n for one in gap.distributions] == [6, 6]
    assert [one.n for one in noise.distributions] == [6, 5]
    assert noise.differences[0].difference == pytest.approx(BATCH_MM, abs=0.7)
    (said,) = noise.values.warnings
    assert said == f"infinite or beyond 1e+150, left out: S-003 ({value:g})"


def test_a_metric_that_runs_do_not_hold_at_all_is_named():
    runs, values = fleet(8, [("41", "A", 0), ("42", "A", 0), ("43", "A", 0)] * 4)
    table = table_of(runs, np.column_stack([values, values]), ("gap", "noise"))
    third = [number for number, run in enumerate(runs) if run.batch == "43"]
    made = compare(without(table, {(0, 0), *((number, 1) for number in third)}), Terms(By.BATCH), NOW)
    gap, noise = made.of_metrics
    assert gap.values.warnings == ("without this measurement, left out: S-000 (1 run)",)
    assert noise.values.warnings == ("without this measurement, left out: S-002, S-005, S-008, S-011 (4 runs)",)
    refused = next(one for one in noise.differences if one.group == "43")
    assert refused.warnings[0] == "no run of 43 that counts has a value of it"
    assert any(
        "no run of 43 that counts has a value of it" in said for said in compare_outcome(made).result.sentences
    )


def test_recipes_that_do_not_measure_a_metric_are_named_instead_of_their_sensors():
    runs, values = fleet(9, [("41", "A", 0), ("42", "A", 0)] * 4)
    runs = [replace(run, recipe="other") if number < 2 else run for number, run in enumerate(runs)]
    table = without(table_of(runs, np.column_stack([values, values]), ("gap", "noise")), {(0, 1), (1, 1)})
    noise = compare(table, Terms(By.BATCH), NOW).of_metrics[1]
    assert noise.values.warnings == ("2 runs of recipes that do not measure it, left out: other",)


def test_runs_of_golden_sensors_that_checked_a_station_do_not_count():
    runs, values = fleet(10, [("41", "A", 0), ("42", "A", 0)] * 4)
    runs = [replace(run, of_check=number < 1) for number, run in enumerate(runs)]
    made = compare(table_of(runs, values), Terms(By.BATCH), NOW)
    assert {group.name: group.runs for group in made.groups} == {"41": 3, "42": 4}
    assert "Left out: 1 run of golden sensors that checked a station" in made.warnings
    every = [replace(run, of_check=True) for run in runs]
    with pytest.raises(RefusedError, match="of 8 stored runs none"):
        compare(table_of(every, values), Terms(By.BATCH), NOW)


def test_runs_of_one_sensor_are_kept_in_their_order():
    runs = [run_of(number, "41", serial="G-1" if number % 2 else "G-2") for number in range(9)]
    found = group_runs(runs, Terms(By.BATCH))
    assert found.tests["41"] == {"G-2": (0, 2, 4, 6, 8), "G-1": (1, 3, 5, 7)}
    assert found.deciding(runs, Policy.FIRST)["41"].tolist() == [0, 1]


def test_a_design_names_its_levels_only_where_batches_could_be_taken_for_groups():
    runs, _ = fleet(11, crossed(1))
    assert design_of(runs, group_runs(runs, DAYS), DAYS).crossing.stations[0] == "A (batch 41)"
    assert design_of(runs, group_runs(runs, Terms(By.BATCH)), Terms(By.BATCH)).crossing.stations[0] == "A"
    nameless = [replace(run, batch="") if run.batch == "41" else run for run in runs]
    assert "A (batch not stated)" in design_of(nameless, group_runs(nameless, DAYS), DAYS).crossing.stations


def test_what_was_taken_out_of_a_difference_of_periods_is_said():
    runs, values = fleet(12, crossed())
    table = table_of(runs, values + [3.0 * (run.started_at.day == 6) for run in runs])
    assert "2026-01-06 − 2026-01-05, adjusted for stations and batches; " in page_of_days(table)
    one_batch = replace(table, runs=tuple(replace(run, batch="41") for run in runs))
    assert "2026-01-06 − 2026-01-05, adjusted for stations; " in page_of_days(one_batch)


def page_of_days(table):
    return page_of(compare_outcome(compare(table, DAYS, NOW)))


def sessions_fleet(deviation, stations=3, metrics=10, sensors=20):
    """Three batches alike, each at so many stations, with a deviation of each session in every metric."""
    plan = [(f"4{batch}", "ABC"[number % stations], 0) for batch in range(3) for number in range(sensors)]
    runs = [run_of(number, *row) for number, row in enumerate(plan)]
    random = np.random.default_rng(12)
    session = {name: deviation * random.normal(size=metrics) for name in sorted({row[:2] for row in plan})}
    values = random.normal(size=(len(runs), metrics)) + [session[run.batch, run.station] for run in runs]
    return table_of(runs, values, tuple(f"gap {number}" for number in range(metrics)))


def test_sessions_that_disturb_all_metrics_are_in_the_intervals_and_named():
    terms = Terms(By.BATCH)
    disturbed, calm = (compare(sessions_fleet(deviation), terms, NOW) for deviation in (1.0, 0.0))
    (said,) = [warning for warning in disturbed.warnings if "depends on the station" in warning]
    assert said.startswith(
        "How far one batch is from another depends on the station, by more than their sensors explain"
    )
    assert all("session" in one.model for one in disturbed.metrics)
    assert not any(disturbed.significant(one) for one in disturbed.metrics)
    assert any("lack of fit, p = " in note for note in disturbed.of_metrics[0].notes)
    assert not any("session" in warning for warning in calm.warnings)
    assert all(one.model == "fixed: group and station, one run a sensor" for one in calm.metrics)


@pytest.mark.parametrize(
    ("plan", "further"),
    [
        ([("41", "A"), ("42", "A")], "some sensors of 41 on a second station too"),
        ([("41", "A"), ("41", "B"), ("42", "B")], "some sensors of 42 on A too"),
    ],
)
def test_a_design_that_cannot_show_sessions_names_the_run_that_would(plan, further):
    runs = [run_of(number, *plan[number % len(plan)]) for number in range(24)]
    values = np.random.default_rng(13).normal(size=24)
    (said,) = [
        warning for warning in compare(table_of(runs, values), Terms(By.BATCH), NOW).warnings if "session" in warning
    ]
    assert said.startswith("These runs cannot tell a batch from its session at a station")
    assert said.endswith(further)


def test_two_batches_at_two_stations_are_said_to_show_sessions_hardly():
    plan = [(batch, station) for batch in ("41", "42") for station in "AB"]
    runs = [run_of(number, *plan[number % 4]) for number in range(24)]
    values = np.random.default_rng(15).normal(size=24)
    (said,) = [
        warning for warning in compare(table_of(runs, values), Terms(By.BATCH), NOW).warnings if "session" in warning
    ]
    assert said.startswith(
        "These runs hardly show whether sessions of a batch at a station differ (1 degree of freedom)"
    )


def test_a_batch_that_scatters_more_is_named_and_weighted():
    runs = [run_of(number, f"4{number % 2}") for number in range(60)]
    values = np.random.default_rng(14).normal(size=60) * [1.0 + 4.0 * (run.batch == "41") for run in runs]
    (metric,) = compare(table_of(runs, values), Terms(By.BATCH), NOW).of_metrics
    assert any("40 scatters least and 41 most, " in note for note in metric.notes)
    difference, naive = metric.differences[0], metric.differences[0].naive
    assert (difference.low, difference.high) == pytest.approx((naive.low, naive.high))  # Welch's
