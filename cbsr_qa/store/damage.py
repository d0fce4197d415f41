"""Whether a SQLite file is whole, seen as the next program will see it."""

from typing import Final

from sqlalchemy import Engine

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.run import RunRecord
from cbsr_qa.store.engine import reading, sqlite_file
from cbsr_qa.store.failures import address, shown
from cbsr_qa.store.runs import load_run

#: Up to this size indexes are compared with their tables too, which takes twice as long (2 s a GB, in the cache) [B].
_COMPARED: Final = 2_000_000_000


def look_afresh(engine: Engine) -> None:
    """Close what is open: the log goes into the file, and what is read next comes from there, not from memory.

    A connection keeps the pages it wrote, and goes on with them whatever becomes of the log on the disk.
    """
    if sqlite_file(engine.url) is not None:
        engine.dispose()


def whole_run(engine: Engine, run: str) -> RunRecord:
    """Load a run afresh, as :func:`cbsr_qa.store.runs.load_run`, with the whole file checked; no file on PostgreSQL.

    Raises
    ------
    StoreError
        If something is damaged; it says whether the run can be saved.
    """
    look_afresh(engine)
    problem = _problem(engine)
    try:
        record = load_run(engine, run)
    except StoreError as error:
        if not problem:
            raise
        of_file = error.reason.startswith(shown(engine.url))  # says again what the check of the file said
        of_run = "" if of_file else f": {error.reason}"
        raise StoreError(
            f"{problem}, and this run with it{of_run}",
            remedy="restore the database from a copy; what was measured after that copy is lost",
        ) from error
    if problem:
        file = address(engine.url)
        raise StoreError(
            f"{problem}; every row and frame of this run was checked and is whole",
            remedy=f"restore the database from a copy, or recover the file: sqlite3 {file} .recover | sqlite3 NEW",
        )
    return record


def _problem(engine: Engine) -> str:
    """Say which file has a problem, and the first one found; empty where there is none, and for other databases."""
    file = sqlite_file(engine.url)
    if file is None:
        return ""
    check = "integrity_check(1)" if file.stat().st_size <= _COMPARED else "quick_check(1)"
    try:
        with reading(engine) as connection:
            said = str(connection.exec_driver_sql(f"PRAGMA {check}").scalar())
    except StoreError as error:
        return error.reason
    found = " ".join(said.removeprefix("*** in database main ***").split())
    return "" if said == "ok" else f"{shown(engine.url)} is damaged ({found})"
