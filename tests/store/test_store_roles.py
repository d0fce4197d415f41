"""The script of roles: a station can store runs and delete nothing, a reader can read and write nothing."""

import re
from contextlib import closing
from uuid import uuid4

import psycopg
import pytest
from stored_runs import calibration, journalled, short_run

from cbsr_qa.domain.results import Outcome, RunResult, Verdict
from cbsr_qa.store import (
    create_views,
    drop_views,
    open_engine,
    open_store,
    parsed_url,
    roles_script,
    upgrade,
    writing,
)
from cbsr_qa.store.tables import RunRow
from cbsr_qa.store.views import VIEWS


def test_the_script_names_every_table_and_view():
    script = roles_script()
    for name in (*RunRow.metadata.tables, *VIEWS, "alembic_version"):
        assert script.count(f" {name}") >= 2, name
    assert not re.search("TRUNCATE|DELETE", script)


@pytest.fixture
def logins(postgres_server, postgres_database):
    """A database with logins in both roles; returns the address for one of them."""
    prefix = f"cbsr_qa_test_{uuid4().hex[:8]}"
    engine = open_engine(parsed_url(postgres_database))
    upgrade(engine)
    roles = [f"{prefix}_{name}" for name in ("bench", "ada", "station", "reader")]
    bench, ada, station, reader = roles
    with closing(psycopg.connect(postgres_database, autocommit=True)) as owner:
        for _ in range(2):  # it may be run again
            owner.execute(roles_script(station, reader))
        owner.execute(f"CREATE ROLE {bench} LOGIN IN ROLE {station}")
        owner.execute(f"CREATE ROLE {ada} LOGIN IN ROLE {reader}")
    names = {"bench": bench, "ada": ada}
    yield lambda who: postgres_database.replace("//postgres@", f"//{names[who]}@"), engine
    with closing(psycopg.connect(postgres_database, autocommit=True)) as owner:
        owner.execute(f"DROP OWNED BY {', '.join(roles)}")
    engine.dispose()
    for role in roles:
        postgres_server.execute(f"DROP ROLE {role}")


def refused(url, statement):
    with closing(psycopg.connect(url)) as connection, pytest.raises(psycopg.errors.InsufficientPrivilege):
        connection.execute(statement)


@pytest.mark.postgres
def test_a_station_stores_runs_and_cannot_delete_and_a_reader_reads(logins):
    login, engine = logins
    station, reader = login("bench"), login("ada")
    with open_store(station) as store:
        for _ in range(2):  # the second calibration supersedes the first
            run = store.new_id()
            with store.writing_alone(run):
                journalled(store, short_run(run))
            record = store.load_run(run)
            issued = calibration(store.new_id(), run)
            store.save_result(RunResult(record, None, (), Verdict(Outcome.PASS, "why"), issued, ""))
        store.override_verdict(run, Outcome.FAIL, operator="Ada", why="scratched")
        assert store.listed_runs()[-1].verdict is Outcome.FAIL
    for statement in (
        "DELETE FROM frame_blocks",
        "TRUNCATE runs CASCADE",
        "UPDATE runs SET serial = 'x'",
        "UPDATE phase_ends SET ended_s = 1",
        "UPDATE calibrations SET file = NULL",
        "DROP TABLE warnings",
        "CREATE TABLE mine (one integer)",
        "UPDATE alembic_version SET version_num = '0001'",
    ):
        refused(station, statement)
    for _ in range(2):  # an upgrade makes the views again
        with closing(psycopg.connect(reader)) as connection:
            counts = [connection.execute(f"SELECT count(*) FROM {view}").fetchone()[0] for view in VIEWS]
            assert counts == [2, 0, 1]
            assert connection.execute("SELECT count(*) FROM frame_blocks").fetchone()[0] > 0
        with writing(engine) as connection:
            drop_views(connection)
            create_views(connection)
    refused(reader, "INSERT INTO sensors SELECT * FROM sensors")
    refused(reader, "UPDATE phase_ends SET ended_s = 1")
    refused(reader, "DELETE FROM runs")
