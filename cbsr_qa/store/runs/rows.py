"""Rows of a run: inserted at its start, and look-ups."""

from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection, Row, RowMapping, insert, select

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import EndReason
from cbsr_qa.domain.run import InstrumentIdentity, RunIdentity
from cbsr_qa.domain.sensor import SensorIdentity
from cbsr_qa.store.chain import add_rows, new_chain
from cbsr_qa.store.engine import stored
from cbsr_qa.store.tables import InstrumentRow, RunRow, RunStateRow, SensorRow


def begin_run(connection: Connection, identity: RunIdentity, configuration: str, setting: dict[str, Any]) -> None:
    """Insert a run with its sensor (where it is new) and its instruments."""
    sensor = identity.sensor
    if connection.scalar(select(SensorRow.serial).where(SensorRow.serial == sensor.serial)) is None:
        values = {"serial": sensor.serial, "batch": sensor.batch, "sensor_type": sensor.sensor_type}
        connection.execute(insert(SensorRow), {**values, "first_seen": identity.started_at})
    row = {
        "run": identity.run,
        "serial": sensor.serial,
        "batch": sensor.batch,
        "sensor_type": sensor.sensor_type,
        "station": identity.station,
        "recipe": identity.recipe,
        "operator": identity.operator,
        "started_at": identity.started_at,
        "configuration": configuration,
        "configuration_digest": identity.configuration_digest,
        "software": [list(pair) for pair in identity.software],
        "simulated": list(identity.simulated),
        "setting": setting,
        "chain": new_chain(connection),
    }
    instruments = [
        {"run": identity.run, "position": position} | instrument_values(instrument)
        for position, instrument in enumerate(identity.instruments)
    ]
    add_rows(connection, identity.run, RunRow, [row])
    add_rows(connection, identity.run, InstrumentRow, instruments)


def run_row(connection: Connection, run: str) -> Row[Any] | None:
    """Return a run's row, or None."""
    return connection.execute(select(*RunRow.__table__.columns).where(RunRow.run == run)).one_or_none()


def current_state(connection: Connection, run: str) -> Row[Any]:
    """Return the last state of a run. StoreError if its end is invalid."""
    states = select(*RunStateRow.__table__.columns).where(RunStateRow.run == run)
    row = connection.execute(states.order_by(RunStateRow.number.desc()).limit(1)).one_or_none()
    if row is None:
        raise StoreError(f"there is no run {run}")
    stored(EndReason, row.end, "run_states.end", f"run {run}, state {row.number},")
    return row


def identity_of(connection: Connection, row: Row[Any]) -> RunIdentity:
    """Return the identity stored in a run's row."""
    instruments = select(*InstrumentRow.__table__.columns).where(InstrumentRow.run == row.run)
    return RunIdentity(
        run=row.run,
        sensor=SensorIdentity(row.serial, row.batch, row.sensor_type),
        station=row.station,
        recipe=row.recipe,
        operator=row.operator,
        started_at=row.started_at,
        configuration_digest=row.configuration_digest,
        software=tuple((name, version) for name, version in row.software),
        instruments=tuple(
            instrument_of(row) for row in connection.execute(instruments.order_by(InstrumentRow.position)).mappings()
        ),
        simulated=tuple(row.simulated),
    )


def instrument_of(values: RowMapping | Mapping[str, Any]) -> InstrumentIdentity:
    """Return an identity; the inverse of :func:`instrument_values`."""
    said = ("role", "driver", "model", "serial", "firmware", "simulated", "calibration_due")
    notes = tuple((what, value) for what, value in values["notes"] or ())
    return InstrumentIdentity(**{name: values[name] for name in said}, notes=notes)


def instrument_values(instrument: InstrumentIdentity) -> dict[str, Any]:
    """Return what an instrument says of itself as plain columns."""
    return {
        "role": instrument.role,
        "driver": instrument.driver,
        "model": instrument.model,
        "serial": instrument.serial,
        "firmware": instrument.firmware,
        "simulated": bool(instrument.simulated),
        "calibration_due": instrument.calibration_due,
        "notes": [list(note) for note in instrument.notes],
    }
