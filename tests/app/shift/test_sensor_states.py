"""Sensors handed over and searched for: each counted once, found by any form of input, nothing hidden by a change."""

import shutil
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa
from altered_runs import change
from hypothesis import given, strategies as st
from stored_lots import LIMITS, store_run

from cbsr_qa.app.shift.sensors import MOST_FOUND, search_sensors, sort_for_handover
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.store.opening import open_store

WELL, DRIFTS = ((Measurement("drift", drift, "%/min").judge(LIMITS["drift"]),) for drift in (0.1, 3.0))
ENDS = {
    "passed": (EndReason.FINISHED, Outcome.PASS, ""),
    "failed": (EndReason.FINISHED, Outcome.FAIL, ""),
    "unmeasured": (EndReason.FINISHED, Outcome.NOT_MEASURED, ""),
    "stopped": (EndReason.ABORTED, None, ""),
    "running": (EndReason.RUNNING, None, ""),
    "cut off": (EndReason.RUNNING, None, ""),
    "altered": (EndReason.FINISHED, None, "run_parts was changed"),
}


def listed(number, serial, kind, recipe="short", *, of_check=False):
    end, outcome, altered = ENDS[kind]
    began = datetime(2026, 11, 30, 8, tzinfo=UTC)
    fixed = {"batch": "", "sensor_type": "disc", "station": "A", "operator": "", "reason": "", "decision": None}
    return ListedRun(
        f"{number:03d}", serial=serial, recipe=recipe, started_at=began, end=end, station_s=1.0, outcome=outcome,
        failed=(), earlier=0, of_check=of_check, simulated=True, altered=altered, **fixed,
    )  # fmt: skip


def hand_over(*rows):
    runs = [listed(number, *row) for number, row in enumerate(rows)]
    return sort_for_handover(runs, {run.run for run, row in zip(runs, rows, strict=True) if row[1] == "running"})


def serials(states):
    return [state.last.serial for state in states]


@given(
    st.lists(st.tuples(st.sampled_from("ABCDE"), st.sampled_from(sorted(ENDS)), st.sampled_from(["short", "long"])))
)
def test_every_sensor_is_counted_once_or_tested_for_the_first_time_and_the_sums_add_up(rows):
    shift, sensors = hand_over(*rows), {serial for serial, *_ in rows}
    failed, undecided, running = (set(serials(states)) for states in (shift.failed, shift.undecided, shift.running))
    assert failed & undecided == set()
    assert shift.tested == shift.passed + len(failed | undecided)
    decided = {serial for serial, kind, _ in rows if kind in ("passed", "failed", "altered")}
    assert len(decided) <= shift.tested <= len(sensors)
    assert len(sensors) - shift.tested == len(running - decided - undecided)
    assert running == {serial for serial, kind, _ in rows if kind == "running"} & running


def test_what_failed_is_hidden_neither_by_another_recipe_nor_by_a_test_in_progress():
    shift = hand_over(
        ("A", "failed"), ("A", "passed"),  # the last decided test counts
        ("B", "failed"), ("B", "stopped"),
        ("C", "failed"), ("C", "passed", "long"),
        ("D", "failed"), ("D", "running"),
        ("E", "passed"), ("E", "altered", "long"),
        ("F", "cut off"),
    )  # fmt: skip
    assert (shift.tested, shift.passed) == (6, 1)
    assert serials(shift.failed) == ["D", "C", "B"]
    assert serials(shift.undecided) == ["F", "E"]
    assert [(state.last.serial, state.failed) for state in shift.running] == [("D", True)]


def test_checks_of_a_station_are_no_sensors_of_the_shift():
    runs = [listed(0, "A", "passed"), listed(1, "GOLD", "failed", of_check=True)]
    assert sort_for_handover(runs, ()).tested == 1


def store_lots(url):
    """A and B are of sheet lot 7 in two revisions, LOT7 is a serial number too, C is of lot 8, D of a board LOT7."""
    parts = {
        "A": ["sheet=LOT7/B", "board=9"],
        "B": ["sheet=LOT7/C"],
        "C": ["sheet=LOT8"],
        "LOT7": [],
        "D": ["board=LOT7"],
    }
    with open_store(url, durable=False) as store:
        runs = {serial: store_run(store, serial, DRIFTS, parts=of_sensor) for serial, of_sensor in parts.items()}
        store_run(store, "A", WELL, recipe="long", parts=["sheet=LOT7/B"])
    return runs


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("lots") / "runs.db"
    return path, store_lots(f"sqlite:///{path}")


