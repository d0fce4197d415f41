"""Migrations, up and down with data in every table, on SQLite and on PostgreSQL."""

import datetime as dt
from contextlib import closing

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from stored_runs import journalled, short_run

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store import schema, views
from cbsr_qa.store.engine import open_engine, parse_url, reading, writing
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.tables import records
from cbsr_qa.store.tables.runs import AttendanceRow, Base

pytestmark = pytest.mark.rest

CHECKS = {
    table.__tablename__
    for table in (records.StationCheckRow, records.StationCheckLineRow, records.StationCheckFramesRow)
}

CHANGES = {table.__tablename__ for table in (records.ConfigurationChangeRow, records.VerdictOverrideRow)}

LINKS = records.LinkRow.__tablename__


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    """Here every database is migrated; returns what makes the tables of a new one."""
    at_once = schema._create
    monkeypatch.setattr(schema, "_create", lambda connection: schema._alembic(connection, "upgrade", schema.HEAD))
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


@pytest.mark.filterwarnings("ignore:Cannot correctly sort tables:sqlalchemy.exc.SAWarning")
def test_data_survive_every_step_up_and_down(engine):
    schema.upgrade(engine, "0001")
    measured = table_names(engine)
    fill(engine, measured)
    before = content(engine)
    assert all(len(rows) == 1 for rows in before.values())

    schema.upgrade(engine, "0002")
    concluded = table_names(engine) - measured
    assert concluded
    assert content(engine) == before | {name: [] for name in concluded}
    fill(engine, concluded)
    full = content(engine)
    assert all(len(rows) == 1 for rows in full.values())

    schema.upgrade(engine, "0003")
    schema.downgrade(engine, "0002")
    assert content(engine) == full

    schema.downgrade(engine, "0001")
    assert content(engine) == before
    schema.upgrade(engine)
    concluded |= {"calibration_forces", *CHECKS, *CHANGES, records.ChartReferenceRow.__tablename__}
    concluded |= {
        LINKS,
        AttendanceRow.__tablename__,
        "gate_answers",
        "releases",
        "archives",
        "reanalyses",
        "adoptions",
    }
    announced = {name: content(engine)[name] for name in ("outbox", "sync_accepts")}
    concluded |= {*announced, "sync_refusals", "sync_settlements", "phase_ends", "runs_begun"}
    # Eased, notes; chain, the run before; operator, software and time of a session.
    later = {
        name: [(*row, *[None] * columns) for row in before[name]]
        for name, columns in (("loads", 1), ("instruments", 1), ("runs", 4), ("run_states", 3))
    }
    # The end of a phase has a row of its own, and the runs of a sensor say when it was first seen.
    later |= {name: [row[:-1] for row in before[name]] for name in ("sensors", "phases")}
    later["phase_ends"] = [("x", 7, before["phases"][0][-1])]
    # Digests are bytes; the arrays of these rows have no length that fits, and stay as they are.
    later |= {name: [(*row[:-1], b"x") for row in before[name]] for name in ("frame_blocks", "sample_blocks")}
    assert content(engine) == before | {name: [] for name in concluded} | later | announced
    assert [row[:2] for row in announced["outbox"]] == [("run", "x")]
    assert announced["sync_accepts"] == [(schema.OLDEST_SENDER,)]

    schema.downgrade(engine, "base")
    assert table_names(engine) == set()
    assert schema.read_version(engine).age is schema.Age.EMPTY
    schema.upgrade(engine)
    assert table_names(engine) == measured | concluded


def view_names(engine):
    with reading(engine) as connection:
        return set(sa.inspect(connection).get_view_names())


CALLED = {"truncated-svd": "components kept", "pyeit-greit": "pyEIT's lamb", "gauss-newton-noser": "λ", "x": "λ"}


def test_the_parameter_of_an_old_calibration_is_named_as_its_method_did(engine):
    schema.upgrade(engine, "0002")
    fill(engine, table_names(engine))
    tables = {table.name: table for table in reflected(engine)}
    row = {column.name: sample(column) for column in tables["calibrations"].columns}
    with writing(engine) as connection:
        for method in CALLED:
            if method != "x":  # the row that is there already
                connection.execute(tables["calibrations"].insert(), row | {"calibration": method, "method": method})
    before = sorted(content(engine)["calibrations"], key=repr)

    schema.upgrade(engine, "0003")
    with reading(engine) as connection:
        found = connection.execute(
            sa.text("SELECT method, regularisation_name, regularisation_criterion FROM calibrations")
        )
        assert {method: (name, criterion) for method, name, criterion in found} == {
            method: (name, "") for method, name in CALLED.items()
        }
    schema.downgrade(engine, "0002")
    assert sorted(content(engine)["calibrations"], key=repr) == before


