"""Rows are only added: ends of phases and settled refusals have rows of their own; each run names the one before it.

What was stored beside is derived: a later calibration of a sensor supersedes the earlier ones, and the first run of a
sensor says when it was first seen.
"""

import sqlalchemy as sa
from alembic import op

from cbsr_qa.domain.errors import StoreError

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None

_PHASE = ["run", "phase"]
_SAME_PHASE = "e.run = phases.run AND e.phase = phases.phase"
_REFERENCE = "CONSTRAINT fk_calibrations_superseded_by_calibrations REFERENCES calibrations (calibration)"
_KEY = ["kind", "item", "station", "station_sha256", "centre_sha256"]


def upgrade() -> None:
    op.create_table(
        "phase_ends",
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("phase", sa.Integer(), nullable=False),
        sa.Column("ended_s", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(_PHASE, ["phases.run", "phases.phase"], name=op.f("fk_phase_ends_run_phase_phases")),
        sa.PrimaryKeyConstraint(*_PHASE, name=op.f("pk_phase_ends")),
        sqlite_with_rowid=False,
    )
    op.execute("INSERT INTO phase_ends SELECT run, phase, ended_s FROM phases WHERE ended_s IS NOT NULL")
    op.drop_column("phases", "ended_s")
    op.drop_column("sensors", "first_seen")
    _without("calibrations", "superseded_by")
    op.create_table(
        "sync_settlements",
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("item", sa.String(length=64), nullable=False),
        sa.Column("settled_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("kind", "item", "settled_at", name=op.f("pk_sync_settlements")),
    )
    op.execute(
        "INSERT INTO sync_settlements SELECT DISTINCT kind, item, settled_at FROM sync_refusals"
        " WHERE settled_at IS NOT NULL"
    )
    _without("sync_refusals", "settled_at", key=[*_KEY, "noted_at"])
    op.add_column("runs", sa.Column("before_run", sa.String(length=36), nullable=True))
    op.add_column("runs", sa.Column("before_link", sa.Integer(), nullable=True))
    op.add_column("runs", sa.Column("before_sha256", sa.LargeBinary(length=32), nullable=True))
    op.create_index(op.f("ix_runs_before_run"), "runs", ["before_run"])
    op.create_table(
        "runs_begun",
        sa.Column("number", sa.Integer(), nullable=False, autoincrement=False),
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("sha256", sa.LargeBinary(length=32), nullable=False),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_runs_begun")),
        sa.UniqueConstraint("run", name=op.f("uq_runs_begun_run")),
        sqlite_with_rowid=False,
    )
    # Programs of earlier schemas send ends of phases as columns.
    _accept(revision)


def downgrade() -> None:
    begun = op.get_bind().execute(sa.text("SELECT count(*) FROM runs WHERE before_run IS NOT NULL")).scalar()
    if begun:  # their first links cover columns that the earlier schema lacks
        raise StoreError(
            f"runs that name the run before them: {begun}; an earlier schema does not",
            remedy="restore the copy that was made before the upgrade, or use this version",
        )
    _accept("0020")
    op.drop_table("runs_begun")
    op.drop_index(op.f("ix_runs_before_run"), table_name="runs")
    op.drop_column("runs", "before_sha256")
    op.drop_column("runs", "before_link")
    op.drop_column("runs", "before_run")
    op.add_column("sync_refusals", sa.Column("settled_at", sa.DateTime(timezone=True), nullable=True))
    same = "s.kind = sync_refusals.kind AND s.item = sync_refusals.item AND s.settled_at > sync_refusals.noted_at"
    op.execute(f"UPDATE sync_refusals SET settled_at = (SELECT min(settled_at) FROM sync_settlements s WHERE {same})")
    newer = " AND ".join(f"n.{name} = sync_refusals.{name}" for name in _KEY)
    op.execute(
        "DELETE FROM sync_refusals WHERE EXISTS"
        f" (SELECT 1 FROM sync_refusals n WHERE {newer} AND n.noted_at > sync_refusals.noted_at)"
    )
    _without("sync_refusals", "", key=_KEY)
    op.drop_table("sync_settlements")
    op.execute(f"ALTER TABLE calibrations ADD COLUMN superseded_by VARCHAR(36) {_REFERENCE}")
    later = "SELECT min(c.calibration) FROM calibrations c WHERE c.serial = calibrations.serial"
    op.execute(f"UPDATE calibrations SET superseded_by = ({later} AND c.calibration > calibrations.calibration)")
    unknown = sa.text("'1970-01-01 00:00:00.000000'")
    first_seen = sa.Column("first_seen", sa.DateTime(timezone=True), nullable=False, server_default=unknown)
    op.add_column("sensors", first_seen)
    first = "SELECT min(started_at) FROM runs WHERE runs.serial = sensors.serial"
    op.execute(f"UPDATE sensors SET first_seen = coalesce(({first}), first_seen)")
    op.add_column("phases", sa.Column("ended_s", sa.Double(), nullable=True))
    op.execute(f"UPDATE phases SET ended_s = (SELECT e.ended_s FROM phase_ends e WHERE {_SAME_PHASE})")
    op.drop_table("phase_ends")


def _accept(oldest_schema: str) -> None:
    op.execute("DELETE FROM sync_accepts")
    op.execute(f"INSERT INTO sync_accepts (oldest_schema) VALUES ('{oldest_schema}')")


def _without(name: str, column: str, key: list[str] | None = None) -> None:
    """Take a column from a table, and give the table another primary key."""
    connection = op.get_bind()
    table = sa.Table(name, sa.MetaData(), autoload_with=connection)
    if connection.dialect.name == "sqlite":
        _make_again(connection, table, column, key or list(table.primary_key.columns.keys()))
        return
    if column:
        op.drop_column(name, column)  # with its reference
    if key:
        op.drop_constraint(f"pk_{name}", name, type_="primary")
        op.create_primary_key(f"pk_{name}", name, key)


def _make_again(connection: sa.Connection, table: sa.Table, without: str, key: list[str]) -> None:
    """Make a table of SQLite again under its own name, which changes neither references nor keys.

    So references to it hold at the end of the transaction, when they are checked.
    """
    columns = [one for one in table.columns if one.name != without]
    references = [one for one in table.foreign_key_constraints if without not in one.column_keys]
    parts = [
        *(sa.Column(one.name, one.type, nullable=one.nullable, server_default=one.server_default) for one in columns),
        *(
            sa.ForeignKeyConstraint(one.column_keys, [to.target_fullname for to in one.elements], name=one.name)
            for one in references
        ),
        *(sa.Index(one.name, *one.columns.keys(), unique=one.unique) for one in table.indexes),
        sa.PrimaryKeyConstraint(*key, name=f"pk_{table.name}"),
    ]
    connection.exec_driver_sql("PRAGMA defer_foreign_keys = ON")
    connection.exec_driver_sql(f"CREATE TEMPORARY TABLE rows_of_before AS SELECT * FROM {table.name}")
    table.drop(connection)
    table.metadata.remove(table)
    sa.Table(table.name, table.metadata, *parts).create(connection)
    names = ", ".join(f'"{one.name}"' for one in columns)
    connection.exec_driver_sql(f"INSERT INTO {table.name} ({names}) SELECT {names} FROM rows_of_before")
    connection.exec_driver_sql("DROP TABLE rows_of_before")
