"""Copies of a SQLite database: consistent while others write, verified, whole or not at all; and put back."""

import glob
import os
import secrets
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Final

from sqlalchemy import URL, Engine, select
from sqlalchemy.orm import aliased

from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.store.damage import name_database, translate_errors
from cbsr_qa.store.engine import SIDES, file_problem, open_engine, parse_url, sqlite_file
from cbsr_qa.store.schema import Age, SchemaVersion, read_version, refusal
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.system.files import holder
from cbsr_qa.system.foreign import UnfitFileError, check_regular, open_foreign

#: Function that reports progress: the stage, the parts done, and all parts.
Count = Callable[[str, int, int], None]

#: Pages copied between two reports of progress: 4 MB.
_PAGES: Final = 1000
#: Bytes that every connection to a SQLite file holds a lock on, in any journal mode: the pending byte and what
#: follows it (https://www.sqlite.org/fileformat2.html, "the lock-byte page").
_LOCKED: Final = (0x40000000, 512)
_MOVED: Final = ("-wal", "-shm")
_UNCHANGED: Final = "the database is unchanged"


def copy_database(engine: Engine, to: Path, count: Count = lambda what, done, of: None) -> None:
    """Copy a SQLite database as it is now, and verify the copy: its file, and the chain head of every run.

    Others may read and write meanwhile. The copy gets its name when it is verified, and never replaces a file.

    Raises
    ------
    RefusedError
        If the file exists, or cannot be written.
    StoreError
        If the database is not a file, is missing, damaged or of another program, or the copy is not what was copied.
    """
    source = sqlite_file(engine.url)
    if source is None:
        raise _server_error(engine, "pg_dump --format=custom --file=FILE --dbname='{url}'")
    if to.exists():
        raise RefusedError(f"{to} exists already; a backup replaces nothing", remedy="name another file")
    version = read_version(engine)
    if version.age not in (Age.CURRENT, Age.OLDER):  # missing, newer, or of another program
        raise refusal(engine, version)
    with _temporary(to) as partial:
        with (
            translate_errors(engine.url),
            closing(sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True)) as source_connection,
        ):
            # One state of the database: others write on, and do not begin the copy again.
            source_connection.execute("BEGIN")
            source_connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            with (
                translate_errors(URL.create("sqlite", database=str(to))),
                closing(sqlite3.connect(partial)) as copy_connection,
            ):
                source_connection.backup(
                    copy_connection, pages=_PAGES, progress=lambda _, left, of: count("copying", of - left, of)
                )
                copy_connection.execute("PRAGMA journal_mode = DELETE")  # one file, which can be moved
            heads = _heads(source_connection)
        count("verifying", 0, 1)
        _verify(partial, heads, to)
        count("verifying", 1, 1)
        _name(partial, to)


def put_back(engine: Engine, backup: Path, aside: Path, count: Count = lambda what, done, of: None) -> SchemaVersion:
    """Put a backup in the place of a SQLite database; what was there is kept beside it, as ``aside``.

    Returns
    -------
    The version of the database that is there now.

    Raises
    ------
    RefusedError, StoreError
        If the backup is damaged or not one of this program, or anybody uses the database; nothing is changed then.
    """
    target = sqlite_file(engine.url)
    if target is None:
        raise _server_error(engine, "pg_restore --clean --if-exists --dbname='{url}' FILE")
    try:
        check_regular(backup)
    except OSError as error:
        reason = error.strerror or str(error)
        raise RefusedError(
            f"{backup} cannot be restored: {reason}; {_UNCHANGED}", remedy="name a backup that cbsr-qa db backup made"
        ) from error
    if target.exists() and backup.samefile(target):
        raise RefusedError(f"{backup} is the database itself; {_UNCHANGED}", remedy="name a backup of it")
    if target.exists() and aside.exists():
        raise RefusedError(f"{aside} exists already; {_UNCHANGED}", remedy="move it away, or try again in a second")
    with _temporary(target) as partial:
        count("copying", 0, 1)
        _copy(backup, partial)
        if (log := backup.with_name(f"{backup.name}-wal")).exists():  # a copy made with cp during use has one
            _copy(log, partial.with_name(f"{partial.name}-wal"))
        count("verifying", 0, 1)
        version = _restorable(partial, backup)
        with _hold_unused(target):
            _exchange(partial, target, aside)
    return version


def _copy(backup: Path, to: Path) -> None:
    room_bytes = shutil.disk_usage(to.parent).free
    try:
        file = open_foreign(backup, room_bytes)
    except UnfitFileError as error:
        raise RefusedError(
            f"{backup} cannot be restored: {error.strerror}; {_UNCHANGED}",
            remedy=f"name a backup that cbsr-qa db backup made; {room_bytes >> 20} MiB of the disk are free",
        ) from error
    with file, to.open("wb") as copy:
        shutil.copyfileobj(file, copy)


