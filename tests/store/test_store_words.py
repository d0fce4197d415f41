"""A stored word that its column does not know is a damaged database: whatever reads the one run refuses it.

Lists mark the run and go on: one odd word, which a station's login can add at a centre, must not hide all other runs.
"""

import sqlite3
from contextlib import closing

import numpy as np
import pytest
from stored_lots import judged, measured, store_run
from stored_runs import journalled, short_run

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.store.opening import open_store


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A run with its analysis and an override of its verdict, and a run that did not finish."""
    path = tmp_path_factory.mktemp("words") / "runs.db"
    with open_store(f"sqlite:///{path}", durable=False) as store:
        random = np.random.default_rng(1)
        run = store_run(store, "S-1", judged(measured(random, random.standard_normal(3))))
        store.changes.override_verdict(run, Outcome.FAIL, operator="Kim", why="a scratch")
        cut = store.new_id()
        journalled(store, short_run(cut, "S-3")[:-1])
    return path, run, cut


READERS = {
    "analyses": lambda store, run, cut: store.analyses.load(run),
    "run": lambda store, run, cut: store.runs.load(run),
    "overrides": lambda store, run, cut: store.changes.list_overrides(),
    "override": lambda store, run, cut: store.changes.override_verdict(
        run, Outcome.PASS, operator="Kim", why="clean"
    ),
    "fleet": lambda store, run, cut: store.fleet.load_table(),
    "state": lambda store, run, cut: store.runs.read_last_session(cut),
    "incomplete": lambda store, run, cut: store.unfinished.list_incomplete(),
}
#: What is shown of each run, and why it is marked.
LISTS = {
    "runs": lambda store: [(one.run, one.altered) for one in store.runs.find()],
    "list": lambda store: [(one.run, one.altered) for one in store.lists.read_runs()],
    "lines": lambda store: [(one.run, one.altered) for one in store.fleet.read_lines()],
}


@pytest.mark.parametrize(
    ("table", "column", "readers"),
    [
        ("analyses", "outcome", ["analyses", "overrides", "override", "fleet"]),
        ("measurements", "outcome", ["analyses", "fleet"]),
        ("measurements", "bound", ["analyses", "fleet"]),
        ("verdict_overrides", "outcome", ["overrides"]),
        ("run_states", "end", ["run", "override", "fleet", "incomplete"]),
        ("phases", "role", ["run"]),
    ],
)
def test_the_table_and_row_are_named(stored, tmp_path, table, column, readers):
    path, run, cut = stored
    words = f" has {table}.{column} 'odd'; allowed: "
    copy = tmp_path / "copy.db"
    with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(copy)) as target:
        source.backup(target)
        target.execute("DELETE FROM run_links")  # of a chained run, the change itself is refused
        target.execute("UPDATE runs SET chain = NULL")
        last = f"WHERE rowid IN (SELECT max(rowid) FROM {table} GROUP BY run)" if table == "run_states" else ""
        assert target.execute(f"UPDATE {table} SET {column} = 'odd' {last}").rowcount
        target.commit()
    for name in readers:
        with open_store(f"sqlite:///{copy}") as store, pytest.raises(StoreError) as raised:
            READERS[name](store, run, cut)
        assert words in raised.value.reason, name
    with open_store(f"sqlite:///{copy}") as store:
        for name, read in LISTS.items():
            shown = dict(read(store))
            assert set(shown) == {run, cut}, name
            odd = {"run_states": {run, cut}, "analyses": {run}, "verdict_overrides": {run}}.get(table, set())
            assert {one for one, why in shown.items() if words in why} == odd, name
    if table == "run_states":
        assert run_guarded(["db", "status", "--database", f"sqlite:///{copy}"]) == 2
