"""Earlier runs of a sensor: counted as tries, told in words, and read from the store as they stood before a run."""

import sqlite3
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from report_samples import sample_run
from stored_lots import judged, store_run

from cbsr_qa.app.run.outcome import PastRuns, RunOutcome, run_outcome
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.run.changes import EarlierRun, SensorHistory
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.run.station import StationCheck
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.report.document import json_document
from cbsr_qa.report.heads import run_page
from cbsr_qa.store.opening import open_store

SENSOR = SensorIdentity("S-7", "42", "disc-100mm")


def earlier(day, outcome=Outcome.PASS, reason="all 3 limits are met", end=EndReason.FINISHED, **more):
    began = datetime(2026, 11, day, 8, tzinfo=UTC)
    made = EarlierRun(f"run-{day}", began, SENSOR, "nine-locations", end, outcome, reason)
    return replace(made, **more)


FAIL = earlier(20, Outcome.FAIL, "centre of mass error is 8.2 mm (allowed: at most 6.5 mm)")
STOPPED = earlier(21, None, "", EndReason.ABORTED)
CHECKS = tuple(earlier(day, recipe="golden-check", of_check=True) for day in (3, 4))


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        ((), ""),
        ((FAIL,), "second test with this recipe; earlier: 2026-11-20 fail (centre of mass error is 8.2 mm)"),
        (
            (FAIL, STOPPED),
            "third test with this recipe; earlier:"
            " 2026-11-20 fail (centre of mass error is 8.2 mm), 2026-11-21 aborted",
        ),
        (
            (replace(FAIL, overridden=(Outcome.PASS, "Zoë")),),
            "second test with this recipe; earlier: 2026-11-20 fail (centre of mass error is 8.2 mm),"
            " overridden to pass by Zoë",
        ),
        (
            (earlier(2, recipe="re-verification"), earlier(3, None, "", EndReason.RUNNING)),
            "second test with this recipe; earlier: 2026-11-03 cut off or still under way;"
            " 1 run of other recipes, the latest (re-verification) 2026-11-02 pass",
        ),
        (CHECKS, "2 runs in checks of stations, the latest 2026-11-04 pass"),
        (
            tuple(earlier(day) for day in range(1, 8)),
            "eighth test with this recipe; earlier: 2026-11-03 pass, 2026-11-04 pass, 2026-11-05 pass,"
            " 2026-11-06 pass, 2026-11-07 pass, and 2 before",
        ),
    ],
)
def test_the_number_of_the_try_and_what_came_before_are_told(runs, said):
    assert SensorHistory(SENSOR, "nine-locations", runs).words == said


@pytest.mark.parametrize(
    ("tries", "ordinal"), [(0, "first"), (9, "tenth"), (10, "11th"), (21, "22nd"), (112, "113th")]
)
def test_tries_are_numbered_as_people_do(tries, ordinal):
    assert SensorHistory(SENSOR, "nine-locations", tries * (FAIL,)).ordinal == ordinal


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        (SENSOR, ()),
        (replace(SENSOR, batch=""), ()),
        (replace(SENSOR, batch="41"), ("batch '41' now; its run of 2026-11-21 says '42'",)),
        (replace(SENSOR, sensor_type="elbow"), ("type 'elbow' now; its run of 2026-11-21 says 'disc-100mm'",)),
    ],
)
def test_another_batch_or_type_than_earlier_runs_state_is_told_once(sensor, said):
    nobody = replace(STOPPED, sensor=replace(SENSOR, batch=""), run="run-22")
    found = SensorHistory(sensor, "nine-locations", (FAIL, STOPPED, nobody)).differences
    assert [one.split(": ")[1] for one in found] == list(said)
    assert all(one.startswith("sensor S-7: ") and "two sensors have this serial number" in one for one in found)


def test_several_other_batches_are_one_warning():
    runs = tuple(earlier(day, sensor=replace(SENSOR, batch=str(day))) for day in (3, 4))
    (said,) = SensorHistory(SENSOR, "nine-locations", runs).differences
    assert "batch '42' now; its run of 2026-11-03 says '3', its run of 2026-11-04 says '4': one is" in said


