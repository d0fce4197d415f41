"""Issued calibrations as rows: everything but the imaging matrix, which sensor type and readings determine."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, insert, select, update
from sqlalchemy.orm import Session

from cbsr_qa.domain.calibration import (
    BaselineConductance,
    Calibration,
    OverlapBand,
    SettlingSummary,
    Validity,
)
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.reconstruction import LinearReconstruction
from cbsr_qa.domain.sensor import Parameter, QuasiStatic, Response, SensorIdentity
from cbsr_qa.store.arrays import digest, packed, packed_flags, unpacked, unpacked_flags
from cbsr_qa.store.codec import decoded_indenter, decoded_sensor_type, encoded
from cbsr_qa.store.engine import reading
from cbsr_qa.store.result_tables import BaselineRow, CalibrationRow, FitParameterRow, OverlapBandRow, SettlingRow
from cbsr_qa.store.run_tables import RunRow

#: Fit parameters: their name in the database, their unit, and what a calibration's ``assumed`` calls them.
_PARAMETERS = (
    ("against_stress.slope", "1/kPa", "α against stress"),
    ("against_stress.intercept", "1", "β against stress"),
    ("against_strain.slope", "1", "α against strain"),
    ("against_strain.intercept", "1", "β against strain"),
)


@dataclass(frozen=True, slots=True)
class CalibrationSummary:
    """A calibration in one line; ``superseded_by`` is None while it holds."""

    calibration: str
    serial: str
    run: str
    analysis: str
    issued_at: datetime
    superseded_by: str | None


def insert_calibration(connection: Connection, calibration: Calibration, analysis: str) -> None:
    """Insert a calibration with its rows and mark the sensor's earlier ones as superseded by it."""
    connection.execute(insert(CalibrationRow), _values(calibration, analysis))
    for table, rows in _rows(calibration):
        if rows:
            connection.execute(insert(table), [{"calibration": calibration.calibration, **row} for row in rows])
    earlier = update(CalibrationRow).where(
        CalibrationRow.serial == calibration.sensor.serial,
        CalibrationRow.calibration != calibration.calibration,
        CalibrationRow.superseded_by.is_(None),
    )
    connection.execute(earlier.values(superseded_by=calibration.calibration))


def calibrations_of(engine: Engine, serial: str) -> tuple[CalibrationSummary, ...]:
    """Return a sensor's calibrations, the latest first; the first is the one that holds."""
    row = CalibrationRow
    columns = row.calibration, row.serial, row.run, row.analysis, row.issued_at, row.superseded_by
    query = select(*columns).where(row.serial == serial).order_by(row.issued_at.desc(), row.calibration.desc())
    with reading(engine) as connection:
        return tuple(CalibrationSummary(*found) for found in connection.execute(query))


def used_readings(engine: Engine, calibration: str) -> NDArray[np.bool_]:
    """Return which readings a calibration images, (drives, measures) bool: what its matrix is prepared for."""
    with reading(engine) as connection, Session(bind=connection) as session:
        row = _known(session, calibration)
        return unpacked_flags(row.used, (row.drives, row.measures)).astype(np.bool_)


def load_calibration(engine: Engine, calibration: str, reconstruction: LinearReconstruction) -> Calibration:
    """Load a calibration.

    Parameters
    ----------
    reconstruction : its imaging matrix, prepared again by the same method for the same readings.

    Raises
    ------
    StoreError
        If there is no such calibration, its reference frame is not what was stored, or the matrix is not its own.
    """
    with reading(engine) as connection, Session(bind=connection) as session:
        row = _known(session, calibration)
        if (row.method, row.regularisation) != (reconstruction.method, reconstruction.choice.value):
            raise StoreError(
                f"calibration {calibration} was made with {row.method} at λ = {row.regularisation:g}, not with"
                f" {reconstruction.method} at λ = {reconstruction.choice.value:g}"
            )
        return _calibration(session, row, reconstruction)


def _known(session: Session, calibration: str) -> CalibrationRow:
    row = session.get(CalibrationRow, calibration)
    if row is None:
        raise StoreError(f"there is no calibration {calibration[:64]!r} in this database")
    if digest(f"{row.drives}x{row.measures}|V", (row.reference, row.used)) != row.reference_sha256:
        raise StoreError(
            f"calibration {calibration}: its reference frame is not what was stored",
            remedy="restore the database from a copy",
        )
    return row


def _values(calibration: Calibration, analysis: str) -> dict[str, Any]:
    reconstruction, validity = calibration.reconstruction, calibration.validity
    drives, measures = calibration.reference.shape
    reference, used = packed(calibration.reference), packed_flags(reconstruction.problem.used.astype("uint8"))
    return {
        "calibration": calibration.calibration,
        "run": calibration.run,
        "analysis": analysis,
        "serial": calibration.sensor.serial,
        "issued_at": datetime.fromisoformat(calibration.issued_at),
        "superseded_by": None,
        "response": str(calibration.response),
        "current_a": calibration.current_A,
        "scale": calibration.scale,
        "noise_floor": calibration.noise_floor,
        "mask": calibration.mask,
        "method": reconstruction.method,
        "regularisation": reconstruction.choice.value,
        "regularisation_how": reconstruction.choice.how,
        "noise_figure": reconstruction.choice.noise_figure,
        "drives": drives,
        "measures": measures,
        "reference": reference,
        "used": used,
        "reference_sha256": digest(f"{drives}x{measures}|V", (reference, used)),
        "overlap_threshold": calibration.overlap_threshold,
        **_validity_values(validity),
        "assumed": list(calibration.assumed),
        "simulated": list(calibration.simulated),
        "setting": encoded(calibration.sensor_type, calibration.indenter),
    }


