"""Translation of database errors into one clear message with a remedy."""

import errno
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from typing import Any, Final, TypeVar

from sqlalchemy import (
    JSON,
    URL,
    Column,
    ColumnElement,
    Connection,
    DateTime,
    LargeBinary,
    Table,
    Text,
    cast,
    select,
    type_coerce,
)
from sqlalchemy.exc import DataError, DBAPIError, SQLAlchemyError, StatementError
from sqlalchemy.types import NullType, TypeDecorator

from cbsr_qa.domain.errors import CbsrError, StoreError

#: Errors of a cell that has another type than its column, JSON without end, or a moment that no calendar has.
FOREIGN_VALUE: Final = (AttributeError, IndexError, KeyError, OverflowError, RecursionError, TypeError, ValueError)
#: Errors of reading a cell: the driver raises the last one, also for some values that a query looks for.
FOREIGN_CELL: Final = (*FOREIGN_VALUE, DataError)

#: Columns of JSON that hold an object; others hold a list.
_OBJECTS: Final = frozenset({"setting", "settings", "step", "kernels"})
#: The column of versions, whose list is of pairs.
_VERSIONS: Final = "software"

#: Part of the driver's message → (what it means, what to do). The first that fits is used.
_KNOWN = (
    ("file is not a database", "is not a database", "name another file, or restore it from a copy"),
    ("malformed", "is damaged or cut off", "restore it from a copy; the damaged file is left as it is"),
    ("unable to open database file", "cannot be opened", "check that its folder exists and may be written to"),
    ("readonly database", "is read-only", "make the file and its folder writable, or use another database"),
    ("read-only transaction", "is read-only", "connect as a user with write access, or use another database"),
    ("permission denied", "refuses this user", "grant the user the right to read and write its tables"),
    ("database is locked", "is in use by another program", "end that program, or try again"),
    ("disk is full", "cannot grow: the disk is full", "free space; everything committed so far is kept"),
    ("no space left", "cannot grow: the disk is full", "free space; everything committed so far is kept"),
    (
        "disk i/o error",
        "cannot be read or written: the disk fails, or a quota or file size limit is reached",
        "check the disk and the limits (quota, ulimit -f); committed data is kept unless the disk loses it",
    ),
    ("authentication failed", "refuses the user or the password", "check both in the database URL"),
    ("fatal:  role", "refuses the user", "check the user in the database URL, or create its role"),
    ("does not exist", "does not exist", "create it, or correct its name in the database URL"),
    ("connection refused", "does not answer", "start the server, or correct its address in the database URL"),
    ("could not translate host", "has an unknown host", "correct its address in the database URL"),
    ("failed to resolve host", "has an unknown host", "correct its address in the database URL"),
    ("server closed the connection", "closed the connection", "check the server; all committed data is kept"),
    ("connection is lost", "closed the connection", "check the server; all committed data is kept"),
    ("connection is closed", "closed the connection", "check the server; all committed data is kept"),
    ("timeout expired", "does not answer", "start the server, or correct its address in the database URL"),
    ("ssl syscall error", "closed the connection", "check the server; all committed data is kept"),
    ("consuming input failed", "closed the connection", "check the server; all committed data is kept"),
    ("terminating connection", "closed the connection", "check the server; everything committed so far is kept"),
)


_Word = TypeVar("_Word", bound=StrEnum)


class OddCellError(StoreError):
    """A cell holds a value that its column cannot; this row cannot be read, others can."""


def read_word(words: type[_Word], value: Any, column: str, row: str) -> _Word:
    """Return a stored text as a member of its column's enumeration.

    Parameters
    ----------
    column : name of the column with its table, e.g. ``"analyses.outcome"``.
    row : key of the row in words, e.g. ``"analysis 0199…"``.

    Raises
    ------
    StoreError
        If it is not a member.
    """
    try:
        return words(value)
    except ValueError:
        raise StoreError(
            f"the database is damaged: {row} has {column} {str(value)[:64]!r}; allowed: {', '.join(words)}",
            remedy="restore the database from a copy; the row is left unchanged",
        ) from None


def name_database(url: URL) -> str:
    """Write a URL with its password hidden, or the path of a SQLite file."""
    if url.get_backend_name() == "sqlite":
        return f"database {url.database or 'in memory'}"
    return f"database {hide_password(url)}"


def hide_password(url: URL) -> str:
    """Return a URL with its password hidden, in its query too."""
    hidden = {name: "***" for name in url.query if "password" in name.lower()}
    return url.update_query_dict(hidden).render_as_string(hide_password=True).replace("%2A%2A%2A", "***")


def address(url: URL) -> str:
    """Return the value of ``--database`` for a database: a file's path, or the URL with its password hidden."""
    sqlite = url.get_backend_name() == "sqlite"
    return str(url.database) if sqlite else hide_password(url)


