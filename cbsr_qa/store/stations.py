"""Station checks: appended; the latest one gives a station's state.

References of control charts: appended; the latest of each chart holds, unless it retires the chart.
"""

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Engine, Row, func, insert, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.results.charts import ChartKind, ChartReference
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, RingReadings, StationCheck
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import convert_row, row_of
from cbsr_qa.store.outbox import Kind, announce
from cbsr_qa.store.runs.codec import frame_block, frame_values
from cbsr_qa.store.seals import check_seal, new_seal
from cbsr_qa.store.tables.records import (
    ChartReferenceRow,
    StationCheckFramesRow,
    StationCheckLineRow,
    StationCheckRow,
)
from cbsr_qa.store.tables.runs import FrameBlockRow, InstrumentRow, RunRow

_SETTINGS = ("subgroup", "rules", "weight", "width", "slack", "threshold")


def save_references(engine: Engine, references: Sequence[ChartReference]) -> None:
    """Store references of charts in one transaction; earlier ones are kept.

    Raises
    ------
    StoreError
        If one is already stored, one of its runs is missing, or the database cannot be written.
    """
    if references:
        with writing(engine) as connection:
            connection.execute(insert(ChartReferenceRow), [_values(one) for one in references])
            announce(connection, Kind.CHART_REFERENCE, [one.reference for one in references])


def current_references(engine: Engine, station: str, until: str = "") -> tuple[ChartReference, ...]:
    """Return the current references of a station's charts in the order stored; retired charts have none.

    Parameters
    ----------
    until : ignore references that sort after this name.
    """
    query = select(*ChartReferenceRow.__table__.columns).where(ChartReferenceRow.station == station)
    if until:
        query = query.where(ChartReferenceRow.reference <= until)
    with reading(engine) as connection:
        rows = connection.execute(query.order_by(ChartReferenceRow.reference)).all()
    latest = {(one.recipe, one.golden, one.key, one.chart): one for one in map(_reference, rows)}
    holding = (one for one in latest.values() if not one.retired)
    return tuple(sorted(holding, key=lambda one: one.reference))


def all_references(engine: Engine, station: str = "") -> tuple[ChartReference, ...]:
    """Return all references of a station's charts (empty: of all stations), oldest first."""
    query = select(*ChartReferenceRow.__table__.columns)
    if station:
        query = query.where(ChartReferenceRow.station == station)
    with reading(engine) as connection:
        return tuple(_reference(row) for row in connection.execute(query.order_by(ChartReferenceRow.reference)))


def _values(one: ChartReference) -> dict[str, Any]:
    settings = {name: getattr(one, name) for name in _SETTINGS} | {"rules": list(one.rules)}
    return {
        **row_of(ChartReferenceRow, one, golden=one.golden or "", kind=str(one.chart)),
        # Only where set, so that rows of earlier versions of this program read the same.
        "settings": settings | ({"retired": True} if one.retired else {}),
    }


def _reference(row: Row[Any]) -> ChartReference:
    settings = {name: row.settings[name] for name in _SETTINGS}
    return convert_row(
        ChartReference,
        row,
        chart=read_word(ChartKind, row.kind, "chart_references.kind", f"reference {row.reference}"),
        golden=row.golden or None,
        retired=bool(row.settings.get("retired", False)),
        **settings | {"rules": tuple(settings["rules"])},
    )


def save_check(engine: Engine, check: StationCheck, ring: RingReadings | None = None) -> None:
    """Store a check with all its lines, and the frames of its ring, in one transaction.

    Raises
    ------
    StoreError
        If it is already stored, its golden run is missing, or the database cannot be written.
    """
    instruments = [row_of(InstrumentRow, one) for one in check.instruments]
    values = row_of(StationCheckRow, check, check_id=check.check, instruments=instruments, seal=None)
    lines = [
        row_of(StationCheckLineRow, line, check_id=check.check, number=number)
        for number, line in enumerate(check.results)
    ]
    rings = []
    if ring is not None:
        own = {"check_id": check.check, "resistances_ohm": [float(one) for one in ring.resistances_ohm]}
        rings = [own | frame_values(ring.frames)]
    tables = (StationCheckRow, [values]), (StationCheckLineRow, lines), (StationCheckFramesRow, rings)
    with writing(engine) as connection:
        values["seal"] = new_seal(connection, check.check, [(table, row) for table, rows in tables for row in rows])
        for table, rows in tables:
            if rows:
                connection.execute(insert(table), rows)
        announce(connection, Kind.STATION_CHECK, [check.check])