@pytest.fixture
def store(file):
    with open_store(f"sqlite:///{file[0]}") as opened:
        yield opened


def found_serials(found):
    return [states[0].last.serial for states in found.sensors]


@pytest.mark.parametrize(
    ("wanted", "found"),
    [
        ("A", ["A"]),
        ("sheet=LOT7/B", ["A"]),
        ("sheet=LOT7", ["A", "B"]),
        ("LOT7", ["A", "D", "LOT7", "B"]),
        ("LOT7/C", ["B"]),
        ("board=LOT7", ["D"]),
        ("9", ["A"]),
        ("sheet=%", []),
        ("sheet=LOT7' OR '1'='1", []),
        ("lot_7", []),
    ],
)
def test_sensors_are_found_by_each_form_of_input_the_one_tested_last_first(store, wanted, found):
    result = search_sensors(store, wanted)
    assert found_serials(result) == found
    assert (result.count, result.altered) == (len(found), 0)


def test_a_sensor_has_a_state_for_each_recipe_and_its_last_verdict(store):
    (states,) = search_sensors(store, "A").sensors
    assert [(state.shown.recipe, state.passed, state.failed) for state in states] == [
        ("long", True, False),
        ("short", False, True),
    ]


@pytest.mark.parametrize(
    ("wanted", "nearest"),
    [
        ("lot8", "LOT8"),
        ("sheet=LOT9", "sheet=LOT8"),
        ("b", "B"),
        ("sheet=LOT7/D", "sheet=LOT7/C"),
        ("LOT13", ""),
        ("quartz", ""),
    ],
)
def test_where_nothing_is_found_the_nearest_name_is_told(store, wanted, nearest):
    result = search_sensors(store, wanted)
    assert (result.count, result.nearest) == (0, nearest)


def test_sensors_are_found_by_batch_and_by_operator_the_one_tested_last_first(tmp_path, monkeypatch):
    with open_store(f"sqlite:///{tmp_path / 'people.db'}", durable=False) as store:
        for serial, batch, operator in (("S-1", "B-7", "Kim Lee"), ("S-2", "B-8", "Kim Lee"), ("S-3", "B-7", "Zoë")):
            store_run(store, serial, (), batch=batch, operator=operator, parts=["sheet=B-8"])
        found = {wanted: search_sensors(store, wanted) for wanted in ("B-7", "Kim Lee", "Zoë", "B-8", "sheet=B-7")}
        assert {wanted: found_serials(one) for wanted, one in found.items()} == {
            "B-7": ["S-3", "S-1"],
            "Kim Lee": ["S-2", "S-1"],
            "Zoë": ["S-3"],
            "B-8": ["S-3", "S-2", "S-1"],
            "sheet=B-7": [],
        }
        assert {wanted for wanted, one in found.items() if one.of_operator} == {"Kim Lee", "Zoë"}
        assert search_sensors(store, "kim").alike == ("Kim Lee",)
        assert search_sensors(store, "B-77").nearest == "B-7"
        monkeypatch.setattr("cbsr_qa.app.shift.sensors.OPERATOR_RUNS", 1)
        assert found_serials(search_sensors(store, "Kim Lee")) == []


def test_names_that_hold_a_text_are_listed_those_that_begin_with_it_first(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'alike.db'}", durable=False) as store:
        for serial in ("S-101", "S-102", "S-110", "X-S-10", "S-11"):
            store_run(store, serial, (), parts=["sheet=S-109"])
        found = search_sensors(store, "s-10")
        assert (found.count, found.alike) == (0, ("S-101", "S-102", "X-S-10", "sheet=S-109"))
        assert search_sensors(store, "Q").alike == ()
        assert search_sensors(store, "S-101").alike == ()


@pytest.mark.parametrize("wanted", ["sheet=", "=LOT7", "a b=LOT7", "x" * 65, "A\x00B", "/B", "\u202e"])
def test_what_can_be_no_name_is_refused(store, wanted):
    with pytest.raises(ConfigError):
        search_sensors(store, wanted)


