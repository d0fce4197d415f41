"""Schema versions of the database: detection, required version, upgrade."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final

from sqlalchemy import (
    Column,
    Connection,
    Engine,
    MetaData,
    PrimaryKeyConstraint,
    String,
    Table,
    insert,
    inspect,
    text,
)

from cbsr_qa.domain.errors import AT_COMMAND_LINE, LAST_UNRELEASED, StoreError
from cbsr_qa.store.damage import address, name_database
from cbsr_qa.store.engine import reading, sqlite_file, use_write_ahead_log, writing
from cbsr_qa.store.locks import changing_schema
from cbsr_qa.store.views import create_views, drop_views, views_missing

#: Revisions in order; the last is what this program reads and writes. Kept here so that opening a database
#: that is up to date costs no import of Alembic; a test compares it with the migration scripts.
#: They are compared as text, also by programs from before 0.1.0, whose own went from 0001 to 0024: counted from 1001,
#: none can be taken for one of those, and all come after them.
REVISIONS: Final = ("1001", "1002", "1003", "1004")
HEAD: Final = REVISIONS[-1]
_UNRELEASED: Final = frozenset(f"{number:04}" for number in range(1, 25))
#: Place where Alembic finds the migrations.
SCRIPTS: Final = "cbsr_qa._migrations:"
VERSION_TABLE: Final = "alembic_version"
#: Oldest schema of databases that may send to one of schema HEAD; the migrations set it too.
OLDEST_SENDER: Final = "1001"


class Age(Enum):
    """Whether a database's schema is older or newer than this program's, or was never in a released version."""

    EMPTY = "empty"
    CURRENT = "current"
    OLDER = "older"
    NEWER = "newer"
    UNRELEASED = "from before 0.1.0"
    FOREIGN = "of another program"


@dataclass(frozen=True, slots=True)
class SchemaVersion:
    """Schema version of a database.

    Parameters
    ----------
    revision : revision of the schema; None if the database has no version.
    """

    age: Age
    revision: str | None


def read_version(engine: Engine) -> SchemaVersion:
    """Return a database's version without changing it; a missing SQLite file counts as empty and is not created.

    Raises
    ------
    StoreError
        If it cannot be opened or read, or is a link to a file that does not exist.
    """
    file = sqlite_file(engine.url)
    if file is not None and not file.exists():
        _refuse_dangling(engine, file)
        return SchemaVersion(Age.EMPTY, None)
    with reading(engine) as connection:
        return _read_version(connection)


def _refuse_dangling(engine: Engine, file: Path) -> None:
    """Refuse a link to a missing file: SQLite would make a database there, perhaps in place of a missing disk."""
    if file.is_symlink():
        target = os.path.realpath(file)
        problem = "leads back to itself" if Path(target).is_symlink() else f"leads to {target}, which does not exist"
        raise StoreError(
            f"{name_database(engine.url)} is a link that {problem}",
            remedy="bring that file back, or name the file of the database itself, to have it made there",
        )


def upgrade(engine: Engine, *, tell: Callable[[str], None] | None = None) -> SchemaVersion:
    """Upgrade a database to this program's schema in one transaction; an error leaves it unchanged.

    Parameters
    ----------
    tell : function called while another program creates or upgrades the same database.

    Returns
    -------
    The version it had before.

    Raises
    ------
    StoreError
        If it is newer than this program or from before 0.1.0, belongs to another one, or cannot be written.
    """
    _upgradable(engine, read_version(engine))
    _make_folder(engine)
    with changing_schema(engine, tell):
        use_write_ahead_log(engine)
        with writing(engine) as connection:
            # Read again: another program may have been faster.
            version_before = _upgradable(engine, _read_version(connection))
            if version_before.revision is None:
                _create(connection)
            elif version_before.revision != HEAD:
                _migrate(connection)
            elif views_missing(connection):
                drop_views(connection)
                create_views(connection)
    return version_before


def check_writable(engine: Engine, version: SchemaVersion) -> None:
    """Check that the user may add rows or create tables, without doing so.

    For a SQLite file that does not exist yet, its lock file and folder are created and removed.

    Raises
    ------
    StoreError
        If the database is read-only or refuses the user, or no file can be created in its folder.
    """
    if version.age is Age.CURRENT:
        with writing(engine) as connection:
            connection.execute(text("INSERT INTO runs SELECT * FROM runs WHERE 1 = 0"))
    elif (file := sqlite_file(engine.url)) is not None:
        with _folder_for_now(engine, file.parent), changing_schema(engine):
            pass
    else:
        with reading(engine) as connection:
            connection.execute(text("CREATE TABLE cbsr_qa_probe (one INTEGER)"))
            connection.rollback()


def refusal(engine: Engine, version: SchemaVersion) -> StoreError:
    """Return the error for a database that is not up to date."""
    match version.age:
        case Age.OLDER:
            return StoreError(
                f"{name_database(engine.url)} has schema {version.revision}, older than this program's {HEAD}",
                remedy=f"run: cbsr-qa db upgrade --database {address(engine.url)} (it copies a SQLite file first)",
            )
        case Age.NEWER:
            return StoreError(
                f"{name_database(engine.url)} has schema {version.revision}, unknown to this program ({HEAD})",
                remedy="use the newer version of cbsr-qa that made it",
            )
        case Age.UNRELEASED:
            return StoreError(
                f"{name_database(engine.url)} has schema {version.revision}, from before version 0.1.0, which this"
                " program does not read",
                remedy=f"use another database; commit {LAST_UNRELEASED} of cbsr-qa still reads and exports this one",
            )
        case Age.FOREIGN:
            return StoreError(
                f"{name_database(engine.url)} belongs to another program: it has tables but no schema version of"
                " cbsr-qa",
                remedy="use another database",
            )
        case _:
            return StoreError(
                f"{name_database(engine.url)} does not exist or is empty",
                remedy="test a sensor first, or name another database with --database",
            )


def _upgradable(engine: Engine, version: SchemaVersion) -> SchemaVersion:
    if version.age in (Age.NEWER, Age.UNRELEASED, Age.FOREIGN):
        raise refusal(engine, version)
    return version


def _read_version(connection: Connection) -> SchemaVersion:
    looked_at = inspect(connection)
    if not looked_at.has_table(VERSION_TABLE):
        return SchemaVersion(Age.FOREIGN if looked_at.get_table_names() else Age.EMPTY, None)
    revision = connection.scalar(text(f"SELECT version_num FROM {VERSION_TABLE}"))
    if revision is None:
        return SchemaVersion(Age.EMPTY if looked_at.get_table_names() == [VERSION_TABLE] else Age.FOREIGN, None)
    if revision == HEAD:
        return SchemaVersion(Age.CURRENT, revision)
    if revision in _UNRELEASED:
        return SchemaVersion(Age.UNRELEASED, revision)
    return SchemaVersion(Age.OLDER if revision in REVISIONS else Age.NEWER, revision)


def _make_folder(engine: Engine) -> None:
    file = sqlite_file(engine.url)
    if file is None:
        return
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"{name_database(engine.url)}: its folder cannot be created: {error.strerror}",
            remedy=f"free the path, or use another database\n{AT_COMMAND_LINE}--database or CBSR_QA_DATABASE",
        ) from error


@contextmanager
def _folder_for_now(engine: Engine, folder: Path) -> Iterator[None]:
    """Create the folder of a database while entered; StoreError if it cannot be created."""
    created_folders = [above for above in (folder, *folder.parents) if not above.exists()]
    try:
        _make_folder(engine)
        yield
    finally:
        for above in created_folders:
            with suppress(OSError):  # the folder was not created, or holds files of others
                above.rmdir()


def _create(connection: Connection) -> None:
    """Create tables and views of an empty database at once: all migrations, and Alembic itself, take 0.3 s.

    They are the same as those that the migrations make, which is tested.
    """
    from cbsr_qa.store.tables.records import ChartReferenceRow, ReleaseRow
    from cbsr_qa.store.tables.results import AnalysisRow
    from cbsr_qa.store.tables.runs import Base, RunRow
    from cbsr_qa.store.tables.sync import SyncAcceptsRow

    # All files are registered.
    assert {row_class.metadata for row_class in (AnalysisRow, ChartReferenceRow, ReleaseRow, RunRow)} == {
        Base.metadata
    }
    Base.metadata.create_all(connection)
    connection.execute(insert(SyncAcceptsRow), {"oldest_schema": OLDEST_SENDER})
    key = PrimaryKeyConstraint(name=f"{VERSION_TABLE}_pkc")
    version = Table(
        VERSION_TABLE, MetaData(), Column("version_num", String(32), nullable=False, primary_key=True), key
    )
    version.create(connection, checkfirst=True)
    connection.execute(version.insert(), {"version_num": HEAD})
    create_views(connection)


def _migrate(connection: Connection) -> None:
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", SCRIPTS)
    config.attributes["connection"] = connection
    command.upgrade(config, HEAD)
