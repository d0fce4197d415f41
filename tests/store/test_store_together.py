"""Several stations that meet one database at the same moment: real processes, on SQLite and PostgreSQL."""

import multiprocessing
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from functools import partial

import pytest
from later_schema import LATER, add_revision
from stored_runs import journalled, short_run

from cbsr_qa.app.run.request import RunRequest, default_seed
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.app.run.session import Session
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store import locks, schema
from cbsr_qa.store.engine import open_engine, parse_url, reading
from cbsr_qa.store.opening import open_store

STATIONS = 4


_TOGETHER = []


def started(barrier):
    """Have a process wait for the others once it has loaded everything."""
    import alembic.command  # noqa: F401 - what takes longest to load

    _TOGETHER.append(barrier)


def opened(url, _):
    _TOGETHER[0].wait(60)
    with open_store(url) as store:
        return store.count_rows()["runs"]


def upgraded(url, folder, _):
    engine = open_engine(parse_url(url))
    with pytest.MonkeyPatch.context() as patch:
        add_revision(patch, folder)
        _TOGETHER[0].wait(60)
        before = schema.upgrade(engine).revision
    engine.dispose()
    return before


def seed_of_a_run(url, folder, number):
    """Begin a run of one sensor and hold it until all have begun theirs; returns its seed."""

    def begun(session, identity, store):
        _TOGETHER[0].wait(60)
        return session.configuration.seed

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CBSR_QA_VAR", f"{folder}/{number}")  # each has a bench
        patch.setattr(Session, "press", lambda session, identity, store: None)
        patch.setattr(Session, "conclude", begun)
        return run_sensor(RunRequest("simulated", "nine-locations", "S-1", database=url))


@pytest.fixture(scope="module")
def stations():
    """Call a function in as many processes as there are stations, at the same moment."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["alembic.command", "cbsr_qa.app.run.run", "cbsr_qa_plugins"])
    barrier = context.Barrier(STATIONS)
    with ProcessPoolExecutor(STATIONS, context, started, (barrier,)) as pool:
        yield lambda function: list(pool.map(function, range(STATIONS)))


def test_stations_that_create_one_database_together_all_find_it_made(stations, database_url):
    assert stations(partial(opened, database_url)) == [0] * STATIONS


def test_stations_that_upgrade_one_database_together_upgrade_it_once(stations, database_url, tmp_path, monkeypatch):
    engine = open_engine(parse_url(database_url))
    schema.upgrade(engine)
    made_by = schema.HEAD
    add_revision(monkeypatch, tmp_path)  # which writes the scripts once
    before = stations(partial(upgraded, database_url, tmp_path))
    assert sorted(before) == [made_by, *[LATER] * (STATIONS - 1)]
    engine.dispose()


def five_begun(url, number):
    """Begin five runs, one after the other, while others do the same."""
    _TOGETHER[0].wait(60)
    with open_store(url) as store:
        for _ in range(5):
            journalled(store, short_run(store.new_id(), f"S-{number}")[:2])


@pytest.mark.rest
def test_runs_that_begin_together_each_follow_one_other(stations, database_url):
    open_store(database_url).close()
    stations(partial(five_begun, database_url))
    with open_store(database_url) as store, reading(store._engine) as connection:
        assert store.soundness.find_order_problems() == ((), ())
        begun = connection.exec_driver_sql("SELECT run FROM runs_begun ORDER BY number").scalars().all()
        before = dict(map(tuple, connection.exec_driver_sql("SELECT run, before_run FROM runs").all()))
    assert [before[run] for run in begun] == [None, *begun[:-1]]
    assert len(begun) == 5 * STATIONS


@pytest.mark.rest
def test_runs_of_one_sensor_that_begin_together_have_the_seeds_of_its_first_tries(stations, database_url, tmp_path):
    seeds = stations(partial(seed_of_a_run, database_url, str(tmp_path)))
    assert sorted(seeds) == sorted(default_seed("S-1", number) for number in range(STATIONS))
    assert not list(tmp_path.glob("*.lock"))


def test_who_changes_the_schema_is_waited_for_aloud_and_not_for_ever(database_url, monkeypatch):
    monkeypatch.setattr(locks, "PATIENCE_S", 0.1)
    monkeypatch.setattr(locks, "SCHEMA_WAIT_S", 0.3)
    engine, told = open_engine(parse_url(database_url)), []
    with locks.changing_schema(engine), pytest.raises(StoreError, match=r"created or upgraded by .*waited 0\.3 s"):
        open_store(database_url, tell=told.append)
    (said,) = told
    assert "is being created or upgraded by somebody on" in said
    assert "waiting 0.3 s at most" in said
    engine.dispose()
    open_store(database_url).close()


def test_a_seed_is_claimed_by_one_run_at_a_time_and_of_one_sensor(database_url):
    with open_store(database_url) as store, ExitStack() as held:
        claims = [("S-1", 7), ("S-1", 7), ("S-1", 8), ("S-2", 7)]
        claimed = [held.enter_context(store.sensors.claim_seed(*claim)) for claim in claims]
        assert claimed == [True, False, True, True]


CLAIM = """
import sys
from cbsr_qa.store.opening import open_store
with open_store(sys.argv[1]) as store, store.sensors.claim_seed("S-1", 7) as claimed:
    print(claimed, flush=True)
    sys.stdin.read()
"""


def test_the_lock_file_of_a_claim_that_was_killed_is_removed_by_the_next_run(tmp_path):
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    with subprocess.Popen(
        [sys.executable, "-c", CLAIM, url], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "True\n"
        with open_store(url) as store, store.sensors.claim_seed("S-1", 7) as claimed:
            assert not claimed
        assert len(list(tmp_path.glob("*.lock"))) == 1
        process.kill()
    with open_store(url) as store, store.sensors.claim_seed("S-2", 8) as claimed:
        assert claimed
        assert len(list(tmp_path.glob("*.lock"))) == 1
    assert not list(tmp_path.glob("*.lock"))