@pytest.mark.rest
def test_the_store_tells_a_run_of_those_before_it_alone(database_url):
    with open_store(database_url) as store:
        bad, good = (judged((Measurement("drift", drift, "%/min"),)) for drift in (0.9, 0.1))
        first = store_run(store, "S-7", bad, batch="41", recipe="nine-locations")
        stopped = store_run(store, "S-7", good, batch="42", recipe="nine-locations", end=EndReason.ABORTED)
        golden = store_run(store, "S-7", good, batch="", recipe="golden-check")
        at = datetime(2026, 11, 22, tzinfo=UTC)
        store.stations.save_check(StationCheck(store.new_id(), "bench-α", "", at, "t", 64 * "a", (), (), (), golden))
        last = store_run(store, "S-7", good, batch="42", recipe="nine-locations")
        store_run(store, "S-8", bad, recipe="nine-locations")
        for outcome in (Outcome.PASS, Outcome.FAIL):
            store.changes.override_verdict(first, outcome, operator="Zoë", why="so")
        found = store.sensors.read_history(SENSOR, "nine-locations", last)
        assert [one.run for one in found.earlier] == [first, stopped, golden]
        assert [(one.outcome, one.end, one.of_check) for one in found.earlier] == [
            (Outcome.FAIL, EndReason.FINISHED, False),
            (None, EndReason.ABORTED, False),
            (Outcome.PASS, EndReason.FINISHED, True),
        ]
        assert found.earlier[0].overridden == (Outcome.FAIL, "Zoë")
        assert "drift" in found.earlier[0].reason
        assert (found.ordinal, json_document(PastRuns.from_history(found))["try"]) == ("third", 3)
        assert len(found.differences) == 1
        assert store.sensors.read_history(SENSOR, "nine-locations", first).words == ""
        assert len(store.sensors.read_history(SENSOR, "nine-locations").earlier) == 4


EDITED = {
    "verdict": ("update analyses set outcome = 'pass'", "analyses"),
    "word": ("update analyses set outcome = 'good'", "analyses"),
    "date": ("update runs set started_at = 'today'", "runs"),
    "link": ("delete from run_links where kind = 'analyses'", "analyses"),
    "bytes for the chain": ("update runs set chain = x'ff006a'", "runs.chain ("),
}


@pytest.mark.parametrize(("statement", "table"), EDITED.values(), ids=EDITED)
def test_an_earlier_run_that_was_changed_is_named_and_stops_nothing(tmp_path, statement, table):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store:
        run = store_run(store, "S-7", judged((Measurement("drift", 0.9, "%/min"),)), recipe="nine-locations")
        store.changes.override_verdict(run, Outcome.FAIL, operator="Zoë", why="so")
        with sqlite3.connect(tmp_path / "runs.db") as database:
            assert database.execute(statement).rowcount >= 1
        found = store.sensors.read_history(SENSOR, "nine-locations")
    assert "changed since it was stored (run " + run in found.words
    assert table in found.earlier[0].changed
    assert (found.earlier[0].outcome, found.ordinal, len(found.warnings)) == (None, "second", 1)
    told = json_document(PastRuns.from_history(found))["earlier_runs"][0]
    assert (told["end"], told["outcome"], table in told["changed"]) == (None, None, True)


@pytest.mark.rest
def test_an_earlier_run_without_a_chain_is_told_apart(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store:
        store_run(store, "S-7", judged((Measurement("drift", 0.9, "%/min"),)), recipe="nine-locations")
        with sqlite3.connect(tmp_path / "runs.db") as database:
            database.executescript("delete from run_links; update runs set chain = null")
        assert store.sensors.read_history(SENSOR, "nine-locations").words.endswith(" (no chain)")


def test_last_lines_document_and_page_one_tell_the_history():
    result = replace(sample_run(), sensor_history=SensorHistory(SENSOR, "nine-locations", (FAIL, STOPPED)))
    words = result.sensor_history.words
    outcome = run_outcome(RunOutcome.from_result(result))
    told = json_document(outcome.result)["sensor_history"]
    assert (told["try"], [one["outcome"] for one in told["earlier_runs"]]) == (3, ["fail", None])
    assert dict(outcome.page.identity)["Sensor"] == words
    assert dict(run_page(result).identity)["Earlier runs"] == words


@pytest.mark.parametrize(
    ("outcome", "tries", "remark"),
    [
        (Outcome.FAIL, (FAIL, STOPPED), "Third test with this recipe; failed on 2026-11-20 as well."),
        (Outcome.PASS, (FAIL, earlier(22, Outcome.FAIL)),
         "Third test with this recipe; failed on 2026-11-20, 2026-11-22."),
        (Outcome.FAIL, (earlier(20, Outcome.FAIL, overridden=(Outcome.PASS, "Ada")), *CHECKS), ""),
        (Outcome.FAIL, (earlier(20, Outcome.FAIL, recipe="short"),), ""),
        (Outcome.FAIL, (), ""),
    ],
)  # fmt: skip
def test_the_box_of_the_verdict_says_when_the_sensor_failed_before(outcome, tries, remark):
    result = replace(sample_run(), verdict=Verdict(outcome, "so"), missing=False)
    history = SensorHistory(SENSOR, "nine-locations", tries)
    assert run_page(replace(result, sensor_history=history)).banner.remark == remark
    assert run_page(result).banner.remark == ""


def test_a_first_run_says_nothing_of_earlier_ones():
    result = replace(sample_run(), sensor_history=SensorHistory(SENSOR, "nine-locations"))
    assert "Sensor" not in dict(run_outcome(RunOutcome.from_result(result)).page.identity)
    assert dict(run_page(result).identity)["Earlier runs"] == "none of this sensor in the database"
    assert json_document(PastRuns.from_history(result.sensor_history)) == {"try": 1, "earlier_runs": []}
