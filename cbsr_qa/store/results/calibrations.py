"""Issued calibrations: the bytes of their files, and searchable columns."""

import hashlib
from dataclasses import asdict, dataclass
from datetime import datetime

from sqlalchemy import Connection, Engine, select, update

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import Calibration
from cbsr_qa.store.chain import RESULTS, add_rows, check_run
from cbsr_qa.store.engine import reading
from cbsr_qa.store.tables import BaselineRow, CalibrationRow


@dataclass(frozen=True, slots=True)
class CalibrationSummary:
    """A calibration in one line; ``superseded_by`` is None while it is valid."""

    calibration: str
    serial: str
    run: str
    analysis: str
    issued_at: datetime
    superseded_by: str | None


def insert_calibration(connection: Connection, calibration: Calibration, analysis: str) -> None:
    """Insert a calibration and mark the sensor's earlier ones as superseded by it.

    Raises
    ------
    StoreError
        If it has no file, because it was never issued.
    """
    if not (calibration.file and calibration.digest and calibration.record_digest):
        raise StoreError(
            f"calibration {calibration.calibration} has no digest: it was never issued, and is not stored"
        )
    name, serial = calibration.calibration, calibration.sensor.serial
    row = {
        "calibration": name,
        "run": calibration.run,
        "analysis": analysis,
        "serial": serial,
        "issued_at": datetime.fromisoformat(calibration.issued_at),
        "superseded_by": None,
        "content_sha256": calibration.digest,
        "record_sha256": calibration.record_digest,
        "file": calibration.file,
        "file_sha256": _sha256(calibration.file),
    }
    add_rows(connection, calibration.run, CalibrationRow, [row])
    places = [{"calibration": name, "number": k, **asdict(place)} for k, place in enumerate(calibration.baseline)]
    add_rows(connection, calibration.run, BaselineRow, places)
    earlier = update(CalibrationRow).where(
        CalibrationRow.serial == serial,
        CalibrationRow.calibration != name,
        CalibrationRow.superseded_by.is_(None),
    )
    connection.execute(earlier.values(superseded_by=name))


def calibrations_of(engine: Engine, serial: str) -> tuple[CalibrationSummary, ...]:
    """Return a sensor's calibrations, the latest first; the first is the valid one."""
    row = CalibrationRow
    columns = row.calibration, row.serial, row.run, row.analysis, row.issued_at, row.superseded_by
    query = select(*columns).where(row.serial == serial).order_by(row.issued_at.desc(), row.calibration.desc())
    with reading(engine) as connection:
        return tuple(CalibrationSummary(*found) for found in connection.execute(query))


def calibration_file(engine: Engine, calibration: str) -> tuple[bytes, str] | None:
    """Return a calibration's file as issued, and its content's digest; None for one stored as rows.

    Raises
    ------
    StoreError
        If the calibration does not exist, or it or its run was altered.
    """
    row = CalibrationRow
    with reading(engine) as connection:
        query = select(row.run, row.file, row.file_sha256, row.content_sha256).where(row.calibration == calibration)
        found = connection.execute(query).one_or_none()
        if found is None:
            raise StoreError(f"there is no calibration {calibration[:64]!r} in this database")
        check_run(connection, found.run, RESULTS)
    if found.file_sha256 is None and found.file is None:
        return None
    if found.file is None or _sha256(found.file) != found.file_sha256:
        raise StoreError(
            f"calibration {calibration}: its file is not what was stored", remedy="restore the database from a copy"
        )
    return found.file, found.content_sha256


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