@contextmanager
def translate_errors(url: URL) -> Iterator[None]:
    """Turn any database exception of the body into a StoreError that names it and gives a remedy."""
    try:
        yield
    except CbsrError:
        raise
    except UnicodeEncodeError as error:
        raise StoreError(
            f"{name_database(url)} cannot hold {error.object[:60]!r}: {error.reason}", remedy="write it in UTF-8"
        ) from error
    except (UnicodeDecodeError, OverflowError) as error:  # from Python's sqlite3, for bytes that SQLite never checks
        raise _driver_error(url, sqlite3.DatabaseError(f"malformed: {error}")) from error
    except sqlite3.Error as error:  # outside a statement, e.g. while a connection is set up
        raise _driver_error(url, error) from error
    except StatementError as error:
        if isinstance(error, DBAPIError) and error.orig is not None:
            raise _driver_error(url, error.orig) from error
        # A column type refuses a value.
        raise StoreError(f"{name_database(url)}: {_first_line(str(error.orig))}") from error
    except SQLAlchemyError as error:
        raise StoreError(f"{name_database(url)}: {_first_line(str(error))}") from error


def check_files(url: URL) -> None:
    """Raise StoreError if this process may open no more files: SQLite says only that it cannot open its own."""
    try:
        ends = os.pipe()
    except OSError as error:
        if error.errno not in (errno.EMFILE, errno.ENFILE):
            return
        limit = _file_limit() if error.errno == errno.EMFILE else ""
        raise StoreError(
            f"{name_database(url)} cannot be opened: {error.strerror}{limit}",
            remedy="raise the limit (ulimit -n); do without a plugin that lowers it, or leaves files open",
        ) from error
    for end in ends:
        os.close(end)


def _file_limit() -> str:
    try:
        import resource
    except ImportError:  # Windows
        return ""
    return f" in this process, whose limit is {resource.getrlimit(resource.RLIMIT_NOFILE)[0]}"


def _driver_error(url: URL, error: BaseException) -> StoreError:
    message = _first_line(str(error))
    if "unable to open database file" in message:
        try:
            check_files(url)
        except StoreError as full:
            return full
    if "could not decode to utf-8" in message.lower():
        return OddCellError(
            f"{name_database(url)} is damaged: {message}", remedy="cbsr-qa db check names rows that cannot be read"
        )
    for part, meaning, remedy in _KNOWN:
        if part in message.lower():
            return StoreError(f"{name_database(url)} {meaning} ({message})", remedy=remedy)
    return StoreError(f"{name_database(url)}: {message}")


def _first_line(text: str) -> str:
    return text.strip().splitlines()[0] if text.strip() else "no reason given"


def find_foreign_cell(
    connection: Connection, rows: Iterable[tuple[Table, ColumnElement[bool]]], what: str = "the database is damaged"
) -> OddCellError | None:
    """Return the error for the first cell that its column cannot hold; None without one.

    SQLite keeps bytes in a column of text, and text in one of numbers, dates or JSON.

    Parameters
    ----------
    rows : tables, and conditions that select their rows.
    what : start of the message.
    """
    for table, condition in rows:
        converters = [(table_column, cell_reader(connection, table_column)) for table_column in table.columns]
        raw_query = select(*(raw_cell(connection, table_column) for table_column in table.columns))
        for row in connection.execute(raw_query.where(condition)).mappings():
            for column, convert in converters:
                try:
                    convert(row[column.name])
                except FOREIGN_CELL:
                    key = ", ".join(
                        f"{table_column.name} {row[table_column.name]}" for table_column in table.primary_key
                    )
                    return OddCellError(
                        f"{what}: {table.name}.{column.name} ({key}) holds {repr(row[column.name])[:60]},"
                        " which is not a value of that column",
                        remedy="restore the database from a copy; the row is left unchanged",
                    )
    return None


def raw_cell(connection: Connection, column: Column[Any]) -> Any:
    """Select a column as it is stored; moments and JSON of PostgreSQL as text, before its driver converts them."""
    if connection.dialect.name == "postgresql" and isinstance(_unwrap_type(column), (DateTime, JSON)):
        return cast(column, Text).label(column.name)
    return type_coerce(column, NullType()).label(column.name)


def cell_reader(connection: Connection, column: Column[Any]) -> Callable[[Any], Any]:
    """Return the function that turns a cell of :func:`raw_cell` into a value; it raises :data:`FOREIGN_VALUE`."""
    kind = _unwrap_type(column)
    if connection.dialect.name == "postgresql":  # which checks types itself
        if isinstance(kind, JSON):
            return partial(_json_value, column.name, json.loads)
        if isinstance(kind, DateTime):
            return lambda cell: None if cell is None else datetime.fromisoformat(cell).astimezone(UTC)
        column_type: Any = column.type
        if isinstance(kind, LargeBinary) and isinstance(column_type, TypeDecorator):  # a digest
            return lambda cell: column_type.process_result_value(cell, connection.dialect)
        return lambda cell: cell
    convert = column.type.dialect_impl(connection.dialect).result_processor(connection.dialect, None)
    if convert is None:
        return lambda cell: cell
    return partial(_json_value, column.name, convert) if isinstance(kind, JSON) else convert


def _unwrap_type(column: Column[Any]) -> Any:
    return getattr(column.type, "impl", column.type)


def _json_value(name: str, convert: Callable[[Any], Any], cell: Any) -> Any:
    """Return JSON of the kind that a column holds, an object or a list; TypeError for another."""
    value = None if cell is None else convert(cell)
    if value is not None and not isinstance(value, dict if name in _OBJECTS else list):
        raise TypeError(f"it holds {type(value).__name__}")
    if (
        name == _VERSIONS
        and value is not None
        and not all(isinstance(item, list) and len(item) == 2 for item in value)
    ):
        raise TypeError("it holds other items than [package, version]")
    return value
