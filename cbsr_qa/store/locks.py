"""Locks that end with the process: one writer per run, one schema change at a time, one run per seed, or sensor."""

import glob
import hashlib
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from threading import Lock
from typing import Final
from weakref import WeakKeyDictionary

from sqlalchemy import URL, Connection, Engine, text
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from cbsr_qa.domain.errors import AT_COMMAND_LINE, StoreError
from cbsr_qa.store.damage import name_database, translate_errors
from cbsr_qa.store.engine import sqlite_file
from cbsr_qa.system.files import FileLock, HeldError, holder

_NAME_LENGTH: Final = 63  # longest name of an application in PostgreSQL

#: Longest wait for another program that creates tables, and the part of it that is silent [s].
SCHEMA_WAIT_S: Final = 60.0
PATIENCE_S: Final = 1.0


def this_process(operator: str) -> str:
    """Name the writer of a run: operator, computer and process."""
    return f"{operator or 'somebody'} on {platform.node() or 'this computer'}, process {os.getpid()}"


@contextmanager
def writing_alone(engine: Engine, run: str, who: str) -> Iterator[None]:
    """Hold the right to write a run; it is released when the process ends, even if killed.

    On SQLite this is a locked file beside the database, on PostgreSQL an advisory lock on a connection for locks. A
    database in memory has only one process. The next process to lock removes the files of killed ones.

    Raises
    ------
    StoreError
        If another process holds it; the message names it.
    """
    release = _acquire(engine, run, who)
    if isinstance(release, str):
        raise StoreError(
            f"run {run} is being written by {release} ({name_database(engine.url)})",
            remedy=f"wait for it to end, or stop it, and resume the run\n{AT_COMMAND_LINE}cbsr-qa run --resume {run}",
        )
    try:
        yield
    finally:
        release()


@contextmanager
def sending_alone(engine: Engine, who: str) -> Iterator[None]:
    """Hold the right to send what waits in a database's outbox; StoreError names another process that holds it."""
    release = _acquire(engine, "sync", who)
    if isinstance(release, str):
        raise StoreError(
            f"{release} sends from {name_database(engine.url)} already", remedy="let it finish; nothing is sent twice"
        )
    try:
        yield
    finally:
        release()


@contextmanager
def changing_schema(engine: Engine, tell: Callable[[str], None] | None = None) -> Iterator[None]:
    """Hold the right to create or change tables; wait for the current holder.

    Parameters
    ----------
    tell : function called with the current holder after :data:`PATIENCE_S`.

    Raises
    ------
    StoreError
        If another process still holds it after :data:`SCHEMA_WAIT_S`; the message names it.
    """
    begun_s, announced = time.monotonic(), tell is None
    while isinstance(release := _acquire(engine, "schema", this_process("")), str):
        waited_s, busy = (
            time.monotonic() - begun_s,
            f"{name_database(engine.url)} is being created or upgraded by {release}",
        )
        if waited_s >= SCHEMA_WAIT_S:
            raise StoreError(
                f"{busy}; waited {SCHEMA_WAIT_S:g} s for it", remedy="try again when it is done, or end that process"
            )
        if not announced and waited_s >= PATIENCE_S and tell is not None:
            tell(f"{busy}; waiting {SCHEMA_WAIT_S:g} s at most")
            announced = True
        time.sleep(0.05)
    try:
        yield
    finally:
        release()


def seed_claimed(engine: Engine, serial: str, seed: int, who: str) -> AbstractContextManager[str]:
    """Claim the seed of a sensor's run; see :func:`_claim`."""
    return _claim(engine, "seed", f"{serial}/{seed}", who)


@contextmanager
def _claim(engine: Engine, kind: str, claim: str, who: str) -> Iterator[str]:
    """Claim something while entered; yields the other process that has it, empty without one."""
    name = hashlib.sha256(claim.encode()).hexdigest()[:16]
    release = _acquire(engine, f"{kind}-{name}", who)
    if isinstance(release, str):
        yield release
        return
    try:
        yield ""
    finally:
        release()


def writer_of(engine: Engine, run: str) -> str:
    """Return the writer of a run; empty without one."""
    file = sqlite_file(engine.url)
    if file is not None:
        holder_bytes = holder(_lock_file(file, run))
        return "" if holder_bytes is None else _name_process(holder_bytes)
    if engine.url.get_backend_name() != "postgresql":
        return ""
    with translate_errors(engine.url), engine.connect() as connection:
        return _holder(connection, _number(run))


