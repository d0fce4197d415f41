"""Rows in the binary form of COPY of PostgreSQL, written column by column: a third of the time of row by row.

Format: PostgreSQL documentation, COPY, "Binary Format". Numbers are big-endian; instants are microseconds since 2000.
"""

import json
import struct
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime, timedelta
from itertools import chain, repeat
from typing import Any, Final

from sqlalchemy import JSON, Boolean, Connection, LargeBinary, Table
from sqlalchemy.exc import DBAPIError

from cbsr_qa.store.types import Digest, FiniteDouble, Instant, Whole

_HEAD: Final = b"PGCOPY\n\xff\r\n\0" + bytes(8)
_END: Final = struct.pack("!h", -1)
_length: Final = struct.Struct("!i").pack
_NULL: Final = _length(-1)
_EPOCH: Final = datetime(2000, 1, 1, tzinfo=UTC)
#: Rows that are written at once: few enough for their bytes to stay in the processor's cache.
AT_ONCE: Final = 256
#: Words are encoded once where a column repeats each of them so often.
_MIN_REPETITIONS: Final = 4
#: Columns without an empty cell: how a length and a number are written, and the length.
_NUMBERS: Final = ((FiniteDouble, struct.Struct("!id").pack, 8), (Whole, struct.Struct("!ii").pack, 4))
#: How the cell of any other column is written; words are UTF-8.
_WRITERS: Final[tuple[tuple[type, Callable[[Any], bytes]], ...]] = (
    (FiniteDouble, struct.Struct("!d").pack),
    (Whole, struct.Struct("!i").pack),
    (Boolean, lambda value: b"\1" if value else b"\0"),
    (Instant, lambda value: struct.pack("!q", (value - _EPOCH) // timedelta(microseconds=1))),
    (JSON, lambda value: json.dumps(value).encode()),
    (LargeBinary, bytes),
    (Digest, bytes),
)


def copy_rows(connection: Connection, table: Table, rows: Sequence[Sequence[Any]]) -> None:
    """Store rows with COPY, ten times as fast as INSERT.

    Parameters
    ----------
    rows : digests are bytes, JSON is decoded.

    Raises
    ------
    DBAPIError
        If PostgreSQL refuses a row.
    OverflowError
        If a cell does not fit the type of its column.
    """
    columns = ", ".join(f'"{column.name}"' for column in table.columns)
    statement = f'COPY "{table.name}" ({columns}) FROM STDIN (FORMAT BINARY)'
    driver: Any = connection.connection.driver_connection
    dbapi: Any = connection.dialect.loaded_dbapi
    try:
        with driver.cursor() as cursor, cursor.copy(statement) as copy:
            copy.write(_HEAD)
            for first in range(0, len(rows), AT_ONCE):
                copy.write(encode_rows(table, rows[first : first + AT_ONCE]))
            copy.write(_END)
    except dbapi.Error as error:
        raise DBAPIError.instance(statement, None, error, dbapi.Error, dialect=connection.dialect) from error


def encode_rows(table: Table, rows: Sequence[Sequence[Any]]) -> bytes:
    """Return rows in the binary form, without its head and end."""
    parts: list[Iterable[bytes]] = [repeat(struct.pack("!h", len(table.columns)), len(rows))]
    for column, cells in zip(table.columns, zip(*rows, strict=True), strict=True):
        try:
            parts += _fields(column.type, cells)
        except (struct.error, TypeError, AttributeError) as error:
            raise OverflowError(f"{table.name}.{column.name}: {error}") from error
    return b"".join(chain.from_iterable(zip(*parts, strict=True)))


def _fields(kind: object, cells: Sequence[Any]) -> tuple[Iterable[bytes], ...]:
    """Return a column's cells as they are written, each after its length: together, or in two parts."""
    write = next((how for of_kind, how in _WRITERS if isinstance(kind, of_kind)), str.encode)
    if None in cells:
        written = [None if cell is None else write(cell) for cell in cells]
        return [_NULL if cell is None else _length(len(cell)) for cell in written], [cell or b"" for cell in written]
    for of_kind, pack, size in _NUMBERS:
        if isinstance(kind, of_kind):
            return (list(map(pack, repeat(size), cells)),)
    if write is str.encode and len(words := set(cells)) * _MIN_REPETITIONS <= len(cells):
        once = {word: _length(len(data)) + data for word in words for data in (str.encode(word),)}
        return (list(map(once.__getitem__, cells)),)
    whole = list(map(write, cells))
    return map(_length, map(len, whole)), whole
