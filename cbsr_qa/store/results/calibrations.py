"""Issued calibrations as rows: all but imaging matrix and templates, which sensor type, head and readings determine.

The calibration file is an export of these rows: a calibration loaded from them has the ``record_digest`` it was
issued with, and with a matrix and templates prepared on the same computer the ``digest`` too
(:mod:`cbsr_qa.calibration.file.digests`).
"""

import math
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, select, update
from sqlalchemy.orm import Session

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import Calibration, LinearReconstruction, ParameterChoice, Validity
from cbsr_qa.domain.sensor import QuasiStatic, Response, SensorIdentity
from cbsr_qa.store.chain import RESULTS, add_rows, check_run
from cbsr_qa.store.engine import reading, stored
from cbsr_qa.store.results import calibration_rows as lists
from cbsr_qa.store.results.calibration_rows import PrepareForce, check_force, force_values, stored_force
from cbsr_qa.store.runs import decoded_indenter, decoded_sensor_type, encoded
from cbsr_qa.store.tables import AnalysisRow, CalibrationRow, ForceRow, RunRow
from cbsr_qa.store.types import digest, packed, packed_flags, unpacked, unpacked_flags

#: A parameter found again for the same sensor type agrees to the tolerance of its search, not to the last digit.
_SAME_PARAMETER = 1e-6


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
    """Insert a calibration with its rows and mark the sensor's earlier ones as superseded by it.

    Raises
    ------
    StoreError
        If it has no digests: it was made by hand and never issued.
    """
    if not (calibration.digest and calibration.record_digest):
        raise StoreError(
            f"calibration {calibration.calibration} has no digest: it was never issued, and is not stored"
        )
    run, name = calibration.run, {"calibration": calibration.calibration}
    add_rows(connection, run, CalibrationRow, [_values(calibration, analysis)])
    for table, rows in lists.list_rows(calibration):
        add_rows(connection, run, table, [name | row for row in rows])
    if calibration.force is not None:
        add_rows(connection, run, ForceRow, [name | force_values(calibration.force)])
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


def check_arrays(engine: Engine, calibration: str) -> None:
    """Hold the arrays of a calibration against their digests; StoreError where one was changed."""
    with reading(engine) as connection, Session(bind=connection) as session:
        _known(session, calibration)
        force = session.get(ForceRow, calibration)
        if force is not None:
            check_force(force)


def load_calibration(
    engine: Engine,
    calibration: str,
    reconstruction: LinearReconstruction,
    prepare_force: PrepareForce | None = None,
) -> Calibration:
    """Load a calibration.

    Parameters
    ----------
    reconstruction : its imaging matrix, prepared again by the same method for the same readings.
    prepare_force : prepares the templates of its force model; needed where it has one.

    Raises
    ------
    StoreError
        If there is no such calibration, it or its run is not what was stored, the matrix is not its own, or nobody
        prepares its templates.
    """
    with reading(engine) as connection, Session(bind=connection) as session:
        row = _known(session, calibration)
        check_run(connection, row.run, RESULTS)
        _check_matrix(row, reconstruction)
        _check_weighting(session.get_one(AnalysisRow, row.analysis), row, reconstruction)
        return _calibration(session, row, replace(reconstruction, choice=_choice(row)), prepare_force)


def _choice(row: CalibrationRow) -> ParameterChoice:
    return ParameterChoice(
        row.regularisation,
        row.regularisation_how,
        row.noise_figure,
        row.regularisation_name,
        criterion=row.regularisation_criterion,
    )


def _check_matrix(row: CalibrationRow, reconstruction: LinearReconstruction) -> None:
    """Raise StoreError where a matrix was prepared by another method or parameter, or for other readings."""
    prepared = reconstruction.choice.value
    alike = math.isclose(row.regularisation, prepared, rel_tol=_SAME_PARAMETER)
    if row.method != reconstruction.method or not alike:
        raise StoreError(
            f"calibration {row.calibration} was made with {row.method} at"
            f" {row.regularisation_name} = {row.regularisation:g}, not with"
            f" {reconstruction.method} at {reconstruction.choice.name} = {prepared:g}"
        )
    problem = reconstruction.problem
    used = unpacked_flags(row.used, (row.drives, row.measures)).astype(np.bool_)
    if problem.sensor_type != decoded_sensor_type(row.setting) or not np.array_equal(used, problem.used):
        raise StoreError(
            f"calibration {row.calibration} images {int(used.sum())} readings of a {problem.sensor_type.name};"
            " the matrix at hand was prepared for another sensor type or other readings"
        )