def _restorable(partial: Path, backup: Path) -> SchemaVersion:
    copy = open_engine(parse_url(f"sqlite:///{partial}"))
    try:
        version = read_version(copy)
        if version.age not in (Age.CURRENT, Age.OLDER):
            raise refusal(copy, version)
        if problem := file_problem(copy):
            raise StoreError(problem)
        with closing(sqlite3.connect(partial)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")  # as the database has it
    except StoreError as error:
        reason = error.reason.replace(f"database {partial}", "it")
        raise StoreError(
            f"{backup} cannot be restored: {reason}; {_UNCHANGED}", remedy=error.remedy or "name another backup"
        ) from error
    finally:
        copy.dispose()
    return version


def _verify(partial: Path, heads: dict[str, str], to: Path) -> None:
    copy = open_engine(parse_url(f"sqlite:///{partial}"))
    try:
        problem = file_problem(copy)
        if not problem:
            with closing(sqlite3.connect(partial)) as connection:
                copied_heads = _heads(connection)
            differing_runs = [run for run in heads | copied_heads if heads.get(run) != copied_heads.get(run)]
            problem = f"run {differing_runs[0]} in it has another chain than the database" if differing_runs else ""
    finally:
        copy.dispose()
    if problem:
        reason = problem.replace(f"database {partial}", "the copy")
        raise StoreError(f"{to} was not made: {reason}", remedy="check the disk it is on; the database is unchanged")


def _heads(connection: sqlite3.Connection) -> dict[str, str]:
    """Return the last link's digest of each run; nothing where their table is missing."""
    if not connection.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (LinkRow.__tablename__,)).fetchone():
        return {}
    link, later = LinkRow, aliased(LinkRow)
    is_last = ~select(later.run).where(later.run == link.run, later.number > link.number).exists()
    query = str(select(link.run, link.sha256).where(is_last).compile(compile_kwargs={"literal_binds": True}))
    return dict(connection.execute(query))


def _server_error(engine: Engine, command: str) -> RefusedError:
    bare_url = engine.url.difference_update_query([name for name in engine.url.query if "password" in name.lower()])
    url = bare_url._replace(drivername=bare_url.get_backend_name(), password=None).render_as_string()
    if engine.url.get_backend_name() == "sqlite":
        return RefusedError(f"{name_database(engine.url)} is not a file")
    return RefusedError(
        f"{name_database(engine.url)} is not a file: its server makes and restores backups",
        remedy=f"with its own tools (password: PGPASSWORD or ~/.pgpass): {command.format(url=url)}",
    )


@contextmanager
def _temporary(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside ``path``; whatever is left of it at the end is removed."""
    partial = path.parent / f".{secrets.token_hex(8)}.partial"
    try:
        with partial.open("xb"):
            pass
        yield partial
    except OSError as error:
        raise RefusedError(
            f"{path} cannot be written: {error.strerror or error}; {_UNCHANGED}",
            remedy="free space, make its folder writable, or name another file",
        ) from error
    finally:
        for suffix in ("", *SIDES):
            with suppress(OSError):
                partial.with_name(partial.name + suffix).unlink()


def _name(partial: Path, to: Path) -> None:
    """Give a finished file its name; another file of that name is not replaced."""
    with partial.open("rb+") as file:
        os.fsync(file.fileno())
    try:
        os.link(partial, to)
    except FileExistsError:
        raise RefusedError(f"{to} exists by now; a backup replaces nothing", remedy="name another file") from None
    except OSError:  # a file system without links, e.g. of a memory stick
        if to.exists():
            raise
        partial.rename(to)


@contextmanager
def _hold_unused(database: Path) -> Iterator[None]:
    """Hold all locks of a SQLite file: nobody reads or writes it, and nobody begins to.

    The locks work even if the content of the file is damaged.

    Raises
    ------
    StoreError
        If another process uses it; the message names a run that is being written.
    """
    for lock in sorted(database.parent.glob(f"{glob.escape(database.name)}-*.lock")):
        if (holder_bytes := holder(lock)) is not None:
            name = lock.name.removeprefix(f"{database.name}-").removesuffix(".lock")
            raise _busy_error(
                database, f"{name} is held by {holder_bytes.decode(errors='replace') or 'another process'}"
            )
    if not database.exists():
        yield
        return
    import fcntl

    with database.open("rb+") as file:
        first_byte, length = _LOCKED
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, length, first_byte)
        except OSError as error:
            raise _busy_error(database, "a page, a run or another program has it open") from error
        yield


def _busy_error(database: Path, who: str) -> StoreError:
    return StoreError(
        f"database {database} is in use: {who}; {_UNCHANGED}",
        remedy="end runs and cbsr-qa serve, and whatever else reads it, then restore again",
    )


def _exchange(partial: Path, target: Path, aside: Path) -> None:
    """Rename the old database with its log, then the new one; put the old one back if that fails."""
    moved_files: list[tuple[Path, Path]] = []
    try:
        for suffix in ("", *_MOVED):
            old_file, kept_file = target.with_name(target.name + suffix), aside.with_name(aside.name + suffix)
            if old_file.exists():
                old_file.rename(kept_file)
                moved_files.append((old_file, kept_file))
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        partial.rename(target)
    except OSError:
        for old_file, kept_file in reversed(moved_files):
            kept_file.rename(old_file)
        raise
