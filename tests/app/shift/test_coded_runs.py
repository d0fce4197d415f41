"""Failure codes of stored runs: in lists, counts, tables and other exports, the same however a run is looked at."""

import csv
import io
import json
from xml.etree import ElementTree

import pytest
from stored_lots import LIMITS, PHASE, store_run

from cbsr_qa.app.shift.lists import ListRequest, list_runs, list_sensors
from cbsr_qa.app.shift.summary import CodeCount, shift_summary
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.plan.limits import FailureCode, Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store

ERROR, DRIFT = "centre_of_mass_error", "drift"
CODES = {
    ERROR: {"code": "P1", "text": "wrong place", "disposition": "retest"},
    DRIFT: {"code": "N2", "text": "drifts", "disposition": "scrap"},
    "not measured": {"code": "M1", "text": "not measured"},
    "aborted": {"code": "M2", "text": "stopped", "disposition": "retest"},
}
P1, N2 = FailureCode("P1", "wrong place", "retest", (ERROR,)), FailureCode("N2", "drifts", "scrap", (DRIFT,))
TABLES = {"tables": {"failure_codes": CODES}}


def values(*, error=2.0, drift=0.0):
    place = Measurement(ERROR, error, "mm", 0.02, PHASE, "L0", 0, load=0, strain=0.2)
    return tuple(m.judge(LIMITS[m.name]) for m in (place, Measurement(DRIFT, drift, "%/min")))


@pytest.fixture(scope="module")
def coded(tmp_path_factory):
    """A passes, B fails drift worse than place, C is aborted, D could not be measured, E is overridden to a pass."""
    url = f"sqlite:///{tmp_path_factory.mktemp('coded') / 'coded.db'}"
    with open_store(url, durable=False) as store:
        names = {
            "A": store_run(store, "A", values(), **TABLES),
            "B": store_run(store, "B", values(error=9.0, drift=3.0), **TABLES),
            "C": store_run(store, "C", values(), end=EndReason.ABORTED, **TABLES),
            "D": store_run(store, "D", values(drift=None), **TABLES),
            "E": store_run(store, "E", values(error=9.0), **TABLES),
            "F": store_run(store, "F", values(error=9.0)),
        }
        store.changes.override_verdict(names["E"], Outcome.PASS, operator="Bob", why="draught")
        yield url, store, names


def codes_by_serial(entries):
    return {entry.serial: entry.failure_codes for entry in entries}


def test_a_run_has_the_codes_of_what_failed_the_worst_first(coded):
    _, store, _ = coded
    entries = list_runs(store, ListRequest(RunSelection())).runs
    of_runs = codes_by_serial(entries)
    assert of_runs["A"] == () == of_runs["F"]
    assert of_runs["B"] == (N2, P1)
    assert [code.code for code in of_runs["C"]] == ["M2"]
    assert [code.code for code in of_runs["D"]] == ["M1"]
    assert of_runs["E"] == (P1,)
    assert next(entry for entry in entries if entry.serial == "B").failed_limits == (DRIFT, f"{ERROR} ({PHASE})")


def test_a_sensor_has_the_codes_of_its_last_decided_run(coded):
    _, store, _ = coded
    of_sensors = codes_by_serial(list_sensors(store, ListRequest(RunSelection())).sensors)
    assert of_sensors["B"] == (N2, P1)
    assert of_sensors["C"] == ()


def test_codes_are_counted_most_sensors_first_and_without_overridden_passes(coded):
    _, store, _ = coded
    assert shift_summary(store, RunSelection()).codes == (
        CodeCount("M1", "not measured", "", 1, 1),
        CodeCount("M2", "stopped", "retest", 1, 1),
        CodeCount("N2", "drifts", "scrap", 1, 1),
        CodeCount("P1", "wrong place", "retest", 1, 1),
    )


def test_a_failure_counts_the_earlier_ones_of_its_sensor_and_recipe_with_its_code(tmp_path):
    again = {**CODES, ERROR: {**CODES[ERROR], "disposition_again": "scrap"}}
    own = {"tables": {"failure_codes": again}}
    with open_store(f"sqlite:///{tmp_path / 'again.db'}", durable=False) as store:
        let_through = store_run(store, "A", values(error=9.0), **own)
        store.changes.override_verdict(let_through, Outcome.PASS, operator="Bob", why="draught")
        store_run(store, "A", values(error=9.0), recipe="other", **own)
        store_run(store, "B", values(error=9.0), **own)
        runs = [
            store_run(store, "A", values(drift=3.0), **own),
            store_run(store, "A", values(error=9.0), **own),
            store_run(store, "A", values(error=9.0), end=EndReason.ABORTED, **own),
            store_run(store, "A", values(error=9.0), **own),
            store_run(store, "A", values(error=9.0, drift=3.0), **own),
        ]
        todo = [["scrap"], ["retest"], ["retest"], ["scrap (it has failed 2 times with P1)"]]
        todo += [["scrap (it has failed 2 times with N2)", "scrap (it has failed 3 times with P1)"]]
        listed = {run.run: run for run in store.lists.read_runs()}
        assert [[code.todo for code in listed[run].failure_codes] for run in runs] == todo
        (last,) = store.lists.read_named(runs[-1:])
        assert last == listed[runs[-1]]
        assert store.lists.read_failed_before(runs[-1]) == last.failed_before == ("N2", "P1", "P1")
        assert store.lists.read_failed_before(runs[2]) == ("N2", "P1")


def test_lists_print_codes(coded, capsys):
    url, _, _ = coded
    run_guarded(["runs", "--database", url])
    printed = capsys.readouterr().out
    assert "Failure codes" in printed
    assert "wrong place" in printed
    run_guarded(["runs", "--json", "--database", url])
    listed = json.loads(capsys.readouterr().out)
    assert listed["runs"][1]["failure_codes"][0] == {
        "code": "N2",
        "text": "drifts",
        "disposition": "scrap",
        "causes": [DRIFT],
        "disposition_again": "",
        "failed_before": 0,
    }
    assert listed["summary"]["codes"][0]["code"] == "M1"


def test_tables_and_junit_hold_codes(coded, tmp_path):
    url, _, _ = coded
    target = tmp_path / "runs.csv"
    assert run_guarded(["export", "--to", str(target), "--database", url]) == 0
    rows = list(csv.DictReader(io.StringIO(target.read_text())))
    assert [row["failure_codes"] for row in rows] == ["", "N2; P1", "M2", "M1", "P1", ""]
    xml = tmp_path / "runs.xml"
    assert run_guarded(["export", "--to", str(xml), "--database", url]) == 0
    suites = ElementTree.parse(xml).getroot()
    properties = [{p.get("name"): p.get("value") for p in suite.iter("property")} for suite in suites]
    assert [of_run["failure_codes"] for of_run in properties] == ["", "N2; P1", "M2", "M1", "P1", ""]