def _check_weighting(analysis: AnalysisRow, row: CalibrationRow, reconstruction: LinearReconstruction) -> None:
    """Raise StoreError where a matrix weighs readings otherwise; an analysis without images says nothing of it."""
    found = "equal" if reconstruction.problem.noise_variance is None else "measured"
    if analysis.noise_weighting not in ("", found):
        raise StoreError(
            f"calibration {row.calibration} was made with {analysis.noise_weighting} noise weighting; the matrix at"
            f" hand was prepared with {found}"
        )


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
    size_ratio = calibration.size_ratio or (None, None)
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
        "measured_noise_figure": calibration.noise_figure,
        **_imaging_values(calibration.reconstruction, calibration.reference),
        "no_force": calibration.no_force,
        "overlap_threshold": calibration.overlap_threshold,
        "size_ratio_low": size_ratio[0],
        "size_ratio_high": size_ratio[1],
        "stress_covariance": calibration.against_stress.covariance,
        "strain_covariance": calibration.against_strain.covariance,
        **_validity_values(calibration.validity),
        "assumed": list(calibration.assumed),
        "simulated": list(calibration.simulated),
        "setting": encoded(calibration.sensor_type, calibration.indenter),
        "content_sha256": calibration.digest,
        "record_sha256": calibration.record_digest,
    }


def _imaging_values(reconstruction: LinearReconstruction, reference: NDArray[np.float64]) -> dict[str, Any]:
    drives, measures = reference.shape
    frame, used = packed(reference), packed_flags(reconstruction.problem.used.astype("uint8"))
    return {
        "method": reconstruction.method,
        "regularisation": reconstruction.choice.value,
        "regularisation_name": reconstruction.choice.name,
        "regularisation_criterion": reconstruction.choice.criterion,
        "regularisation_how": reconstruction.choice.how,
        "noise_figure": reconstruction.choice.noise_figure,
        "drives": drives,
        "measures": measures,
        "reference": frame,
        "used": used,
        "reference_sha256": digest(f"{drives}x{measures}|V", (frame, used)),
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


def _calibration(
    session: Session, row: CalibrationRow, reconstruction: LinearReconstruction, prepare: PrepareForce | None
) -> Calibration:
    run = session.get_one(RunRow, row.run)
    fits = _fits(session, row)
    sensor_type, head = decoded_sensor_type(row.setting), decoded_indenter(row.setting)
    reference = unpacked(row.reference, (row.drives, row.measures))
    used = reconstruction.problem.used
    return Calibration(
        calibration=row.calibration,
        run=row.run,
        issued_at=row.issued_at.isoformat(),
        sensor=SensorIdentity(row.serial, run.batch, run.sensor_type),
        sensor_type=sensor_type,
        indenter=head,
        reference=reference,
        current_A=row.current_a,
        scale=row.scale,
        reconstruction=reconstruction,
        response=stored(Response, row.response, "calibrations.response", f"calibration {row.calibration}"),
        noise_floor=row.noise_floor,
        mask=row.mask,
        baseline=tuple(lists.baselines(session, row.calibration)),
        against_stress=fits[0],
        against_strain=fits[1],
        assumed=tuple(row.assumed),
        settling=tuple(lists.settling(session, row.calibration)),
        overlap_bands=tuple(lists.bands(session, row.calibration)),
        overlap_threshold=row.overlap_threshold,
        validity=_validity(row),
        simulated=tuple(row.simulated),
        relaxations=tuple(lists.relaxations(session, row.calibration)),
        size_ratio=_pair(row.size_ratio_low, row.size_ratio_high),
        noise_figure=row.measured_noise_figure,
        force=stored_force(session, row.calibration, prepare, sensor_type, used, reference, head),
        no_force=row.no_force,
        digest=row.content_sha256,
        record_digest=row.record_sha256,
    )


def _validity(row: CalibrationRow) -> Validity:
    return Validity(
        force_N=_pair(row.force_low_n, row.force_high_n),
        strain=(row.strain_low, row.strain_high),
        temperature_C=_pair(row.temperature_low_c, row.temperature_high_c),
        radius_mm=row.radius_mm,
        reduced=tuple(row.reduced),
    )


def _pair(low: float | None, high: float | None) -> tuple[float, float] | None:
    return None if low is None or high is None else (low, high)


def _fits(session: Session, row: CalibrationRow) -> tuple[QuasiStatic, QuasiStatic]:
    """α, β against stress and against strain."""
    found = lists.parameters(session, row.calibration)
    stress, strain = (
        QuasiStatic(found[f"{fit}.slope"], found[f"{fit}.intercept"], covariance)
        for fit, covariance in (("against_stress", row.stress_covariance), ("against_strain", row.strain_covariance))
    )
    return stress, strain
