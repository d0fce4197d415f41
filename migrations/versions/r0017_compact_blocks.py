"""Frames and samples in half the room: arrays deflated, digests as bytes, links without a second index."""

import math
from collections.abc import Iterator
from typing import Any

import sqlalchemy as sa
from alembic import op

from cbsr_qa.store.types import compact, restore

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

_AT_ONCE = 500
_FEW = "kind NOT IN ('frame_blocks', 'sample_blocks', 'steps')"
_INDEX = "ix_run_links_run_kind_document"
#: Columns with a digest.
_DIGESTS = ("content_sha256", "sha256", "mac")
#: Tables with arrays: their columns, with bytes of a number and whether its steps are stored.
_FRAMES = {
    "time_s": (8, True),
    "voltages": (8, False),
    "flags": (1, False),
    "reading_time_s": (8, True),
}
_ARRAYS = {
    "frame_blocks": _FRAMES,
    "station_check_frames": _FRAMES,
    "sample_blocks": {"time_s": (8, True), "sample_values": (8, False)},
    "run_links": {},
}


def _block(digest: sa.types.TypeEngine[Any]) -> list[sa.Column[object]]:
    return [
        sa.Column("frames", sa.Integer(), nullable=False),
        sa.Column("drives", sa.Integer(), nullable=False),
        sa.Column("measures", sa.Integer(), nullable=False),
        sa.Column("unit", sa.String(length=16), nullable=False),
        sa.Column("current_a", sa.Double(), nullable=True),
        sa.Column("first_s", sa.Double(), nullable=False),
        sa.Column("last_s", sa.Double(), nullable=False),
        sa.Column("time_s", sa.LargeBinary(), nullable=False),
        sa.Column("voltages", sa.LargeBinary(), nullable=False),
        sa.Column("flags", sa.LargeBinary(), nullable=False),
        sa.Column("reading_time_s", sa.LargeBinary(), nullable=True),
        sa.Column("sha256", digest, nullable=False),
    ]


def _of_phase(table: str) -> list[sa.schema.SchemaItem]:
    return [
        sa.Column("run", sa.String(length=36), nullable=False),
        sa.Column("phase", sa.Integer(), nullable=False),
        sa.Column("block", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["run", "phase"], ["phases.run", "phases.phase"], name=f"fk_{table}_run_phase_phases"
        ),
        sa.PrimaryKeyConstraint("run", "phase", "block", name=f"pk_{table}"),
    ]


def _tables(digest: sa.types.TypeEngine[Any]) -> dict[str, list[sa.schema.SchemaItem]]:
    """The columns and constraints of each table."""
    checked = "station_checks"
    return {
        "frame_blocks": [*_of_phase("frame_blocks"), *_block(digest)],
        "sample_blocks": [
            *_of_phase("sample_blocks"),
            sa.Column("channel", sa.Text(), nullable=False),
            sa.Column("unit", sa.String(length=16), nullable=False),
            sa.Column("samples", sa.Integer(), nullable=False),
            sa.Column("time_s", sa.LargeBinary(), nullable=False),
            sa.Column("sample_values", sa.LargeBinary(), nullable=False),
            sa.Column("sha256", digest, nullable=False),
        ],
        "station_check_frames": [
            sa.Column("check_id", sa.String(length=36), nullable=False),
            sa.Column("resistances_ohm", sa.JSON(), nullable=False),
            *_block(digest),
            sa.ForeignKeyConstraint(
                ["check_id"], [f"{checked}.check_id"], name=f"fk_station_check_frames_check_id_{checked}"
            ),
            sa.PrimaryKeyConstraint("check_id", name="pk_station_check_frames"),
        ],
        "run_links": [
            sa.Column("run", sa.String(length=36), nullable=False),
            sa.Column("number", sa.Integer(), nullable=False),
            sa.Column("kind", sa.String(length=32), nullable=False),
            sa.Column("document", sa.String(length=64), nullable=False),
            sa.Column("content_sha256", digest, nullable=False),
            sa.Column("sha256", digest, nullable=False),
            sa.Column("mac", digest, nullable=True),
            sa.ForeignKeyConstraint(["run"], ["runs.run"], name="fk_run_links_run_runs"),
            sa.PrimaryKeyConstraint("run", "number", name="pk_run_links"),
        ],
    }


