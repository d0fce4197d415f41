"""Database connections: SQLite set up for journalling, PostgreSQL with its defaults.

What a database says when something is wrong, turned into one clear message with what to do.
"""

import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from sqlalchemy import (
    URL,
    ColumnElement,
    Connection,
    Engine,
    RootTransaction,
    Table,
    create_engine,
    event,
    make_url,
    select,
    true,
    type_coerce,
)
from sqlalchemy.exc import ArgumentError, DBAPIError, OperationalError, SQLAlchemyError, StatementError
from sqlalchemy.types import NullType

from cbsr_qa.domain import CbsrError, StoreError

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
    ("does not exist", "does not exist", "create it, or correct its name in the database URL"),
    ("connection refused", "does not answer", "start the server, or correct its address in the database URL"),
    ("could not translate host", "has an unknown host", "correct its address in the database URL"),
    ("failed to resolve host", "has an unknown host", "correct its address in the database URL"),
    ("server closed the connection", "closed the connection", "check the server; all committed data is kept"),
    ("terminating connection", "closed the connection", "check the server; everything committed so far is kept"),
)


_Word = TypeVar("_Word", bound=StrEnum)


def stored(words: type[_Word], value: Any, column: str, row: str) -> _Word:
    """Return a stored text as a member of its column's enumeration.

    Parameters
    ----------
    column : with its table, e.g. ``"analyses.outcome"``.
    row : its key in words, e.g. ``"analysis 0199…"``.

    Raises
    ------
    StoreError
        If it is not one of them.
    """
    try:
        return words(value)
    except ValueError:
        raise StoreError(
            f"the database is damaged: {row} has {column} {str(value)[:64]!r}; allowed: {', '.join(words)}",
            remedy="restore the database from a copy; the row is left unchanged",
        ) from None


def shown(url: URL) -> str:
    """Write a URL with its password hidden; a SQLite file as its path."""
    if url.get_backend_name() == "sqlite":
        return f"database {url.database or 'in memory'}"
    return f"database {url.render_as_string(hide_password=True)}"


def address(url: URL) -> str:
    """Return what names a database to ``--database``: a file's path, or the URL with its password hidden."""
    sqlite = url.get_backend_name() == "sqlite"
    return str(url.database) if sqlite else url.render_as_string(hide_password=True)


@contextmanager
def translated(url: URL) -> Iterator[None]:
    """Turn any database exception of the body into a StoreError that names it and gives a remedy."""
    try:
        yield
    except CbsrError:
        raise
    except UnicodeEncodeError as error:
        raise StoreError(
            f"{shown(url)} cannot hold {error.object[:60]!r}: {error.reason}", remedy="write it in UTF-8"
        ) from error
    except (UnicodeDecodeError, OverflowError) as error:  # Python's sqlite3 itself, of bytes that SQLite never checks
        raise _driver_error(url, sqlite3.DatabaseError(f"malformed: {error}")) from error
    except sqlite3.Error as error:  # outside of a statement, e.g. while a connection is set up
        raise _driver_error(url, error) from error
    except StatementError as error:
        if isinstance(error, DBAPIError) and error.orig is not None:
            raise _driver_error(url, error.orig) from error
        # A value our column types refuse.
        raise StoreError(f"{shown(url)}: {_first_line(str(error.orig))}") from error
    except SQLAlchemyError as error:
        raise StoreError(f"{shown(url)}: {_first_line(str(error))}") from error


def _driver_error(url: URL, error: BaseException) -> StoreError:
    said = _first_line(str(error))
    for part, meaning, remedy in _KNOWN:
        if part in said.lower():
            return StoreError(f"{shown(url)} {meaning} ({said})", remedy=remedy)
    return StoreError(f"{shown(url)}: {said}")


def _first_line(text: str) -> str:
    return text.strip().splitlines()[0] if text.strip() else "no reason given"


#: How long a writer waits for another one before it gives up [ms].
BUSY_TIMEOUT_MS = 10_000
#: How long it waits before it says so [ms].
_PATIENCE_MS = 1_000

#: What a connection notes its file under.
_FILE = "cbsr_qa file"

_DRIVERS = {"sqlite": "sqlite", "postgresql": "postgresql+psycopg"}


