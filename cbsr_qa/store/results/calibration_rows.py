"""Rows of a calibration's lists: places, settling, relaxations, fit parameters, bands.

What a calibration says of force as a row, and back: the map, merging and scatter, but no templates.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select
from sqlalchemy.orm import Session

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import (
    NUMBERS,
    BaselineConductance,
    Calibration,
    FitStatus,
    ForceModel,
    LoadRelaxation,
    OverlapBand,
    RelaxationFit,
    RelaxationKernel,
    SettlingSummary,
    SettlingTime,
)
from cbsr_qa.domain.run import Indenter
from cbsr_qa.domain.sensor import Parameter, SensorType
from cbsr_qa.store.engine import stored
from cbsr_qa.store.tables import BaselineRow, FitParameterRow, ForceRow, OverlapBandRow, RelaxationRow, SettlingRow
from cbsr_qa.store.types import digest, packed, unpacked

#: Fit parameters: their name in the database, their unit, and what a calibration's ``assumed`` calls them.
_PARAMETERS = (
    ("against_stress.slope", "1/kPa", "α against stress"),
    ("against_stress.intercept", "1", "β against stress"),
    ("against_strain.slope", "1", "α against strain"),
    ("against_strain.intercept", "1", "β against strain"),
)


def list_rows(calibration: Calibration) -> Iterator[tuple[Any, list[dict[str, Any]]]]:
    """Yield every table with the rows a calibration has in it, its name left out."""
    yield BaselineRow, _numbered(map(_baseline_values, calibration.baseline))
    yield SettlingRow, _numbered(map(_settling_values, calibration.settling))
    yield RelaxationRow, _numbered(map(_relaxation_values, calibration.relaxations))
    yield OverlapBandRow, _numbered(map(_band_values, calibration.overlap_bands))
    yield FitParameterRow, [_parameter_values(calibration, *parameter) for parameter in _PARAMETERS]


def baselines(session: Session, calibration: str) -> Iterator[BaselineConductance]:
    """Yield baseline conductances in their order."""
    query = select(BaselineRow).where(BaselineRow.calibration == calibration).order_by(BaselineRow.number)
    for r in session.scalars(query):
        yield BaselineConductance(r.location, r.x_mm, r.y_mm, r.value, r.stderr, r.loads, r.why)


def settling(session: Session, calibration: str) -> Iterator[SettlingSummary]:
    """Yield summaries of settling times in their order."""
    query = select(SettlingRow).where(SettlingRow.calibration == calibration).order_by(SettlingRow.number)
    for r in session.scalars(query):
        yield SettlingSummary(r.signal, r.loading, r.mean_s, r.deviation_s, r.accepted, r.censored, r.rejected)


def relaxations(session: Session, calibration: str) -> Iterator[LoadRelaxation]:
    """Yield fitted relaxations in their order."""
    query = select(RelaxationRow).where(RelaxationRow.calibration == calibration).order_by(RelaxationRow.number)
    for r in session.scalars(query):
        yield LoadRelaxation(
            location=r.location,
            trial=r.trial,
            signal=r.signal,
            loading=r.loading,
            fit=_fit(r),
            settling=SettlingTime(r.settling_s, r.settling_censored, r.settling_band, r.settling_why),
            phase=r.phase,
            load=r.load_index,
            strain=r.strain,
            unit=r.unit,
        )


def bands(session: Session, calibration: str) -> Iterator[OverlapBand]:
    """Yield bands of the area overlap in their order."""
    query = select(OverlapBandRow).where(OverlapBandRow.calibration == calibration).order_by(OverlapBandRow.number)
    for r in session.scalars(query):
        yield OverlapBand(r.name, r.lower_percent, r.upper_percent)


def parameters(session: Session, calibration: str) -> dict[str, Parameter]:
    """Return fit parameters by their name in the database, such as ``"against_stress.slope"``."""
    rows = session.scalars(select(FitParameterRow).where(FitParameterRow.calibration == calibration))
    return {row.name: Parameter(row.value, row.stderr, row.source) for row in rows}


def _numbered(rows: Iterator[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{"number": number, **row} for number, row in enumerate(rows)]


def _baseline_values(place: BaselineConductance) -> dict[str, Any]:
    return {
        "location": place.location,
        "x_mm": place.x_mm,
        "y_mm": place.y_mm,
        "value": place.value,
        "stderr": place.stderr,
        "loads": place.loads,
        "why": place.why,
    }


def _settling_values(summary: SettlingSummary) -> dict[str, Any]:
    return {
        "signal": summary.signal,
        "loading": bool(summary.loading),
        "mean_s": summary.mean_s,
        "deviation_s": summary.deviation_s,
        "accepted": summary.accepted,
        "censored": summary.censored,
        "rejected": summary.rejected,
    }


def _relaxation_values(relaxation: LoadRelaxation) -> dict[str, Any]:
    fit, settled = relaxation.fit, relaxation.settling
    first, second = _two(fit.amplitudes)
    fast_s, slow_s = _two(fit.time_constants_s)
    fast_stderr_s, slow_stderr_s = _two(fit.time_constant_stderr_s)
    return {
        "phase": relaxation.phase,
        "load_index": relaxation.load,
        "location": relaxation.location,
        "trial": relaxation.trial,
        "strain": relaxation.strain,
        "signal": relaxation.signal,
        "unit": relaxation.unit,
        "loading": bool(relaxation.loading),
        "status": str(fit.status),
        "level": fit.offset,
        "level_stderr": fit.offset_stderr,
        "amplitude_1": first,
        "amplitude_2": second,
        "time_constant_1_s": fast_s,
        "time_constant_2_s": slow_s,
        "time_constant_1_stderr_s": fast_stderr_s,
        "time_constant_2_stderr_s": slow_stderr_s,
        "r_squared": fit.r_squared,
        "why": fit.why,
        "settling_s": settled.value_s,
        "settling_censored": bool(settled.censored),
        "settling_band": settled.band,
        "settling_why": settled.why,
    }


def _fit(row: RelaxationRow) -> RelaxationFit:
    return RelaxationFit(
        status=stored(FitStatus, row.status, "calibration_relaxations.status", f"calibration {row.calibration}"),
        offset=row.level,
        amplitudes=_known(row.amplitude_1, row.amplitude_2),
        time_constants_s=_known(row.time_constant_1_s, row.time_constant_2_s),
        offset_stderr=row.level_stderr,
        time_constant_stderr_s=_known(row.time_constant_1_stderr_s, row.time_constant_2_stderr_s),
        r_squared=row.r_squared,
        why=row.why,
    )


def _two(values: tuple[float, ...]) -> tuple[float | None, float | None]:
    """At most two numbers, padded with None."""
    first, second = (*values, None, None)[:2]
    return first, second


def _known(*values: float | None) -> tuple[float, ...]:
    return tuple(value for value in values if value is not None)


def _band_values(band: OverlapBand) -> dict[str, Any]:
    return {"name": band.name, "lower_percent": band.lower, "upper_percent": band.upper}


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


Array = NDArray[np.float64]

#: Prepares a model's templates from sensor type, used readings, merging [1/V], reference [V] and head.
PrepareForce = Callable[[SensorType, NDArray[np.bool_], Array, Array, Indenter], ForceModel]


def force_values(model: ForceModel) -> dict[str, Any]:
    """Return the row of a model, its calibration left out."""
    merged, readings = model.merging.shape
    arrays = [packed(values + 0.0) for values in (model.merging, model.log_response, model.log_response_stderr)]
    return {
        "merged": merged,
        "readings": readings,
        "merging": arrays[0],
        "nodes": len(model.log_response),
        "log_response": arrays[1],
        "log_response_stderr": arrays[2],
        "force_sha256": digest(f"{merged}x{readings}|1/V|{len(model.log_response)}", arrays),
        "stress_low_kpa": model.stress_kPa[0],
        "stress_high_kpa": model.stress_kPa[1],
        **{name: getattr(model, name) for name in NUMBERS},
        "kernels": {
            name: _kernel_values(kernel)
            for name, kernel in (("loading", model.loading), ("unloading", model.unloading))
            if kernel is not None
        },
    }


def stored_force(
    session: Session,
    calibration: str,
    prepare: PrepareForce | None,
    sensor_type: SensorType,
    used: NDArray[np.bool_],
    reference: Array,
    head: Indenter,
) -> ForceModel | None:
    """Return the force model of a calibration, its templates prepared again; None where it has none.

    Raises
    ------
    StoreError
        If what was stored was changed, nobody prepares the templates, or they are not on the lattice of the map.
    """
    row = session.get(ForceRow, calibration)
    if row is None:
        return None
    check_force(row)
    if prepare is None:
        raise StoreError(f"calibration {calibration} needs `prepare` for the templates of its force model")
    merging = unpacked(row.merging, (row.merged, row.readings))
    prepared = prepare(sensor_type, used, merging, reference, head)
    if len(prepared.templates) != row.nodes:
        raise StoreError(
            f"calibration {calibration} has a map of {row.nodes} places; this version prepares templates for"
            f" {len(prepared.templates)}"
        )
    return replace(
        prepared,
        merging=merging,
        log_response=unpacked(row.log_response, (row.nodes,)),
        log_response_stderr=unpacked(row.log_response_stderr, (row.nodes,)),
        stress_kPa=(row.stress_low_kpa, row.stress_high_kpa),
        loading=_kernel(row, "loading"),
        unloading=_kernel(row, "unloading"),
        **{name: getattr(row, name) for name in NUMBERS},
    )


def check_force(row: ForceRow) -> None:
    """Raise StoreError where the bytes of a force model do not fit their digest."""
    arrays = (row.merging, row.log_response, row.log_response_stderr)
    if digest(f"{row.merged}x{row.readings}|1/V|{row.nodes}", arrays) != row.force_sha256:
        raise StoreError(
            f"calibration {row.calibration}: its force model does not match its digest",
            remedy="restore the database from a copy",
        )


def _kernel_values(kernel: RelaxationKernel) -> dict[str, Any]:
    return {
        "weights": kernel.weights.tolist(),
        "time_constants_s": kernel.time_constants_s.tolist(),
        "covariance": kernel.covariance.tolist(),
        "scatter": kernel.scatter.tolist(),
        "scatter_freedom": float(kernel.scatter_freedom),
        "loads": int(kernel.loads),
        "start_s": float(kernel.start_s),
        "why": kernel.why,
    }


def _kernel(row: ForceRow, name: str) -> RelaxationKernel | None:
    held = row.kernels.get(name)
    if held is None:
        return None
    arrays = {key: np.array(held[key], dtype=np.float64) for key in ("weights", "time_constants_s", "scatter")}
    count = len(arrays["weights"])
    return RelaxationKernel(
        loading=name == "loading",
        covariance=np.array(held["covariance"], dtype=np.float64).reshape(2 * count, 2 * count),
        scatter_freedom=float(held["scatter_freedom"]),
        loads=int(held["loads"]),
        start_s=float(held["start_s"]),
        why=str(held["why"]),
        **arrays,
    )
