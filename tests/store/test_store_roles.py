"""The script of roles: a station can store runs and delete nothing, a reader can read and write nothing."""

import re
from contextlib import closing
from datetime import UTC, datetime
from uuid import uuid4

import psycopg
import pytest
import sqlalchemy as sa
from stored_runs import calibration, journalled, short_run
from synced import everything, run_of

from cbsr_qa.app.keeping import check_database
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.store.engine import open_engine, parse_url, reading, writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.results.reanalyses import Reanalysis
from cbsr_qa.store.roles import CHANGED, OF_THE_OWNER, roles_script
from cbsr_qa.store.schema import upgrade
from cbsr_qa.store.tables.runs import RunRow
from cbsr_qa.store.types import Digest, FiniteDouble, Instant, Whole
from cbsr_qa.store.views import VIEWS, create_views, drop_views


def test_the_script_names_every_table_and_view():
    script = roles_script()
    for name in (*RunRow.metadata.tables, *VIEWS, "alembic_version"):
        assert script.count(f" {name}") >= 2, name
    assert not re.search("TRUNCATE|DELETE", script)


@pytest.fixture
def logins(postgres_server, postgres_database):
    """A database with logins in both roles; returns the address for one of them."""
    prefix = f"cbsr_qa_test_{uuid4().hex[:8]}"
    engine = open_engine(parse_url(postgres_database))
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
            with store.claims.hold_run(run):
                journalled(store, short_run(run))
            record = store.runs.load(run)
            issued = calibration(store.new_id(), run)
            store.analyses.save(RunResult(record, None, (), Verdict(Outcome.PASS, "why"), issued, ""))
        store.changes.override_verdict(run, Outcome.FAIL, operator="Ada", why="scratched")
        assert store.lists.read_runs()[-1].verdict is Outcome.FAIL
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


#: Tables without a link, and to which a station adds rows that nobody can tell from another station's.
NOT_NOTICED = {
    *("chart_references", "releases"),
    *("outbox", "sync_refusals", "sync_settlements"),
}


@pytest.fixture
def filled(logins):
    """A database with one of everything, stored by a station's login: its address, the owner's engine, two runs."""
    login, engine = logins
    with open_store(login("bench")) as store:
        run = everything(store)
        under_way = run_of(store, "S-2", events=2)
        reanalysis = store.reanalyses.save(found_again(run))
        store.reanalyses.adopt(reanalysis, operator="Zoë", why="so")
    return login("bench"), engine, run, under_way


def found_again(run):
    """What a run was found to be by another recipe."""
    return Reanalysis(
        run, 64 * "a", "{}", (("cbsr-qa", "9"),), Verdict(Outcome.PASS, "so"), (), (), "equal", None, ()
    )


def attempts():
    """Every way in which a cell or row that is there can be changed or removed."""
    for table in RunRow.metadata.sorted_tables:
        for column in table.columns:
            yield table.name, column.name, f'UPDATE {table.name} SET "{column.name}" = "{column.name}"'
        yield table.name, "", f"DELETE FROM {table.name}"
        yield table.name, "", f"TRUNCATE {table.name} CASCADE"
        yield table.name, "", f"ALTER TABLE {table.name} ADD COLUMN more TEXT"
        yield table.name, "", f"CREATE RULE none AS ON INSERT TO {table.name} DO INSTEAD NOTHING"
        yield table.name, "", f"LOCK TABLE {table.name} IN ACCESS EXCLUSIVE MODE"
        yield table.name, "", f"DROP TABLE {table.name} CASCADE"


@pytest.mark.postgres
@pytest.mark.rest
def test_of_all_that_is_there_a_station_changes_only_what_is_listed(filled):
    url = filled[0]
    changed = set()
    with closing(psycopg.connect(url)) as station:
        for table, column, statement in attempts():
            try:
                station.execute(statement)
                changed.add((table, column))
            except psycopg.errors.InsufficientPrivilege:
                pass
            station.rollback()
    assert changed == {(table, column) for table, columns in CHANGED.items() for column in columns}
    assert check_database(url, None, lambda *_: None, quick=False).exit_code == 0


