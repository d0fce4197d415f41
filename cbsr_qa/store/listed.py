"""Runs as a shift lists them, by columns and indices: only the selected runs and their latest results are read."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from typing import Any, Final

from sqlalchemy import Connection, Engine, exists, func, select, type_coerce
from sqlalchemy.types import NullType

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Bound, Outcome, margin_to
from cbsr_qa.domain.results.fleet import MetricKey, RunSelection
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.chain.check import RESTORE
from cbsr_qa.store.chain.many_runs import ReadRows, find_altered, read_rows
from cbsr_qa.store.chain.run_documents import list_covered
from cbsr_qa.store.engine import reading
from cbsr_qa.store.golden import find_golden_runs, golden_runs
from cbsr_qa.store.left_out import with_left_out
from cbsr_qa.store.results.analyses import restore_measurement
from cbsr_qa.store.runs.outcomes import RECENT_RUNS
from cbsr_qa.store.runs.verdicts import StoredVerdict, read_verdicts, verdict_pages
from cbsr_qa.store.selected import conditions
from cbsr_qa.store.tables.results import MeasurementRow
from cbsr_qa.store.tables.runs import Base, RunRow, RunStateRow
from cbsr_qa.store.unreadable_runs import read_apart

_EVERY: Final = RunSelection()
#: Number of runs from which on the runs of all sensors are read; below it, only those of the sensors concerned.
_READ_ALL_FROM: Final = 1000
#: Allowed words of those columns of measurements that hold a word.
_WORDS: Final = {"outcome": frozenset(map(str, Outcome)), "bound": frozenset(map(str, Bound))}


def _names(connection: Connection, selection: RunSelection) -> list[str]:
    """Return the selected runs, and altered ones that may belong to them.

    Of runs of other sensors the latest 500 are compared with their links: to compare 100 000 takes ten seconds.
    """
    latest = RECENT_RUNS if selection.serials or selection.parts else None
    query = select(RunRow.run).where(*conditions(selection)).order_by(RunRow.run)
    return with_left_out(connection, selection, list(connection.scalars(query)), latest)


@dataclass(frozen=True, slots=True)
class MeasuredRuns:
    """Measurements of the latest analyses of runs, by run and number.

    Parameters
    ----------
    runs : run of each measurement.
    columns : cells of the table of measurements, by the name of their column.
    altered : problems of the runs that do not match their chain, by run; these have no measurements here.
    """

    runs: Sequence[str]
    columns: Mapping[str, Sequence[Any]]
    altered: Mapping[str, str]


class RunLists:
    """Lists of runs, and what they measured."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def read_runs(self, selection: RunSelection = _EVERY) -> tuple[ListedRun, ...]:
        """Return the selected runs in the order they were made in; those that were altered are marked.

        An altered run is returned even if the selection excludes it, as the selecting columns may have been altered;
        of a selection by sensors or parts, if it is one of the latest 500.
        The rows of a run are compared with their links, not with the whole chain: see docs/explanation.

        Raises
        ------
        StoreError
            If the database cannot be read.
        """
        with reading(self._engine) as connection:
            return _list_runs(connection, _names(connection, selection))

    def read_named(self, runs: Sequence[str]) -> tuple[ListedRun, ...]:
        """Return the named runs, checked like those of :meth:`read_runs`; names of no stored run are passed over."""
        with reading(self._engine) as connection:
            return _list_runs(connection, runs)

    def read_failed_before(self, run: str) -> tuple[str, ...]:
        """Return the codes of the earlier failures of a run's sensor with its recipe, as often as each was given."""
        with reading(self._engine) as connection:
            counts, tries, _ = _earlier(connection, [run])
            query = select(RunRow.serial, RunRow.recipe).where(RunRow.run == run)
            serial, recipe = connection.execute(query).one()
            names = tries.get((serial, recipe), [])[: counts.get(run, 0)]  # none of a golden sensor
            return _list_codes(_read_runs(connection, names, {}, set()))

    def count_runs(self, selection: RunSelection = _EVERY) -> int:
        """Return how many runs are selected. StoreError if the database cannot be read."""
        with reading(self._engine) as connection:
            query = select(func.count()).select_from(RunRow).where(*conditions(selection))
            return connection.scalar(query) or 0

    def read_names(self, selection: RunSelection = _EVERY) -> tuple[str, ...]:
        """Return the identifiers of the runs that :meth:`read_runs` returns, in the order they were made in."""
        with reading(self._engine) as connection:
            return tuple(_names(connection, selection))

    def find_resumed(self, runs: Sequence[str], since: datetime) -> set[str]:
        """Return those of some runs of which a session began at a moment or later."""
        query = select(RunStateRow.run).where(RunStateRow.run.in_(runs), RunStateRow.noted_at >= since)
        with reading(self._engine) as connection:
            return set(connection.scalars(query))

    def read_measurements(self, runs: Sequence[str]) -> MeasuredRuns:
        """Read what runs measured, compared with their chains.

        Raises
        ------
        StoreError
            If the database cannot be read.
        """
        with reading(self._engine) as connection:
            read = partial(_read_measurements, connection)
            parts = (
                list(read_apart(connection, runs, read, lambda run, problem: MeasuredRuns((), {}, {run: problem})))
                if runs
                else []
            )
        names = [column.name for column in list_covered(Base.metadata.tables[MeasurementRow.__tablename__])]
        return MeasuredRuns(
            [run for part in parts for run in part.runs],
            {name: [cell for part in parts for cell in part.columns.get(name, ())] for name in names},
            {run: problem for part in parts for run, problem in part.altered.items()},
        )

    def read_limited_measurements(self, runs: Sequence[str]) -> dict[str, list[Measurement]]:
        """Return the measurements with a limit by run. StoreError also if a run was altered."""
        measured = self.read_measurements(runs)
        for problem in measured.altered.values():
            raise StoreError(problem, remedy=RESTORE)
        measurements_by_run: dict[str, list[Measurement]] = {}
        names, limited = list(measured.columns), measured.columns["limited"]
        for index, cells in enumerate(zip(*measured.columns.values(), strict=True)):
            if limited[index]:
                values = dict(zip(names, cells, strict=True))
                place = f"analysis {values['analysis']}, measurement {values['number']},"
                measurements_by_run.setdefault(measured.runs[index], []).append(restore_measurement(values, place))
        return measurements_by_run


