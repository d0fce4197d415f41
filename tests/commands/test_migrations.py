"""Migrations, with a second revision that the tests make, on SQLite and on PostgreSQL."""

import datetime as dt
import hashlib
import sqlite3
from contextlib import closing

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from command import cbsr_qa
from later_schema import add_revision, take_back
from stored_runs import journalled, short_run

from cbsr_qa.domain.errors import LAST_UNRELEASED, StoreError
from cbsr_qa.store import schema, views
from cbsr_qa.store.engine import open_engine, parse_url, reading, writing
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.tables.runs import Base

pytestmark = pytest.mark.rest

#: What the second revision adds.
ADDED = {"lots", "cases"}


@pytest.fixture(autouse=True)
def migrated(monkeypatch):
    """Here every database is migrated; returns what makes the tables of a new one."""
    at_once = schema._create
    monkeypatch.setattr(schema, "_create", schema._migrate)
    return at_once


@pytest.fixture
def engine(database_url):
    engine = open_engine(parse_url(database_url))
    yield engine
    engine.dispose()


def sample(column):
    """A value of a column's type; keys are alike in every table, so that references hold."""
    kind = column.type
    if isinstance(kind, sa.JSON):
        return {"Δρ": [1, 2.5, None]}
    if isinstance(kind, sa.DateTime):
        return dt.datetime(2026, 11, 21, 8, 30, 0, 123456)
    if isinstance(kind, sa.LargeBinary):
        return bytes(range(256))
    if isinstance(kind, sa.Boolean):
        return True
    if isinstance(kind, sa.Float):
        return 0.1 + 0.2
    return 7 if isinstance(kind, sa.Integer) else "x"


def reflected(engine):
    metadata = sa.MetaData()
    metadata.reflect(engine)
    return [table for table in metadata.sorted_tables if table.name != schema.VERSION_TABLE]


def fill(engine, names):
    with writing(engine) as connection:
        for table in reflected(engine):
            if table.name in names:
                connection.execute(table.insert(), {column.name: sample(column) for column in table.columns})


def content(engine):
    """Every row of every table; JSON is read as such on both databases."""
    with reading(engine) as connection:
        return {table.name: [tuple(row) for row in connection.execute(table.select())] for table in reflected(engine)}


def table_names(engine):
    return {table.name for table in reflected(engine)}


def view_names(engine):
    with reading(engine) as connection:
        return set(sa.inspect(connection).get_view_names())


def test_data_survive_a_step_up_and_down(engine, tmp_path, monkeypatch):
    schema.upgrade(engine)
    first, made = schema.HEAD, table_names(engine)
    fill(engine, made - {"runs_begun"})
    before = content(engine)
    assert all(rows for name, rows in before.items() if name != "runs_begun")
    add_revision(monkeypatch, tmp_path)
    assert schema.read_version(engine).age is schema.Age.OLDER
    assert schema.upgrade(engine) == schema.SchemaVersion(schema.Age.OLDER, first)
    later = content(engine)
    assert {name: later.pop(name) for name in ADDED} == {name: [] for name in ADDED}
    assert later == before | {"runs": [(*row, None) for row in before["runs"]]}
    assert view_names(engine) == set(views.VIEWS)

    take_back(engine, first)
    assert content(engine) == before
    assert view_names(engine) == set()
    take_back(engine, "base")
    assert table_names(engine) == set()
    assert schema.read_version(engine).age is schema.Age.EMPTY
    schema.upgrade(engine)  # Alembic leaves an empty table of versions
    assert table_names(engine) == made | ADDED


def test_a_stored_run_keeps_its_chain_in_a_later_schema(engine, tmp_path, monkeypatch):
    schema.upgrade(engine)
    store = Repository(engine, lambda: dt.datetime.now(dt.UTC))
    run = store.new_id()
    journalled(store, short_run(run))
    measured = store.runs.load(run)
    add_revision(monkeypatch, tmp_path)
    schema.upgrade(engine)
    again = store.runs.load(run)
    assert (again.chain.chained, again.chain_head) == (True, measured.chain_head)
    with writing(engine) as connection:  # a column that the program does not know is covered by no link
        connection.execute(sa.text("UPDATE runs SET loudness = 'loud'"))
    assert store.runs.load(run).chain_head == measured.chain_head


def _index(found):
    options = {name: str(value) for name, value in found.pop("dialect_options", {}).items()}
    return repr((found, options))


def described(engine):
    """Everything a database says of its tables and views, in an order of its own; migrations append columns."""
    with reading(engine) as connection:
        found = sa.inspect(connection)
        return {name: found.get_view_definition(name) for name in found.get_view_names()} | {
            name: {
                "columns": sorted(repr(sorted(one.items())) for one in found.get_columns(name)),
                "key": found.get_pk_constraint(name),
                "references": sorted(map(repr, found.get_foreign_keys(name))),
                "indexes": sorted(map(_index, found.get_indexes(name))),
                "unique": sorted(map(repr, found.get_unique_constraints(name))),
                "checks": sorted(map(repr, found.get_check_constraints(name))),
            }
            for name in found.get_table_names()
        }