def parsed_url(text: str) -> URL:
    """Read a database URL.

    Raises
    ------
    StoreError
        If it is not one, or of a database this program does not speak to.
    """
    try:
        url = make_url(text)
        text.encode()  # drivers take no halves of characters, which names of files may hold
    except (ArgumentError, ValueError):
        # The text is not repeated: it may hold a password.
        raise StoreError(
            "the database URL cannot be read",
            remedy="expected: sqlite:///folder/file.db or postgresql://user:password@host:5432/name",
        ) from None
    name = url.get_backend_name()
    if name not in _DRIVERS:
        raise StoreError(f"{name} databases are not supported", remedy=f"supported: {', '.join(_DRIVERS)}")
    return url.set(drivername=_DRIVERS[name]) if "+" not in url.drivername else url


def sqlite_file(url: URL) -> Path | None:
    """Return the file behind a SQLite URL; None for other databases and for one in memory."""
    if url.get_backend_name() != "sqlite" or not url.database or url.database == ":memory:":
        return None
    return Path(url.database.removeprefix("file:").partition("?")[0])


def open_engine(url: URL, *, durable: bool = True) -> Engine:
    """Create the engine; nothing is opened yet.

    Parameters
    ----------
    durable : whether a power cut may lose no committed frame of a SQLite file. Without it a commit does not wait
        for the disk: a killed process still loses nothing and the file stays whole, but a power cut may undo the
        last commits.

    Raises
    ------
    StoreError
        If the driver of this kind of database is not installed.
    """
    try:
        engine = create_engine(url)
    except ModuleNotFoundError as error:
        raise StoreError(
            f"{shown(url)} needs {error.name}, which is not installed", remedy="pip install 'cbsr-qa[postgres]'"
        ) from error
    if url.get_backend_name() == "sqlite":
        event.listen(engine, "connect", partial(_set_up_sqlite, synchronous="FULL" if durable else "NORMAL"))
        if sqlite_file(url) is not None:
            event.listen(engine, "connect", partial(_remember_file, url))
            event.listen(engine, "begin", _refuse_lost_file)
        event.listen(engine, "begin", _begin_sqlite)
    return engine


@contextmanager
def reading(engine: Engine) -> Iterator[Connection]:
    """One read transaction; database errors become StoreError, and so do errors caused by a cell of another type."""
    with translated(engine.url), engine.begin() as connection, _foreign_cells_named(connection):
        yield connection


@contextmanager
def _foreign_cells_named(connection: Connection) -> Iterator[None]:
    """Raise StoreError in place of an error that a cell of another type explains."""
    try:
        yield
    except (TypeError, ValueError, AttributeError, IndexError) as error:
        from cbsr_qa.store.tables import Base

        foreign = foreign_cell(connection, ((table, true()) for table in Base.metadata.sorted_tables))
        raise foreign or error from error


def foreign_cell(
    connection: Connection, rows: Iterable[tuple[Table, ColumnElement[bool]]], what: str = "the database is damaged"
) -> StoreError | None:
    """Return the error for the first cell that its column cannot hold; None if there is none.

    SQLite keeps bytes in a column of text, and text in one of numbers, dates or JSON.

    Parameters
    ----------
    rows : tables, and which of their rows are looked at.
    what : begins the message.
    """
    for table, wanted in rows:
        kinds = [(one, one.type.dialect_impl(connection.dialect)) for one in table.columns]
        converters = [(one, kind.result_processor(connection.dialect, None)) for one, kind in kinds]
        raw = select(*(type_coerce(one, NullType()).label(one.name) for one in table.columns))
        for row in connection.execute(raw.where(wanted)).mappings():
            for column, convert in converters:
                try:
                    if convert is not None:
                        convert(row[column.name])
                except (TypeError, ValueError, AttributeError):
                    key = ", ".join(f"{one.name} {row[one.name]}" for one in table.primary_key)
                    return StoreError(
                        f"{what}: {table.name}.{column.name} ({key}) holds {repr(row[column.name])[:60]},"
                        " which is not a value of that column",
                        remedy="restore the database from a copy; the row is left unchanged",
                    )
    return None