def _read_measurements(connection: Connection, runs: Sequence[str]) -> MeasuredRuns:
    verdicts = {verdict.run: verdict for verdict in read_verdicts(connection, runs)}
    sound_runs = [run for run, verdict in verdicts.items() if not verdict.altered]
    rows = read_rows(connection, MeasurementRow, sound_runs)
    altered = {run: verdict.altered for run, verdict in verdicts.items() if verdict.altered}
    altered |= find_altered(connection, {run: verdicts[run].values["chain"] for run in sound_runs}, [rows])
    altered |= _unknown_words(rows, altered)
    latest_analyses = {verdict.analysis for run, verdict in verdicts.items() if run not in altered}
    shown_indexes = [index for index, analysis in enumerate(rows.columns["analysis"]) if analysis in latest_analyses]
    columns = {name: [cells[index] for index in shown_indexes] for name, cells in rows.columns.items()}
    return MeasuredRuns([rows.runs[index] for index in shown_indexes], columns, altered)


def _unknown_words(rows: ReadRows, altered: Collection[str]) -> dict[str, str]:
    """Return the problems of runs whose measurements hold unknown words; runs already altered are skipped."""
    problem_by_run: dict[str, str] = {}
    for column, allowed_words in _WORDS.items():
        if set(rows.columns[column]) <= allowed_words:
            continue
        for run, analysis, number, word in zip(
            rows.runs, *(rows.columns[name] for name in ("analysis", "number", column)), strict=True
        ):
            if word not in allowed_words and run not in altered:
                place = f"analysis {analysis}, measurement {number}, has measurements.{column} {word[:64]!r}"
                problem_by_run.setdefault(run, f"run {run}: {place}; allowed: {', '.join(sorted(allowed_words))}")
    return problem_by_run


def _list_runs(connection: Connection, names: Sequence[str]) -> tuple[ListedRun, ...]:
    counts, tries, of_checks = _earlier(connection, names)
    runs = {run.run: run for run in _read_runs(connection, names, counts, of_checks)}
    repeated = {
        name: tries[run.serial, run.recipe][: run.earlier]
        for name, run in runs.items()
        if run.earlier and run.failure_codes
    }
    others = sorted({name for own in repeated.values() for name in own} - set(runs))
    known_runs = runs | {run.run: run for run in _read_runs(connection, others, {}, set())}
    for name, own in repeated.items():
        runs[name] = replace(runs[name], failed_before=_list_codes(known_runs[one] for one in own))
    return tuple(runs.values())


def _list_codes(runs: Iterable[ListedRun]) -> tuple[str, ...]:
    """Return the codes of those runs that count as failed, as often as each was given."""
    return tuple(code.code for run in runs if run.verdict is Outcome.FAIL for code in run.failure_codes)


