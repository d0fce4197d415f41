"""Outcomes of runs, without their frames: the latest of one run, the earlier runs of a sensor, their seeds."""

import json
from datetime import UTC, datetime
from typing import Any, Final

from sqlalchemy import Connection, Engine, and_, exists, func, select

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import EndReason, Outcome, ResultState
from cbsr_qa.domain.run import EarlierRun
from cbsr_qa.domain.sensor import SensorIdentity
from cbsr_qa.store.chain import check_run, unreadable
from cbsr_qa.store.damage import shown, stored
from cbsr_qa.store.engine import open_engine, parsed_url, reading, sqlite_file
from cbsr_qa.store.standing import standing_of, up_to_date
from cbsr_qa.store.tables import AnalysisRow, RunRow, RunStateRow, StationCheckRow, VerdictOverrideRow
from cbsr_qa.store.types import made_at


def latest_result(url: str, run: str) -> tuple[ResultState, Outcome | None]:
    """Return what has come of a run, and the outcome of the latest analysis after its last session, or None.

    Raises
    ------
    StoreError
        If the database or the run does not exist, or it cannot be read.
    """
    parsed = parsed_url(url)
    file = sqlite_file(parsed)
    if file is not None and not file.exists():  # SQLite would create an empty one
        raise StoreError(f"{shown(parsed)} does not exist")
    engine = open_engine(parsed)
    try:
        with reading(engine) as connection:
            standing = standing_of(connection, run)
            query = select(AnalysisRow.outcome).where(AnalysisRow.analysis == standing.analysis)
            outcome = connection.scalar(query)
    finally:
        engine.dispose()
    judged = None if outcome is None else stored(Outcome, outcome, "analyses.outcome", f"run {run}")
    return standing.result, judged


#: Columns read of an earlier run.
_READ: Final = frozenset(table.__tablename__ for table in (RunRow, RunStateRow, AnalysisRow, VerdictOverrideRow))


def earlier_runs(engine: Engine, serial: str, before: str = "") -> tuple[EarlierRun, ...]:
    """Return the runs of a sensor that began before a run (empty: all), oldest first.

    An altered run is returned with the problem instead of its result.
    """
    run, of_check = RunRow, exists().where(StationCheckRow.golden_run == RunRow.run)
    query = select(run.run, run.recipe, of_check).where(run.serial == serial).order_by(run.run)
    if before:
        query = query.where(run.run < before)
    with reading(engine) as connection:
        return tuple(_checked(connection, serial, *row) for row in connection.execute(query).all())


def _checked(connection: Connection, serial: str, run: str, recipe: str, of_check: bool) -> EarlierRun:
    try:
        chained = check_run(connection, run, _READ).chained
        return _earlier(_row(connection, run), of_check=of_check, chained=chained)
    except (StoreError, ValueError, TypeError, AttributeError) as error:
        changed = (error if isinstance(error, StoreError) else unreadable(connection, run, error)).reason
        began = made_at(run) or datetime.fromtimestamp(0, UTC)
        sensor = SensorIdentity(serial, "", "")
        return EarlierRun(run, began, sensor, recipe, EndReason.RUNNING, None, "", of_check=of_check, changed=changed)


def _row(connection: Connection, of: str) -> Any:
    run, state, analysis, override = RunRow, RunStateRow, AnalysisRow, VerdictOverrideRow
    last_state = select(func.max(state.number)).where(state.run == run.run).correlate(run).scalar_subquery()
    last_analysis = select(func.max(analysis.analysis)).where(analysis.run == run.run, up_to_date()).correlate(run)
    last_override = select(func.max(override.override_id)).where(
        override.run == run.run, override.analysis == analysis.analysis
    )
    query = (
        select(
            *(run.run, run.started_at, run.serial, run.batch, run.sensor_type, run.recipe),
            *(state.end, analysis.outcome, analysis.reason),
            override.outcome.label("decided"),
            override.operator.label("by"),
        )
        .join(state, and_(state.run == run.run, state.number == last_state))
        .outerjoin(analysis, analysis.analysis == last_analysis.scalar_subquery())
        .outerjoin(override, override.override_id == last_override.correlate(run, analysis).scalar_subquery())
        .where(run.run == of)
    )
    return connection.execute(query).one()


def seeds_of(engine: Engine, serial: str) -> tuple[int | None, ...]:
    """Return the seeds of all runs of a sensor, oldest first; None where a configuration has none."""
    query = select(RunRow.configuration).where(RunRow.serial == serial).order_by(RunRow.run)
    with reading(engine) as connection:
        return tuple(map(_seed, connection.scalars(query)))


def _seed(configuration: str) -> int | None:
    """Seed of a configuration; None for a damaged one, which is refused when the run is read."""
    try:
        seed: int | None = json.loads(configuration).get("seed")
    except (ValueError, TypeError, AttributeError):
        return None
    return seed


def _earlier(row: Any, *, of_check: bool, chained: bool) -> EarlierRun:
    return EarlierRun(
        run=row.run,
        started_at=row.started_at,
        sensor=SensorIdentity(row.serial, row.batch, row.sensor_type),
        recipe=row.recipe,
        end=EndReason(row.end),
        outcome=None if row.outcome is None else Outcome(row.outcome),
        reason=row.reason or "",
        overridden=None if row.decided is None else (Outcome(row.decided), row.by),
        of_check=of_check,
        chained=chained,
    )
