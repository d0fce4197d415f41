"""Rows of runs as the driver returns them, by the documents they belong to."""

from collections.abc import Collection, Sequence
from functools import cache
from typing import Any

from sqlalchemy import (
    JSON,
    Boolean,
    ColumnElement,
    Connection,
    Integer,
    LargeBinary,
    Select,
    Table,
    and_,
    bindparam,
    func,
    select,
    type_coerce,
)
from sqlalchemy.types import NullType

from cbsr_qa.store.chain.check import select_run
from cbsr_qa.store.chain.run_documents import KEYS
from cbsr_qa.store.tables.runs import Base
from cbsr_qa.store.types import Digest, Instant, Whole


def within(table: Table, run: str, keys: Collection[str]) -> ColumnElement[bool]:
    """Condition that holds for the rows of some documents, and for few others."""
    names = KEYS[table.name]
    if not names:
        return and_(select_run(table, run))
    if not isinstance(table.c[names[0]].type, Whole):
        return and_(table.c[names[0]].in_(list(keys)))
    phases = {int(key) for key in {key.partition("/")[0] for key in keys}}
    conditions = [select_run(table, run), table.c[names[0]].between(min(phases), max(phases))]
    if len(names) > 1 and len(phases) == 1:
        blocks = [int(key.rpartition("/")[2]) for key in keys]
        conditions.append(table.c[names[1]].between(min(blocks), max(blocks)))
    return and_(*conditions)


def counts_of(connection: Connection, run: str, names: Sequence[str]) -> dict[str, int]:
    """Return how many rows a run has in some tables, in one query."""
    counts = connection.execute(_counting(tuple(names)), {"of_run": run}).one()
    return dict(zip(names, counts, strict=True))


@cache
def _counting(names: tuple[str, ...]) -> Select[Any]:
    metadata = Base.metadata.tables
    run: Any = bindparam("of_run")
    counted = [
        select(func.count()).select_from(metadata[name]).where(select_run(metadata[name], run)) for name in names
    ]
    return select(*(query.scalar_subquery() for query in counted))


def is_bytes(column: Any) -> bool:
    """Whether a column holds bytes."""
    return isinstance(column.type, LargeBinary)


@cache
def raw_select(table: Table) -> Select[Any]:
    """Select whole rows as the driver returns them, which is quick: digests detect cells of a wrong type."""
    return select(*(_raw(table, column) for column in table.columns))


def _raw(table: Table, column: Any) -> ColumnElement[Any]:
    if isinstance(column.type, (JSON, Instant)):
        return column  # type: ignore[no-any-return]
    if isinstance(column.type, Boolean):
        return type_coerce(column, Integer).label(column.name)
    return type_coerce(column, NullType()).label(column.name)


def columns_of(table: Table, rows: Sequence[Sequence[Any]]) -> dict[str, Sequence[Any]]:
    """Return the cells of rows from :func:`raw_select` by column, digests as hexadecimal digits."""
    cells = zip(*rows, strict=True) if rows else [()] * len(table.columns)
    return {
        column.name: _digits(column_cells) if isinstance(column.type, Digest) else column_cells
        for column, column_cells in zip(table.columns, cells, strict=True)
    }


def _digits(cells: Sequence[Any]) -> Sequence[str | None]:
    """Return digests as hexadecimal digits. TypeError if a cell is not 32 bytes."""
    foreign = [cell for cell in cells if cell is not None and (type(cell) is not bytes or len(cell) != 32)]
    if foreign:
        raise TypeError("a cell is not a digest of 32 bytes")
    return [None if cell is None else cell.hex() for cell in cells]
