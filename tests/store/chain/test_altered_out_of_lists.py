"""A run that was moved out of a selection or made unreadable by hand is listed as altered, and hides no other."""

import json
import shutil
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest
from altered_runs import change
from stored_lots import judged, measured, store_run
from tiers import REST, rest_but_named

from cbsr_qa.app.shift.lists import list_request, list_runs, list_sensors
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, StationCheck
from cbsr_qa.store.chain.links import VARIABLE
from cbsr_qa.store.opening import open_store


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs of S-1 that passed and then failed, of S-2 that passed, and of S-3, golden, that failed."""
    file = tmp_path_factory.mktemp("moved") / "runs.db"
    random = np.random.default_rng(3)
    good = judged(measured(random, np.zeros(3)))
    bad = judged(measured(random, np.array([60.0, 0.0, 0.0])))
    with open_store(f"sqlite:///{file}", durable=False) as store:
        names = [
            store_run(store, serial, values)
            for serial, values in (("S-1", good), ("S-1", bad), ("S-2", good), ("S-3", bad))
        ]
        store.stations.save_check(golden_check(store, names[3]))
        assert [run.verdict for run in store.lists.read_runs()][1] is Outcome.FAIL
    return file, names


def golden_check(store, run):
    (listed,) = store.lists.read_runs(RunSelection(up_to=run, latest=1))
    return StationCheck(
        check=store.new_id(),
        station=listed.station,
        operator="Ada",
        checked_at=listed.started_at + timedelta(hours=1),
        sensor_type="disc-100mm",
        configuration_digest="",
        software=(),
        instruments=(),
        results=(CheckResult("its own mean", CheckOutcome.OK, subject="golden sensor S-3"),),
        golden_run=run,
    )


@pytest.fixture
def moved(made, tmp_path):
    file, names = made
    shutil.copy(file, tmp_path / "runs.db")
    return tmp_path / "runs.db", names


#: What a selection reads, what it is changed to, and options that then leave the run out.
MOVES = {
    "station": ("'line-9'", ["--station", "bench-α"]),
    "batch": ("'another'", ["--batch", "golden"]),
    "operator": ("'nobody'", ["--operator", "Zoë"]),
    "recipe": ("'another'", ["--recipe", "short"]),
    "started_at": ("'2001-01-01 00:00:00.000000'", ["--since", "2002-01-01"]),
    "run, by an invalid day": ("'yesterday'", ["--until", "2099-01-01"]),
}


@pytest.mark.parametrize(
    ("column", "value", "options"),
    rest_but_named({name: (name, *which) for name, which in MOVES.items()}, "station", "run, by an invalid day"),
)
def test_a_failed_run_that_was_moved_out_of_a_selection_is_listed_as_altered(
    moved, capsys, tmp_path, column, value, options
):
    path, names = moved
    column = column if value != "'yesterday'" else "started_at"
    change(path, f"update runs set {column} = {value} where run = ?", names[1])
    at = [*options, "--database", f"sqlite:///{path}"]
    for command in (["runs"], ["runs", "--failed"], ["sensors"]):
        assert run_guarded([*command, *at, "--json"]) == 1, command
        shown = json.loads(capsys.readouterr().out)
        entries = shown.get("runs") or shown.get("sensors")
        assert names[1] in [one["run"] for one in entries if one["verdict"] == "altered"], command
    assert run_guarded(["export", *at, "--to", str(tmp_path / "runs.csv")]) == 1
    assert run_guarded(["export", *at, "--to", str(tmp_path / "runs.xml")]) == 2
    assert not (tmp_path / "runs.xml").exists()
    assert names[1] in capsys.readouterr().err
    with open_store(f"sqlite:///{path}") as store, pytest.raises(StoreError, match=names[1]):
        store.fleet.load_table(RunSelection(stations=("bench-α",), recipe="short", batch="golden", serials=("S-1",)))


def test_a_selection_of_the_latest_runs_looks_no_further_back_than_the_oldest_of_them(moved):
    path, names = moved
    change(path, "update runs set station = 'line-9' where run = ?", names[1])
    with open_store(f"sqlite:///{path}") as store:
        for latest, altered in ((1, []), (2, []), (3, [names[1]])):
            listed = store.lists.read_runs(RunSelection(stations=("bench-α",), latest=latest))
            assert [run.run for run in listed if run.altered] == altered


def test_a_failed_run_that_was_given_another_serial_number_is_listed_with_the_runs_of_its_sensor(moved):
    path, names = moved
    change(path, "update runs set serial = 'S-2' where run = ?", names[1])
    with open_store(f"sqlite:///{path}") as store:
        listed = store.lists.read_runs(RunSelection(serials=("S-1",)))
        found = store.runs.find("S-1")
    assert [(run.run, bool(run.altered)) for run in listed] == [(names[0], False), (names[1], True)]
    assert [(run.run, bool(run.altered)) for run in reversed(found)] == [(names[0], False), (names[1], True)]


def test_a_serial_number_is_not_resolved_past_an_altered_run(moved):
    path, names = moved
    change(path, "update runs set serial = 'S-2' where run = ?", names[1])
    with open_store(f"sqlite:///{path}") as store:
        with pytest.raises(StoreError, match=rf"{names[1]}.* it may be a later run of sensor S-1"):
            store.runs.resolve("S-1")
        assert store.runs.resolve(names[0]) == names[0]
        assert store.runs.resolve("S-3") == names[3]
        assert list(store.sensors.find_altered_elsewhere("S-1")) == [names[1]]
    change(path, "update runs set serial = 'S-1' where run = ?", names[1])
    with open_store(f"sqlite:///{path}") as store:
        assert (store.runs.resolve("S-1"), store.sensors.find_altered_elsewhere("S-1")) == (names[1], {})


def test_an_altered_run_has_a_row_of_its_own_among_sensors(moved):
    path, names = moved
    change(path, "update runs set serial = 'S-2' where run = ?", names[1])
    with open_store(f"sqlite:///{path}") as store:
        rows = [(one.serial, one.run, one.verdict) for one in list_sensors(store, list_request()).sensors]
    assert rows == [("S-1", names[0], "pass"), ("S-2", names[1], "altered"), ("S-2", names[2], "pass")]


DEEP = "[" * 5000 + "]" * 5000
UNREADABLE = {
    "a word": "update analyses set outcome = 'odd' where run = ?",
    "an end": "update run_states set end = 'odd' where number = 1 and run = ?",
    "an override's word": "insert into verdict_overrides select 'zz', run, analysis, 'odd', 'a', 'b', analysed_at"
    " from analyses where run = ?",
    "text in a number": "update run_states set time_s = 'late' where run = ?",
    "bytes in a text": "update runs set batch = x'ff00' where run = ?",
    "a moment": "update runs set started_at = 'yesterday' where run = ?",
    "deep JSON of an analysis": f"update analyses set software = '{DEEP}' where run = ?",
    "deep JSON of a run": f"update runs set setting = '{DEEP}' where run = ?",
    "JSON of another shape": "update analyses set software = '{\"a\": 1}' where run = ?",
    "an invalid setting": "update runs set setting = '[1]' where run = ?",
    "what was simulated": "update runs set simulated = '3' where run = ?",
    "broken JSON": "update analyses set software = '[' where run = ?",
    "a number of a measurement": "update measurements set value = 'far' where analysis ="
    " (select analysis from analyses where run = ?)",
    "a word of a measurement": "update measurements set outcome = 'odd' where analysis ="
    " (select analysis from analyses where run = ?)",
}


#: One of each kind of cell: of another type, too deep to read, of a measurement.
FIRST = {"text in a number": True, "deep JSON of a run": False, "a word of a measurement": True}
ODD = [
    pytest.param(statement, chained, id=f"{name}-{way}", marks=() if FIRST.get(name) is chained else REST)
    for name, statement in UNREADABLE.items()
    for way, chained in {"chained": True, "unchained": False}.items()
]


@pytest.mark.parametrize(("statement", "chained"), ODD)
def test_one_odd_cell_marks_its_run_and_hides_no_other(moved, tmp_path, capsys, statement, chained):
    path, names = moved
    run = names[1]
    if not chained:
        change(path, "delete from run_links")
        change(path, "update runs set chain = null, before_run = null, before_sha256 = null, before_link = null")
    change(path, statement, run)
    at = ["--database", f"sqlite:///{path}"]
    measuring = "measurement" in statement
    with open_store(f"sqlite:///{path}") as store:
        listed = list_runs(store, list_request()).runs
        assert [one.run for one in listed] == names[:3]
        marked = {one.run: one.reason for one in listed if one.verdict == "altered"}
        if not measuring or chained:
            assert list(marked) == [run]
            assert run in marked[run]
        if not measuring:
            assert [one.run for one in store.runs.find() if one.altered] == [run]
            assert [one.run for one in store.fleet.read_lines() if one.altered] == [run]
        assert list(store.lists.read_measurements(names).altered) == [run]
        with pytest.raises(StoreError):
            store.lists.read_limited_measurements([run])
    expected = 1 if marked else 0
    assert run_guarded(["runs", *at]) == expected
    assert run_guarded(["sensors", *at]) == expected
    assert run_guarded(["export", *at, "--to", str(tmp_path / "runs.csv")]) == expected
    assert run_guarded(["export", *at, "--table", "measurements", "--to", str(tmp_path / "values.csv")]) == 1
    assert run_guarded(["db", "check", *at]) == 1
    assert run in capsys.readouterr().out
    assert run_guarded(["report", run, *at]) == 2
    assert run_guarded(["export", run, *at, "--to", str(tmp_path / "runs.nc")]) == 2


def test_a_run_whose_whole_chain_was_removed_is_altered_if_another_one_followed_it(moved, capsys):
    path, names = moved
    for run in (names[1], names[3]):
        change(path, "delete from run_links where run = ?", run)
        change(path, "update runs set chain = null where run = ?", run)
    change(path, "update analyses set outcome = 'pass' where run = ?", names[1])
    with open_store(f"sqlite:///{path}") as store:
        listed = {one.run: one for one in list_runs(store, list_request(checks=True)).runs}
    assert "begun after it, names a link of it" in listed[names[1]].reason
    assert [listed[run].verdict for run in names] == ["pass", "altered", "pass", "fail"]
    assert listed[names[3]].chain == "unchained"
    assert run_guarded(["runs", "--checks", "--database", f"sqlite:///{path}"]) == 1
    assert "fail, unchained" in capsys.readouterr().out


HIDING = {
    "without a seal": ("update station_checks set golden_run = ?, seal = null", "has no seal"),
    "with the seal of another": ("update station_checks set golden_run = ?", "was altered"),
}


@pytest.mark.parametrize(("statement", "words"), HIDING.values(), ids=HIDING)
def test_a_check_that_does_not_fit_hides_no_failed_run(moved, capsys, statement, words):
    path, names = moved
    with open_store(f"sqlite:///{path}") as store:
        assert [one.run for one in list_runs(store, list_request()).runs] == names[:3]
    change(path, statement, names[1])
    with open_store(f"sqlite:///{path}") as store:
        listed = {one.run: one for one in list_runs(store, list_request()).runs}
        assert (listed[names[1]].verdict, listed[names[1]].of_check) == (Outcome.FAIL, False)
        assert names[1] in [one.run for one in store.fleet.read_lines(RunSelection(checks=False))]
    assert run_guarded(["db", "check", "--database", f"sqlite:///{path}"]) == 1
    assert words in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"station": "elsewhere"}, "it is of station 'elsewhere', the run of 'bench-α'"),
        ({"check": "01000000-0000-7000-8000-000000000000"}, "was made at 2004-11-03"),
        ({"check": "02000000-0000-7000-8000-000000000000"}, "was made at 2039-09-07"),
    ],
    ids=["station", "earlier", "later"],
)
def test_a_sealed_check_of_another_station_or_time_hides_no_failed_run(moved, capsys, changes, words):
    path, names = moved
    with open_store(f"sqlite:///{path}") as store:
        store.stations.save_check(replace(golden_check(store, names[1]), **changes))
        assert [one.run for one in list_runs(store, list_request()).runs] == names[:3]
    assert run_guarded(["db", "check", "--database", f"sqlite:///{path}"]) == 1
    assert words in " ".join(capsys.readouterr().out.split())


def test_a_check_without_the_key_hides_no_signed_run(tmp_path, monkeypatch):
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    values = judged(measured(np.random.default_rng(3), np.array([60.0, 0.0, 0.0])))
    monkeypatch.setenv(VARIABLE, "a key of twenty-two let")
    with open_store(url) as store:
        runs = [store_run(store, serial, values) for serial in ("S-1", "S-2")]
        store.stations.save_check(golden_check(store, runs[0]))
    monkeypatch.delenv(VARIABLE)
    with open_store(url) as store:
        store.stations.save_check(golden_check(store, runs[1]))
        assert [one.run for one in list_runs(store, list_request()).runs] == runs[1:]


@pytest.mark.parametrize("chained", [True, pytest.param(False, marks=REST)], ids=["chained", "unchained"])
@pytest.mark.parametrize("cell", ["outcome = 'odd'", pytest.param("why = x'ff'", marks=REST)])
def test_an_override_that_cannot_be_read_hides_no_other(moved, capsys, cell, chained):
    path, names = moved
    with open_store(f"sqlite:///{path}") as store:
        for run in names[:2]:
            store.changes.override_verdict(run, Outcome.PASS, operator="Ada", why="seen")
    if not chained:
        change(path, "delete from run_links")
        change(path, "update runs set chain = null")
    change(path, f"update verdict_overrides set {cell} where run = ?", names[1])
    assert run_guarded(["db", "changes", "--database", f"sqlite:///{path}", "--json"]) == 1
    shown = json.loads(capsys.readouterr().out)
    assert [one["run"] for one in shown["overrides"]] == names[:1]
    assert len(shown["altered"]) == 1
    assert names[1] in shown["altered"][0]


def test_an_altered_run_of_a_golden_sensor_is_counted_and_fails_the_list(moved, capsys):
    path, names = moved
    change(path, "update analyses set outcome = 'pass' where run = ?", names[3])
    assert run_guarded(["runs", "--checks", "--json", "--database", f"sqlite:///{path}"]) == 1
    listed = json.loads(capsys.readouterr().out)
    golden = {one["run"]: one for one in listed["runs"]}[names[3]]
    assert (golden["verdict"], golden["of_check"], listed["summary"]["total"]["altered"]) == ("altered", True, 1)
