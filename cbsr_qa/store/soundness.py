"""Whether a database is sound: its file, its references, its runs one after the other, and each with its frames."""

from collections.abc import Iterator, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, Engine, Row, exists, func, select, text, type_coerce
from sqlalchemy.types import NullType

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.run.run import ChainState
from cbsr_qa.store.chain.check import check_run
from cbsr_qa.store.chain.links import PLAIN, new_chain, signing_key
from cbsr_qa.store.chain.run_documents import KEYS
from cbsr_qa.store.engine import file_problem, reading, sqlite_file
from cbsr_qa.store.golden import find_doubtful_checks
from cbsr_qa.store.odd_rows import keep_odd_text, read_rows_apart
from cbsr_qa.store.results.calibrations import Calibrations
from cbsr_qa.store.runs import begun
from cbsr_qa.store.runs.runs import Runs
from cbsr_qa.store.seals import check_seals
from cbsr_qa.store.stations import StationChecks
from cbsr_qa.store.tables.records import LinkRow, StationCheckFramesRow, StationCheckRow
from cbsr_qa.store.tables.results import CalibrationRow
from cbsr_qa.store.tables.runs import Base, RunRow, SensorRow
from cbsr_qa.store.tables.sync import OutboxRow

#: Most rows with a missing reference that are named.
_MAX_NAMED = 10


