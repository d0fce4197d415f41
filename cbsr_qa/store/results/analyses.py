"""Analyses of runs: appended, never changed."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from sqlalchemy import Connection, Engine, Row, select

from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.plan.limits import Bound, Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.store.chain.check import RESULTS, check_unless_checked, unreadable
from cbsr_qa.store.chain.links import add_links, add_rows
from cbsr_qa.store.chain.run_documents import FIGURES, figures_digest
from cbsr_qa.store.damage import FOREIGN_CELL, read_word
from cbsr_qa.store.engine import look_afresh, reading, writing
from cbsr_qa.store.mapping import convert_row, row_of
from cbsr_qa.store.results.calibrations import insert_calibration
from cbsr_qa.store.runs.standing import up_to_date
from cbsr_qa.store.tables.results import (
    AdoptionRow,
    AnalysisRow,
    CalibrationRow,
    MeasurementRow,
    ReanalysisRow,
    WarningRow,
)
from cbsr_qa.store.tables.runs import RunRow


@dataclass(frozen=True, slots=True)
class Adoption:
    """How a re-analysis became an analysis.

    Parameters
    ----------
    recipe : canonical JSON of the recipe that the values and limits follow from, in place of the run's own.
    operator, why, adopted_at : who decided, for what reason, and when.
    """

    reanalysis: str
    recipe: str
    operator: str
    why: str
    adopted_at: datetime


@dataclass(frozen=True, slots=True)
class StoredAnalysis:
    """One analysis of a run.

    Parameters
    ----------
    analysed_at, software : when, and with which versions.
    calibration : issued calibration; if None, ``calibration_why`` gives the reason.
    noise_weighting : ``"equal"`` or ``"measured"``; empty where nothing was imaged.
    weight_ratio : largest over smallest weight of a reading; None if not recorded.
    adoption : None unless it was adopted from a re-analysis.
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
    adoption: Adoption | None = None


class Analyses:
    """Analyses of runs."""

    def __init__(self, engine: Engine, new_id: Callable[[], str], wall: Callable[[], datetime]) -> None:
        self._engine = engine
        self._new_id = new_id
        self._wall = wall

    def save(self, result: RunResult, *, software: Sequence[tuple[str, str]] | None = None) -> str:
        """Store the results of a run, including its calibration, in one transaction, and read them back.

        Rows that were checked when the run was loaded are not checked again unless rows were added since.

        Parameters
        ----------
        software : versions used for the analysis; by default those of the run.

        Returns
        -------
        Identifier of the new analysis; earlier ones stay, and the latest holds.

        Raises
        ------
        StoreError
            If the run does not exist or was altered, or a number is not finite; nothing is stored then. Also if the
            stored analysis cannot be read back.
        """
        record, observation = result.record, result.observation
        run = record.identity.run
        look_afresh(self._engine)
        analysis = self._new_id()
        versions = record.identity.software if software is None else software
        values = {
            "analysis": analysis,
            "run": run,
            "analysed_at": self._wall(),
            "software": [list(pair) for pair in versions],
            "outcome": str(result.verdict.outcome),
            "reason": result.verdict.reason,
            "calibration_why": result.calibration_why,
            "noise_weighting": "" if observation is None else observation.settings.noise_weighting,
            "weight_ratio": None if observation is None else observation.weight_ratio,
            "compute_s": [[stage, float(seconds)] for stage, seconds in result.compute_s],
        }
        with writing(self._engine) as connection:
            check_unless_checked(connection, run, record.chain_head)
            add_analysis(connection, values, result.warnings, map(measurement_values, result.measurements))
            if result.calibration is not None:
                insert_calibration(connection, result.calibration, analysis)
        look_afresh(self._engine)
        self.load(run)
        return analysis

    def load(self, run: str, *, checked_link: str = "") -> tuple[StoredAnalysis, ...]:
        """Return the analyses of a run that were stored after its last session, the latest first.

        StoreError if stored rows were changed; ``checked_link`` as for :func:`check_unless_checked`.
        """
        with reading(self._engine) as connection:
            if connection.scalar(select(RunRow.run).where(RunRow.run == run)) is not None:
                check_unless_checked(connection, run, checked_link, RESULTS)
            query = select(*AnalysisRow.__table__.columns).where(AnalysisRow.run == run, up_to_date())
            try:
                rows = connection.execute(query.order_by(AnalysisRow.analysis.desc())).all()
                return tuple(_analysis(connection, row) for row in rows)
            except FOREIGN_CELL as error:
                raise unreadable(connection, run, error) from error


