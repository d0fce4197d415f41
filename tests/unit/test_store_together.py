"""Several stations that meet one database at the same moment: real processes, on SQLite and PostgreSQL."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import pytest
import sqlalchemy as sa

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store import locks, schema
from cbsr_qa.store.engine import open_engine, parsed_url
from cbsr_qa.store.repository import open_store

STATIONS = 4


def started(barrier):
    """Have a process wait for the others once it has loaded everything."""
    import alembic.command  # noqa: F401 - what takes longest to load

    global _together
    _together = barrier


def opened(url, _):
    _together.wait(60)
    with open_store(url) as store:
        return store.counts()["runs"]


def upgraded(url, _):
    _together.wait(60)
    engine = open_engine(parsed_url(url))
    before = schema.upgrade(engine).revision
    engine.dispose()
    return before


@pytest.fixture(scope="module")
def stations():
    """Call a function in as many processes as there are stations, at the same moment."""
    context = multiprocessing.get_context("forkserver")
    barrier = context.Barrier(STATIONS)
    with ProcessPoolExecutor(STATIONS, context, started, (barrier,)) as pool:
        yield lambda function: list(pool.map(function, range(STATIONS)))


def test_stations_that_create_one_database_together_all_find_it_made(stations, database_url):
    assert stations(partial(opened, database_url)) == [0] * STATIONS


def test_stations_that_upgrade_one_database_together_upgrade_it_once(stations, database_url):
    engine = open_engine(parsed_url(database_url))
    schema.upgrade(engine, "0001")
    before = stations(partial(upgraded, database_url))
    assert sorted(before) == ["0001", *[schema.HEAD] * (STATIONS - 1)]
    engine.dispose()
