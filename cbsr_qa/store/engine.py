"""Database connections: SQLite set up for journalling, PostgreSQL with its defaults."""

import os
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from threading import Lock
from typing import Any, Final

from sqlalchemy import (
    URL,
    Connection,
    Engine,
    ExceptionContext,
    RootTransaction,
    create_engine,
    event,
    make_url,
    true,
)
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from cbsr_qa.domain.errors import AT_COMMAND_LINE, StoreError
from cbsr_qa.store.damage import FOREIGN_VALUE, find_foreign_cell, name_database, translate_errors
from cbsr_qa.system.foreign import UnfitFileError, check_regular

#: Longest wait of a writer for another one [ms].
BUSY_TIMEOUT_MS = 10_000
#: Time a writer waits before it reports the wait [ms].
_PATIENCE_MS = 1_000

#: Size of the log at which it is merged into the file, if commits do not wait for the disk [pages of 4 KB]. Merging
#: waits for the disk, and SQLite's default of 1000 pages is full every 90 frames.
_LOG_PAGES = 10_000

#: Suffixes of a SQLite file's journal, log and index of the log.
SIDES: Final = ("-journal", "-wal", "-shm")

#: Key under which a connection keeps the identity of its file.
_FILE = "cbsr_qa file"

#: Settings of libpq by which a silent server's connection counts as lost ([s], the last one [ms]).
_PATIENCE: Final = {
    "connect_timeout": 10,
    "keepalives_idle": 30,
    "keepalives_interval": 10,
    "tcp_user_timeout": 60_000,
}

#: How many use the engine of a server, by URL and process. One that disposed it for all would leave open the
#: connections that others had taken from it.
_USERS: Final[Counter[tuple[URL, int]]] = Counter()
_COUNTING: Final = Lock()

_DRIVERS = {"sqlite": "sqlite", "postgresql": "postgresql+psycopg"}


def parse_url(text: str) -> URL:
    """Read a database URL.

    Raises
    ------
    StoreError
        If it is malformed, or of a database that is not supported.
    """
    try:
        url = make_url(text)
        text.encode()  # drivers refuse lone surrogates, which file names may hold
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
    """Return the file behind a SQLite URL; None for other databases and in memory."""
    if url.get_backend_name() != "sqlite" or not url.database or url.database == ":memory:":
        return None
    return Path(url.database.removeprefix("file:").partition("?")[0])


def open_engine(url: URL, *, durable: bool = True) -> Engine:
    """Create the engine; nothing is opened yet.

    Parameters
    ----------
    durable : whether commits to a SQLite file survive a power cut. If not, a commit does not wait
        for the disk: a killed process still loses nothing and the file stays whole, but a power cut may undo the
        last commits.

    Raises
    ------
    StoreError
        If the driver of this kind of database is not installed, or the file is a folder, pipe or device.
    """
    connect_arguments = (
        {} if url.get_backend_name() == "sqlite" else {k: v for k, v in _PATIENCE.items() if k not in url.query}
    )
    try:
        engine = create_engine(url, connect_args=connect_arguments)
    except ModuleNotFoundError as error:
        raise StoreError(
            f"{name_database(url)} needs {error.name}, which is not installed",
            remedy="pip install 'cbsr-qa[postgres]'",
        ) from error
    event.listen(engine, "begin", partial(_refuse_copy, os.getpid()))
    if url.get_backend_name() == "sqlite":
        event.listen(engine, "connect", partial(_set_up_sqlite, synchronous="FULL" if durable else "NORMAL"))
        if (file := sqlite_file(url)) is not None:
            _check_regular(file, url)
            event.listen(engine, "connect", partial(_remember_file, file))
            event.listen(engine, "begin", partial(_refuse_lost_file, file))
        event.listen(engine, "begin", _begin_sqlite)
        event.listen(engine, "handle_error", _keep_connection)
    else:
        event.listen(engine, "connect", _disable_compiler)
    return engine


@cache
def _engine_of_server(url: URL, process: int) -> Engine:
    """Return the engine of a server, one a process: it keeps the server's settings and compiled statements."""
    return open_engine(url)