class Claims:
    """Claims of processes that use one database; a claim ends with its process."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def hold_run(self, run: str, operator: str = "") -> AbstractContextManager[None]:
        """Hold the right to write a run while entered; StoreError names another process that holds it."""
        return writing_alone(self._engine, run, this_process(operator))

    def claim_sensor(self, serial: str, recipe: str, operator: str = "") -> AbstractContextManager[str]:
        """Claim a sensor for a run of a recipe while entered; yields the process that tests it already, or ''."""
        return _claim(self._engine, "sensor", f"{serial}/{recipe}", this_process(operator))

    def name_writer(self, run: str) -> str:
        """Return who writes a run now; empty for nobody."""
        return writer_of(self._engine, run)


def _acquire(engine: Engine, name: str, who: str) -> Callable[[], None] | str:
    """Return a function that releases the lock, or the current holder."""
    if engine.url.get_backend_name() == "postgresql":
        return _SERVER_LOCKS.setdefault(engine, _ServerLocks(engine.url)).acquire(engine, _number(name), who)
    file = sqlite_file(engine.url)
    return (lambda: None) if file is None else _file_lock(engine, file, name, who)


def _lock_file(database: Path, name: str) -> Path:
    return database.with_name(f"{database.name}-{name}.lock")


def _file_lock(engine: Engine, database: Path, name: str, who: str) -> Callable[[], None] | str:
    for file in database.parent.glob(f"{glob.escape(database.name)}-*.lock"):
        holder(file)  # removes the file if it is unlocked
    try:
        return FileLock(_lock_file(database, name), who.encode(errors="replace")).release
    except HeldError as error:
        return _name_process(error.who)
    except OSError as error:  # a full disk could not store the run either
        raise StoreError(
            f"{name_database(engine.url)}: cannot create a lock file beside it ({error.strerror})",
            remedy="make its folder writable, free space, or name another database; everything committed is kept",
        ) from error


def _name_process(who: bytes) -> str:
    return who.decode(errors="replace") or "another process"


class _ServerLocks:
    """Advisory locks of PostgreSQL that an engine holds, all over one connection, which ends with the process."""

    def __init__(self, url: URL) -> None:
        self._url = url
        self._process = os.getpid()
        self._connection: Connection | None = None
        self._held: dict[int, str] = {}
        self._alone = Lock()

    def acquire(self, engine: Engine, number: int, who: str) -> Callable[[], None] | str:
        """Return a function that releases the lock, or the current holder."""
        with self._alone, translate_errors(self._url):
            try:
                return self._acquire(engine, number, who)
            except DBAPIError as error:
                if not error.connection_invalidated:
                    raise
                self._close()  # the server has released what this connection held
                return self._acquire(engine, number, who)
            finally:
                if not self._held:
                    self._close()

    def _acquire(self, engine: Engine, number: int, who: str) -> Callable[[], None] | str:
        if self._connection is None:
            self._connection = engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        connection = self._connection
        if number in self._held:
            connection.execute(text("SELECT 1"))  # a lost connection holds nothing
            return self._held[number]
        values = {"number": number, "who": who[:_NAME_LENGTH]}
        if connection.scalar(_TRY_LOCK, values) is None:
            return _holder(connection, number) or "another process"
        self._held[number] = who
        return lambda: self._release(connection, number)

    def _release(self, connection: Connection, number: int) -> None:
        with self._alone:
            if self._connection is not connection or os.getpid() != self._process:
                return  # the lock was lost, or this is a forked copy of the process that holds it
            del self._held[number]
            with suppress(SQLAlchemyError):
                connection.execute(text("SELECT pg_advisory_unlock(:number)"), {"number": number})
            if not self._held:
                self._close()

    def _close(self) -> None:
        connection, self._connection = self._connection, None
        self._held.clear()
        if connection is not None:
            with suppress(SQLAlchemyError):
                connection.close()


_SERVER_LOCKS: Final[WeakKeyDictionary[Engine, _ServerLocks]] = WeakKeyDictionary()
#: Query that tries to take a lock. It names the connection after its writer; None if another one has the lock.
_TRY_LOCK: Final = text(
    "SELECT CASE WHEN pg_try_advisory_lock(:number) THEN set_config('application_name', :who, false) END"
)
_HOLDER: Final = text(
    "SELECT a.application_name FROM pg_locks l JOIN pg_stat_activity a USING (pid)"
    " WHERE l.locktype = 'advisory' AND l.granted AND l.objsubid = 1"
    " AND l.classid::bigint = :high AND l.objid::bigint = :low"
)


def _number(name: str) -> int:
    return int.from_bytes(hashlib.sha256(f"cbsr-qa run {name}".encode()).digest()[:8], signed=True)


def _holder(connection: Connection, number: int) -> str:
    """Return who holds an advisory lock; empty for nobody."""
    unsigned = number % (1 << 64)
    row = connection.execute(_HOLDER, {"high": unsigned >> 32, "low": unsigned & 0xFFFFFFFF}).first()
    return "" if row is None else str(row[0] or "another process")