def _validity_values(validity: Validity) -> dict[str, Any]:
    force_N, temperature_C = validity.force_N or (None, None), validity.temperature_C or (None, None)
    return {
        "force_low_n": force_N[0],
        "force_high_n": force_N[1],
        "strain_low": validity.strain[0],
        "strain_high": validity.strain[1],
        "temperature_low_c": temperature_C[0],
        "temperature_high_c": temperature_C[1],
        "radius_mm": validity.radius_mm,
        "reduced": list(validity.reduced),
    }


def _rows(calibration: Calibration) -> Iterator[tuple[Any, list[dict[str, Any]]]]:
    yield (
        BaselineRow,
        [
            {
                "number": number,
                "location": b.location,
                "x_mm": b.x_mm,
                "y_mm": b.y_mm,
                "value": b.value,
                "stderr": b.stderr,
                "loads": b.loads,
                "why": b.why,
            }
            for number, b in enumerate(calibration.baseline)
        ],
    )
    yield (
        SettlingRow,
        [
            {
                "number": number,
                "signal": s.signal,
                "loading": bool(s.loading),
                "mean_s": s.mean_s,
                "deviation_s": s.deviation_s,
                "accepted": s.accepted,
                "censored": s.censored,
                "rejected": s.rejected,
            }
            for number, s in enumerate(calibration.settling)
        ],
    )
    yield (
        OverlapBandRow,
        [
            {"number": number, "name": b.name, "lower_percent": b.lower, "upper_percent": b.upper}
            for number, b in enumerate(calibration.overlap_bands)
        ],
    )
    yield FitParameterRow, [_parameter_values(calibration, *parameter) for parameter in _PARAMETERS]


def _parameter_values(calibration: Calibration, name: str, unit: str, called: str) -> dict[str, Any]:
    fit, which = name.split(".")
    parameter: Parameter = getattr(getattr(calibration, fit), which)
    return {
        "name": name,
        "value": parameter.value,
        "stderr": parameter.stderr,
        "unit": unit,
        "source": parameter.source,
        "assumed": called in calibration.assumed,
    }


def _calibration(session: Session, row: CalibrationRow, reconstruction: LinearReconstruction) -> Calibration:
    run = session.get_one(RunRow, row.run)
    fits = _fits(session, row.calibration)
    return Calibration(
        calibration=row.calibration,
        run=row.run,
        issued_at=row.issued_at.isoformat(),
        sensor=SensorIdentity(row.serial, run.batch, run.sensor_type),
        sensor_type=decoded_sensor_type(row.setting),
        indenter=decoded_indenter(row.setting),
        reference=unpacked(row.reference, (row.drives, row.measures)),
        current_A=row.current_a,
        scale=row.scale,
        reconstruction=reconstruction,
        response=Response(row.response),
        noise_floor=row.noise_floor,
        mask=row.mask,
        baseline=tuple(_baselines(session, row.calibration)),
        against_stress=fits["against_stress"],
        against_strain=fits["against_strain"],
        assumed=tuple(row.assumed),
        settling=tuple(_settling(session, row.calibration)),
        overlap_bands=tuple(_bands(session, row.calibration)),
        overlap_threshold=row.overlap_threshold,
        validity=Validity(
            force_N=_pair(row.force_low_n, row.force_high_n),
            strain=(row.strain_low, row.strain_high),
            temperature_C=_pair(row.temperature_low_c, row.temperature_high_c),
            radius_mm=row.radius_mm,
            reduced=tuple(row.reduced),
        ),
        simulated=tuple(row.simulated),
    )


def _pair(low: float | None, high: float | None) -> tuple[float, float] | None:
    return None if low is None or high is None else (low, high)


def _fits(session: Session, calibration: str) -> dict[str, QuasiStatic]:
    rows = session.scalars(select(FitParameterRow).where(FitParameterRow.calibration == calibration))
    found = {row.name: Parameter(row.value, row.stderr, row.source) for row in rows}
    return {
        fit: QuasiStatic(found[f"{fit}.slope"], found[f"{fit}.intercept"])
        for fit in ("against_stress", "against_strain")
    }


def _baselines(session: Session, calibration: str) -> Iterator[BaselineConductance]:
    query = select(BaselineRow).where(BaselineRow.calibration == calibration).order_by(BaselineRow.number)
    for r in session.scalars(query):
        yield BaselineConductance(r.location, r.x_mm, r.y_mm, r.value, r.stderr, r.loads, r.why)


def _settling(session: Session, calibration: str) -> Iterator[SettlingSummary]:
    query = select(SettlingRow).where(SettlingRow.calibration == calibration).order_by(SettlingRow.number)
    for r in session.scalars(query):
        yield SettlingSummary(r.signal, r.loading, r.mean_s, r.deviation_s, r.accepted, r.censored, r.rejected)


def _bands(session: Session, calibration: str) -> Iterator[OverlapBand]:
    query = select(OverlapBandRow).where(OverlapBandRow.calibration == calibration).order_by(OverlapBandRow.number)
    for r in session.scalars(query):
        yield OverlapBand(r.name, r.lower_percent, r.upper_percent)
