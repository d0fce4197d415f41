"""What leaves the program: a run that was altered is marked in lists and tables, and refused by every other file."""

import csv
import io
import json
import shutil

import pytest
from altered_runs import change
from exported_runs import five_runs

from cbsr_qa.app.run.render import outcome_of_stored
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.interface.stored_run import Run
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.store.opening import open_store

FAILED, PASSED = "S-1", "S-0"


@pytest.fixture
def database(tmp_path):
    """A copy of five runs; yields its file, its address, and the runs by name."""
    url, names = five_runs()
    shutil.copy(url.removeprefix("sqlite:///"), tmp_path / "runs.db")
    return tmp_path / "runs.db", f"sqlite:///{tmp_path / 'runs.db'}", names


@pytest.fixture
def forged(database):
    """The failed run states pass in every row of its result."""
    path, _, names = database
    analysis = "select analysis from analyses where run = ?"
    change(
        path, f"update measurements set outcome = 'pass' where limited and analysis = ({analysis})", names["failed"]
    )
    change(path, "update analyses set outcome = 'pass' where run = ?", names["failed"])
    return database


def command(*words, database):
    return run_guarded([*map(str, words), "--database", database])


def csv_rows(file):
    return list(csv.DictReader(io.StringIO(file.read_text(encoding="utf-8"), newline="")))


def listed(capsys, *words, database):
    """The document that a list prints, and its exit code."""
    code = command(*words, "--json", database=database)
    return json.loads(capsys.readouterr().out), code


@pytest.mark.parametrize(
    ("file", "which"),
    [("o.xml", FAILED), ("o.xml", ""), ("o.nc", FAILED), ("o.mat", FAILED), ("o.h5", FAILED)],
    ids=["junit of one", "junit of all", "netcdf", "eidors", "recording"],
)
def test_a_file_that_states_a_verdict_is_refused_as_a_report_is(forged, tmp_path, capsys, file, which):
    _, url, names = forged
    assert command("export", *filter(None, [which]), "--to", tmp_path / file, database=url) == 2
    said = capsys.readouterr().err
    assert f"run {names['failed']}: " in said
    assert "was changed: it does not match its digest" in said
    assert not (tmp_path / file).exists()
    assert command("report", FAILED, "--to", tmp_path, database=url) == 2


def test_outcomes_of_an_unchained_run_must_follow_from_its_values(forged, tmp_path, capsys):
    path, url, _ = forged
    change(path, "delete from run_links")  # of all: a chained run would name a link of the one before it
    change(path, "update runs set chain = null")
    assert command("export", FAILED, "--to", tmp_path / "o.xml", database=url) == 2
    assert "states pass; its value 7.25 mm and limit" in capsys.readouterr().err
    change(path, "update measurements set outcome = 'fail' where value = 7.25")
    assert command("export", FAILED, "--to", tmp_path / "o.xml", database=url) == 2
    assert "the verdict states pass; its measurements say fail" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_table_marks_the_run_and_has_all_others(forged, tmp_path, suffix, capsys):
    _, url, names = forged
    target = tmp_path / f"runs.{suffix}"
    assert command("export", "--to", target, "--json", database=url) == 1
    assert json.loads(capsys.readouterr().out)["altered"] == [names["failed"]]
    if suffix == "parquet":
        rows = pytest.importorskip("pyarrow.parquet").read_table(target).to_pylist()
    else:
        rows = csv_rows(target)
    verdicts = {row["run"]: row["verdict"] or None for row in rows}
    assert verdicts == {
        names["passed"]: "marginal",
        names["failed"]: "altered",
        names["unmeasured"]: "not measured",
        names["overridden"]: "pass",
        names["aborted"]: None,
    }
    (marked,) = (row for row in rows if row["run"] == names["failed"])
    assert "was changed: it does not match its digest" in marked["reason"]
    assert not marked["outcome"]


