"""Station checks: appended; the latest one gives a station's state.

Rows that cannot be read are passed over; db check names them.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Engine, func, insert, select, type_coerce
from sqlalchemy.types import NullType

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, RingReadings, StationCheck
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import convert_row, row_of
from cbsr_qa.store.odd_rows import keep_odd_text, read_rows_apart
from cbsr_qa.store.outbox import Kind, announce
from cbsr_qa.store.runs.codec import frame_block, frame_values
from cbsr_qa.store.seals import check_seal, new_seal
from cbsr_qa.store.tables.records import (
    StationCheckFramesRow,
    StationCheckLineRow,
    StationCheckRow,
)
from cbsr_qa.store.tables.runs import FrameBlockRow, InstrumentRow, RunRow


class StationChecks:
    """Checks of stations."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def save_check(self, check: StationCheck, ring: RingReadings | None = None) -> None:
        """Store a check with all its lines, and the frames of its ring, in one transaction.

        Raises
        ------
        StoreError
            If it is already stored, its golden run is missing, or the database cannot be written.
        """
        instruments = [row_of(InstrumentRow, instrument) for instrument in check.instruments]
        values = row_of(StationCheckRow, check, check_id=check.check, instruments=instruments, seal=None)
        lines = [
            row_of(StationCheckLineRow, line, check_id=check.check, number=number)
            for number, line in enumerate(check.results)
        ]
        rings = []
        if ring is not None:
            ring_cells = {"check_id": check.check, "resistances_ohm": [float(ohm) for ohm in ring.resistances_ohm]}
            rings = [ring_cells | frame_values(ring.frames)]
        tables = (StationCheckRow, [values]), (StationCheckLineRow, lines), (StationCheckFramesRow, rings)
        with writing(self._engine) as connection:
            values["seal"] = new_seal(
                connection, check.check, [(table, row) for table, rows in tables for row in rows]
            )
            for table, rows in tables:
                if rows:
                    connection.execute(insert(table), rows)
            announce(connection, Kind.STATION_CHECK, [check.check])

    def read_latest_check(self, station: str, before: datetime | None = None) -> StationCheck | None:
        """Return the latest check of a station, or None.

        Parameters
        ----------
        before : moment of the latest check that counts; None for any.
        """
        conditions = [StationCheckRow.station == station]
        if before is not None:
            conditions.append(StationCheckRow.checked_at <= before)
        order = StationCheckRow.checked_at.desc(), StationCheckRow.check_id.desc()
        with reading(self._engine) as connection:
            return next(_read_checks(connection, conditions, order), None)

    def read_latest_golden_check(self, station: str) -> StationCheck | None:
        """Return the latest check of a station that measured a golden sensor, or None."""
        table = StationCheckRow
        with reading(self._engine) as connection:
            for check in _read_checks(connection, [table.station == station], [table.check_id.desc()]):
                # An altered check may have measured a golden sensor.
                if check.golden_run is not None or check.altered:
                    return check
        return None

    def count_runs_since(self, station: str, run: str, most: int) -> int:
        """Count the runs of a station that began after a run, up to ``most``."""
        later = select(RunRow.run).where(RunRow.station == station, RunRow.run > run).limit(most).subquery()
        with reading(self._engine) as connection:
            return connection.scalar(select(func.count()).select_from(later)) or 0

    def read_ring(self, check: str) -> RingReadings | None:
        """Return the frames of a check's reference ring; None if not measured.

        Raises
        ------
        StoreError
            If the stored frames were altered.
        """
        query = select(*StationCheckFramesRow.__table__.columns).where(StationCheckFramesRow.check_id == check)
        with reading(self._engine) as connection:
            row = connection.execute(query).mappings().one_or_none()
        if row is None:
            return None
        columns = {name: value for name, value in row.items() if name not in ("check_id", "resistances_ohm")}
        try:
            frames = frame_block(FrameBlockRow(run="", phase=0, block=0, **columns))
        except StoreError as error:
            raise StoreError(
                f"the ring's frames of station check {check} are not what was measured: their digest does not match",
                remedy="restore the database from a copy",
            ) from error
        return RingReadings(frames, tuple(float(resistance_ohm) for resistance_ohm in row["resistances_ohm"]))


def _read_checks(
    connection: Connection, conditions: Sequence[ColumnElement[bool]], order: Sequence[ColumnElement[Any]]
) -> Iterator[StationCheck]:
    """Yield checks in an order; those that cannot be read are left out."""
    row = StationCheckRow
    names: Any = select(type_coerce(row.check_id, NullType())).where(*conditions).order_by(*order)
    with keep_odd_text(connection):
        stored = connection.scalars(names).all()
    for name in stored:
        for cells in read_rows_apart(connection, row, type_coerce(row.check_id, NullType()) == name).rows:
            yield _check(connection, cells)


def _check(connection: Connection, row: Mapping[str, Any]) -> StationCheck:
    lines = select(*StationCheckLineRow.__table__.columns).where(StationCheckLineRow.check_id == row["check_id"])
    of_check = f"check {row['check_id']}"
    seal_state, problem = check_seal(connection, row["check_id"], row["seal"])
    results = (
        convert_row(
            CheckResult, line, outcome=read_word(CheckOutcome, line.outcome, "station_check_lines.outcome", of_check)
        )
        for line in connection.execute(lines.order_by(StationCheckLineRow.number))
    )
    return fill_from_mapping(
        StationCheck,
        row,
        check=row["check_id"],
        instruments=()
        if problem
        else tuple(fill_from_mapping(InstrumentIdentity, identity) for identity in row["instruments"]),
        results=(_mark_altered(problem),) if problem else tuple(results),
        sealed=seal_state,
        altered=problem,
    )


def _mark_altered(problem: str) -> CheckResult:
    """Return the result that an altered check shows in place of its lines, also of its golden sensor."""
    return CheckResult(
        "what is stored of this check",
        CheckOutcome.FAILED,
        said=problem,
        remedy="check the station again, and find out who changed the database",
        subject="golden sensor, and everything else",
    )
