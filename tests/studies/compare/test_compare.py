"""``cbsr-qa compare`` on stored lots: what differs by batch, station, period and material, and how sure that is."""

import re
from datetime import datetime, timedelta

import numpy as np
import pytest
from compared_fleets import BATCH_MM, ERROR, STATION_MM, compared, fleet, json_of, metric
from stored_lots import judged, measured, store_run

from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.compare.terms import Adjustment, By, Period, Policy, Quarantine


def test_the_batch_is_told_from_the_station(two):
    made = compared(two)
    found = metric(made)
    assert (found["group"], found["reference"]) == ("42", "41")
    assert found["low"] < BATCH_MM < found["high"]
    assert found["p"] < 0.05
    assert found["model"].startswith("mixed")
    assert found["unit"] == "mm"
    assert found["effect_size"] == pytest.approx(found["difference"] / found["deviation"])
    station = next(s for s in json_of(made)["stations"] if s["name"] == ERROR)
    assert (station["station"], station["reference"]) == ("B", "A")
    assert station["low"] < STATION_MM < station["high"]
    assert made.exit_code == 0
    worse = r"Batch 42 reads [\d.]+ mm \(.*\) worse than 41 in centre of mass error at the same stations\. "
    worse += "Station B reads "
    assert re.match(worse, made.result.headline)


def test_stations_are_compared_with_the_batches_taken_out(two):
    found = metric(compared(two, By.STATION))
    assert (found["group"], found["reference"]) == ("B", "A")
    assert found["low"] < STATION_MM < found["high"]
    assert found["p"] < 0.001


def test_batches_on_a_station_each_are_not_fitted_and_the_claim_of_a_t_test_is_shown(url):
    fleet(url, alone=True)
    made = compared(url)
    found = metric(made)
    assert found["difference"] is found["low"] is found["p"] is found["equivalent"] is None
    assert found["model"] == "refused"
    assert "42 ran on B only and 41 on A only" in found["warnings"][0]
    assert found["naive"]["difference"] == pytest.approx(BATCH_MM + STATION_MM, abs=0.4)
    said = " ".join(made.result.sentences)
    assert "A t test, which ignores stations and the number of metrics, claims" in said
    assert made.exit_code == 3


def test_a_metric_is_the_mean_of_its_loads_and_a_retest_decides_by_policy(url):
    def values(mm):
        return judged(tuple(Measurement(ERROR, mm + k, "mm", 0.1, "nine locations", f"L{k}", 0) for k in range(3)))

    with open_store(url, durable=False) as store:
        for number, mm in enumerate((1.0, 2.0, 3.0)):
            store_run(store, f"S-{number}", values(mm + 4.0), batch="41")  # 5 to 7, 6 to 8, 7 to 9: beyond 6.5
            store_run(store, f"S-{number}", values(mm), batch="41")

    last, first, some = (json_of(compared(url, policy=policy)) for policy in (Policy.LAST, Policy.FIRST, Policy.ANY))
    assert [d["distributions"][0]["mean"] for d in (last, first, some)] == [3.0, 7.0, 3.0]
    assert [d["groups"][0]["yield"] for d in (last, first, some)] == [1.0, 0.0, 1.0]
    assert {d["groups"][0]["first_pass_yield"] for d in (last, first, some)} == {0.0}
    assert first["groups"][0]["failures"] == [{"metric": f"{ERROR} (nine locations)", "sensors": 3}]
    assert last["groups"][0]["failures"] == []
    with open_store(url, durable=False) as store:
        latest = {line.serial: line.run for line in store.fleet.read_lines()}
        store.changes.override_verdict(latest["S-0"], Outcome.FAIL, operator="Zoë", why="scratched")
    again = json_of(compared(url))["groups"][0]
    assert again["yield"] == pytest.approx(2 / 3)
    assert again["failures"] == [{"metric": "decided by an operator", "sensors": 1}]
    # Capability is of the worst load: of 3, 4 and 5 mm against 6.5 mm.
    assert last["distributions"][0]["capability"]["cpk"]["value"] == pytest.approx((6.5 - 4.0) / 3)


def test_two_limits_that_judge_every_load_give_capability_of_both_sides(url):
    limit = Limit("area_ratio", "1", 0.0, 2.0)

    def values(ratio):
        loads = ratio - 0.1, ratio, ratio + 0.2
        return tuple(
            Measurement("area_ratio", one, "1", None, "nine locations", f"L{k}", 0).judge(limit)
            for k, one in enumerate(loads)
        )

    with open_store(url, durable=False) as store:
        for number, ratio in enumerate((0.9, 1.0, 1.1)):
            store_run(store, f"S-{number}", values(ratio), batch="41")
    (one,) = json_of(compared(url))["distributions"]
    assert one["no_capability"] is None
    assert one["capability"]["cpk"]["value"] == pytest.approx((2.0 - 1.2) / 0.3)
    assert one["capability"]["cp"]["value"] == pytest.approx((2.0 - 0.3) / 0.6)


