"""Parts of sensors: kept under the chain of a run, selected by, listed and exported."""

import csv
import io
import json
from dataclasses import replace
from xml.etree import ElementTree

import pytest
import sqlalchemy as sa
from stored_lots import LIMITS, store_run
from stored_runs import identity, journalled, short_run

from cbsr_qa.app.shift.lists import ListRequest, list_runs
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.config.serials import read_parts
from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.events import RunStarted
from cbsr_qa.store.engine import open_engine, parse_url, writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.selection import check_names

DRIFT = (Measurement("drift", 0.1, "%/min").judge(LIMITS["drift"]),)
B7, C7 = "sheet=LOT7/B", "sheet=LOT7/C"


@pytest.fixture
def made(database_url):
    """A and B are of sheet lot 7, in two revisions, C is of lot 8, D of nothing stated."""
    with open_store(database_url, durable=False) as store:
        parts_by_serial = {"A": [B7, "board=9"], "B": [C7], "C": ["sheet=LOT8"], "D": []}
        runs = {serial: store_run(store, serial, DRIFT, parts=parts) for serial, parts in parts_by_serial.items()}
        yield database_url, store, runs


def select(store, *texts):
    return RunSelection(parts=read_parts(texts))


def serials(lines):
    return [line.serial for line in lines]


def test_a_run_keeps_the_parts_of_its_sensor(database_url):
    parts = read_parts(["board=9", B7])
    with open_store(database_url) as store:
        run = store.new_id()
        _, *events = short_run(run)
        journalled(store, [RunStarted(replace(identity(run), parts=parts)), *events])
        assert store.runs.load(run).identity.parts == parts
        assert store.runs.read_identity(run).parts == parts


def test_runs_are_selected_by_lot_revision_and_several_parts(made):
    _, store, _ = made
    assert serials(store.fleet.read_lines(select(store, "sheet=LOT7"))) == ["A", "B"]
    assert serials(store.fleet.read_lines(select(store, C7))) == ["B"]
    assert serials(store.lists.read_runs(RunSelection(parts=read_parts(["sheet=LOT7", "board=9"])))) == ["A"]
    assert serials(store.fleet.load_table(select(store, "sheet=LOT7")).runs) == ["A", "B"]
    assert store.lists.count_runs(select(store, "sheet=LOT8")) == 1


def test_lists_and_tables_hold_parts(made, capsys, tmp_path):
    url, store, _ = made
    first = list_runs(store, ListRequest(RunSelection())).runs[0]
    assert first.parts == read_parts([B7, "board=9"])
    assert run_guarded(["runs", "--part", "sheet=LOT7", "--json", "--database", url]) == 0
    listed = json.loads(capsys.readouterr().out)["runs"]
    assert [entry["parts"] for entry in listed] == [
        [
            {"name": "board", "identifier": "9", "revision": ""},
            {"name": "sheet", "identifier": "LOT7", "revision": "B"},
        ],
        [{"name": "sheet", "identifier": "LOT7", "revision": "C"}],
    ]
    for name in ("runs.csv", "runs.xml"):
        target = tmp_path / name
        assert run_guarded(["export", "--part", "sheet=LOT7", "--to", str(target), "--database", url]) == 0
    rows = list(csv.DictReader(io.StringIO((tmp_path / "runs.csv").read_text())))
    assert [row["parts"] for row in rows] == ["board=9; sheet=LOT7/B", "sheet=LOT7/C"]
    values = [
        p.get("value") for p in ElementTree.parse(tmp_path / "runs.xml").iter("property") if p.get("name") == "parts"
    ]
    assert values == ["board=9; sheet=LOT7/B", "sheet=LOT7/C"]


def test_an_unknown_part_is_refused_without_a_look_at_the_chain_of_any_run(made):
    """To check 100 000 runs takes a quarter of a minute."""
    _, store, _ = made
    asked = []
    sa.event.listen(store.fleet._engine, "before_cursor_execute", lambda *call: asked.append(call[2]))
    with pytest.raises(RefusedError):
        check_names(store, select(store, "sheet=LOT9"))
    assert asked
    assert not [query for query in asked if "links" in query]


def test_an_unknown_part_is_refused_with_the_nearest(made):
    _, store, _ = made
    with pytest.raises(RefusedError) as caught:
        list_runs(store, ListRequest(select(store, "sheet=LOT9")))
    assert "no stored run is of part 'sheet=LOT9'" in str(caught.value)
    assert "parts: board=9, sheet=LOT7, sheet=LOT8" in str(caught.value)
    for text, near in (("sheet=lot7", "sheet=LOT7"), ("sheet=LOT7/b", B7)):
        with pytest.raises(RefusedError, match=f"did you mean '{near}'"):
            list_runs(store, ListRequest(select(store, text)))


@pytest.mark.parametrize(
    "change",
    ["DELETE FROM run_parts WHERE run = :run", "UPDATE run_parts SET identifier = 'LOT1' WHERE run = :run",
     "INSERT INTO run_parts VALUES (:run, 'glue', 'G', '')"],
)  # fmt: skip
def test_a_changed_part_is_noticed_and_not_left_out_of_a_selection(made, change):
    url, store, runs = made
    engine = open_engine(parse_url(url))
    with writing(engine) as connection:
        connection.execute(sa.text(change), {"run": runs["B"]})
    engine.dispose()
    listed = {run.serial: run for run in store.lists.read_runs(select(store, "sheet=LOT7"))}
    assert "run_parts" in listed["B"].altered
    assert not listed["A"].altered
    with pytest.raises(StoreError, match="run_parts"):
        store.runs.load(runs["B"])
    with pytest.raises(StoreError, match="run_parts"):
        store.runs.read_identity(runs["B"])


def test_runs_of_a_part_are_found_whatever_its_revision(made):
    _, store, runs = made
    (part,) = read_parts([B7])
    assert store.sensors.find_runs_of_part(part) == [(runs["A"], "A"), (runs["B"], "B")]