def add_analysis(
    connection: Connection, row: dict[str, Any], warnings: Iterable[str], measurements: Iterable[dict[str, Any]]
) -> None:
    """Add the rows and links of one analysis; ``measurements`` are rows without their key."""
    run, analysis = row["run"], row["analysis"]
    add_rows(connection, run, AnalysisRow, [row])
    add_rows(connection, run, WarningRow, _number_rows(analysis, [{"text": text} for text in warnings]))
    add_rows(connection, run, MeasurementRow, _number_rows(analysis, measurements))
    add_links(connection, run, [(FIGURES, analysis, figures_digest(connection, analysis))])


def _number_rows(analysis: str, rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{"analysis": analysis, "number": number, **row} for number, row in enumerate(rows)]


#: Columns of a limit, and the corresponding fields.
_BOUNDS: Final = {
    "lower_limit": "lower",
    "upper_limit": "upper",
    "marginal": "marginal",
    "limit_phase": "phase",
    "limit_qualifier": "qualifier",
}


def measurement_values(measurement: Measurement) -> dict[str, Any]:
    """Return the columns of a measurement, without its key."""
    limit = measurement.limit
    bounds = {column: getattr(limit, name, None) for column, name in _BOUNDS.items()}
    return row_of(MeasurementRow, measurement, load_index=measurement.load, limited=limit is not None, **bounds)


def _analysis(connection: Connection, row: Row[Any]) -> StoredAnalysis:
    issued = select(CalibrationRow.calibration).where(CalibrationRow.analysis == row.analysis)
    warnings = select(WarningRow.text).where(WarningRow.analysis == row.analysis).order_by(WarningRow.number)
    measured = select(*MeasurementRow.__table__.columns).where(MeasurementRow.analysis == row.analysis)
    return convert_row(
        StoredAnalysis,
        row,
        verdict=Verdict(analysis_outcome(row), row.reason),
        measurements=tuple(map(as_measurement, connection.execute(measured.order_by(MeasurementRow.number)))),
        warnings=tuple(connection.scalars(warnings)),
        calibration=connection.scalar(issued),
        adoption=_adoption(connection, row.analysis),
    )


def _adoption(connection: Connection, analysis: str) -> Adoption | None:
    a = AdoptionRow
    query = select(a.reanalysis, ReanalysisRow.recipe, a.operator, a.why, a.adopted_at)
    joined = query.join(ReanalysisRow, ReanalysisRow.reanalysis == a.reanalysis).where(a.analysis == analysis)
    row = connection.execute(joined).one_or_none()
    return None if row is None else Adoption(*row)


def analysis_outcome(row: Row[*tuple[Any, ...]]) -> Outcome:
    """Return the outcome in a row of analyses. StoreError if it is invalid."""
    return read_word(Outcome, row.outcome, "analyses.outcome", f"analysis {row.analysis}")


def as_measurement(row: Row[Any]) -> Measurement:
    """Return the measurement of a row. StoreError if a cell of it is damaged."""
    return restore_measurement(row._mapping, f"analysis {row.analysis}, measurement {row.number},")


def restore_measurement(values: Mapping[Any, Any], key: str) -> Measurement:
    """Return a measurement of its columns. StoreError, which begins with ``key``, if a word in it is invalid."""
    limit = None
    if values["limited"]:
        lower, upper, marginal = (values[column] for column in ("lower_limit", "upper_limit", "marginal"))
        phase, qualifier = values["limit_phase"] or "", values["limit_qualifier"] or ""
        limit = Limit(values["name"], values["unit"], lower, upper, marginal or 0.0, phase, qualifier)
    return fill_from_mapping(
        Measurement,
        values,
        bound=read_word(Bound, values["bound"], "measurements.bound", key),
        load=values["load_index"],
        limit=limit,
        outcome=read_word(Outcome, values["outcome"], "measurements.outcome", key),
    )
