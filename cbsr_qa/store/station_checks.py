"""Checks of stations: added one after the other; the latest one says how a station stands."""

from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Engine, Row, RowMapping, insert, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.station_check import CheckOutcome, CheckResult, RingReadings, StationCheck
from cbsr_qa.store.blocks import frame_block, frame_values
from cbsr_qa.store.check_tables import StationCheckFramesRow, StationCheckLineRow, StationCheckRow
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.failures import stored
from cbsr_qa.store.run_rows import instrument_of, instrument_values
from cbsr_qa.store.run_tables import FrameBlockRow

_LINE = ("name", "value", "unit", "allowed", "remedy", "said", "subject")


def save_check(engine: Engine, check: StationCheck, ring: RingReadings | None) -> None:
    """Store a check with all its lines, and the frames of its ring, in one transaction.

    Raises
    ------
    StoreError
        If it is stored already, its golden run is not, or the database cannot be written.
    """
    values = {
        "check_id": check.check,
        "station": check.station,
        "operator": check.operator,
        "checked_at": check.checked_at,
        "sensor_type": check.sensor_type,
        "configuration_digest": check.configuration_digest,
        "software": [list(pair) for pair in check.software],
        "instruments": [instrument_values(one) for one in check.instruments],
        "outcome": str(check.outcome),
        "golden_run": check.golden_run,
    }
    lines = [
        {"check_id": check.check, "number": number, "outcome": str(line.outcome)}
        | {name: getattr(line, name) for name in _LINE}
        for number, line in enumerate(check.results)
    ]
    with writing(engine) as connection:
        connection.execute(insert(StationCheckRow), values)
        if lines:
            connection.execute(insert(StationCheckLineRow), lines)
        if ring is not None:
            own = {"check_id": check.check, "resistances_ohm": [float(one) for one in ring.resistances_ohm]}
            connection.execute(insert(StationCheckFramesRow), own | frame_values(ring.frames))


def latest_check(engine: Engine, station: str, before: datetime | None = None) -> StationCheck | None:
    """Return the latest check of a station, or None where it was never checked.

    Parameters
    ----------
    before : leave out checks of after this moment: what was known when a run began.
    """
    query = select(*StationCheckRow.__table__.columns).where(StationCheckRow.station == station)
    if before is not None:
        query = query.where(StationCheckRow.checked_at <= before)
    newest = query.order_by(StationCheckRow.checked_at.desc(), StationCheckRow.check_id.desc()).limit(1)
    with reading(engine) as connection:
        row = connection.execute(newest).one_or_none()
        return None if row is None else _check(connection, row)


def ring_of(engine: Engine, check: str) -> RingReadings | None:
    """Return the frames of a check's reference ring; None where none was measured.

    Raises
    ------
    StoreError
        If what is stored is not what was measured.
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
            f"the ring's frames of station check {check} are not what was measured: their digest does not fit",
            remedy="restore the database from a copy",
        ) from error
    return RingReadings(frames, tuple(float(one) for one in found["resistances_ohm"]))


def _check(connection: Connection, row: Row[Any]) -> StationCheck:
    lines = select(*StationCheckLineRow.__table__.columns).where(StationCheckLineRow.check_id == row.check_id)
    found = connection.execute(lines.order_by(StationCheckLineRow.number)).mappings()
    return StationCheck(
        check=row.check_id,
        station=row.station,
        operator=row.operator,
        checked_at=row.checked_at,
        sensor_type=row.sensor_type,
        configuration_digest=row.configuration_digest,
        software=tuple((name, version) for name, version in row.software),
        instruments=tuple(instrument_of(one) for one in row.instruments),
        results=tuple(
            CheckResult(
                outcome=stored(CheckOutcome, line["outcome"], "station_check_lines.outcome", f"check {row.check_id}"),
                **{name: line[name] for name in _LINE},
            )
            for line in found
        ),
        golden_run=row.golden_run,
    )


def _outcome(line: RowMapping) -> CheckOutcome:
    row = f"check {line['check_id']}, line {line['number']},"
    return stored(CheckOutcome, line["outcome"], "station_check_lines.outcome", row)
