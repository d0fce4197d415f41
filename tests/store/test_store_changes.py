"""What people changed is noted: files of a known name, verdicts; and nothing a verdict rests on is ever updated."""

import hashlib
import json
import re
import sqlite3
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy import event
from stored_runs import SETTING, calibration, identity, short_run
from tiers import rest_after

from cbsr_qa.app.changes import override_verdict
from cbsr_qa.app.run.render import render_stored
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.changes import NO_REASON, Difference, FileKind, differences
from cbsr_qa.domain.run.events import RunEnded, RunStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.engine import writing
from cbsr_qa.store.opening import open_store

#: What is still to be sent is no result.
OUTBOX = "INSERT INTO outbox "


@pytest.fixture
def repository(database_url):
    with open_store(database_url) as opened:
        yield opened


def recipe(upper=6.5, **more):
    """Tables of a recipe with a limit."""
    limit = {"measurement": "drift", "unit": "%/min", "upper": upper}
    return {"recipe": {"name": "short"}, "limits": [limit], **more}


def begun(repository, serial="S-1", why="", operator="Zoë", station="bench-α", end=EndReason.FINISHED, **tables):
    """Journal a run of a recipe; returns its name."""
    run = repository.new_id()
    configuration = json.dumps({"layout": 1, "recipe": recipe(), "station": {"name": station}, **tables})
    started = RunStarted(
        replace(
            identity(run, serial),
            operator=operator,
            station=station,
            configuration_digest=hashlib.sha256(configuration.encode()).hexdigest(),
        )
    )
    journal = repository.open_journal(configuration=configuration, why=why, **SETTING)
    for document in (started, *short_run(run, serial)[1:-1], RunEnded(end, "", 201.0, ())):
        journal(document)
    return run


def judged(repository, run, outcome=Outcome.PASS, issued=None):
    """Store a result of a run; returns the analysis."""
    drift = Measurement("drift", 0.2, "%/min").judge(Limit("drift", "%/min", None, 0.5))
    result = RunResult(repository.runs.load(run), None, (drift,), Verdict(outcome, "why"), issued, "not asked for")
    return repository.analyses.save(result)


def test_differences_are_named_by_what_tables_are_of_limits_first():
    before = recipe(phases=[{"name": "grid", "hold_s": 60.0}], analysis={"masks": [75.0, 85.0], "old": True})
    after = recipe(5.0, phases=[{"name": "grid", "hold_s": 20.0}], analysis={"masks": [85.0], "new": "Δ"})
    assert [one.words for one in differences(before, after)] == [
        "limits[drift].upper 6.5 → 5.0",
        "analysis.masks [75.0, 85.0] → [85.0]",
        'analysis.new = "Δ" added',
        "analysis.old = true removed",
        "phases[grid].hold_s 60.0 → 20.0",
    ]
    assert differences(before, before) == ()


def test_a_table_that_is_added_or_named_twice_is_told_apart():
    twice = recipe()["limits"] * 2
    assert [one.key for one in differences(recipe(), {**recipe(), "limits": twice})] == [
        "limits[drift, 2].measurement",
        "limits[drift, 2].unit",
        "limits[drift, 2].upper",
    ]


def test_the_first_run_of_a_name_changes_nothing_and_neither_does_another_seed(repository):
    begun(repository, seed=1)
    begun(repository, "S-2", seed=2)
    assert repository.changes.list_all() == ()


def test_a_limit_that_changed_is_noted_with_who_when_and_why(repository):
    first = begun(repository)
    second = begun(repository, "S-2", "the lot of May", recipe=recipe(5.0))
    third = begun(repository, "S-3", operator="Jo", recipe=recipe(5.0))
    (change,) = repository.changes.list_all()
    assert (change.run, change.earlier_run, change.kind, change.name) == (second, first, FileKind.RECIPE, "short")
    assert change.differences == (Difference("limits[drift].upper", "6.5", "5.0"),)
    assert (change.by, change.why) == ("Zoë", "the lot of May")
    assert change.at == identity(second).started_at
    assert change.old_digest != change.new_digest
    assert third not in (change.run, change.earlier_run)


def test_a_change_back_is_another_change_and_silence_is_noted(repository):
    begun(repository)
    begun(repository, recipe=recipe(5.0))
    begun(repository)
    there, back = repository.changes.list_all()
    assert (there.old_digest, there.new_digest) == (back.new_digest, back.old_digest)
    assert {there.why, back.why} == {NO_REASON}


@pytest.mark.rest
def test_scenes_belong_to_the_station_and_other_stations_do_not_matter(repository):
    begun(repository, scenes={"bench": {"seed": 1}})
    begun(repository, scenes={"bench": {"seed": 1}}, station="bench-β")
    begun(repository, scenes={"bench": {"seed": 2}})
    (change,) = repository.changes.list_all()
    assert (change.kind, change.name) == (FileKind.STATION, "bench-α")
    assert change.words() == "scenes.bench.seed 1 → 2"


