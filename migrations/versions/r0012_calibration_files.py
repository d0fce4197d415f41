"""The file of a calibration as it was issued; what it holds is no longer written to columns as well."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

#: Searchable columns of old and new calibrations.
_SEARCHED = frozenset(
    {"calibration", "run", "analysis", "serial", "issued_at", "superseded_by", "content_sha256", "record_sha256"}
)
_ADDED: dict[str, sa.types.TypeEngine[Any]] = {"file": sa.LargeBinary(), "file_sha256": sa.String(length=64)}


def upgrade() -> None:
    for name, kind in _ADDED.items():
        op.add_column("calibrations", sa.Column(name, kind, nullable=True))
    _let_be_empty(True)


def downgrade() -> None:
    # Content only in files is lost, and so are rows that refer to it.
    rows, listed = _reflected("calibrations"), _reflected("calibration_baselines")
    of_files = sa.select(rows.c.calibration).where(rows.c.file.is_not(None))
    op.execute(rows.update().where(rows.c.superseded_by.in_(of_files)).values(superseded_by=None))
    op.execute(listed.delete().where(listed.c.calibration.in_(of_files)))
    op.execute(rows.delete().where(rows.c.file.is_not(None)))
    for name in _ADDED:
        op.drop_column("calibrations", name)
    _let_be_empty(False)


def _reflected(name: str) -> sa.Table:
    return sa.Table(name, sa.MetaData(), autoload_with=op.get_bind())


#: Columns that schema 0011 already allowed to be empty.
_COULD_BE_EMPTY = frozenset(
    {
        *("superseded_by", "measured_noise_figure", "size_ratio_low", "size_ratio_high", "stress_covariance"),
        *("strain_covariance", "force_low_n", "force_high_n", "temperature_low_c", "temperature_high_c"),
    }
)


def _let_be_empty(empty: bool) -> None:
    """Allow columns of calibrations to be empty, or forbid it again."""
    connection, table = op.get_bind(), _reflected("calibrations")
    changed = [c for c in table.columns if c.name not in _SEARCHED | _COULD_BE_EMPTY | _ADDED.keys()]
    if connection.dialect.name != "sqlite":
        for column in changed:
            op.alter_column("calibrations", column.name, nullable=empty, server_default=None)
        return
    # SQLite changes no column. The table is made again under its own name, so that references to it hold at the end
    # of the transaction, when they are checked.
    connection.exec_driver_sql("PRAGMA defer_foreign_keys = ON")
    connection.exec_driver_sql("CREATE TEMPORARY TABLE calibrations_of_before AS SELECT * FROM calibrations")
    for column in changed:
        column.nullable, column.server_default = empty, None
    table.drop(connection)
    table.create(connection)
    connection.exec_driver_sql("INSERT INTO calibrations SELECT * FROM calibrations_of_before")
    connection.exec_driver_sql("DROP TABLE calibrations_of_before")