@pytest.mark.rest
def test_another_database_finds_the_same(postgres_database):
    store_lots(postgres_database)
    with open_store(postgres_database) as store:
        assert found_serials(search_sensors(store, "LOT7")) == ["A", "D", "LOT7", "B"]
        assert found_serials(search_sensors(store, "sheet=LOT7/B")) == ["A"]
        assert search_sensors(store, "lot8").nearest == "LOT8"


def test_a_changed_part_hides_no_sensor_without_a_word(file, tmp_path):
    path, runs = file
    shutil.copy(path, tmp_path / "runs.db")
    change(tmp_path / "runs.db", "UPDATE run_parts SET identifier = 'LOT1' WHERE run = ?", runs["B"])
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store:
        assert search_sensors(store, "LOT7/C").altered == 1
        found = search_sensors(store, "LOT1")
    ((state,),) = found.sensors
    assert (state.last.serial, state.passed, state.failed, found.altered) == ("B", False, False, 0)
    assert "run_parts" in state.shown.altered


def test_of_many_sensors_those_tested_last_are_listed(store, monkeypatch):
    monkeypatch.setattr("cbsr_qa.app.shift.sensors.MOST_FOUND", 2)
    result = search_sensors(store, "LOT7")
    assert (found_serials(result), result.count) == (["A", "LOT7"], 4)
    assert MOST_FOUND >= 100


def test_a_search_looks_up_indices_and_scans_no_table(tmp_path):
    """Of 100 000 runs it must not read all."""
    asked = []
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store:
        engine = store.sensors._engine
        sa.event.listen(engine, "before_cursor_execute", lambda *call: asked.append(call[2:4]))
        for part in (SensorPart("", "LOT7"), SensorPart("sheet", "LOT7", "B")):
            store.sensors.find_sensors_of_part(part)
        store.sensors.find_sensors_of_batch("B-7")
        store.sensors.find_runs(["A", "B"])
        selects = [(query, values) for query, values in asked if query.lstrip().startswith(("SELECT", "WITH"))]
        with engine.connect() as connection:
            plans = [
                [row[3] for row in connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {query}", values)]
                for query, values in selects
            ]
    assert len(plans) == 4
    for plan in plans:
        assert not [line for line in plan if line.startswith("SCAN") and "names" not in line], plan
        assert any("ix_run" in line for line in plan)


@pytest.mark.parametrize(
    ("wanted", "nearest"),
    [
        *((wanted, "OLD-0417") for wanted in ("OLD-0471", "OLD-041", "OLD-04177", "OLD-0517", "old-0417")),
        ("board=B77", "board=B7"),
        ("NEU-1", "NEW-1"),
        ("OLD-9999", ""),
    ],
)
def test_any_name_that_differs_by_one_character_is_suggested_however_long_ago_it_was_tested(
    tmp_path, monkeypatch, wanted, nearest
):
    monkeypatch.setattr("cbsr_qa.app.shift.sensors._RUNS_WITH_NAMES", 1)
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as store:
        for serial, parts in (("OLD-0417", ["board=B7"]), ("OTHER", []), ("NEW-1", [])):
            store_run(store, serial, WELL, parts=parts)
        assert search_sensors(store, wanted).nearest == nearest


@pytest.mark.parametrize(("recent", "listed"), [(3, True), (1, False)])
def test_a_list_of_a_part_compares_the_latest_runs_of_others(file, tmp_path, monkeypatch, recent, listed):
    """A run that was altered may be of the part; to compare 100 000 takes ten seconds."""
    path, runs = file
    shutil.copy(path, tmp_path / "runs.db")
    change(tmp_path / "runs.db", "UPDATE run_parts SET identifier = 'LOT1' WHERE run = ?", runs["D"])
    monkeypatch.setattr("cbsr_qa.store.listed.RECENT_RUNS", recent)
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store:
        of_part = store.lists.read_runs(RunSelection(parts=(SensorPart("sheet", "LOT7"),)))
        of_station = store.lists.read_runs(RunSelection(batch="another"))
    assert [run.serial for run in of_part if run.altered] == (["D"] if listed else [])
    assert [run.serial for run in of_station] == ["D"]
