"""Views of what holds: overridden verdicts, latest analyses, valid calibrations; they are read through indices."""

import sqlite3

import pytest
import sqlalchemy as sa
from exported_runs import five_runs, measured
from stored_runs import calibration, journalled, short_run

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Verdict, decide
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.store.engine import open_engine, parse_url, reading
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.views import VIEWS


@pytest.fixture
def analysed_twice(database_url):
    """A run that failed, was analysed again, overridden, and issued two calibrations; yields its name and a query."""
    with open_store(database_url) as store:
        run = store.new_id()
        journalled(store, short_run(run))
        for error_mm in (9.0, 5.0):
            values = measured(error_mm, 0.1)
            record = store.runs.load(run)
            issued = calibration(store.new_id(), run)
            store.analyses.save(RunResult(record, None, values, decide(values), issued, ""))
        store.changes.override_verdict(run, Outcome.FAIL, operator="Ada", why="scratched")
        latest = store.analyses.load(run)[0]
        expected = (run, latest.analysis, latest.calibration)
    engine = open_engine(parse_url(database_url))

    def rows(query):
        with reading(engine) as connection:
            return [dict(row._mapping) for row in connection.execute(sa.text(query))]

    yield expected, rows
    engine.dispose()


def test_one_row_of_each_view_is_what_holds(analysed_twice):
    (run, analysis, issued), rows = analysed_twice
    (row,) = rows("SELECT * FROM v_runs")
    assert (row["run"], row["analysis"], row["state"]) == (run, analysis, "finished")
    assert (row["verdict"], row["outcome"], row["overridden_by"], row["overridden_why"]) == (
        *("fail", "pass", "Ada", "scratched"),
    )
    assert (bool(row["simulated"]), bool(row["of_check"]), row["station_s"]) == (True, False, 201.0)
    values = rows("SELECT * FROM v_measurements ORDER BY number")
    assert [(value["name"], value["value"], value["analysis"]) for value in values] == [
        ("centre_of_mass_error", 5.0, analysis),
        ("drift", 0.1, analysis),
        ("zero_return", None, analysis),
    ]
    (held,) = rows("SELECT * FROM v_calibrations")
    assert (held["serial"], held["calibration"], held["verdict"]) == ("S-1", issued, "fail")


@pytest.mark.parametrize("of_run", ["its own run", "a run of another sensor", "no run"])
def test_a_calibration_that_no_link_names_is_not_the_valid_one(tmp_path, of_run):
    """Its identifier is of the future, so that it would be the latest."""
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as store:
        run, other = store.new_id(), store.new_id()
        for name, serial in ((run, "S-1"), (other, "S-2")):
            journalled(store, short_run(name, serial))
        issued = calibration(store.new_id(), run)
        values = measured(5.0, 0.1)
        store.analyses.save(RunResult(store.runs.load(run), None, values, decide(values), issued, ""))
    owner = {"its own run": run, "a run of another sensor": other}.get(of_run, "none")
    with sqlite3.connect(tmp_path / "runs.db") as database:
        columns = [row[1] for row in database.execute("PRAGMA table_info(calibrations)")]
        others = ", ".join(f'"{name}"' for name in columns if name not in ("calibration", "run"))
        database.execute(
            f"INSERT INTO calibrations (calibration, run, {others})"
            f" SELECT 'ffffffff-0000-7000-8000-000000000000', ?, {others} FROM calibrations",
            [owner],
        )
        held = database.execute("SELECT serial, calibration, run FROM v_calibrations").fetchall()
    assert held == [("S-1", issued.calibration, run)]


def test_an_override_of_an_earlier_analysis_does_not_hold(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as store:
        run = store.new_id()
        journalled(store, short_run(run))

        def analysed(outcome):
            store.analyses.save(RunResult(store.runs.load(run), None, (), Verdict(outcome, "why"), None, ""))

        analysed(Outcome.PASS)
        store.changes.override_verdict(run, Outcome.FAIL, operator="Ada", why="scratched")
        analysed(Outcome.PASS)
        (listed,) = store.lists.read_runs()
    with sqlite3.connect(tmp_path / "runs.db") as database:
        row = database.execute("SELECT verdict, overridden_by FROM v_runs").fetchone()
    assert row == (str(listed.verdict), None) == ("pass", None)


def test_the_view_says_what_the_program_lists():
    url, _ = five_runs()
    with open_store(url) as store:
        listed = [
            (run.run, str(run.end), run.verdict and str(run.verdict), run.reason) for run in store.lists.read_runs()
        ]
    with sqlite3.connect(url.removeprefix("sqlite:///")) as database:
        found = database.execute(
            "SELECT run, state, verdict, COALESCE(reason, '') FROM v_runs ORDER BY run"
        ).fetchall()
    assert found == listed
    assert len(found) == 5


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("column", ["run", "serial"])
def test_a_row_is_found_through_indices(view, column):
    """Among 100 000 runs a scan takes a second. Runs that checked a station are few, and listed once."""
    with sqlite3.connect(five_runs()[0].removeprefix("sqlite:///")) as database:
        plan = database.execute(f"EXPLAIN QUERY PLAN SELECT * FROM {view} WHERE {column} = 'x'").fetchall()
    scanned = [step for *_, step in plan if step.startswith("SCAN")]
    assert scanned in ([], ["SCAN c"])
    assert sum("SEARCH" in step and "INDEX" in step for *_, step in plan) >= 3