def use_engine(url: URL, *, durable: bool = True) -> Engine:
    """Return an engine to be given back to :func:`leave_engine`; see :func:`open_engine`.

    A run opens its database several times, also while it is open: on a server all share one engine.
    """
    if url.get_backend_name() == "sqlite":
        return open_engine(url, durable=durable)
    engine = _engine_of_server(url, os.getpid())
    with _COUNTING:
        _USERS[url, os.getpid()] += 1
    return engine


def leave_engine(engine: Engine) -> None:
    """Close an engine's connections, unless somebody else in this process uses it."""
    with _COUNTING:
        user = engine.url, os.getpid()
        _USERS[user] -= 1
        if _USERS[user] > 0:
            return
        del _USERS[user]
    engine.dispose()


def _keep_connection(context: ExceptionContext) -> None:
    """Keep a SQLite connection whose statement a signal's exception ends: it is sound, and is rolled back.

    SQLAlchemy would close it; closed with a cursor open, SQLite holds the lock on the file as long as the exception.
    """
    if not isinstance(context.original_exception, Exception):
        context.is_disconnect = False


def _check_regular(file: Path, url: URL) -> None:
    """Refuse a folder, pipe or device as database, or as its log: SQLite would wait, or read for ever."""
    if file.is_dir():
        raise StoreError(f"{name_database(url)} is a folder, not a database", remedy="name a file in it")
    nearest_parent = next((above for above in file.absolute().parents if os.path.lexists(above)), None)
    if nearest_parent is not None and not nearest_parent.is_dir():
        raise StoreError(
            f"{name_database(url)} cannot be opened: {nearest_parent} is not a folder",
            remedy=f"name another file\n{AT_COMMAND_LINE}--database, CBSR_QA_DATABASE or CBSR_QA_VAR names it",
        )
    for path in (file, *(file.with_name(file.name + suffix) for suffix in SIDES)):
        try:
            check_regular(path)
        except UnfitFileError as error:
            raise StoreError(
                f"{name_database(url)} cannot be opened: {path.name}: {error.strerror}",
                remedy="name the file of a database",
            ) from error
        except OSError:
            continue  # SQLite reports the error, or creates the file


def _disable_compiler(connection: Any, record: object) -> None:
    """Switch off the compiler of queries: it takes a second for plans that look costly, and saves no time here."""
    with connection.cursor() as cursor:
        cursor.execute("SET jit = off")
    connection.commit()


@contextmanager
def reading(engine: Engine) -> Iterator[Connection]:
    """Open a read transaction on one snapshot; StoreError for database errors and for cells of the wrong type."""
    with translate_errors(engine.url), engine.connect() as connection:
        if connection.dialect.name == "postgresql":  # as in SQLite, commits of others meanwhile are not seen
            connection.execution_options(isolation_level="REPEATABLE READ")
        with connection.begin(), _name_foreign_cells(connection):
            yield connection


@contextmanager
def _name_foreign_cells(connection: Connection) -> Iterator[None]:
    """Raise StoreError in place of an error caused by a cell of the wrong type."""
    try:
        yield
    except FOREIGN_VALUE as error:
        from cbsr_qa.store.tables.runs import Base

        try:
            cell_error = find_foreign_cell(connection, ((table, true()) for table in Base.metadata.sorted_tables))
        except SQLAlchemyError:  # a schema that is being changed lacks tables
            cell_error = None
        raise cell_error or error from error


@contextmanager
def writing(engine: Engine, *, tell: Callable[[str], None] | None = None) -> Iterator[Connection]:
    """Open a write transaction: committed at the end, rolled back on any error.

    Parameters
    ----------
    tell : function called once the wait for another program exceeds a second; the wait ends after
        :data:`BUSY_TIMEOUT_MS`.
    """
    with translate_errors(engine.url), engine.connect() as connection:
        writer = connection.execution_options(cbsr_writes=True)
        with _begin(writer, tell), _name_foreign_cells(writer):
            yield writer