def test_a_table_of_measurements_has_a_marked_row_in_place_of_them(forged, tmp_path):
    _, url, names = forged
    target = tmp_path / "m.csv"
    assert command("export", "--table", "measurements", "--to", target, database=url) == 1
    rows = csv_rows(target)
    (marked,) = (row for row in rows if row["run"] == names["failed"])
    assert (marked["serial"], marked["outcome"], marked["name"], marked["value"]) == (FAILED, "altered", "", "")
    assert "was changed" in marked["how"]
    assert sum(row["run"] == names["passed"] for row in rows) == 3


def test_a_measurement_alone_that_was_altered_marks_its_run(database, tmp_path):
    path, url, _ = database
    change(path, "update measurements set value = 5.0 where value = 5.5")
    assert command("export", "--table", "measurements", "--to", tmp_path / "m.csv", database=url) == 1
    assert command("export", PASSED, "--to", tmp_path / "o.xml", database=url) == 2


def test_lists_mark_the_run_do_not_count_it_and_say_so(forged, capsys):
    _, url, names = forged
    found, code = listed(capsys, "runs", database=url)
    assert code == 1
    marked = {run["run"]: run["verdict"] for run in found["runs"]}
    assert (marked[names["failed"]], marked[names["passed"]]) == ("altered", "marginal")
    total = found["summary"]["total"]
    assert (total["runs"], total["passed"], total["failed"], total["altered"]) == (5, 2, 0, 1)
    assert total["yield"]["count"] == 2
    assert any("1 run altered since stored" in note for note in found["notes"])
    sensors, code = listed(capsys, "sensors", database=url)
    assert code == 1
    assert {one["serial"]: one["verdict"] for one in sensors["sensors"]}[FAILED] == "altered"


def test_a_failed_run_does_not_leave_the_list_of_failures_by_being_altered(forged, capsys):
    _, url, names = forged
    found, code = listed(capsys, "runs", "--failed", database=url)
    assert ([run["run"] for run in found["runs"]], code) == ([names["failed"]], 1)
    found, code = listed(capsys, "sensors", "--limit", "drift", database=url)
    assert ([one["serial"] for one in found["sensors"]], code) == ([FAILED], 1)


@pytest.mark.parametrize("words", [("runs",), ("sensors",), ("runs", "--csv", "-")])
def test_an_override_that_nobody_made_shows_as_no_verdict(database, words, capsys):
    path, url, names = database
    change(
        path,
        "insert into verdict_overrides select 'zzz', run, analysis, 'pass', 'Mallory', 'so', analysed_at"
        " from analyses where run = ?",
        names["failed"],
    )
    assert command(*words, database=url) == 1
    shown, notes = capsys.readouterr()
    assert "Mallory" not in shown
    assert "altered" in shown
    assert "1 run altered since stored" in shown + notes


def test_runs_without_a_chain_are_named_as_such(database, capsys):
    path, url, names = database
    change(path, "delete from run_links")  # of all: a chained run would name a link of the one before it
    change(path, "update runs set chain = null")
    found, code = listed(capsys, "runs", database=url)
    assert code == 0
    assert {run["run"]: run["chain"] for run in found["runs"]} == dict.fromkeys(names.values(), "unchained")
    sensors, code = listed(capsys, "sensors", database=url)
    assert (code, {sensor["chain"] for sensor in sensors["sensors"]}) == (0, {"unchained"})
    assert any("5 runs without a chain" in note for note in found["notes"])


def test_a_notebook_is_refused_too(forged):
    _, url, names = forged
    with pytest.raises(StoreError, match="was changed"):
        Run(names["failed"], url).verdict  # noqa: B018 - reading is what is tried
    assert Run(names["passed"], url).verdict == "marginal"
    with open_store(url) as store, pytest.raises(StoreError, match="was changed"):
        outcome_of_stored(names["failed"], store, discover())


def test_changes_are_listed_without_an_override_that_nobody_made(database, capsys):
    path, url, names = database
    change(path, "update verdict_overrides set operator = 'Mallory'")
    found, code = listed(capsys, "db", "changes", database=url)
    assert (found["overrides"], code) == ([], 1)
    assert f"run {names['overridden']}: verdict_overrides" in found["altered"][0]
