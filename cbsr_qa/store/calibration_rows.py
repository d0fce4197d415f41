"""The lists of a calibration as rows, and back: places, settling, relaxations, fit parameters, bands."""

from collections.abc import Iterator
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from cbsr_qa.domain.calibration import (
    BaselineConductance,
    Calibration,
    LoadRelaxation,
    OverlapBand,
    SettlingSummary,
)
from cbsr_qa.domain.relaxation import FitStatus, RelaxationFit, SettlingTime
from cbsr_qa.domain.sensor import Parameter
from cbsr_qa.store.failures import stored
from cbsr_qa.store.result_tables import (
    BaselineRow,
    FitParameterRow,
    OverlapBandRow,
    RelaxationRow,
    SettlingRow,
)

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
    """At most two numbers, with None where there is none."""
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