def latest_check(engine: Engine, station: str, before: datetime | None = None) -> StationCheck | None:
    """Return the latest check of a station, or None.

    Parameters
    ----------
    before : ignore later checks.
    """
    query = select(*StationCheckRow.__table__.columns).where(StationCheckRow.station == station)
    if before is not None:
        query = query.where(StationCheckRow.checked_at <= before)
    newest = query.order_by(StationCheckRow.checked_at.desc(), StationCheckRow.check_id.desc()).limit(1)
    with reading(engine) as connection:
        row = connection.execute(newest).one_or_none()
        return None if row is None else _check(connection, row)


def latest_golden_check(engine: Engine, station: str) -> StationCheck | None:
    """Return the latest check of a station that measured a golden sensor, or None."""
    row = StationCheckRow
    newest = select(*row.__table__.columns).where(row.station == station).order_by(row.check_id.desc())
    with reading(engine) as connection:
        for found in connection.execute(newest.execution_options(yield_per=10)):
            check = _check(connection, found)
            # One that was altered may have measured a golden sensor.
            if found.golden_run is not None or check.altered:
                return check
    return None


def runs_since(engine: Engine, station: str, run: str, most: int) -> int:
    """Count the runs of a station that began after a run, up to ``most``."""
    later = select(RunRow.run).where(RunRow.station == station, RunRow.run > run).limit(most).subquery()
    with reading(engine) as connection:
        return connection.scalar(select(func.count()).select_from(later)) or 0


def ring_of(engine: Engine, check: str) -> RingReadings | None:
    """Return the frames of a check's reference ring; None if not measured.

    Raises
    ------
    StoreError
        If the stored frames were altered.
    """
    query = select(*StationCheckFramesRow.__table__.columns).where(StationCheckFramesRow.check_id == check)
    with reading(engine) as connection:
        found = connection.execute(query).mappings().one_or_none()
    if found is None:
        return None
    columns = {name: value for name, value in found.items() if name not in ("check_id", "resistances_ohm")}
    try:
        frames = frame_block(FrameBlockRow(run="", phase=0, block=0, **columns))
    except StoreError as error:
        raise StoreError(
            f"the ring's frames of station check {check} are not what was measured: their digest does not match",
            remedy="restore the database from a copy",
        ) from error
    return RingReadings(frames, tuple(float(one) for one in found["resistances_ohm"]))


def _check(connection: Connection, row: Row[Any]) -> StationCheck:
    lines = select(*StationCheckLineRow.__table__.columns).where(StationCheckLineRow.check_id == row.check_id)
    of_check = f"check {row.check_id}"
    sealed, problem = check_seal(connection, row.check_id, row.seal)
    results = (
        convert_row(
            CheckResult, line, outcome=read_word(CheckOutcome, line.outcome, "station_check_lines.outcome", of_check)
        )
        for line in connection.execute(lines.order_by(StationCheckLineRow.number))
    )
    return convert_row(
        StationCheck,
        row,
        check=row.check_id,
        instruments=() if problem else tuple(fill_from_mapping(InstrumentIdentity, one) for one in row.instruments),
        results=(_mark_altered(problem),) if problem else tuple(results),
        sealed=sealed,
        altered=problem,
    )


def _mark_altered(problem: str) -> CheckResult:
    """Return what an altered check shows in place of its lines, also to who asks for the golden sensor."""
    return CheckResult(
        "what is stored of this check",
        CheckOutcome.FAILED,
        said=problem,
        remedy="check the station again, and find out who changed the database",
        subject="golden sensor, and everything else",
    )
