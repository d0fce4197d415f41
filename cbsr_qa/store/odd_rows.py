"""Rows read cell by cell: a row with a cell that its column cannot hold is skipped and named; others are read.

One such row would stop any query that reads it. SQLite keeps bytes in a column of text, and PostgreSQL has moments
that no calendar has (``infinity``); anybody who may add rows can store one.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, select

from cbsr_qa.store.damage import FOREIGN_CELL, cell_reader, raw_cell
from cbsr_qa.store.tables.runs import Base

#: Longest text of a cell in a message.
_MAX_CELL_LENGTH: Final = 60


@dataclass(frozen=True, slots=True)
class OddRow:
    """A row with a cell that its column cannot hold.

    Parameters
    ----------
    words : the problem in words: table, key and cell.
    cells : cells that can be read, by column.
    """

    words: str
    cells: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class RowsApart:
    """Rows of one table in the order of their keys: those that can be read, and those that cannot."""

    rows: tuple[dict[str, Any], ...]
    odd: tuple[OddRow, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        return tuple(row.words for row in self.odd)


def read_rows_apart(connection: Connection, model: type[Base], *conditions: ColumnElement[bool]) -> RowsApart:
    """Read rows of a table; those with an odd cell are set apart.

    Parameters
    ----------
    conditions : conditions, compared with the cells as they are stored.
    """
    table = Base.metadata.tables[model.__tablename__]
    readers = {column.name: cell_reader(connection, column) for column in table.columns}
    raw_query = select(*(raw_cell(connection, column) for column in table.columns))
    rows: list[dict[str, Any]] = []
    odd_rows: list[OddRow] = []
    with keep_odd_text(connection):
        raw_rows = connection.execute(raw_query.where(*conditions).order_by(*table.primary_key)).mappings().all()
    for row in raw_rows:
        values: dict[str, Any] = {}
        unread_columns: list[str] = []
        for name, read_cell in readers.items():
            try:
                values[name] = read_cell(row[name])
            except FOREIGN_CELL:
                unread_columns.append(name)
        if unread_columns:
            keys = {column.name: row[column.name] for column in table.primary_key}
            texts = {name: cell if isinstance(cell, str) else repr(cell) for name, cell in keys.items()}
            key = ", ".join(f"{name} {text[:_MAX_CELL_LENGTH]}" for name, text in texts.items())
            odd_cells = ", ".join(f"{name} holds {repr(row[name])[:_MAX_CELL_LENGTH]}" for name in unread_columns)
            odd_rows.append(OddRow(f"{table.name} ({key}): {odd_cells}, which is not a value of that column", values))
        else:
            rows.append(values)
    return RowsApart(tuple(rows), tuple(odd_rows))


@contextmanager
def keep_odd_text(connection: Connection) -> Iterator[None]:
    """Read text that is not UTF-8 as bytes, which a text column refuses; only SQLite stores such text."""
    if connection.dialect.name != "sqlite":
        yield
        return
    driver: Any = connection.connection.dbapi_connection
    earlier_factory, driver.text_factory = driver.text_factory, _decode
    try:
        yield
    finally:
        driver.text_factory = earlier_factory


def _decode(text: bytes) -> str | bytes:
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text
