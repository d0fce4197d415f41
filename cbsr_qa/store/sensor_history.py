"""Earlier runs of one sensor in one query, and the seeds they had."""

import json
from typing import Any

from sqlalchemy import Engine, and_, exists, func, select

from cbsr_qa.domain.outcome import EndReason, Outcome
from cbsr_qa.domain.sensor import SensorIdentity
from cbsr_qa.domain.sensor_history import EarlierRun
from cbsr_qa.store.change_tables import VerdictOverrideRow
from cbsr_qa.store.check_tables import StationCheckRow
from cbsr_qa.store.engine import reading
from cbsr_qa.store.result_tables import AnalysisRow
from cbsr_qa.store.run_tables import RunRow, RunStateRow


def earlier_runs(engine: Engine, serial: str, before: str = "") -> tuple[EarlierRun, ...]:
    """Return the runs of a sensor that began before a run (empty: all), oldest first."""
    run, state, analysis, override = RunRow, RunStateRow, AnalysisRow, VerdictOverrideRow
    last_state = select(func.max(state.number)).where(state.run == run.run).correlate(run).scalar_subquery()
    last_analysis = select(func.max(analysis.analysis)).where(analysis.run == run.run).correlate(run)
    last_override = select(func.max(override.override_id)).where(
        override.run == run.run, override.analysis == analysis.analysis
    )
    query = (
        select(
            *(run.run, run.started_at, run.serial, run.batch, run.sensor_type, run.recipe),
            *(state.end, analysis.outcome, analysis.reason),
            override.outcome.label("decided"),
            override.operator.label("by"),
            exists().where(StationCheckRow.golden_run == run.run).label("of_check"),
        )
        .join(state, and_(state.run == run.run, state.number == last_state))
        .outerjoin(analysis, analysis.analysis == last_analysis.scalar_subquery())
        .outerjoin(override, override.override_id == last_override.correlate(run, analysis).scalar_subquery())
        .where(run.serial == serial)
        .order_by(run.run)
    )
    if before:
        query = query.where(run.run < before)
    with reading(engine) as connection:
        return tuple(_earlier(row) for row in connection.execute(query))


def seeds_of(engine: Engine, serial: str) -> tuple[int | None, ...]:
    """Return the seeds of all runs of a sensor, oldest first; None where a configuration states none."""
    query = select(RunRow.configuration).where(RunRow.serial == serial).order_by(RunRow.run)
    with reading(engine) as connection:
        return tuple(json.loads(text).get("seed") for text in connection.scalars(query))


def _earlier(row: Any) -> EarlierRun:
    return EarlierRun(
        run=row.run,
        started_at=row.started_at,
        sensor=SensorIdentity(row.serial, row.batch, row.sensor_type),
        recipe=row.recipe,
        end=EndReason(row.end),
        outcome=None if row.outcome is None else Outcome(row.outcome),
        reason=row.reason or "",
        overridden=None if row.decided is None else (Outcome(row.decided), row.by),
        of_check=row.of_check,
    )