def test_a_resumed_run_notes_its_changes_once(repository):
    begun(repository)
    run = begun(repository, recipe=recipe(5.0), end=EndReason.ABORTED)
    begun(repository, "S-2", recipe=recipe(4.0))
    configuration = repository.runs.read_configuration(run)
    journal = repository.open_journal(configuration=configuration, **SETTING)
    journal(RunStarted(repository.runs.read_identity(run)))
    assert len(repository.changes.list_all()) == 2


@pytest.mark.rest
def test_a_history_begins_after_the_last_run_that_passed(repository):
    begun(repository, recipe=recipe(8.0))
    accepted = begun(repository, recipe=recipe(7.0))
    judged(repository, accepted)
    judged(repository, begun(repository, recipe=recipe(6.0)), Outcome.FAIL)
    failed = begun(repository, recipe=recipe(5.0))
    judged(repository, failed)
    judged(repository, failed, Outcome.FAIL)  # its latest analysis holds
    last = begun(repository, recipe=recipe(4.0))
    begun(repository, recipe=recipe(3.0))
    history = repository.changes.read_history(repository.runs.load(last))
    assert history.accepted_run == accepted
    assert [one.differences[0].after for one in history.changes] == ["6.0", "5.0", "4.0"]
    assert [one.run for one in history.changes_in(last)] == [last]


def test_an_override_stands_beside_the_verdict_and_can_be_overridden(repository):
    run = begun(repository)
    analysis = judged(repository, run, Outcome.FAIL)
    before = repository.analyses.load(run)
    first = repository.changes.override_verdict(run, Outcome.PASS, operator="Zoë", why="the limit is a typing error")
    second = repository.changes.override_verdict(run, Outcome.FAIL, operator="Jo", why="it is not")
    assert repository.changes.list_overrides(run) == repository.changes.list_overrides() == (first, second)
    assert (first.analysis, first.verdict, first.outcome) == (analysis, Outcome.FAIL, Outcome.PASS)
    assert repository.analyses.load(run) == before
    assert repository.calibrations.list_issued("S-1") == ()
    assert repository.new_id() > second.override


def test_what_has_no_verdict_cannot_be_overridden(repository):
    stopped = begun(repository, end=EndReason.ABORTED)
    unjudged = begun(repository, "S-2")
    for run, said in (("none", "no run none"), (stopped, "has not finished"), (unjudged, "no result yet")):
        with pytest.raises(StoreError, match=said):
            repository.changes.override_verdict(run, Outcome.PASS, operator="Zoë", why="so")
    assert repository.changes.list_overrides() == ()


@pytest.mark.parametrize("cell", rest_after(1, ["runs.configuration", "runs.started_at", "runs.serial"]))
def test_a_cell_of_another_type_met_while_writing_is_named(tmp_path, cell):
    table, column = cell.split(".")
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as repository:
        run = begun(repository)
        judged(repository, run)
        with sqlite3.connect(tmp_path / "runs.db") as database:
            database.execute(f"update {table} set {column} = x'ff00'")
        with pytest.raises(StoreError, match=cell):
            repository.changes.override_verdict(run, Outcome.FAIL, operator="Zoë", why="so")


@contextmanager
def only_added():
    """Fail on any statement that changes or removes a row."""
    seen = []

    def look(connection, cursor, statement, parameters, context, executemany):
        words = " ".join(statement.split())
        changes = re.match(r"(?i)(UPDATE|DELETE|REPLACE|MERGE|TRUNCATE)\b|INSERT .*ON CONFLICT", words)
        if changes and not words.startswith(OUTBOX):
            seen.append(words)

    event.listen(sa.Engine, "before_cursor_execute", look)
    try:
        yield
    finally:
        event.remove(sa.Engine, "before_cursor_execute", look)
    assert seen == []


@pytest.mark.rest
def test_nothing_a_verdict_rests_on_is_changed_or_removed(repository):
    with only_added():
        run = begun(repository)
        judged(repository, run, issued=calibration(repository.new_id(), run))
        judged(repository, run, Outcome.FAIL, calibration(repository.new_id(), run))
        repository.changes.override_verdict(run, Outcome.PASS, operator="Zoë", why="so")
        repository.changes.override_verdict(run, Outcome.FAIL, operator="Zoë", why="no")
        begun(repository, recipe=recipe(5.0), end=EndReason.ABORTED)


@pytest.mark.rest
def test_a_whole_run_with_its_report_and_override_only_adds(database_url, tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    recipe_file = str(Path(__file__).parents[1] / "faults" / "two-frames.toml")
    open_store(database_url).close()  # migrations have their own tests
    with only_added():
        for serial in ("S-1", "S-2"):
            request = RunRequest(station="simulated", recipe=recipe_file, serial=serial, database=database_url)
            outcome = run_sensor(request)
        override_verdict(outcome.run, "fail", by="Zoë", why="so", database=database_url)
        render_stored(outcome.run, database=database_url)
    assert outcome.result.record.end is EndReason.FINISHED


@pytest.mark.parametrize("statement", ["UPDATE analyses SET outcome = 'pass'", "DELETE FROM warnings"])
def test_a_statement_that_changes_a_row_is_found(repository, statement):
    begun(repository)
    with pytest.raises(AssertionError, match=statement[:6]), only_added(), writing(repository._engine) as connection:
        connection.exec_driver_sql(statement)