def test_a_new_database_has_the_tables_that_the_migrations_make(engine, monkeypatch, migrated):
    schema.upgrade(engine)
    by_migration = described(engine)
    assert schema.VERSION_TABLE in by_migration
    assert set(views.VIEWS) <= set(by_migration)
    with writing(engine) as connection:
        views.drop_views(connection)
        for table in [*reversed(Base.metadata.sorted_tables), sa.table(schema.VERSION_TABLE)]:
            connection.execute(sa.text(f"DROP TABLE {table.name}"))
    monkeypatch.setattr(schema, "_create", migrated)
    schema.upgrade(engine)
    assert schema.read_version(engine) == schema.SchemaVersion(schema.Age.CURRENT, schema.HEAD)
    assert described(engine) == by_migration


def test_the_migrations_make_what_the_program_uses(engine):
    schema.upgrade(engine)
    with reading(engine) as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []


def test_an_upgrade_makes_views_that_a_later_version_took_away(engine):
    schema.upgrade(engine)
    with writing(engine) as connection:
        views.drop_views(connection)
    assert schema.upgrade(engine).age is schema.Age.CURRENT
    assert view_names(engine) == set(views.VIEWS)


def test_a_migration_that_fails_half_way_leaves_no_trace(engine, tmp_path, monkeypatch):
    schema.upgrade(engine)
    first = schema.HEAD
    add_revision(monkeypatch, tmp_path)
    with writing(engine) as connection:
        connection.exec_driver_sql("CREATE TABLE cases (in_the_way INTEGER)")
    before = table_names(engine)
    with pytest.raises(StoreError, match="cases"):
        schema.upgrade(engine)
    assert table_names(engine) == before
    assert schema.read_version(engine).revision == first


@pytest.mark.parametrize("number", [1, 21, 24])
def test_a_database_of_before_the_first_version_is_refused_by_its_schema_and_stays_as_it_is(engine, number):
    schema.upgrade(engine)
    with writing(engine) as connection:
        connection.execute(sa.text(f"UPDATE {schema.VERSION_TABLE} SET version_num = '{number:04}'"))
    before = content(engine)
    assert schema.read_version(engine).age is schema.Age.UNRELEASED
    with pytest.raises(StoreError, match=rf"has schema {number:04}, from before version 0\.1\.0") as caught:
        schema.upgrade(engine)
    assert f"commit {LAST_UNRELEASED} of cbsr-qa still reads and exports this one" in caught.value.remedy
    assert content(engine) == before


@pytest.mark.parametrize(
    "arguments",
    [
        *(["db", one] for one in ("upgrade", "check", "sync --to other.db")),
        ["db", "backup", "to.db"],
        ["db", "restore", "var/cbsr-qa.db", "--database", "other.db"],
        ["runs"],
        ["report", "S-1"],
    ],
    ids=" ".join,
)
def test_no_command_takes_or_changes_a_file_of_before_the_first_version(tmp_path, arguments):
    path = tmp_path / "var" / "cbsr-qa.db"
    schema.upgrade(file := open_engine(parse_url(f"sqlite:///{path}")))
    file.dispose()
    with closing(sqlite3.connect(path)) as other, other:
        other.execute("UPDATE alembic_version SET version_num = '0019'")
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    done = cbsr_qa(tmp_path, *" ".join(arguments).split(), check=False)
    assert done.returncode == 2
    assert "has schema 0019, from before version 0.1.0" in done.stderr
    assert LAST_UNRELEASED in done.stderr
    assert hashlib.sha256(path.read_bytes()).hexdigest() == before
    assert [one.name for one in tmp_path.rglob("*") if one.is_file()] == [path.name]


def test_the_programs_list_of_revisions_is_the_scripts():
    config = Config()
    config.set_main_option("script_location", schema.SCRIPTS)
    scripts = ScriptDirectory.from_config(config)
    walked = [script.revision for script in scripts.walk_revisions()]
    assert tuple(reversed(walked)) == schema.REVISIONS
    assert scripts.get_heads() == [schema.HEAD]


def test_references_between_tables_hold(engine):
    """A measurement of no analysis is refused by the database itself, on SQLite too."""
    schema.upgrade(engine)
    with closing(engine.raw_connection()) as raw, pytest.raises(Exception, match=r"(?i)foreign key"):
        raw.cursor().execute("INSERT INTO warnings (analysis, number, text) VALUES ('none', 0, 'x')")


def test_sqlite_is_set_up_to_lose_nothing_that_was_committed(tmp_path):
    engine = open_engine(parse_url(f"sqlite:///{tmp_path / 'runs.db'}"))
    schema.upgrade(engine)
    with reading(engine) as connection:
        found = {p: connection.exec_driver_sql(f"PRAGMA {p}").scalar() for p in ("journal_mode", "synchronous")}
    engine.dispose()
    assert found == {"journal_mode": "wal", "synchronous": 2}  # 2 is FULL
