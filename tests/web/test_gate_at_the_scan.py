"""What a scan says first: what this sensor did before, at which station, and whether another test needs consent."""

import asyncio
import json
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import pytest
import sqlalchemy as sa
from stored_lots import LIMITS, store_run

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.run.station import StationCheck
from cbsr_qa.store.opening import open_store
from cbsr_qa.web import gate
from cbsr_qa.web.actions import Actions
from cbsr_qa.web.gate import gate_view, is_serial
from cbsr_qa.web.outcomes import earlier_words
from cbsr_qa.web.pages import Pages
from cbsr_qa.web.start import StartForm
from cbsr_qa.web.state import Mode
from cbsr_qa.web.stations import load_stations

_MEASURED = (Measurement("drift", 0.1, "%/min"),)


@pytest.fixture(scope="module")
def served():
    (station,) = load_stations(["simulated"], ["nine-locations"])
    return station


@pytest.fixture
def database(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    return str(tmp_path / "runs.db")


def _view(served, database, **form):
    return gate_view(served, StartForm.from_form(served, {"serial": "S-1", **form}), database)


def test_a_sensor_that_was_never_tested_has_no_past(served, database):
    view = _view(served, database)
    assert (view.may, view.earlier, view.asks_again, view.runs) == (True, None, "", 0)


@pytest.mark.parametrize(("outcome", "words"), [(Outcome.PASS, "Passed"), (Outcome.FAIL, "Failed")])
def test_the_latest_test_with_this_recipe_is_named_with_its_station_and_asks_for_consent(
    served, database, outcome, words
):
    recipe = served.recipes[0].name
    with open_store(f"sqlite:///{database}") as store:
        store_run(store, "S-1", _MEASURED, recipe=recipe, station="line-7", verdict=Verdict(outcome, "why"))
        latest = store_run(store, "S-1", _MEASURED, recipe=recipe, station="line-8", verdict=Verdict(outcome, "why"))
        store_run(store, "S-1", _MEASURED, recipe="other", station="line-9")
        store_run(store, "S-2", _MEASURED, recipe=recipe, station="line-9")
    view = _view(served, database)
    assert (view.asks_again, view.runs) == (latest, 3)
    assert earlier_words(view.earlier) == f"{words} with {view.earlier.recipe} at line-8, just now."


@pytest.mark.parametrize(("outcome", "words"), [(Outcome.PASS, "Passed"), (Outcome.FAIL, "Failed")])
def test_a_test_with_another_recipe_is_named_and_needs_consent_if_it_failed(served, database, outcome, words):
    with open_store(f"sqlite:///{database}") as store:
        run = store_run(store, "S-1", _MEASURED, recipe="other", station="line-7", verdict=Verdict(outcome, "why"))
    view = _view(served, database)
    assert view.asks_again == (run if outcome is Outcome.FAIL else "")
    assert earlier_words(view.earlier) == f"{words} with other at line-7, just now."


def test_a_failure_with_another_recipe_stands_until_that_recipe_passes(served, database):
    recipe, failed, passed = served.recipes[0].name, Verdict(Outcome.FAIL, "why"), Verdict(Outcome.PASS, "why")
    with open_store(f"sqlite:///{database}") as store:
        standing = store_run(store, "S-1", _MEASURED, recipe="other", verdict=failed)
        store_run(store, "S-1", _MEASURED, recipe="other", end=EndReason.ABORTED)
        store_run(store, "S-1", _MEASURED, recipe=recipe, verdict=passed)
        assert _view(served, database).asks_again == standing
        store_run(store, "S-1", _MEASURED, recipe="other", verdict=passed)
    assert _view(served, database).earlier.recipe == recipe


def test_a_golden_sensor_that_failed_a_check_of_a_station_may_be_tested(served, database):
    with open_store(f"sqlite:///{database}") as store:
        run = store_run(store, "S-1", _MEASURED, recipe="check", station="A", verdict=Verdict(Outcome.FAIL, "why"))
        assert store.live.find_standing_failure("S-1", "other").run == run
        began = store.live.find_run(run).started_at
        check = StationCheck(store.new_id(), "A", "Zoë", began, "disc-100mm", 64 * "a", (), (), ())
        store.stations.save_check(replace(check, golden_run=run))
        assert store.live.find_standing_failure("S-1", "other") is None


def test_a_run_without_a_result_is_named_and_needs_no_consent(served, database):
    recipe = served.recipes[0].name
    with open_store(f"sqlite:///{database}") as store:
        store_run(store, "S-1", _MEASURED, recipe=recipe, station="line-7", end=EndReason.ABORTED)
    view = _view(served, database)
    assert (view.asks_again, earlier_words(view.earlier).startswith("Stopped with nine-locations at line-7,")) == (
        "",
        True,
    )


def test_the_scan_says_what_the_last_failure_asks_for_and_whether_the_recipe_is_new_to_the_sensor(served, database):
    code = {"code": "N2", "text": "drifts", "disposition": "retest", "disposition_again": "scrap"}
    tables = {"failure_codes": {"drift": code}}
    drifted = (Measurement("drift", 9.0, "%/min").judge(LIMITS["drift"]),)
    recipe = served.recipes[0].name
    pages = Pages(SimpleNamespace(stations={}, trouble=""))
    form = StartForm.from_form(served, {"serial": "S-1"})

    def shown():
        return pages.gate("line-1", form, _view(served, database))

    with open_store(f"sqlite:///{database}") as store:
        for name, todo in (
            ("other", "retest"),
            (recipe, "retest"),
            (recipe, "scrap (it has failed 2 times with N2)"),
        ):
            store_run(store, "S-1", drifted, recipe=name, tables=tables)
            assert f"by its last result: {todo}." in shown()
            assert f"Failed with {name} at " in shown()
            assert (f"Never tested with {recipe}." in shown()) == (name == "other")
        for name in (recipe, "other"):
            store_run(store, "S-1", _MEASURED, recipe=name, tables=tables, verdict=Verdict(Outcome.PASS, "why"))
            assert ("by its last result: retest." in shown()) == (name == recipe)  # that of the other one stands


def _actions(served, database, *, elsewhere=None):
    """Actions of a line of two stations, the other of which may be testing a sensor."""
    line = SimpleNamespace(database=database, stations={})
    for name, serial in (("line-1", ""), ("line-2", elsewhere)):
        snapshot = SimpleNamespace(mode=Mode.RUNNING if serial else Mode.READY, serial=serial, resumable=False)
        line.stations[name] = SimpleNamespace(served=served, snapshot=snapshot)
    gate = SimpleNamespace(
        gate=lambda station, form, view: f"{form.serial}: {form.batch} {', '.join(map(str, form.parts))}",
        render_scan=lambda _, serial, view: f"{serial} may start" if view else f"{serial} cannot start",
        render_wrong_field=lambda _, serial, field: f"{serial}: {field} is wrong",
        idle_parts=lambda _: [["state", "as before"]],
    )
    return Actions(line, gate)


def _check(actions, **form):
    with ThreadPoolExecutor(1) as another:  # a browser of other tests has an event loop in this thread
        return json.loads(another.submit(asyncio.run, actions.list_actions()["check"]("line-1", form)).result().body)


def test_a_sensor_keeps_the_parts_and_the_batch_of_its_latest_run(served, database):
    with open_store(f"sqlite:///{database}") as store:
        store_run(store, "S-1", _MEASURED, recipe="other", batch="41", parts=["sheet=LOT7/B"])
    actions = _actions(served, database)
    again = _check(actions, serial="S-1")
    assert again["parts"][0] == ["gate", "S-1: 41 sheet=LOT7/B"]
    assert again["fields"] == {"serial": "S-1", "batch": "41", "recalled": "41", "parts": "sheet=LOT7/B"}
    stated = _check(actions, serial="S-1", batch="42", parts="board=9")
    assert stated["parts"][0] == ["gate", "S-1: 42 board=9"]
    removed = _check(actions, serial="S-1", checked="S-1", batch="", parts="")  # somebody emptied the fields
    assert removed["parts"][0] == ["gate", "S-1:  "]
    other = _check(actions, serial="S-2", checked="S-1", parts="board=9", batch="41", recalled="41")
    assert other["parts"][0] == ["gate", "S-2:  "]
    with_batch = _check(actions, serial="S-2", checked="S-1", batch="41")  # a person stated it
    assert with_batch["parts"][0] == ["gate", "S-2: 41 "]


@pytest.mark.parametrize(
    ("name", "found"), [("S-1", True), ("S-77", True), ("ADA", True), ("Ada", False), ("Kim 2", False)]
)
def test_a_serial_number_is_stored_or_fits_the_pattern_and_has_digits(served, database, monkeypatch, name, found):
    monkeypatch.setattr(gate, "restore", lambda _: SimpleNamespace(serial_pattern="[A-Za-z]+|S-[0-9]+"))
    with open_store(f"sqlite:///{database}") as store:
        run = store_run(store, "S-1", _MEASURED)
        store_run(store, "ADA", _MEASURED)
    assert is_serial(database, name, run) is found


def test_a_sensor_that_another_station_tests_is_refused(served, database):
    refused = _check(_actions(served, database, elsewhere="S-1"), serial="S-1")
    assert refused == {
        "words": "Sensor S-1 is being tested at line-2 now.",
        "parts": [["gate", ""], ["refused", ""], ["state", "S-1 cannot start"], ["verdict", ""]],
        "refused": True,
    }
    assert _check(_actions(served, database, elsewhere="S-1"), serial="S-2")["parts"][0] == ["gate", "S-2:  "]


@pytest.mark.parametrize(
    ("field", "value", "words"), [("parts", "she", "has no ="), ("batch", "b 1", "' '"), ("operator", "Lee;", "';'")]
)
@pytest.mark.parametrize("checked", ["", "S-1"])
def test_a_field_that_is_wrong_says_so_beside_the_sensor_that_was_scanned(
    served, database, field, value, words, checked
):
    answer = _check(_actions(served, database), serial="S-1", checked=checked, **{field: value})
    assert words in answer.pop("wrong")[field]
    shown = {"gate": f"S-1: {field} is wrong", "refused": "", "state": "S-1 cannot start", "verdict": ""}
    assert {key: value for key, value in answer.items() if key != "parts"} == {}
    assert dict(answer["parts"]) == shown


def test_a_part_that_cannot_be_used_leaves_the_sensor_as_it_was(served, database):
    answer = _check(_actions(served, database), serial="sheet=LOT8", checked="S-1", parts="sheet=LOT7")
    assert "given twice" in answer["words"]
    assert ("parts" in answer, answer["fields"]) == (False, {"serial": "S-1"})


@pytest.mark.parametrize(
    ("form", "operator"), [({"by": "Lee"}, "Lee"), ({"by": ""}, "Kim"), ({"operator": "Ada", "by": "Lee"}, "Ada")]
)
def test_a_run_is_resumed_by_who_works_at_the_station_now(served, database, monkeypatch, form, operator):
    actions = _actions(served, database)
    actions._line.stations["line-1"].look = SimpleNamespace(run="a-run", operator="Kim", serial="S-1")
    begun = []

    async def begin(station, arguments, *_):
        begun.extend(arguments)

    monkeypatch.setattr(actions, "_begin", begin)
    with ThreadPoolExecutor(1) as another:
        another.submit(asyncio.run, actions.resume("line-1", {"run": "a-run", **form})).result()
    assert f"--operator={operator}" in begun


def test_the_past_of_a_sensor_is_found_by_an_index_among_however_many_runs(database):
    statements = []
    with open_store(f"sqlite:///{database}") as store:
        store_run(store, "S-1", _MEASURED, recipe="nine-locations")
        engine = store.lists._engine

        @sa.event.listens_for(engine, "before_cursor_execute")
        def note(connection, cursor, statement, parameters, context, executemany):
            if "FROM runs" in statement and "serial = ?" in statement:
                statements.append((statement, parameters))

        assert store.live.find_latest_of_sensor("S-1", "nine-locations") is not None
        assert store.live.find_latest_of_sensor("S-1") is not None
        assert store.lists.count_runs(RunSelection(serials=("S-1",))) == 1
    assert statements
    with closing(sqlite3.connect(database)) as opened:
        for statement, parameters in statements:
            steps = [row[3] for row in opened.execute(f"EXPLAIN QUERY PLAN {statement}", parameters)]
            assert any("SEARCH runs USING" in step and "ix_runs_serial_run" in step for step in steps), steps
