"""Runs as a shift lists them, by columns and indices: only the selected runs and their latest results are read."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, Engine, exists, func, select

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import EndReason, ListedRun, Measurement, MetricKey, Outcome, RunSelection
from cbsr_qa.store.chain import AT_ONCE, RESTORE, altered_runs, read_rows
from cbsr_qa.store.engine import reading
from cbsr_qa.store.results import stored_measurement
from cbsr_qa.store.selected import Conditions, conditions, naming_runs
from cbsr_qa.store.tables import MeasurementRow, RunRow, RunStateRow, StationCheckRow
from cbsr_qa.store.verdicts import StoredVerdict, stored_verdicts, verdict_pages

_EVERY: Final = RunSelection()


def listed_runs(engine: Engine, selection: RunSelection = _EVERY) -> tuple[ListedRun, ...]:
    """Return the selected runs in the order they were made in; those that were altered are marked.

    What is shown of a run is compared with the links of its rows, not the whole chain: see docs/explanation.

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


@dataclass(frozen=True, slots=True)
class MeasuredRuns:
    """What runs measured: the measurements of their latest analyses, by run and number.

    Parameters
    ----------
    runs : of each measurement.
    columns : cells of the table of measurements, by the name of their column.
    altered : what is wrong with runs that do not match their chain, by run; they have no measurements here.
    """

    runs: Sequence[str]
    columns: Mapping[str, Sequence[Any]]
    altered: Mapping[str, str]


def measured_runs(engine: Engine, runs: Sequence[str]) -> MeasuredRuns:
    """Read what runs measured, compared with their chains.

    Raises
    ------
    StoreError
        If the database cannot be read, or a cell of one of the runs is damaged; the message names the run.
    """
    with reading(engine) as connection:
        return naming_runs(connection, [RunRow.run.in_(runs)], _measured)


def judged_measurements(engine: Engine, runs: Sequence[str]) -> dict[str, list[Measurement]]:
    """Return the measurements with a limit by run. StoreError as for measured_runs, and if a run was altered."""
    measured = measured_runs(engine, runs)
    for problem in measured.altered.values():
        raise StoreError(problem, remedy=RESTORE)
    found: dict[str, list[Measurement]] = {}
    names, limited = list(measured.columns), measured.columns["limited"]
    for at, cells in enumerate(zip(*measured.columns.values(), strict=True)):
        if limited[at]:
            values = dict(zip(names, cells, strict=True))
            where = f"analysis {values['analysis']}, measurement {values['number']},"
            found.setdefault(measured.runs[at], []).append(stored_measurement(values, where))
    return found


def _measured(connection: Connection, chosen: Conditions) -> MeasuredRuns:
    verdicts = {one.run: one for one in stored_verdicts(connection, chosen)}
    rows = read_rows(connection, MeasurementRow, list(verdicts))
    chains = {run: one.values["chain"] for run, one in verdicts.items() if not one.altered}
    altered = {run: one.altered for run, one in verdicts.items() if one.altered}
    altered |= altered_runs(connection, chains, [rows.of_runs(chains)])
    latest = {one.analysis for run, one in verdicts.items() if run not in altered}
    shown = [at for at, analysis in enumerate(rows.columns["analysis"]) if analysis in latest]
    columns = {name: [cells[at] for at in shown] for name, cells in rows.columns.items()}
    return MeasuredRuns([rows.runs[at] for at in shown], columns, altered)


def _listed(connection: Connection, chosen: Conditions) -> tuple[ListedRun, ...]:
    earlier = _earlier(connection, chosen)
    of_checks = set(connection.scalars(select(StationCheckRow.golden_run)))
    runs: list[ListedRun] = []
    for page in verdict_pages(connection, chosen):  # not all at once: garbage is looked for among what is kept
        failed, altered = _failed(connection, page)
        runs += (
            _run(
                one,
                altered.get(one.run, one.altered),
                tuple(failed.get(one.analysis, ())),
                earlier.get(one.run, 0),
                of_check=one.run in of_checks,
            )
            for one in page
        )
    return tuple(runs)


def _run(
    one: StoredVerdict, altered: str, failed: tuple[MetricKey, ...], earlier: int, *, of_check: bool
) -> ListedRun:
    row = one.values
    return ListedRun(
        run=row["run"],
        serial=row["serial"],
        batch=row["batch"],
        sensor_type=row["sensor_type"],
        station=row["station"],
        recipe=row["recipe"],
        operator=row["operator"],
        started_at=row["started_at"],
        end=one.end,
        station_s=one.station_s,
        outcome=None if altered else one.outcome,
        reason=altered or one.reason,
        decision=None if altered else one.decision,
        failed=failed,
        earlier=earlier,
        of_check=of_check,
        simulated=bool(row["simulated"]),
        end_detail=one.end_detail,
        chain=one.chain,
        altered=altered,
    )


def _failed(
    connection: Connection, verdicts: Sequence[StoredVerdict]
) -> tuple[dict[str, dict[MetricKey, None]], dict[str, str]]:
    """Return the metrics outside their limits, by analysis, and what is wrong with runs that were altered.

    Only of analyses that failed, as one such metric decides.
    """
    chains = {one.run: one.values["chain"] for one in verdicts if one.outcome is Outcome.FAIL}
    latest = {one.analysis for one in verdicts if one.run in chains}
    if not chains:
        return {}, {}
    rows = read_rows(connection, MeasurementRow, list(chains))
    altered = altered_runs(connection, chains, [rows])
    found: dict[str, dict[MetricKey, None]] = {}
    cells = rows.tuples(("analysis", "outcome", "name", "phase", "qualifier"))
    for run, (analysis, outcome, *key) in zip(rows.runs, cells, strict=True):
        if outcome == Outcome.FAIL and analysis in latest and run not in altered:
            found.setdefault(analysis, {})[MetricKey(*key)] = None
    return found, altered


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