def another_row(connection, table, under_way):
    """Return a row for a table: as one that is there, under a key that is not; else of what it refers to."""
    there = connection.execute(sa.select(table).limit(1)).mappings().one_or_none()
    row = dict(there) if there is not None else {column.name: cell(connection, column) for column in table.columns}
    own = [column for column in table.primary_key if not column.foreign_keys]
    free = [(own or list(table.primary_key))[-1], *(column for column in table.columns if column.unique)]
    row |= {column.name: cell(connection, column) for column in free}
    return row | {"run_links": {"document": "x"}, "phase_ends": {"run": under_way, "phase": 0}}.get(table.name, {})


def cell(connection, column):
    """Return a value that fits a column and is not in it: of what it refers to, or one of its own."""
    for reference in column.foreign_keys:
        unused = reference.column.not_in(sa.select(column))
        return connection.scalar(sa.select(reference.column).where(unused).order_by(reference.column).limit(1))
    if isinstance(column.type, Digest):
        return 64 * "b"
    kinds = {Whole: 7777, FiniteDouble: 0.5, sa.JSON: [], sa.Boolean: True, sa.LargeBinary: b"x"}
    kinds |= {Instant: datetime(2026, 11, 1, tzinfo=UTC)}
    return next((value for kind, value in kinds.items() if isinstance(column.type, kind)), "x-another")


def added(engine, table, *known):
    """Add a row; returns why it is refused, empty if it is not."""
    try:
        with writing(engine) as connection:
            connection.execute(table.insert(), another_row(connection, table, *known))
    except StoreError as error:
        return error.reason
    return ""


@pytest.mark.postgres
@pytest.mark.rest
def test_what_a_station_adds_to_anothers_rows_is_noticed(filled):
    url, owner, _, under_way = filled
    outcome = {}
    engine = open_engine(parse_url(url))
    for table in RunRow.metadata.sorted_tables:
        with reading(owner) as connection:
            before = connection.execute(sa.select(*table.primary_key)).all()
        if why := added(engine, table, under_way):
            outcome[table.name] = why
            continue
        unsound = check_database(url, None, lambda *_: None, quick=True).exit_code
        outcome[table.name] = "noticed" if unsound else "not noticed"
        with writing(owner) as connection:
            new = sa.tuple_(*table.primary_key).not_in(before)
            assert connection.execute(table.delete().where(new)).rowcount == 1
    engine.dispose()
    assert {name for name, how in outcome.items() if "permission denied" in how} == set(OF_THE_OWNER)
    assert {name for name, how in outcome.items() if how == "not noticed"} == NOT_NOTICED
    others = {*outcome} - set(OF_THE_OWNER) - NOT_NOTICED - {"station_check_frames"}  # one a check, which there is
    assert {name: outcome[name] for name in others} == dict.fromkeys(others, "noticed")
    assert check_database(url, None, lambda *_: None, quick=False).exit_code == 0


@pytest.mark.postgres
def test_a_calibration_is_withdrawn_by_no_row_that_a_login_may_change(filled):
    url, engine, run, _ = filled
    with reading(engine) as connection:
        before = connection.exec_driver_sql("SELECT calibration FROM v_calibrations").all()
    assert before
    refused(url, "UPDATE calibrations SET serial = 'S-9'")
    forged = (
        "INSERT INTO calibrations (calibration, run, analysis, serial, issued_at, content_sha256, record_sha256,"
        " file, file_sha256) SELECT 'f' || substr(calibration, 2), run, analysis, serial, issued_at, content_sha256,"
        " record_sha256, file, file_sha256 FROM calibrations c WHERE calibration IN (SELECT calibration FROM"
        " v_calibrations)"
    )
    with closing(psycopg.connect(url)) as connection, connection:
        assert connection.execute(forged).rowcount == 1
    problems = check_database(url, None, lambda *_: None, quick=True).result.problems
    assert [(problem.run, problem.what.partition(" (")[0]) for problem in problems] == [(run, "calibrations")]
