"""Calibrations of schemas up to 0011, which were stored as rows: all but imaging matrix and templates.

Matrix and templates are computed again from sensor type, head and readings. The result has the ``record_digest`` it
was issued with (:mod:`cbsr_qa.calibration.file.content`). A file of it has another ``digest`` than the one issued:
matrix and templates are rounded as in files of today.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.imaging import LinearReconstruction, OverlapBand, ParameterChoice
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import (
    BaselineConductance,
    Calibration,
    ForceModel,
    LoadRelaxation,
    SettlingSummary,
    Validity,
)
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, RelaxationKernel, SettlingTime
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic, Response, SensorIdentity, SensorType
from cbsr_qa.store.chain.check import RESULTS, check_run
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.engine import reading
from cbsr_qa.store.runs.codec import decode_indenter, decode_sensor_type
from cbsr_qa.store.tables.results import (
    AnalysisRow,
    BaselineRow,
    CalibrationRow,
    FitParameterRow,
    ForceRow,
    OverlapBandRow,
    RelaxationRow,
    SettlingRow,
)
from cbsr_qa.store.tables.runs import RunRow
from cbsr_qa.store.types import digest, unpack, unpack_flags

#: Computes a model's templates from sensor type, used readings, merging [1/V], reference [V] and head.
PrepareForce = Callable[[SensorType, NDArray[np.bool_], Array, Array, Indenter], ForceModel]
#: A parameter chosen again for the same sensor type agrees to the tolerance of its search, not to the last digit.
_SAME_PARAMETER = 1e-6
_REMEDY = "restore the database from a copy"
_KERNEL_ARRAYS = ("weights", "time_constants_s", "covariance", "scatter")


def load_calibration_of_before(
    engine: Engine, calibration: str, reconstruction: LinearReconstruction | None, prepare_force: PrepareForce
) -> Calibration | None:
    """Reconstruct a calibration from its rows.

    Parameters
    ----------
    reconstruction : its imaging matrix, computed again by the same method for the same readings; None to check only
        the rows.
    prepare_force : computes the templates of its force model.

    Raises
    ------
    StoreError
        If it or its run was altered, the matrix does not match, or the templates are on another lattice.
    """
    with reading(engine) as connection, Session(bind=connection) as session:
        row: Any = session.get_one(CalibrationRow, calibration)
        check_run(connection, row.run, RESULTS)
        force = session.get(ForceRow, calibration)
        _check_arrays(row, force)
        if reconstruction is None:
            return None
        _check_matrix(row, reconstruction)
        _check_weighting(session.get_one(AnalysisRow, row.analysis), row, reconstruction)
        return _calibration(session, row, force, reconstruction, prepare_force)


def _check_arrays(row: Any, force: ForceRow | None) -> None:
    if digest(f"{row.drives}x{row.measures}|V", (row.reference, row.used)) != row.reference_sha256:
        raise StoreError(f"calibration {row.calibration}: its reference frame is not what was stored", remedy=_REMEDY)
    if force is None:
        return
    arrays = (force.merging, force.log_response, force.log_response_stderr)
    if digest(f"{force.merged}x{force.readings}|1/V|{force.nodes}", arrays) != force.force_sha256:
        raise StoreError(f"calibration {row.calibration}: its force model is not what was stored", remedy=_REMEDY)


def _check_matrix(row: Any, reconstruction: LinearReconstruction) -> None:
    """Raise StoreError if a matrix has another method, parameter or set of readings."""
    prepared = reconstruction.choice.value
    alike = math.isclose(row.regularisation, prepared, rel_tol=_SAME_PARAMETER)
    if row.method != reconstruction.method or not alike:
        raise StoreError(
            f"calibration {row.calibration} was made with {row.method} at"
            f" {row.regularisation_name} = {row.regularisation:g}, not with"
            f" {reconstruction.method} at {reconstruction.choice.name} = {prepared:g}"
        )
    problem = reconstruction.problem
    used = unpack_flags(row.used, (row.drives, row.measures)).astype(np.bool_)
    if problem.sensor_type != decode_sensor_type(row.setting) or not np.array_equal(used, problem.used):
        raise StoreError(
            f"calibration {row.calibration} images {int(used.sum())} readings of a {problem.sensor_type.name};"
            " the matrix at hand was prepared for another sensor type or other readings"
        )


def _check_weighting(analysis: AnalysisRow, row: Any, reconstruction: LinearReconstruction) -> None:
    """Raise StoreError if the matrix weights readings differently; an analysis without images has no weighting."""
    found = "equal" if reconstruction.problem.noise_variance is None else "measured"
    if analysis.noise_weighting not in ("", found):
        raise StoreError(
            f"calibration {row.calibration} was made with {analysis.noise_weighting} noise weighting; the matrix at"
            f" hand was prepared with {found}"
        )


def _calibration(
    session: Session, row: Any, force: Any, reconstruction: LinearReconstruction, prepare: PrepareForce
) -> Calibration:
    run = session.get_one(RunRow, row.run)
    sensor_type, head = decode_sensor_type(row.setting), decode_indenter(row.setting)
    reference, used = unpack(row.reference, (row.drives, row.measures)), reconstruction.problem.used
    parameters = {
        one.name: Parameter(one.value, one.stderr, one.source) for one in _rows(session, row, FitParameterRow)
    }
    choice = ParameterChoice(
        row.regularisation,
        row.regularisation_how,
        row.noise_figure,
        row.regularisation_name,
        criterion=row.regularisation_criterion,
    )
    named = {name: getattr(row, name) for name in ("scale", "noise_floor", "mask", "overlap_threshold", "no_force")}
    return Calibration(
        calibration=row.calibration,
        run=row.run,
        issued_at=row.issued_at.isoformat(),
        sensor=SensorIdentity(row.serial, run.batch, run.sensor_type),
        sensor_type=sensor_type,
        indenter=head,
        reference=reference,
        current_A=row.current_a,
        reconstruction=replace(reconstruction, choice=choice),
        response=read_word(Response, row.response, "calibrations.response", f"calibration {row.calibration}"),
        baseline=_alike(session, row, BaselineRow, BaselineConductance),
        against_stress=_line(parameters, "against_stress", row.stress_covariance),
        against_strain=_line(parameters, "against_strain", row.strain_covariance),
        assumed=tuple(row.assumed),
        settling=_alike(session, row, SettlingRow, SettlingSummary),
        overlap_bands=tuple(
            OverlapBand(band.name, band.lower_percent, band.upper_percent)
            for band in _rows(session, row, OverlapBandRow)
        ),
        validity=Validity(
            force_N=_pair(row.force_low_n, row.force_high_n),
            strain=(row.strain_low, row.strain_high),
            temperature_C=_pair(row.temperature_low_c, row.temperature_high_c),
            radius_mm=row.radius_mm,
            reduced=tuple(row.reduced),
        ),
        simulated=tuple(row.simulated),
        relaxations=tuple(map(_relaxation, _rows(session, row, RelaxationRow))),
        size_ratio=_pair(row.size_ratio_low, row.size_ratio_high),
        noise_figure=row.measured_noise_figure,
        force=None if force is None else _force(force, (sensor_type, used), (reference, head), prepare),
        digest=row.content_sha256,
        record_digest=row.record_sha256,
        **named,
    )


def _rows(session: Session, row: Any, table: Any) -> Iterator[Any]:
    order = table.name if table is FitParameterRow else table.number
    yield from session.scalars(select(table).where(table.calibration == row.calibration).order_by(order))


def _alike(session: Session, row: Any, table: Any, of: Any) -> tuple[Any, ...]:
    """Return a list whose rows have the names of its fields."""
    names = [field.name for field in fields(of)]
    return tuple(of(*(getattr(one, name) for name in names)) for one in _rows(session, row, table))


def _pair(low: float | None, high: float | None) -> tuple[float, float] | None:
    return None if low is None or high is None else (low, high)


def _line(parameters: dict[str, Parameter], name: str, covariance: float | None) -> QuasiStatic:
    return QuasiStatic(parameters[f"{name}.slope"], parameters[f"{name}.intercept"], covariance)


def _relaxation(row: Any) -> LoadRelaxation:
    def drop_missing(*names: str) -> tuple[float, ...]:
        return tuple(value for name in names if (value := getattr(row, name)) is not None)

    fit = RelaxationFit(
        status=read_word(FitStatus, row.status, "calibration_relaxations.status", f"calibration {row.calibration}"),
        offset=row.level,
        amplitudes=drop_missing("amplitude_1", "amplitude_2"),
        time_constants_s=drop_missing("time_constant_1_s", "time_constant_2_s"),
        offset_stderr=row.level_stderr,
        time_constant_stderr_s=drop_missing("time_constant_1_stderr_s", "time_constant_2_stderr_s"),
        r_squared=row.r_squared,
        why=row.why,
    )
    settling = SettlingTime(row.settling_s, row.settling_censored, row.settling_band, row.settling_why)
    named = {
        name: getattr(row, name) for name in ("location", "trial", "signal", "loading", "phase", "strain", "unit")
    }
    return LoadRelaxation(fit=fit, settling=settling, load=row.load_index, **named)


def _force(
    row: Any, readings: tuple[SensorType, NDArray[np.bool_]], seen: tuple[Array, Indenter], prepare: PrepareForce
) -> ForceModel:
    merging = unpack(row.merging, (row.merged, row.readings))
    prepared = prepare(*readings, merging, *seen)
    if len(prepared.templates) != row.nodes:
        raise StoreError(
            f"calibration {row.calibration} has a map of {row.nodes} places; this version prepares templates for"
            f" {len(prepared.templates)}"
        )
    named = {field.name for field in fields(ForceModel)} & set(ForceRow.__table__.columns.keys())
    arrays = {name: unpack(getattr(row, name), (row.nodes,)) for name in ("log_response", "log_response_stderr")}
    numbers = {name: getattr(row, name) for name in named - {"merging", *arrays}}
    kernels = {name: _kernel(held, name == "loading") for name, held in row.kernels.items()}
    stress_kPa = row.stress_low_kpa, row.stress_high_kpa
    learned = {"loading": None, "unloading": None} | kernels | numbers | arrays
    return replace(prepared, merging=merging, stress_kPa=stress_kPa, **learned)


def _kernel(held: dict[str, Any], loading: bool) -> RelaxationKernel:
    arrays = {name: np.array(held[name], dtype=np.float64) for name in _KERNEL_ARRAYS}
    count = len(arrays["weights"])
    return RelaxationKernel(
        **{"loading": loading, **held, **arrays, "covariance": arrays["covariance"].reshape(2 * count, 2 * count)}
    )
