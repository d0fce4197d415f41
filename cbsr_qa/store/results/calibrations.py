"""Issued calibrations: the bytes of their files, and searchable columns."""

import hashlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Engine, func, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.store.chain.check import RESULTS, check_unless_checked
from cbsr_qa.store.chain.links import add_rows
from cbsr_qa.store.engine import reading
from cbsr_qa.store.tables.results import BaselineRow, CalibrationRow


@dataclass(frozen=True, slots=True)
class CalibrationSummary:
    """A calibration in one line; ``superseded_by`` names the next one of the sensor, None while there is none."""

    calibration: str
    serial: str
    run: str
    analysis: str
    issued_at: datetime
    superseded_by: str | None


class Calibrations:
    """Issued calibrations."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def list_issued(self, serial: str) -> tuple[CalibrationSummary, ...]:
        """Return a sensor's calibrations, the latest first; the first is the valid one."""
        row = CalibrationRow
        later = func.lead(row.calibration).over(order_by=row.calibration).label("superseded_by")
        columns = row.calibration, row.serial, row.run, row.analysis, row.issued_at, later
        query = select(*columns).where(row.serial == serial).order_by(row.calibration.desc())
        with reading(self._engine) as connection:
            return tuple(CalibrationSummary(*cells) for cells in connection.execute(query))

    def load_file(self, calibration: str, *, checked_link: str = "") -> tuple[bytes, str]:
        """Return a calibration's file as issued, and its content's digest.

        Parameters
        ----------
        checked_link : of its run, as for :func:`~cbsr_qa.store.chain.check.check_unless_checked`.

        Raises
        ------
        StoreError
            If the calibration does not exist, or it or its run was altered.
        """
        row = CalibrationRow
        with reading(self._engine) as connection:
            query = select(row.run, row.file, row.file_sha256, row.content_sha256).where(
                row.calibration == calibration
            )
            stored = connection.execute(query).one_or_none()
            if stored is None:
                raise StoreError(f"there is no calibration {calibration[:64]!r} in this database")
            check_unless_checked(connection, stored.run, checked_link, RESULTS)
        _check_file(calibration, stored.file, stored.file_sha256)
        return stored.file, stored.content_sha256


def insert_calibration(connection: Connection, calibration: Calibration, analysis: str) -> None:
    """Insert a calibration, which from then on is the valid one of its sensor.

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
        "content_sha256": calibration.digest,
        "record_sha256": calibration.record_digest,
        "file": calibration.file,
        "file_sha256": _sha256(calibration.file),
    }
    add_rows(connection, calibration.run, CalibrationRow, [row])
    places = [{"calibration": name, "number": k, **asdict(place)} for k, place in enumerate(calibration.baseline)]
    add_rows(connection, calibration.run, BaselineRow, places)


def check_files(rows: Iterable[Any]) -> None:
    """Check the files in rows of calibrations, digests as text. StoreError names the calibration that has another."""
    for row in rows:
        _check_file(row.calibration, row.file, row.file_sha256)


def _check_file(calibration: str, file: bytes | None, sha256: str | None) -> None:
    if file is None or _sha256(file) != sha256:
        raise StoreError(
            f"calibration {calibration}: its file is not what was stored", remedy="restore the database from a copy"
        )


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
