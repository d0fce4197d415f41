"""Analyses of runs: appended, never changed."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from sqlalchemy import Connection, Engine, Row, select

from cbsr_qa.domain.results import Bound, Limit, Measurement, Outcome, RunResult, Verdict
from cbsr_qa.store.chain import FIGURES, RESULTS, add_links, add_rows, chain_head, check_run, stored_figures
from cbsr_qa.store.damage import stored
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import of_row, row_of
from cbsr_qa.store.results.calibrations import insert_calibration
from cbsr_qa.store.tables import AnalysisRow, CalibrationRow, MeasurementRow, RunRow, WarningRow


@dataclass(frozen=True, slots=True)
class StoredAnalysis:
    """One analysis of a run.

    Parameters
    ----------
    analysed_at, software : when, and with which versions.
    calibration : issued calibration; if None, ``calibration_why`` gives the reason.
    noise_weighting : ``"equal"`` or ``"measured"``; empty where nothing was imaged.
    weight_ratio : largest over smallest weight of a reading; None if not recorded.
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
    """Store the results of a run, including its calibration, in one transaction.

    Parameters
    ----------
    analysis : new time-ordered identifier; the latest analysis of a run holds.
    software : distribution → version, as analysed with.

    Raises
    ------
    StoreError
        If the run does not exist or was altered, or a number is not finite; nothing is stored then. Rows checked when
        the run was loaded are not checked again unless rows were added since.
    """
    record, observation = result.record, result.observation
    run = record.identity.run
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
        if not record.chain_head or chain_head(connection, run) != record.chain_head:
            check_run(connection, run)  # otherwise checked when it was loaded, up to this link
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


#: Columns of a limit, and the corresponding fields.
_BOUNDS: Final = {
    "lower_limit": "lower",
    "upper_limit": "upper",
    "marginal": "marginal",
    "limit_phase": "phase",
    "limit_qualifier": "qualifier",
}


def _values(measurement: Measurement) -> dict[str, Any]:
    limit = measurement.limit
    bounds = {column: getattr(limit, name, None) for column, name in _BOUNDS.items()}
    return row_of(MeasurementRow, measurement, load_index=measurement.load, limited=limit is not None, **bounds)


def _analysis(connection: Connection, row: Row[Any]) -> StoredAnalysis:
    issued = select(CalibrationRow.calibration).where(CalibrationRow.analysis == row.analysis)
    warnings = select(WarningRow.text).where(WarningRow.analysis == row.analysis).order_by(WarningRow.number)
    measured = select(*MeasurementRow.__table__.columns).where(MeasurementRow.analysis == row.analysis)
    return of_row(
        StoredAnalysis,
        row,
        verdict=Verdict(analysis_outcome(row), row.reason),
        measurements=tuple(map(as_measurement, connection.execute(measured.order_by(MeasurementRow.number)))),
        warnings=tuple(connection.scalars(warnings)),
        calibration=connection.scalar(issued),
    )


def analysis_outcome(row: Row[*tuple[Any, ...]]) -> Outcome:
    """Return the outcome in a row of analyses. StoreError if it is invalid."""
    return stored(Outcome, row.outcome, "analyses.outcome", f"analysis {row.analysis}")


def as_measurement(row: Row[Any]) -> Measurement:
    """Return the measurement of a row. StoreError if a cell of it is damaged."""
    key = f"analysis {row.analysis}, measurement {row.number},"
    return of_row(
        Measurement,
        row,
        bound=stored(Bound, row.bound, "measurements.bound", key),
        load=row.load_index,
        limit=_limit(row) if row.limited else None,
        outcome=stored(Outcome, row.outcome, "measurements.outcome", key),
    )


def _limit(row: Row[Any]) -> Limit:
    bounds = row.lower_limit, row.upper_limit, row.marginal or 0.0
    return Limit(row.name, row.unit, *bounds, row.limit_phase or "", row.limit_qualifier or "")