def _begin(writer: Connection, tell: Callable[[str], None] | None) -> RootTransaction:
    """Begin a transaction; wait for a SQLite file that another program writes, silently at first."""
    if tell is None or writer.dialect.name != "sqlite":
        return writer.begin()
    _wait_at_most(writer, _PATIENCE_MS)
    try:
        return writer.begin()
    except sqlite3.OperationalError as error:
        if "database is locked" not in str(error):
            raise
    finally:
        _wait_at_most(writer, BUSY_TIMEOUT_MS)
    database = name_database(writer.engine.url)
    tell(f"{database} is in use by another program; waiting {BUSY_TIMEOUT_MS // 1000} s at most")
    return writer.begin()


def _wait_at_most(connection: Connection, timeout_ms: int) -> None:
    _execute_directly(connection, f"PRAGMA busy_timeout = {timeout_ms}")


def use_write_ahead_log(engine: Engine) -> None:
    """Switch a SQLite file to write-ahead logging: readers and one writer do not block each other."""
    if sqlite_file(engine.url) is None:
        return
    with translate_errors(engine.url):
        connection = engine.raw_connection()
        try:
            connection.cursor().execute("PRAGMA journal_mode = WAL")
        finally:
            connection.close()


#: Largest file whose indexes are compared with their tables, which doubles the time (2 s per GB, cached) [B].
_COMPARED: Final = 2_000_000_000


def look_afresh(engine: Engine) -> None:
    """Close connections: the log is merged into the file, and the next read is from disk.

    A connection keeps using the pages it wrote, even if the log on disk has changed.
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
    return "" if answer == "ok" else f"{name_database(engine.url)} is damaged ({problem})"


def _set_up_sqlite(connection: Any, record: object, *, synchronous: str) -> None:
    # Python's sqlite3 begins transactions by its own rules, and never before DDL; we begin them ourselves, so
    # that a migration is one transaction as it is on PostgreSQL.
    connection.isolation_level = None
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")
    cursor.execute("PRAGMA foreign_keys = ON")
    cursor.execute(f"PRAGMA synchronous = {synchronous}")
    if synchronous == "NORMAL":
        cursor.execute(f"PRAGMA wal_autocheckpoint = {_LOG_PAGES}")
    cursor.close()


def _remember_file(path: Path, _: object, record: Any) -> None:
    record.info[_FILE] = _identify_file(path)


def _identify_file(path: Path) -> tuple[int, int] | None:
    try:
        status = os.stat(path)  # noqa: PTH116 - called in every transaction; Path.stat takes twice as long
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _refuse_copy(process: int, connection: Connection) -> None:
    """Refuse a forked copy of the process that opened the database: both would write over one connection."""
    if os.getpid() != process:
        raise StoreError(
            f"{name_database(connection.engine.url)} was opened by process {process}, of which process {os.getpid()}"
            " is a forked copy: it can neither read nor store",
            remedy="open the database again in the process that forks, or let a plugin that forks end its copy",
        )


def _refuse_lost_file(path: Path, connection: Connection) -> None:
    """Refuse a deleted or replaced file: SQLite would continue to write into the old one."""
    opened_file, current_file = connection.info[_FILE], _identify_file(path)
    if opened_file in (None, current_file):
        return
    fate = "was deleted or moved away" if current_file is None else "was replaced by another file"
    raise StoreError(
        f"{name_database(connection.engine.url)} {fate} while it was in use",
        remedy="put it back under its name, with its files ending in -wal and -shm, or a copy of it; data stored"
        " in a deleted file is lost",
    )


def _begin_sqlite(connection: Connection) -> None:
    # A transaction that will write takes the lock at once: requesting it later can fail without waiting.
    writes = connection.get_execution_options().get("cbsr_writes", False)
    _execute_directly(connection, "BEGIN IMMEDIATE" if writes else "BEGIN")


def _execute_directly(connection: Connection, statement: str) -> None:
    """Execute a statement of every transaction; SQLAlchemy takes ten times as long. Raises errors of sqlite3."""
    cursor = connection.connection.cursor()
    try:
        cursor.execute(statement)
    finally:
        cursor.close()