def test_sensors_that_could_not_be_measured_are_counted_as_the_policy_says(url):
    random = np.random.default_rng(2)
    with open_store(url, durable=False) as store:
        for number in range(6):
            values = judged(measured(random, random.standard_normal(3)))
            changes = {"verdict": Verdict(Outcome.NOT_MEASURED, "drift")} if number == 0 else {}
            store_run(store, f"S-{number}", values, batch="41", **changes)
        store_run(store, "S-6", values, batch="41", end=EndReason.ABORTED)
    apart = json_of(compared(url))
    failed = json_of(compared(url, quarantine=Quarantine.FAILED))
    assert (apart["groups"][0]["yield"], apart["groups"][0]["not_measured"]) == (1.0, 1)
    assert failed["groups"][0]["yield"] == pytest.approx(5 / 6)
    assert "Left out: 1 run that did not finish" in apart["warnings"]


def test_p_values_are_adjusted_for_all_metrics(two):
    raw, holm = (
        {m["name"]: m["p"] for m in json_of(compared(two, adjustment=a))["metrics"]}
        for a in (Adjustment.NONE, Adjustment.HOLM)
    )
    assert holm[ERROR] == pytest.approx(3 * raw[ERROR])  # the smallest of three that could be tested


def test_equivalence_and_how_many_sensors_a_difference_needs(two):
    wide, narrow = (metric(compared(two, margins={"drift": m}, detect={"drift": m}), "drift") for m in (1.0, 1e-4))
    assert wide["equivalent"] is True
    assert narrow["equivalent"] is False
    assert narrow["sensors_needed"] > 1000 > wide["sensors_needed"] >= 2
    assert narrow["sensors_to_show_alike"] > narrow["sensors_needed"]
    alone = metric(compared(two, margins={"drift": 1.0}), "drift")
    assert alone["detect"] is alone["sensors_needed"] is None
    nothing = metric(compared(two), "drift")
    assert nothing["equivalent"] is nothing["sensors_to_show_alike"] is None


def test_what_all_places_share_counts_against_the_station(url):
    random = np.random.default_rng(3)
    with open_store(url, durable=False) as store:
        for number in range(20):
            station = "AB"[number % 3 == 0]
            shift_mm = 0.5 + 0.1 * random.standard_normal() + (station == "B")
            values = (*measured(random, random.standard_normal(3)), Measurement("registration_shift", shift_mm, "mm"))
            store_run(store, f"S-{number}", judged(values), batch=("41", "42")[number % 2], station=station)
    made = compared(url)
    assert metric(made, "registration_shift")["difference"] is None
    (station,) = (s for s in json_of(made)["stations"] if s["name"] == "registration_shift")
    assert station["low"] < 1.0 < station["high"]
    assert (
        "it includes the shift of all places, which depends on how the station places sensors"
        in metric(made)["warnings"]
    )
    assert metric(compared(url, By.STATION), "registration_shift")["difference"] == pytest.approx(1.0, abs=0.2)


def test_more_than_two_groups_are_each_compared_with_the_stated_reference(two):
    random = np.random.default_rng(4)
    with open_store(two, durable=False) as store:
        for number in range(5):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"T-{number}", values, batch="43", station="A")
    assert json_of(compared(two))["reference"] == "41"  # most sensors, then by name
    pairs = {(m["group"], m["reference"]) for m in json_of(compared(two, groups=("43", "41", "42")))["metrics"]}
    assert pairs == {("41", "43"), ("42", "43")}


def test_periods_are_days_weeks_months_and_years(url):
    random = np.random.default_rng(8)
    with open_store(url, durable=False) as store:
        for number in range(8):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"S-{number}", values, day=(0, 14)[number % 2])
    names = {p: [g["name"] for g in json_of(compared(url, By.PERIOD, period=p))["groups"]] for p in Period}
    assert names[Period.MONTH] == ["2026-11", "2026-12"]
    assert names[Period.WEEK] == ["2026-W47", "2026-W49"]
    assert names[Period.YEAR] == ["2026"]
    since = RunSelection(since=(datetime(2026, 11, 21) + timedelta(days=1)).date())
    assert [g["n"] for g in json_of(compared(url, By.PERIOD, since))["groups"]] == [4]
    until = RunSelection(until=datetime(2026, 11, 21).date())
    assert [g["n"] for g in json_of(compared(url, By.PERIOD, until))["groups"]] == [4]


def test_a_material_of_one_batch_cannot_be_told_from_it(url):
    fleet(url, sensors=4, both=0)
    warnings = json_of(compared(url, By.MATERIAL))["warnings"]
    assert any("Batches of one material are treated as alike" in words for words in warnings)
    only = json_of(compared(url, By.MATERIAL, RunSelection(recipe="short")))
    assert [g["name"] for g in only["groups"]] == ["cbsr-8wt"]


def test_only_the_latest_analysis_counts(url):
    random = np.random.default_rng(9)
    with open_store(url, durable=False) as store:
        run = store_run(store, "S-1", judged(measured(random, np.zeros(3))))
        from cbsr_qa.domain.results.run_result import RunResult

        again = (Measurement("drift", 0.25, "%/min"),)
        result = RunResult(store.runs.load(run), None, again, Verdict(Outcome.NOT_JUDGED, ""), None, "")
        store.analyses.save(result)
    document = json_of(compared(url))
    assert [(d["name"], d["mean"]) for d in document["distributions"]] == [("drift", 0.25)]
    assert document["groups"][0]["yield"] is None
