"""Runs as a shift lists them, by columns and indices: only the selected runs and their latest results are read."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final, TypeAlias

from sqlalchemy import Connection, Engine, Row, Select, exists, func, select

from cbsr_qa.domain.results import Decision, EndReason, ListedRun, Measurement, MetricKey, Outcome, RunSelection
from cbsr_qa.store.chain import AT_ONCE
from cbsr_qa.store.damage import stored
from cbsr_qa.store.engine import reading
from cbsr_qa.store.results import analysis_outcome, as_measurement
from cbsr_qa.store.selected import Conditions, conditions, latest_of, naming_runs
from cbsr_qa.store.standing import up_to_date
from cbsr_qa.store.tables import (
    AnalysisRow,
    MeasurementRow,
    RunRow,
    RunStateRow,
    StationCheckRow,
    VerdictOverrideRow,
)

_Found: TypeAlias = Row[*tuple[Any, ...]]
_EVERY: Final = RunSelection()
_COLUMNS: Final = (
    *(RunRow.run, RunRow.serial, RunRow.batch, RunRow.sensor_type, RunRow.station, RunRow.recipe),
    *(RunRow.operator, RunRow.started_at, RunRow.simulated),
)


def listed_runs(engine: Engine, selection: RunSelection = _EVERY) -> tuple[ListedRun, ...]:
    """Return the selected runs in the order they were made in.

    Chains of digests are not checked: that takes 0.3 ms a run, and a report does it.

    Raises
    ------
    StoreError
        If the database cannot be read, or a cell of a selected run is damaged; the message names the run.
    """
    with reading(engine) as connection:
        return naming_runs(connection, conditions(selection), _listed)


def run_count(engine: Engine, selection: RunSelection = _EVERY) -> int:
    """Return how many runs are selected. StoreError if the database cannot be read."""
    with reading(engine) as connection:
        query = select(func.count()).select_from(RunRow).where(*conditions(selection))
        return connection.scalar(query) or 0


def run_names(engine: Engine, selection: RunSelection = _EVERY) -> tuple[str, ...]:
    """Return the identifiers of the selected runs in the order they were made in. StoreError as for listed_runs."""
    with reading(engine) as connection:
        query = select(RunRow.run).where(*conditions(selection)).order_by(RunRow.run)
        return tuple(connection.scalars(query.execution_options(yield_per=AT_ONCE)))


def judged_measurements(engine: Engine, runs: Sequence[str]) -> dict[str, list[Measurement]]:
    """Return the measurements with a limit by run, as :func:`measurement_rows` reads them."""
    found: dict[str, list[Measurement]] = {}
    for row in measurement_rows(engine, runs, limited=True):
        found.setdefault(row.run, []).append(as_measurement(row))
    return found


def measurement_rows(engine: Engine, runs: Sequence[str], *, limited: bool = False) -> Sequence[_Found]:
    """Return the rows of what runs measured, with ``run``, ordered by run and number: of their latest analyses.

    Chains of digests are not checked.

    Parameters
    ----------
    limited : only those with a limit.

    Raises
    ------
    StoreError
        If the database cannot be read, or a cell of one of the runs is damaged; the message names the run.
    """
    a, m = AnalysisRow, MeasurementRow

    def read(connection: Connection, chosen: Conditions) -> Sequence[_Found]:
        ours = select(a.run, func.max(a.analysis).label("analysis")).join(RunRow, RunRow.run == a.run)
        latest = ours.where(*chosen, up_to_date()).group_by(a.run).subquery()
        query = select(latest.c.run, *m.__table__.columns).join(m, m.analysis == latest.c.analysis)
        query = query.where(m.limited) if limited else query
        return connection.execute(query.order_by(latest.c.run, m.number)).all()

    with reading(engine) as connection:
        return naming_runs(connection, [RunRow.run.in_(runs)], read)


def _listed(connection: Connection, chosen: Conditions) -> tuple[ListedRun, ...]:
    s, a = RunStateRow, AnalysisRow
    ends = latest_of(connection, select(s.run, s.end, s.detail, s.time_s).order_by(s.number), chosen)
    analysed = select(a.run, a.analysis, a.outcome, a.reason).where(up_to_date()).order_by(a.analysis)
    analyses = latest_of(connection, analysed, chosen)
    decisions = decisions_of(connection, chosen)
    failed = _failed(connection, chosen)
    earlier = _earlier(connection, chosen)
    of_checks = set(connection.scalars(select(StationCheckRow.golden_run)))
    query = select(*_COLUMNS).where(*chosen).order_by(RunRow.run)
    return tuple(
        _run(
            row,
            ends.get(row.run),
            analysis := analyses.get(row.run),
            None if analysis is None else decisions.get((row.run, analysis.analysis)),
            () if analysis is None else tuple(failed.get(analysis.analysis, ())),
            earlier.get(row.run, 0),
            of_check=row.run in of_checks,
        )
        for row in connection.execute(query.execution_options(yield_per=AT_ONCE))
    )


def _run(
    row: _Found,
    end: _Found | None,
    analysis: _Found | None,
    decision: Decision | None,
    failed: tuple[MetricKey, ...],
    earlier: int,
    *,
    of_check: bool,
) -> ListedRun:
    return ListedRun(
        run=row.run,
        serial=row.serial,
        batch=row.batch,
        sensor_type=row.sensor_type,
        station=row.station,
        recipe=row.recipe,
        operator=row.operator,
        started_at=row.started_at,
        end=EndReason.RUNNING if end is None else stored(EndReason, end.end, "run_states.end", f"run {row.run}"),
        station_s=0.0 if end is None else end.time_s,
        outcome=None if analysis is None else analysis_outcome(analysis),
        reason="" if analysis is None else analysis.reason,
        decision=decision,
        failed=failed,
        earlier=earlier,
        of_check=of_check,
        simulated=bool(row.simulated),
        end_detail="" if end is None else end.detail,
    )


def _of(query: Select[*tuple[Any, ...]], chosen: Conditions) -> Select[*tuple[Any, ...]]:
    """Keep the rows of the chosen runs."""
    return query.where(query.selected_columns.run.in_(select(RunRow.run).where(*chosen))) if chosen else query


def decisions_of(connection: Connection, chosen: Conditions) -> dict[tuple[str, str], Decision]:
    """Return the latest override of each run and analysis."""
    o = VerdictOverrideRow
    query = _of(select(o.run, o.analysis, o.outcome, o.operator, o.why, o.override_id), chosen)
    return {
        (row.run, row.analysis): Decision(
            stored(Outcome, row.outcome, "verdict_overrides.outcome", f"run {row.run}"), row.operator, row.why
        )
        for row in connection.execute(query.order_by(o.override_id))
    }


def _failed(connection: Connection, chosen: Conditions) -> dict[str, dict[MetricKey, None]]:
    """Return the metrics outside their limits, by analysis: only of those that failed, as one such metric decides."""
    m, a = MeasurementRow, AnalysisRow
    analyses = _of(select(a.analysis, a.run).where(a.outcome == str(Outcome.FAIL)), chosen).subquery()
    query = select(m.analysis, m.name, m.phase, m.qualifier).where(
        m.analysis.in_(select(analyses.c.analysis)), m.outcome == str(Outcome.FAIL)
    )
    found: dict[str, dict[MetricKey, None]] = {}
    for analysis, *key in connection.execute(query.order_by(m.analysis, m.number)):
        found.setdefault(analysis, {})[MetricKey(*key)] = None
    return found


def _earlier(connection: Connection, chosen: Conditions) -> dict[str, int]:
    """Return how many finished runs of the sensor and recipe are before each run."""
    r, s = RunRow, RunStateRow
    finished = exists().where(s.run == r.run, s.end == str(EndReason.FINISHED))
    checks = select(StationCheckRow.golden_run).where(StationCheckRow.golden_run.is_not(None))
    query = select(r.run, r.serial, r.recipe, finished).where(r.run.not_in(checks)).order_by(r.run)
    if chosen:
        query = query.where(r.serial.in_(select(r.serial).where(*chosen)))
    before: Counter[tuple[str, str]] = Counter()
    found = {}
    for run, serial, recipe, ended in connection.execute(query):
        found[run] = before[serial, recipe]
        before[serial, recipe] += ended
    return found