@contextmanager
def writing(engine: Engine, *, tell: Callable[[str], None] | None = None) -> Iterator[Connection]:
    """One write transaction: committed at the end, rolled back on any error.

    Parameters
    ----------
    tell : told where another program is waited for for more than a second; the wait ends after
        :data:`BUSY_TIMEOUT_MS`.
    """
    with translated(engine.url), engine.connect() as connection:
        writer = connection.execution_options(cbsr_writes=True)
        with _begun(writer, tell), _foreign_cells_named(writer):
            yield writer


def _begun(writer: Connection, tell: Callable[[str], None] | None) -> RootTransaction:
    """Begin a transaction; wait for a SQLite file that another program writes, silently at first."""
    if tell is None or writer.dialect.name != "sqlite":
        return writer.begin()
    _wait_at_most(writer, _PATIENCE_MS)
    try:
        return writer.begin()
    except OperationalError as error:
        if "database is locked" not in str(error):
            raise
    finally:
        _wait_at_most(writer, BUSY_TIMEOUT_MS)
    tell(f"{shown(writer.engine.url)} is in use by another program; waiting {BUSY_TIMEOUT_MS // 1000} s at most")
    return writer.begin()


def _wait_at_most(connection: Connection, timeout_ms: int) -> None:
    cursor = connection.connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {timeout_ms}")
    cursor.close()


def use_write_ahead_log(engine: Engine) -> None:
    """Switch a SQLite file to write-ahead logging: readers and one writer do not block each other."""
    if sqlite_file(engine.url) is None:
        return
    with translated(engine.url):
        connection = engine.raw_connection()
        try:
            connection.cursor().execute("PRAGMA journal_mode = WAL")
        finally:
            connection.close()


#: Up to this size indexes are compared with their tables too, which takes twice as long (2 s a GB, in the cache) [B].
_COMPARED: Final = 2_000_000_000


def look_afresh(engine: Engine) -> None:
    """Close connections: the log is merged into the file, and the next read is from disk.

    A connection keeps the pages it wrote, and goes on with them whatever becomes of the log on the disk.
    """
    if sqlite_file(engine.url) is not None:
        engine.dispose()


def file_problem(engine: Engine) -> str:
    """Name a damaged SQLite file and its first problem; empty if it is intact, and for other databases."""
    file = sqlite_file(engine.url)
    if file is None:
        return ""
    check = "integrity_check(1)" if file.stat().st_size <= _COMPARED else "quick_check(1)"
    try:
        with reading(engine) as connection:
            answer = str(connection.exec_driver_sql(f"PRAGMA {check}").scalar())
    except StoreError as error:
        return error.reason
    problem = " ".join(answer.removeprefix("*** in database main ***").split())
    return "" if answer == "ok" else f"{shown(engine.url)} is damaged ({problem})"


def _set_up_sqlite(connection: Any, record: object, *, synchronous: str) -> None:
    # Python's sqlite3 begins transactions by its own rules, and never before DDL; we begin them ourselves, so
    # that a migration is one transaction as it is on PostgreSQL.
    connection.isolation_level = None
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")
    cursor.execute("PRAGMA foreign_keys = ON")
    cursor.execute(f"PRAGMA synchronous = {synchronous}")
    cursor.close()


def _remember_file(url: URL, _: object, record: Any) -> None:
    record.info[_FILE] = _which_file(url)


def _which_file(url: URL) -> tuple[int, int] | None:
    """Device and inode of the database file; None without one."""
    path = sqlite_file(url)
    assert path is not None
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _refuse_lost_file(connection: Connection) -> None:
    """Refuse to continue with a deleted or replaced file: SQLite would write into the old one."""
    url, was = connection.engine.url, connection.info[_FILE]
    found = _which_file(url)
    if was in (None, found):
        return
    what = "was deleted or moved away" if found is None else "was replaced by another file"
    raise StoreError(
        f"{shown(url)} {what} while it was in use",
        remedy="put it back under its name, with its files ending in -wal and -shm, or a copy of it; data stored"
        " in a deleted file is lost",
    )


def _begin_sqlite(connection: Connection) -> None:
    # A transaction that will write takes the lock at once: one that asks for it later can fail without waiting.
    immediate = connection.get_execution_options().get("cbsr_writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if immediate else "BEGIN")
