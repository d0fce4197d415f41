"""Analyses of runs: appended, never changed."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Engine, Row, select
from sqlalchemy.orm import Session

from cbsr_qa.domain.results import Bound, Limit, Measurement, Outcome, RunResult, Verdict
from cbsr_qa.store.chain import FIGURES, RESULTS, add_links, add_rows, check_run, stored_figures
from cbsr_qa.store.engine import reading, stored, writing
from cbsr_qa.store.results.calibrations import insert_calibration
from cbsr_qa.store.tables import AnalysisRow, CalibrationRow, MeasurementRow, RunRow, WarningRow


@dataclass(frozen=True, slots=True)
class StoredAnalysis:
    """One analysis of a run.

    Parameters
    ----------
    analysed_at, software : when, and with which versions.
    calibration : the one it issued; None where it did not, ``calibration_why`` then says why.
    noise_weighting : ``"equal"`` or ``"measured"``; empty where nothing was imaged.
    weight_ratio : largest over smallest weight of a reading; None where nobody noted it.
    """

    analysis: str
    run: str
    analysed_at: datetime
    software: tuple[tuple[str, str], ...]
    verdict: Verdict
    measurements: tuple[Measurement, ...]
    warnings: tuple[str, ...]
    compute_s: tuple[tuple[str, float], ...]
    calibration: str | None
    calibration_why: str
    noise_weighting: str
    weight_ratio: float | None


def save_result(
    engine: Engine,
    result: RunResult,
    *,
    analysis: str,
    analysed_at: datetime,
    software: Sequence[tuple[str, str]],
) -> None:
    """Store the results of a run, its calibration included, in one transaction.

    Parameters
    ----------
    analysis : new time-ordered identifier; the latest analysis of a run holds.
    software : distribution → version, as analysed with.

    Raises
    ------
    StoreError
        If the run is not stored, not what was stored, or a number is not finite; nothing of it is stored then.
    """
    run, observation = result.record.identity.run, result.observation
    values = {
        "analysis": analysis,
        "run": run,
        "analysed_at": analysed_at,
        "software": [list(pair) for pair in software],
        "outcome": str(result.verdict.outcome),
        "reason": result.verdict.reason,
        "calibration_why": result.calibration_why,
        "noise_weighting": "" if observation is None else observation.settings.noise_weighting,
        "weight_ratio": None if observation is None else observation.weight_ratio,
        "compute_s": [[stage, float(seconds)] for stage, seconds in result.compute_s],
    }
    with writing(engine) as connection:
        check_run(connection, run)
        add_rows(connection, run, AnalysisRow, [values])
        add_rows(connection, run, WarningRow, _numbered(analysis, [{"text": text} for text in result.warnings]))
        add_rows(connection, run, MeasurementRow, _numbered(analysis, [_values(m) for m in result.measurements]))
        add_links(connection, run, [(FIGURES, analysis, stored_figures(connection, analysis))])
        if result.calibration is not None:
            insert_calibration(connection, result.calibration, analysis)


def analyses_of(engine: Engine, run: str) -> tuple[StoredAnalysis, ...]:
    """Return every analysis of a run, the latest first. StoreError if stored rows were changed."""
    with reading(engine) as connection:
        if connection.scalar(select(RunRow.run).where(RunRow.run == run)) is not None:
            check_run(connection, run, RESULTS)
        query = select(*AnalysisRow.__table__.columns).where(AnalysisRow.run == run)
        rows = connection.execute(query.order_by(AnalysisRow.analysis.desc())).all()
        return tuple(_analysis(connection, row) for row in rows)


def _numbered(analysis: str, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{"analysis": analysis, "number": number, **row} for number, row in enumerate(rows)]


def _values(measurement: Measurement) -> dict[str, Any]:
    limit = measurement.limit
    return {
        "name": measurement.name,
        "value": measurement.value,
        "unit": measurement.unit,
        "uncertainty": measurement.uncertainty,
        "phase": measurement.phase,
        "location": measurement.location,
        "trial": measurement.trial,
        "qualifier": measurement.qualifier,
        "how": measurement.how,
        "bound": str(measurement.bound),
        "load_index": measurement.load,
        "strain": measurement.strain,
        "outcome": str(measurement.outcome),
        "limited": limit is not None,
        "lower_limit": limit.lower if limit else None,
        "upper_limit": limit.upper if limit else None,
        "marginal": limit.marginal if limit else None,
        "limit_phase": limit.phase if limit else None,
        "limit_qualifier": limit.qualifier if limit else None,
    }


def _analysis(connection: Connection, row: Row[Any]) -> StoredAnalysis:
    issued = select(CalibrationRow.calibration).where(CalibrationRow.analysis == row.analysis)
    warnings = select(WarningRow.text).where(WarningRow.analysis == row.analysis).order_by(WarningRow.number)
    measured = select(MeasurementRow).where(MeasurementRow.analysis == row.analysis)
    with Session(bind=connection) as session:
        measurements = session.scalars(measured.order_by(MeasurementRow.number))
        return StoredAnalysis(
            analysis=row.analysis,
            run=row.run,
            analysed_at=row.analysed_at,
            software=tuple((name, version) for name, version in row.software),
            verdict=Verdict(analysis_outcome(row), row.reason),
            measurements=tuple(_measurement(m) for m in measurements),
            warnings=tuple(connection.scalars(warnings)),
            compute_s=tuple((stage, seconds) for stage, seconds in row.compute_s),
            calibration=connection.scalar(issued),
            calibration_why=row.calibration_why,
            noise_weighting=row.noise_weighting,
            weight_ratio=row.weight_ratio,
        )


def analysis_outcome(row: Row[*tuple[Any, ...]]) -> Outcome:
    """Return the outcome in a row of analyses. StoreError if it is invalid."""
    return stored(Outcome, row.outcome, "analyses.outcome", f"analysis {row.analysis}")


def _measurement(row: MeasurementRow) -> Measurement:
    key = f"analysis {row.analysis}, measurement {row.number},"
    return Measurement(
        name=row.name,
        value=row.value,
        unit=row.unit,
        uncertainty=row.uncertainty,
        phase=row.phase,
        location=row.location,
        trial=row.trial,
        qualifier=row.qualifier,
        how=row.how,
        bound=stored(Bound, row.bound, "measurements.bound", key),
        load=row.load_index,
        strain=row.strain,
        limit=_limit(row),
        outcome=stored(Outcome, row.outcome, "measurements.outcome", key),
    )


def _limit(row: MeasurementRow) -> Limit | None:
    if not row.limited:
        return None
    return Limit(
        row.name,
        row.unit,
        row.lower_limit,
        row.upper_limit,
        row.marginal or 0.0,
        row.limit_phase or "",
        row.limit_qualifier or "",
    )