class Soundness:
    """Whether a database is sound."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def find_file_problems(self) -> Iterator[str]:
        """Yield the problems of a SQLite file as a whole: damaged pages, and rows that refer to missing rows.

        A PostgreSQL server takes care of both itself.
        """
        if sqlite_file(self._engine.url) is None:
            return
        if problem := file_problem(self._engine):
            yield problem
            return
        with reading(self._engine) as connection:
            missing = connection.exec_driver_sql("PRAGMA foreign_key_check")
            for number, (table, row_id, referred_table, _) in enumerate(missing):
                if number >= _MAX_NAMED:
                    yield "more rows refer to rows that are missing"
                    return
                yield f"{_row(connection, table, row_id)} refers to a row of {referred_table} that is missing"

    def find_order_problems(self) -> tuple[tuple[begun.Gap, ...], tuple[str, ...]]:
        """Return the runs that are missing between others, and explanations of gaps and doubled places.

        Explained are runs that this database refused when they were sent here, and runs that a copy of a database
        continued.
        """
        with reading(self._engine) as connection:
            gaps = begun.gaps(connection)
            explanations = tuple(
                f"run {gap.run} is not here: it was refused when it was sent, see cbsr-qa db sync --status"
                for gap in gaps
                if gap.refused
            )
            return tuple(gap for gap in gaps if not gap.refused), (*explanations, *begun.forks(connection))

    def find_odd_rows(self) -> Iterator[str]:
        """Yield the problems of rows outside of runs that hold an odd cell; other reads skip them.

        Rows of runs are read with their runs, and frames of reference rings with their checks.
        """
        left_out = {*KEYS, LinkRow.__tablename__, StationCheckFramesRow.__tablename__, OutboxRow.__tablename__}
        with reading(self._engine) as connection:
            for mapper in sorted(Base.registry.mappers, key=lambda mapper: mapper.class_.__tablename__):
                if mapper.class_.__tablename__ not in left_out:
                    yield from read_rows_apart(connection, mapper.class_).problems
            yield from begun.name_odd_rows(connection)

    def find_misplaced_rows(self) -> Iterator[str]:
        """Yield rows that contradict other rows, although no link contradicts them.

        They are sensors that no run tested as their rows say, calibrations of another sensor than their run's, and
        runs without a chain or signature although earlier runs of their station have one.
        """
        of_sensor = RunRow.serial == SensorRow.serial
        same_kind = RunRow.batch == SensorRow.batch, RunRow.sensor_type == SensorRow.sensor_type
        serial: Any = type_coerce(SensorRow.serial, NullType())
        untested_query = select(serial).where(~exists().where(of_sensor, *same_kind)).order_by(SensorRow.serial)
        swapped_query = (
            select(CalibrationRow.calibration, CalibrationRow.serial, RunRow.run, RunRow.serial.label("tested"))
            .join(RunRow, RunRow.run == CalibrationRow.run)
            .where(RunRow.serial != CalibrationRow.serial)
        )
        with reading(self._engine) as connection:
            with keep_odd_text(connection):
                # Serials that are no text are odd rows, which find_odd_rows names.
                serials = [serial for serial in connection.scalars(untested_query) if isinstance(serial, str)]
            for serial in serials:
                yield f"sensors (serial {serial}) has a batch or type of which no run tested it"
            for row in connection.execute(swapped_query.order_by(CalibrationRow.calibration)):
                origin = f"calibration {row.calibration} is of sensor {row.serial}"
                yield f"{origin}; its run {row.run} tested {row.tested}"
            for run, earlier in _find_younger(connection, RunRow.chain.is_not(None), RunRow.chain.is_(None)):
                yield f"run {run} has no chain, and run {earlier} of its station, which is older, has one"
            if signing_key(connection) is not None:
                is_signed = RunRow.chain == new_chain(connection)
                for run, earlier in _find_younger(connection, is_signed, RunRow.chain == PLAIN):
                    yield f"run {run} is not signed, and run {earlier} of its station, which is older, is signed"

    def check_run(self, run: str, *, frames: bool) -> ChainState:
        """Check every link and row of a run, and return the state of its chain.

        Parameters
        ----------
        frames : check every frame and sample too, and the files of its calibrations.

        Raises
        ------
        StoreError
            If something was altered or is damaged; it names table and row.
        """
        if not frames:
            with reading(self._engine) as connection:
                return check_run(connection, run)
        chain = Runs(self._engine).load(run).chain
        with reading(self._engine) as connection:
            calibration_ids = list(
                connection.scalars(select(CalibrationRow.calibration).where(CalibrationRow.run == run))
            )
        calibrations = Calibrations(self._engine)
        for calibration in calibration_ids:
            calibrations.load_file(calibration)
        return chain

    def find_seal_problems(self) -> Iterator[str]:
        """Yield problems of station checks that do not match their seal, or the golden run that they name."""
        row = StationCheckRow
        with reading(self._engine) as connection:
            seals: dict[str, str | None] = dict(
                connection.execute(select(row.check_id, row.seal).order_by(row.check_id)).all()
            )
            altered = {check: problem for check, (_, problem) in check_seals(connection, seals).items() if problem}
            doubted = find_doubtful_checks(connection)
        yield from altered.values()
        for check in doubted.keys() - altered.keys():
            yield f"{doubted[check]}: the run is listed all the same"

    def find_ring_problems(self) -> Iterator[str]:
        """Yield problems of the frames of reference rings that are not as the station checks stored them."""
        with reading(self._engine) as connection:
            checks = list(
                connection.scalars(select(StationCheckFramesRow.check_id).order_by(StationCheckFramesRow.check_id))
            )
        for check in checks:
            try:
                StationChecks(self._engine).read_ring(check)
            except StoreError as error:
                yield error.reason


def _find_younger(
    connection: Connection, before: ColumnElement[bool], after: ColumnElement[bool]
) -> Sequence[Row[str, str]]:
    """Find runs of one kind of chain that are younger than their station's first run of another kind.

    Parameters
    ----------
    before, after : conditions on the kind of chain of the first run, and of the younger ones.

    Returns
    -------
    Pairs: the younger run, and the first run.
    """
    first_runs = (
        select(RunRow.station, func.min(RunRow.run).label("run")).where(before).group_by(RunRow.station).subquery()
    )
    query = select(RunRow.run, first_runs.c.run).join(first_runs, first_runs.c.station == RunRow.station)
    return connection.execute(query.where(after, RunRow.run > first_runs.c.run).order_by(RunRow.run)).all()


def _row(connection: Connection, table: str, rowid: int | None) -> str:
    """Name a row by its primary key, where its table has row numbers."""
    if rowid is None:
        return f"a row of {table}"
    key = [column.name for column in Base.metadata.tables[table].primary_key]
    result = connection.execute(text(f"SELECT {', '.join(key)} FROM {table} WHERE rowid = :rowid"), {"rowid": rowid})
    return f"{table} ({', '.join(f'{name} {value}' for name, value in zip(key, result.one(), strict=True))})"
