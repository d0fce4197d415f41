"""Overrides of verdicts: rows beside the analysis they are about, which stays as it was."""

from datetime import datetime

from sqlalchemy import Connection, Engine, func, select

from cbsr_qa.domain.changes import VerdictOverride
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.outcome import EndReason, Outcome
from cbsr_qa.store.analyses import analysis_outcome
from cbsr_qa.store.chain import check_run
from cbsr_qa.store.change_tables import VerdictOverrideRow
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.failures import stored
from cbsr_qa.store.links import add_rows
from cbsr_qa.store.result_tables import AnalysisRow
from cbsr_qa.store.run_rows import current_state, run_row


def save_override(
    engine: Engine, run: str, outcome: Outcome, *, override: str, operator: str, why: str, noted_at: datetime
) -> VerdictOverride:
    """Store a decision against the verdict of a run's latest analysis.

    Parameters
    ----------
    override : new time-ordered identifier; the latest override of an analysis holds.

    Raises
    ------
    StoreError
        If the run is not stored, not what was stored, has not finished, or has no result yet; nothing is stored then.
    """
    with writing(engine) as connection:
        analysis, verdict = _judged(connection, run)
        made = VerdictOverride(override, run, analysis, verdict, outcome, operator, why, noted_at)
        values = {"run": run, "analysis": analysis, "outcome": str(outcome), "operator": operator, "why": why}
        row = {"override_id": override, "noted_at": noted_at, **values}
        add_rows(connection, run, VerdictOverrideRow, [row])
    return made


def overrides(engine: Engine, run: str | None = None) -> tuple[VerdictOverride, ...]:
    """Return the overrides of one run's verdicts, or of all, oldest first."""
    row = VerdictOverrideRow
    query = select(*row.__table__.columns, AnalysisRow.outcome.label("verdict")).join(
        AnalysisRow, AnalysisRow.analysis == row.analysis
    )
    if run is not None:
        query = query.where(row.run == run)
    with reading(engine) as connection:
        found = connection.execute(query.order_by(row.override_id)).all()
    return tuple(
        VerdictOverride(
            one.override_id,
            one.run,
            one.analysis,
            stored(Outcome, one.verdict, "analyses.outcome", f"analysis {one.analysis}"),
            stored(Outcome, one.outcome, "verdict_overrides.outcome", f"override {one.override_id}"),
            one.operator,
            one.why,
            one.noted_at,
        )
        for one in found
    )


def _judged(connection: Connection, run: str) -> tuple[str, Outcome]:
    """Return the latest analysis of a run with its outcome."""
    if run_row(connection, run) is None:
        raise StoreError(f"there is no run {run}", remedy="cbsr-qa report SERIAL names the latest run of a sensor")
    check_run(connection, run)
    end = current_state(connection, run).end
    if end != EndReason.FINISHED:
        raise StoreError(
            f"run {run} has not finished ({end}): there is no verdict to override",
            remedy=f"cbsr-qa run --resume {run} goes on with it",
        )
    latest = select(func.max(AnalysisRow.analysis)).where(AnalysisRow.run == run).scalar_subquery()
    query = select(AnalysisRow.analysis, AnalysisRow.outcome).where(AnalysisRow.analysis == latest)
    found = connection.execute(query).one_or_none()
    if found is None:
        raise StoreError(
            f"run {run} has no result yet: there is no verdict to override",
            remedy=f"cbsr-qa run --resume {run} works it out",
        )
    return found.analysis, analysis_outcome(found)