def upgrade() -> None:
    op.drop_index(_INDEX, table_name="run_links")
    for table, content in _tables(sa.LargeBinary(length=32)).items():
        _rebuild(table, content, rowid=table not in ("sample_blocks", "run_links"), up=True)
    few = sa.text(_FEW)
    columns = ["run", "kind", "document"]
    op.create_index(_INDEX, "run_links", columns, unique=True, sqlite_where=few, postgresql_where=few)


def downgrade() -> None:
    op.drop_index(_INDEX, table_name="run_links")
    for table, content in _tables(sa.String(length=64)).items():
        _rebuild(table, content, rowid=True, up=False)
    op.create_index(_INDEX, "run_links", ["run", "kind", "document"], unique=True)


def _rebuild(table: str, content: list[sa.schema.SchemaItem], *, rowid: bool, up: bool) -> None:
    """Make a table anew and copy its rows; the chains cover what was measured, and stay valid."""
    old = f"{table}_of_before"
    op.rename_table(table, old)
    if op.get_bind().dialect.name == "postgresql":  # where names of constraints are those of indexes
        for item in content:
            if isinstance(item, sa.Constraint):
                op.drop_constraint(str(item.name), old)
    op.create_table(table, *content, sqlite_with_rowid=rowid)
    names = [item.name for item in content if isinstance(item, sa.Column)]
    for rows in _copied(table, names, up=up):
        op.get_bind().execute(_plain(table, names).insert(), rows)
    op.drop_table(old)


def _plain(table: str, names: list[str]) -> sa.TableClause:
    """A table whose cells come and go as they are, damaged ones too."""
    kinds = {"resistances_ohm": sa.JSON()}
    return sa.table(table, *(sa.column(name, kinds.get(name, sa.types.NullType())) for name in names))


def _copied(table: str, names: list[str], *, up: bool) -> Iterator[list[dict[str, object]]]:
    key = {"run", "phase", "block", "number", "check_id"}
    order: list[sa.ColumnElement[Any]] = [sa.column(name) for name in names if name in key]
    query = sa.select(_plain(f"{table}_of_before", names)).order_by(*order)
    for rows in op.get_bind().execute(query, execution_options={"yield_per": _AT_ONCE}).mappings().partitions():
        yield [_recoded(table, dict(row), up=up) for row in rows]


def _recoded(table: str, row: dict[str, object], *, up: bool) -> dict[str, object]:
    for name in set(_DIGESTS) & set(row):
        row[name] = (_as_bytes if up else _as_text)(row[name])
    for name, (width, steps) in _ARRAYS[table].items():
        cell, size = row[name], width * _numbers(row, name)
        if isinstance(cell, bytes):
            row[name] = _compact(cell, size, width, steps) if up else _restored(cell, size, width, steps)
    return row


def _numbers(row: dict[str, object], name: str) -> int:
    of_frame = ("drives", "measures") if name != "time_s" else ()
    counts = [row[one] for one in (("samples",) if "samples" in row else ("frames", *of_frame))]
    return math.prod(count if isinstance(count, int) else 0 for count in counts)


def _compact(cell: bytes, size: int, width: int, steps: bool) -> bytes:
    return compact(cell, width, steps=steps) if 0 < len(cell) == size else cell  # else damaged: its digest says so


def _restored(cell: bytes, size: int, width: int, steps: bool) -> bytes:
    try:
        return restore(cell, size, width, steps=steps)
    except ValueError:
        return cell


def _as_bytes(cell: object) -> object:
    """A digest in bytes; a damaged one as it was, in UTF-8."""
    if not isinstance(cell, str):
        return cell
    if len(cell) == 64 and not set(cell) - set("0123456789abcdef"):
        return bytes.fromhex(cell)
    return cell.encode("utf-8", "surrogateescape")


def _as_text(cell: object) -> object:
    if not isinstance(cell, bytes):
        return cell
    return cell.hex() if len(cell) == 32 else cell.decode("utf-8", "replace")