@pytest.mark.parametrize(
    ("before", "after", "tables", "columns", "said"),
    [
        ("0003", "0004", set(), "noise_weighting, weight_ratio FROM analyses", ("equal", None)),
        ("0004", "0005", {"calibration_forces"}, "no_force FROM calibrations", ("",)),
        ("0005", "0006", set(), "eased FROM loads", (None,)),
        ("0006", "0007", CHECKS, "notes FROM instruments", (None,)),
        ("0008", "0009", CHANGES, "COUNT(*) FROM runs", (1,)),
        ("0010", "0011", {LINKS}, "chain FROM runs", (None,)),
    ],
)
def test_rows_of_before_say_nothing_of_what_came_later_which_is_lost_on_the_way_back(
    engine, before, after, tables, columns, said
):
    schema.upgrade(engine, before)
    fill(engine, table_names(engine))
    rows = content(engine)
    schema.upgrade(engine, after)
    assert {name: content(engine)[name] for name in tables} == {name: [] for name in tables}
    with reading(engine) as connection:
        assert [tuple(row) for row in connection.execute(sa.text(f"SELECT {columns}"))] == [said]
    fill(engine, tables)
    assert {name: len(content(engine)[name]) for name in tables} == dict.fromkeys(tables, 1)
    schema.downgrade(engine, before)
    assert content(engine) == rows


@pytest.mark.filterwarnings("ignore:Cannot correctly sort tables:sqlalchemy.exc.SAWarning")
def test_calibrations_of_before_keep_their_rows_and_files_are_lost_on_the_way_back(engine):
    schema.upgrade(engine, "0011")
    fill(engine, table_names(engine))
    before = content(engine)
    schema.upgrade(engine, "0012")
    (row,) = before["calibrations"]
    assert content(engine) == before | {"calibrations": [(*row, None, None)]}
    tables = {table.name: table for table in reflected(engine)}
    searched = ("run", "analysis", "serial", "issued_at", "content_sha256", "record_sha256", "file", "file_sha256")
    issued = {name: sample(tables["calibrations"].columns[name]) for name in searched} | {"calibration": "y"}
    baseline = {column.name: sample(column) for column in tables["calibration_baselines"].columns}
    with writing(engine) as connection:
        connection.execute(tables["calibrations"].insert(), issued)
        connection.execute(tables["calibrations"].update().values(superseded_by="y"))
        connection.execute(tables["calibration_baselines"].insert(), baseline | {"calibration": "y"})
    with reading(engine) as connection:
        files = sa.text("SELECT scale, no_force, file_sha256 FROM calibrations WHERE calibration = 'y'")
        assert connection.execute(files).one() == (None, None, "x")
    schema.downgrade(engine, "0011")
    lost = {column.name: value for column, value in zip(tables["calibrations"].columns, row, strict=False)}
    lost["superseded_by"] = None
    assert content(engine) == before | {"calibrations": [tuple(lost.values())]}
    with closing(engine.raw_connection()) as raw, pytest.raises(Exception, match=r"(?i)not.null"):
        raw.cursor().execute("UPDATE calibrations SET scale = NULL")


REFUSED = {"kind": "run", "station": "s", "station_sha256": "", "centre_sha256": "", "run": None, "why": "so"}


@pytest.mark.filterwarnings("ignore:Cannot correctly sort tables:sqlalchemy.exc.SAWarning")
def test_what_was_changed_in_its_row_is_added_beside_it_and_changed_again_on_the_way_back(engine):
    schema.upgrade(engine, "0021")
    fill(engine, table_names(engine))
    tables = {table.name: table for table in reflected(engine)}
    calibration = {column.name: sample(column) for column in tables["calibrations"].columns}
    at = [dt.datetime(2026, 11, day) for day in (1, 2)]
    with writing(engine) as connection:
        connection.execute(tables["sync_refusals"].delete())
        connection.execute(tables["runs"].update().values(chain=None))  # of a chained one, a link must name them
        connection.execute(tables["calibrations"].update().values(superseded_by=None))
        connection.execute(tables["calibrations"].insert(), calibration | {"calibration": "y", "superseded_by": None})
        connection.execute(
            tables["calibrations"].update().where(sa.text("calibration = 'x'")).values(superseded_by="y")
        )
        for item, settled_at in (("open", None), ("settled", at[1])):
            row = REFUSED | {"item": item, "noted_at": at[0], "settled_at": settled_at}
            connection.execute(tables["sync_refusals"].insert(), row)
    before = content(engine)

    schema.upgrade(engine)
    assert cells(engine, "v_calibrations", "calibration", "serial") == [("y", "x")]
    assert cells(engine, "sync_settlements", "kind", "item") == [("run", "settled")]
    assert cells(engine, "phase_ends", "run", "phase", "ended_s") == [("x", 7, 0.1 + 0.2)]
    with writing(engine) as connection:
        refused = sa.table("sync_refusals", *map(sa.column, [*REFUSED, "item", "noted_at"]))
        again = REFUSED | {"item": "settled", "noted_at": dt.datetime(2026, 11, 3)}
        connection.execute(refused.insert(), again)

    schema.downgrade(engine, "0021")
    for name in ("calibrations", "phases"):
        again = sa.select(*(sa.column(one.name, one.type) for one in tables[name].columns)).select_from(
            sa.table(name)
        )
        with reading(engine) as connection:
            assert sorted(map(tuple, connection.execute(again)), key=repr) == sorted(before[name], key=repr), name
    assert dict(map(tuple, cells(engine, "sync_refusals", "item", "settled_at"))) == {"open": None, "settled": None}
    with reading(engine) as connection:  # from now on it is when the first run of the sensor began
        seen = "SELECT count(*) FROM sensors JOIN runs USING (serial) WHERE first_seen = started_at"
        assert connection.exec_driver_sql(seen).scalar() == 1


