"""What a comparison reads from a database, and what ``cbsr-qa compare`` refuses before it does."""

import sqlite3
from datetime import UTC, date, datetime

import numpy as np
import pytest
from stored_lots import judged, measured, store_run
from tiers import REST, rest_after

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.run.station import StationCheck
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.compare.terms import read_amounts, read_groups


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A database of four runs, and their names."""
    file = tmp_path_factory.mktemp("fleet") / "fleet.db"
    random = np.random.default_rng(1)
    with open_store(f"sqlite:///{file}", durable=False) as store:
        values = [judged(measured(random, random.standard_normal(3))) for _ in range(4)]
        runs = [store_run(store, f"S-{n}", some, batch=("41", "42")[n % 2]) for n, some in enumerate(values)]
    return file, runs


@pytest.fixture
def copied(stored, tmp_path):
    """A copy of it, to change: its path, its URL and the names of its runs."""
    file, runs = stored
    with sqlite3.connect(file) as source, sqlite3.connect(tmp_path / "fleet.db") as target:
        source.backup(target)
    return tmp_path / "fleet.db", f"sqlite:///{tmp_path / 'fleet.db'}", runs


def changed(path, statement, *values):
    connection = sqlite3.connect(path)
    with connection:
        connection.execute(statement, values)
    connection.close()


def test_runs_of_golden_sensors_that_checked_a_station_are_left_out_and_said(copied, capsys):
    _, url, runs = copied
    with open_store(url) as store:
        station, now = store.runs.read_identity(runs[1]).station, datetime.now(UTC)
        about = (store.new_id(), station, "", now, "disc-100mm", "0" * 64, (), (), ())
        store.stations.save_check(StationCheck(*about, golden_run=runs[1]))
        assert [run.of_check for run in store.fleet.load_table().runs] == [False, True, False, False]
    run_guarded(["compare", "--by", "batch", "--database", url])
    assert "Left out: 1 run of golden sensors that checked a station" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("table", "column", "word", "said"),
    [
        ("measurements", "outcome", "", "has measurements.outcome ''; allowed: pass, "),
        ("measurements", "name", "a\x1fb", " with the control character U+001F in it"),
    ],
)
def test_words_that_are_none_are_a_damaged_database(copied, table, column, word, said):
    path, url, _ = copied
    changed(path, f"UPDATE {table} SET {column} = '{word}' WHERE rowid = (SELECT max(rowid) FROM {table})")
    with open_store(url) as store, pytest.raises(StoreError, match="the database is damaged: analysis ") as raised:
        store.fleet.load_table()
    assert said in raised.value.reason
    assert run_guarded(["compare", "--by", "batch", "--database", url]) == 2


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("runs.started_at", "odd"),
        ("runs.serial", b"\x00\xff"),
        ("analyses.software", 7),
        ("measurements.value", "odd"),
        pytest.param("runs.started_at", b"\x00\xff", marks=REST),
        pytest.param("runs.started_at", 7, marks=REST),
        pytest.param("runs.recipe", b"\x00\xff", marks=REST),
        pytest.param("runs.simulated", "odd", marks=REST),
        pytest.param("measurements.unit", b"\x00\xff", marks=REST),
    ],
)
@pytest.mark.parametrize("chained", rest_after(1, [True, False]))
def test_a_cell_of_another_type_is_refused_with_its_run(copied, cell, value, chained, capsys):
    path, url, runs = copied
    table, _, column = cell.partition(".")
    of_run = "analysis IN (SELECT analysis FROM analyses WHERE run = ?)" if table == "measurements" else "run = ?"
    changed(path, f"UPDATE {table} SET {column} = ? WHERE {of_run}", value, runs[2])
    if not chained:  # as runs from before chains
        changed(path, "DELETE FROM run_links")
        changed(path, "UPDATE runs SET chain = NULL")
    for command in (["compare", "--by", "batch"], ["gauge", "--recipe", "short"]):
        assert run_guarded([*command, "--database", url]) == 2
        named = f"{cell} ("
        if (cell, value) == ("analyses.software", 7):  # 7 is JSON, so only a digest or what reads it tells
            named = "analyses (analysis " if chained else "analyses.software (analysis "
        assert f"run {runs[2]}: {named}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("column", "selection"),
    [
        ("recipe", RunSelection(recipe="short")),
        ("batch", RunSelection(batch="41")),
        ("station", RunSelection(stations=("bench",))),
        ("operator", RunSelection(operators=("me",))),
    ],
)
def test_a_run_that_a_damaged_name_keeps_out_of_a_selection_is_marked_or_refused(copied, column, selection):
    path, url, runs = copied
    changed(path, f"UPDATE runs SET {column} = 'shorz' WHERE run = ?", runs[2])
    with open_store(url) as store:
        marked = {line.run: line.altered for line in store.fleet.read_lines(selection) if line.altered}
        assert list(marked) == [runs[2]]
        assert f"run {runs[2]}: runs was changed" in marked[runs[2]]
        with pytest.raises(StoreError, match=f"run {runs[2]}: runs was changed"):
            store.fleet.load_table(selection)


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        (["--by", "batch", "--period", "day"], "--period 'day' has no meaning for --by batch"),
        (["--by", "batch", "--groups", ","], "--groups ',' has an empty name"),
        (["--by", "batch", "--groups", ""], "--groups '' has an empty name"),
        (["--by", "batch", "--groups", "41,42,41"], "--groups names '41' twice"),
        (["--by", "batch", "--margin", "drift=1", "--margin", "drift=2"], "--margin states 'drift' twice"),
        (["--by", "batch", "--detect", "drift=1", "--detect", "drift=2"], "--detect states 'drift' twice"),
        (["--by", "batch", "--database", ""], "--database is empty"),
        (["--by", "bach", "--period", "day"], "--by 'bach' is not known"),
        (["--by", "period", "--period", "dya"], "--period 'dya' is not known"),
    ],
)
def test_options_that_would_be_ignored_are_refused(copied, said, reason, capsys):
    database = [] if "--database" in said else ["--database", copied[1]]
    assert run_guarded(["compare", *said, *database]) == 2
    assert reason in capsys.readouterr().err


def test_groups_and_amounts_are_read():
    assert read_groups(None) == ()
    assert read_groups("42, 41") == ("42", "41")
    assert read_amounts(["a=1", "b=2"], "--margin") == {"a": 1.0, "b": 2.0}


def test_the_last_day_there_is_leaves_no_run_out(copied, capsys):
    with open_store(copied[1]) as store:
        assert (
            len(store.fleet.load_table(RunSelection(until=date.max)).runs)
            == len(store.fleet.load_table(RunSelection(until=date(2026, 11, 21))).runs)
            == 4
        )
