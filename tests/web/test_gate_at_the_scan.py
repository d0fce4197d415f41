"""What a scan says first: what this sensor did before, at which station, and whether another test needs consent."""

import sqlite3
from contextlib import closing

import pytest
import sqlalchemy as sa
from stored_lots import store_run

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.web.gate import gate_view
from cbsr_qa.web.outcomes import earlier_words
from cbsr_qa.web.start import StartForm
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
    assert earlier_words(view.earlier) == f"{words} at line-8, just now."


def test_a_run_without_a_result_is_named_and_needs_no_consent(served, database):
    recipe = served.recipes[0].name
    with open_store(f"sqlite:///{database}") as store:
        store_run(store, "S-1", _MEASURED, recipe=recipe, station="line-7", end=EndReason.ABORTED)
    view = _view(served, database)
    assert (view.asks_again, earlier_words(view.earlier)[:18]) == ("", "Stopped at line-7,")


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
        assert store.lists.count_runs(RunSelection(serials=("S-1",))) == 1
    assert statements
    with closing(sqlite3.connect(database)) as opened:
        for statement, parameters in statements:
            steps = [row[3] for row in opened.execute(f"EXPLAIN QUERY PLAN {statement}", parameters)]
            assert any("SEARCH runs USING" in step and "ix_runs_serial_run" in step for step in steps), steps