def cells(engine, table, *names):
    with reading(engine) as connection:
        return connection.execute(sa.text(f"SELECT {', '.join(names)} FROM {table} ORDER BY 1, 2")).all()


def test_stored_runs_take_less_room_and_keep_their_chain_and_every_bit_up_and_down(engine):
    schema.upgrade(engine)
    store = Repository(engine, lambda: dt.datetime.now(dt.UTC))
    run = store.new_id()
    journalled(store, short_run(run))
    measured = store.runs.load(run)
    compact, links = content(engine), cells(engine, LINKS, "number", "document", "sha256")

    schema.downgrade(engine, "0016")
    arrays = "frames * drives * measures", "voltages", "reading_time_s", "flags", "time_s", "frames", "sha256"
    before = content(engine)
    for readings, voltages, own, flags, time_s, frames, sha256 in cells(engine, "frame_blocks", *arrays):
        assert (len(voltages), len(flags), len(time_s)) == (8 * readings, readings, 8 * frames)
        assert own is None or len(own) == 8 * readings
        assert len(sha256) == 64
    assert [(*place, bytes.fromhex(sha)) for *place, sha in cells(engine, LINKS, "number", "document", "sha256")] == [
        tuple(row) for row in links
    ]
    schema.upgrade(engine)
    again = content(engine)
    # Which runs were begun here is forgotten, and runs are announced again to a central database, at a later time.
    assert (len(compact.pop("runs_begun")), again.pop("runs_begun")) == (1, [])
    assert [row[:3] for row in again.pop("outbox")] == [row[:3] for row in compact.pop("outbox")]
    assert again == compact
    again = store.runs.load(run)
    assert again.chain.chained
    for phase, same in zip(measured.phases, again.phases, strict=True):
        for name in ("time_s", "voltages", "flags", "reading_time_s"):
            one, other = getattr(phase.frames, name), getattr(same.frames, name)
            assert (one is None and other is None) or one.tobytes() == other.tobytes()
    schema.downgrade(engine, "0016")
    assert content(engine) == before


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


def test_a_new_database_has_the_tables_that_the_migrations_make(engine, monkeypatch, at_once):
    schema.upgrade(engine)
    migrated = described(engine)
    assert schema.VERSION_TABLE in migrated
    assert set(views.VIEWS) <= set(migrated)
    with writing(engine) as connection:
        views.drop_views(connection)
        for table in [*reversed(Base.metadata.sorted_tables), sa.table(schema.VERSION_TABLE)]:
            connection.execute(sa.text(f"DROP TABLE {table.name}"))
    monkeypatch.setattr(schema, "_create", at_once)
    schema.upgrade(engine)
    assert schema.read_version(engine) == schema.SchemaVersion(schema.Age.CURRENT, schema.HEAD)
    assert described(engine) == migrated


def test_a_new_database_can_be_taken_back_to_every_schema(engine, monkeypatch, at_once):
    monkeypatch.setattr(schema, "_create", at_once)
    schema.upgrade(engine)
    for revision in reversed(schema.REVISIONS[:-1]):
        schema.downgrade(engine, revision)
        assert view_names(engine) == set()
    schema.downgrade(engine, "base")
    assert table_names(engine) == set()
    schema.upgrade(engine)  # Alembic leaves an empty table of versions
    assert schema.read_version(engine).age is schema.Age.CURRENT


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


def test_a_migration_that_fails_half_way_leaves_no_trace(engine):
    schema.upgrade(engine, "0001")
    with writing(engine) as connection:
        connection.exec_driver_sql("CREATE TABLE calibration_settling (in_the_way INTEGER)")
    before = table_names(engine)
    with pytest.raises(StoreError, match="calibration_settling"):
        schema.upgrade(engine)
    assert table_names(engine) == before
    assert schema.read_version(engine).revision == "0001"


def test_the_programs_list_of_revisions_is_the_scripts():
    config = Config()
    config.set_main_option("script_location", "cbsr_qa._migrations:")
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
