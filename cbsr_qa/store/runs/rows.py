"""Rows of a run: inserted at its start, and look-ups."""

from typing import Any

from sqlalchemy import Connection, Row, Select, insert, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.readings.loads import EasedStrain, Load, LoadRecord
from cbsr_qa.domain.run.run import InstrumentIdentity, PressDecided, RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity, SensorPart
from cbsr_qa.store.chain.links import add_rows, new_chain
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.mapping import convert_row, row_of
from cbsr_qa.store.runs.begun import note_begun, run_before
from cbsr_qa.store.tables.runs import (
    DecisionRow,
    InstrumentRow,
    PartRow,
    PhaseEndRow,
    PhaseRow,
    RunRow,
    RunStateRow,
    SensorRow,
)


def begin_run(connection: Connection, identity: RunIdentity, configuration: str, setting: dict[str, Any]) -> None:
    """Insert a run with its instruments and parts, and its sensor if new."""
    sensor = identity.sensor
    if connection.scalar(select(SensorRow.serial).where(SensorRow.serial == sensor.serial)) is None:
        connection.execute(insert(SensorRow), row_of(SensorRow, sensor))
    row = row_of(
        RunRow,
        identity,
        serial=sensor.serial,
        batch=sensor.batch,
        sensor_type=sensor.sensor_type,
        configuration=configuration,
        setting=setting,
        chain=new_chain(connection),
        **run_before(connection),
    )
    instruments = [
        row_of(InstrumentRow, instrument, run=identity.run, position=position)
        for position, instrument in enumerate(identity.instruments)
    ]
    add_rows(connection, identity.run, RunRow, [row])
    note_begun(connection, identity.run)
    add_rows(connection, identity.run, InstrumentRow, instruments)
    add_rows(connection, identity.run, PartRow, [row_of(PartRow, part, run=identity.run) for part in identity.parts])


def run_row(connection: Connection, run: str) -> Row[Any] | None:
    """Return a run's row, or None."""
    return connection.execute(select(*RunRow.__table__.columns).where(RunRow.run == run)).one_or_none()


def phases_of(run: str) -> Select[Any]:
    """Query the phases of a run in order, each with its end [s]: None where it was interrupted or is under way."""
    phase, end = PhaseRow, PhaseEndRow
    joined = select(*phase.__table__.columns, end.ended_s).outerjoin(
        end, (end.run == phase.run) & (end.phase == phase.phase)
    )
    return joined.where(phase.run == run).order_by(phase.phase)


def load_record(row: Any) -> LoadRecord:
    """Return the press of a row."""
    return convert_row(
        LoadRecord,
        row,
        index=row.load_index,
        load=convert_row(Load, row),
        eased=tuple(EasedStrain(*map(float, step)) for step in row.eased or ()),
    )


def decisions_of(connection: Connection, run: str) -> tuple[PressDecided, ...]:
    """Return the decisions of a run in their order."""
    query = select(*DecisionRow.__table__.columns).where(DecisionRow.run == run)
    rows = connection.execute(query.order_by(DecisionRow.phase, DecisionRow.pressed))
    return tuple(
        convert_row(
            PressDecided,
            row,
            load=row.load_index,
            expected_N=row.expected_n,
            upper_N=row.upper_n,
            floor_N=row.floor_n,
        )
        for row in rows
    )


def current_state(connection: Connection, run: str) -> Row[Any]:
    """Return the last state of a run. StoreError if its end is invalid."""
    states = select(*RunStateRow.__table__.columns).where(RunStateRow.run == run)
    row = connection.execute(states.order_by(RunStateRow.number.desc()).limit(1)).one_or_none()
    if row is None:
        raise StoreError(f"there is no run {run}")
    read_word(EndReason, row.end, "run_states.end", f"run {run}, state {row.number},")
    return row


def identity_of(connection: Connection, row: Row[Any]) -> RunIdentity:
    """Return the identity stored in a run's row."""
    query = select(*InstrumentRow.__table__.columns).where(InstrumentRow.run == row.run)
    instruments = connection.execute(query.order_by(InstrumentRow.position))
    parts = select(*PartRow.__table__.columns).where(PartRow.run == row.run).order_by(PartRow.name)
    return convert_row(
        RunIdentity,
        row,
        sensor=convert_row(SensorIdentity, row),
        instruments=tuple(convert_row(InstrumentIdentity, instrument) for instrument in instruments),
        parts=tuple(convert_row(SensorPart, part) for part in connection.execute(parts)),
    )
