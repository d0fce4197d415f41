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
    func,
    null,
    select,
    type_coerce,
)
from sqlalchemy.types import NullType

from cbsr_qa.store.chain import KEYS, of_run
from cbsr_qa.store.tables import Base
from cbsr_qa.store.types import Digest, Instant, Whole


def within(table: Table, run: str, keys: Collection[str]) -> ColumnElement[bool]:
    """Condition that holds for the rows of some documents, and for few others."""
    names = KEYS[table.name]
    if not names:
        return and_(of_run(table, run))
    if not isinstance(table.c[names[0]].type, Whole):
        return and_(table.c[names[0]].in_(list(keys)))
    parts = [tuple(map(int, key.split("/"))) for key in keys]
    first, last = min(parts), max(parts)
    wanted = [of_run(table, run), table.c[names[0]].between(first[0], last[0])]
    if len(names) > 1 and first[0] == last[0]:
        wanted.append(table.c[names[1]].between(first[1], last[1]))
    return and_(*wanted)


def counts_of(connection: Connection, run: str, names: Sequence[str]) -> dict[str, int]:
    """Return how many rows a run has in some tables, in one query."""
    metadata = Base.metadata.tables
    counted = [
        select(func.count()).select_from(metadata[name]).where(of_run(metadata[name], run)).scalar_subquery()
        for name in names
    ]
    return dict(zip(names, connection.execute(select(*counted)).one(), strict=True))


def is_bytes(column: Any) -> bool:
    """Whether a column holds bytes."""
    return isinstance(column.type, LargeBinary)


@cache
def raw_select(table: Table) -> Select[Any]:
    """Select whole rows as the driver returns them, which is quick; digests detect cells of a wrong type."""
    return select(*(_raw(table, column) for column in table.columns))


def _raw(table: Table, column: Any) -> ColumnElement[Any]:
    if (table.name, column.name) in (("calibrations", "superseded_by"), ("phases", "ended_s")):
        return null().label(column.name)  # filled in later, at the centre too
    if isinstance(column.type, (JSON, Instant, Digest)):
        return column  # type: ignore[no-any-return]
    if isinstance(column.type, Boolean):
        return type_coerce(column, Integer).label(column.name)
    return type_coerce(column, NullType()).label(column.name)
