"""Whether a database is sound: its file, its references, and every run with its chain and frames."""

from collections.abc import Iterator

from sqlalchemy import Connection, Engine, select, text

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.run import ChainState
from cbsr_qa.store.chain import check_run
from cbsr_qa.store.engine import file_problem, reading, sqlite_file
from cbsr_qa.store.results import calibrations
from cbsr_qa.store.runs import runs
from cbsr_qa.store.seals import check_seal
from cbsr_qa.store.stations import ring_of
from cbsr_qa.store.tables import Base, CalibrationRow, StationCheckFramesRow, StationCheckRow

#: Rows of one table that refer to nothing and are named; the rest is counted.
_MOST_NAMED = 10


def file_problems(engine: Engine) -> Iterator[str]:
    """Yield what is wrong with a SQLite file as a whole: its pages, and rows that refer to rows that are missing.

    A PostgreSQL server keeps both itself.
    """
    if sqlite_file(engine.url) is None:
        return
    if problem := file_problem(engine):
        yield problem
        return
    with reading(engine) as connection:
        for number, row in enumerate(connection.exec_driver_sql("PRAGMA foreign_key_check")):
            if number >= _MOST_NAMED:
                yield "more rows refer to rows that are missing"
                return
            yield f"{_row(connection, row[0], row[1])} refers to a row of {row[2]} that is missing"


def _row(connection: Connection, table: str, rowid: int | None) -> str:
    """Name a row by its primary key, where its table has row numbers."""
    if rowid is None:
        return f"a row of {table}"
    key = [column.name for column in Base.metadata.tables[table].primary_key]
    found = connection.execute(text(f"SELECT {', '.join(key)} FROM {table} WHERE rowid = :rowid"), {"rowid": rowid})
    return f"{table} ({', '.join(f'{name} {value}' for name, value in zip(key, found.one(), strict=True))})"


def check_stored_run(engine: Engine, run: str, *, frames: bool) -> ChainState:
    """Check every link and row of a run; with ``frames`` also every frame and sample, and its calibrations' files.

    Raises
    ------
    StoreError
        If something was altered or is damaged; it names table and row.
    """
    if not frames:
        with reading(engine) as connection:
            return check_run(connection, run)
    chain = runs.load_run(engine, run).chain
    with reading(engine) as connection:
        issued = list(connection.scalars(select(CalibrationRow.calibration).where(CalibrationRow.run == run)))
    for calibration in issued:
        calibrations.calibration_file(engine, calibration)
    return chain


def seal_problems(engine: Engine) -> Iterator[str]:
    """Yield which checks of stations do not match their seals."""
    row = StationCheckRow
    with reading(engine) as connection:
        for check, seal in connection.execute(select(row.check_id, row.seal).order_by(row.check_id)).all():
            _, problem = check_seal(connection, check, seal)
            if problem:
                yield problem


def ring_problems(engine: Engine) -> Iterator[str]:
    """Yield which frames of reference rings, taken by checks of stations, are not what was stored."""
    with reading(engine) as connection:
        checks = list(
            connection.scalars(select(StationCheckFramesRow.check_id).order_by(StationCheckFramesRow.check_id))
        )
    for check in checks:
        try:
            ring_of(engine, check)
        except StoreError as error:
            yield error.reason