def _read_runs(
    connection: Connection, names: Sequence[str], earlier: Mapping[str, int], of_checks: Collection[str]
) -> list[ListedRun]:
    """Return named runs without their sensors' earlier failures. ``earlier``: number of the tries before each."""
    runs: list[ListedRun] = []
    # Not all at once: garbage collection slows down with the number of objects.
    for page in verdict_pages(connection, names):
        verdicts = {verdict.run: verdict for verdict in page if verdict.outcome is Outcome.FAIL}
        failed: dict[str, list[MetricKey]] = {}
        altered: dict[str, str] = {}
        find_failures = partial(_find_failures, connection, verdicts)
        for metrics, problems in read_apart(
            connection, list(verdicts), find_failures, lambda run, problem: ({}, {run: problem})
        ):
            failed |= metrics
            altered |= problems
        runs += (
            _run(
                verdict,
                altered.get(verdict.run, verdict.altered),
                failed.get(verdict.analysis, []),
                earlier.get(verdict.run, 0),
                of_check=verdict.run in of_checks,
            )
            for verdict in page
        )
    return runs


def _run(
    verdict: StoredVerdict, altered: str, failed: Sequence[MetricKey], earlier: int, *, of_check: bool
) -> ListedRun:
    row = verdict.values
    return ListedRun(
        run=row["run"],
        serial=row["serial"],
        batch=row["batch"],
        sensor_type=row["sensor_type"],
        station=row["station"],
        recipe=row["recipe"],
        operator=row["operator"],
        started_at=row["started_at"],
        end=verdict.end,
        station_s=verdict.station_s,
        outcome=None if altered else verdict.outcome,
        reason=altered or verdict.reason,
        decision=None if altered else verdict.decision,
        failed=tuple(dict.fromkeys(failed)),
        earlier=earlier,
        of_check=of_check,
        simulated=bool(row["simulated"]),
        end_detail=verdict.end_detail,
        chain=verdict.chain,
        altered=altered,
        coded=verdict.coded,
        parts=verdict.parts,
        failures=len(failed),
    )


def _find_failures(
    connection: Connection, verdicts: Mapping[str, StoredVerdict], runs: Sequence[str]
) -> tuple[dict[str, list[MetricKey]], dict[str, str]]:
    """Return what is outside its limit by analysis, the worst first, and the problems of altered runs.

    Only failed runs are passed in: one metric outside its limits decides that.
    """
    if not runs:
        return {}, {}
    latest_analyses = {verdicts[run].analysis for run in runs}
    rows = read_rows(connection, MeasurementRow, runs)
    altered = find_altered(connection, {run: verdicts[run].values["chain"] for run in runs}, [rows])
    margins: dict[str, list[tuple[float, MetricKey]]] = {}
    cells = rows.tuples(("analysis", "outcome", "value", "lower_limit", "upper_limit", "name", "phase", "qualifier"))
    for run, (analysis, outcome, value, lower, upper, *key) in zip(rows.runs, cells, strict=True):
        if outcome == Outcome.FAIL and analysis in latest_analyses and run not in altered:
            margins.setdefault(analysis, []).append((margin_to(value, lower, upper), MetricKey(*key)))
    failed_by_analysis = {
        analysis: [key for _, key in sorted(own, key=lambda pair: pair[0])] for analysis, own in margins.items()
    }
    return failed_by_analysis, altered


def _earlier(
    connection: Connection, names: Sequence[str]
) -> tuple[dict[str, int], dict[tuple[str, str], list[str]], set[str]]:
    """Return how many tries came before each run, the tries by sensor and recipe, and the golden runs.

    A try is a finished run that made no check of a station.
    """
    r, s = RunRow, RunStateRow
    has_finished = exists().where(s.run == r.run, s.end == str(EndReason.FINISHED))
    # A cell of another type must not stop this: the run is marked where its row is read.
    columns: list[Any] = [type_coerce(column, NullType()) for column in (r.run, r.serial, r.recipe)]
    query = select(*columns, has_finished).order_by(r.run)
    if len(names) < _READ_ALL_FROM:
        query = query.where(r.serial.in_(select(r.serial).where(r.run.in_(names))))
    rows = [tuple(row) for row in connection.execute(query)]
    named_runs = set(connection.scalars(golden_runs()))
    of_checks = find_golden_runs(connection, named_runs.intersection(row[0] for row in rows))
    tries: dict[tuple[str, str], list[str]] = {}
    count_by_run = {}
    for run, serial, recipe, ended in rows:
        if run not in of_checks:
            own = tries.setdefault((serial, recipe), [])
            count_by_run[run] = len(own)
            own += [run] if ended else []
    return count_by_run, tries, of_checks
