"""Runs and sensors of a selection, and those of them that failed."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime
from typing import Any, Final, Literal, Self, TypeAlias

from cbsr_qa.app.shift.summary import ShiftSummary, list_failed_limits, local_day, select_settled_runs, summarise_runs
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import FailureCode, Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.listed import ALTERED, ListedRun
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.report.tables import plural
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.selection import check_names, nearest
from cbsr_qa.system.words import echo

Altered: TypeAlias = Literal["altered"]

#: Number of runs that are listed by default: reading 100 000 takes half a minute.
LATEST_RUNS: Final = 50
#: Texts about runs that were altered, and about runs that cannot be checked.
_TRUST: Final = {
    "altered": "{count} altered since stored: no verdict, not counted, listed by --failed too; see cbsr-qa db check",
    "unchained": "{count} without a chain: nothing tells whether it was altered",
    "chained": "{count} not signed, although a signing key is set: digests alone can be computed again",
}
_LATEST: Final = (
    "the latest {shown} of {count} runs are listed and counted; --latest N takes more, --today or --since DAY others"
)


@dataclass(frozen=True, slots=True)
class ListRequest:
    """Which runs or sensors to list.

    Parameters
    ----------
    selection : selection of the runs.
    failed : whether to list only runs that failed, or sensors that failed in their last decided run.
    limit : name of a limit, as recipes write it or in words: only its failures; empty for any.
    latest : largest number of entries, the latest of those that remain; None for all.

    Raises
    ------
    RefusedError
        If ``latest`` is not at least 1.
    """

    selection: RunSelection
    failed: bool = False
    limit: str = ""
    latest: int | None = None

    def __post_init__(self) -> None:
        if self.latest is not None and self.latest < 1:
            raise RefusedError(f"--latest is {self.latest}", remedy="give at least 1")


def list_request(
    *,
    today: bool = False,
    since: date | None = None,
    until: date | None = None,
    failed: bool = False,
    limit: str = "",
    latest: int | None = None,
    checks: bool = False,
    **selection: Any,
) -> ListRequest:
    """Return which runs are meant by a day and criteria; ``selection``: further fields of a RunSelection.

    Raise RefusedError if two of them exclude each other.
    """
    if today and (since or until):
        raise RefusedError("--today with --since or --until", remedy="give one of them")
    begins, ends = local_day() if today else (None, None)
    runs = RunSelection(since=since, until=until, checks=checks, from_moment=begins, before_moment=ends, **selection)
    return ListRequest(runs, failed=failed, limit=limit, latest=latest)


@dataclass(frozen=True, slots=True)
class RunEntry:
    """One run.

    Parameters
    ----------
    verdict : verdict that counts, an override included; None if the run did not finish or has no result. ``altered``
        if what is stored of it does not match its chain: it has no outcome then, and ``reason`` says what does not
        match.
    outcome, reason : outcome and reason of its analysis.
    overridden_by, overridden_why : operator and reason of the override; None without one.
    failed_limits : limits for which it counts as failed, as recipes write them, the worst first.
    failure_codes : codes of what failed by the run's own recipe, the worst first; an override keeps them.
    parts : parts of the sensor.
    number : number of this try of the recipe on the sensor, from 1; runs that did not finish do not count.
    of_check : whether the run is a golden sensor's, made to check its station.
    chain : ``unchained`` (nothing would tell if it was altered), ``chained``, ``signed``, ``signature not checked``
        if it is signed with another key than the one that is set.
    """

    run: str
    serial: str
    batch: str
    sensor_type: str
    station: str
    recipe: str
    operator: str
    started_at: datetime
    end: EndReason
    station_s: float
    verdict: Outcome | Altered | None
    outcome: Outcome | None
    reason: str
    overridden_by: str | None
    overridden_why: str | None
    failed_limits: tuple[str, ...]
    failure_codes: tuple[FailureCode, ...]
    parts: tuple[SensorPart, ...]
    number: int
    of_check: bool
    simulated: bool
    chain: str

    @classmethod
    def from_run(cls, run: ListedRun) -> Self:
        return fill_from_object(
            cls,
            run,
            verdict=ALTERED if run.altered else run.verdict,
            overridden_by=None if run.decision is None else run.decision.operator,
            overridden_why=None if run.decision is None else run.decision.why,
            failed_limits=tuple(key.label for key in list_failed_limits(run)),
            number=run.earlier + 1,
            chain=run.chain.label,
        )


@dataclass(frozen=True, slots=True)
class RunPage:
    """Some of the selected runs; ``done`` of ``total`` runs have been read with it."""

    runs: tuple[ListedRun, ...]
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class RunList:
    """Runs of a selection, in the order they were made in, and their summary."""

    summary: ShiftSummary
    runs: tuple[RunEntry, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SensorEntry:
    """One sensor and recipe.

    Parameters
    ----------
    runs, tries : all runs of the selection, and those that finished.
    first, last : start of the first and of the last run.
    station, operator, end, run : station, operator, end and identifier of the last run.
    verdict, reason, failed_limits, failure_codes : verdict, reason, failed limits and failure codes of the last
        decided run; None and empty where nothing was decided. ``altered`` if a run after it, or it, does not match
        its chain; ``reason`` then says what does not.
    overridden_by, overridden_why : operator and reason of the override of that run; None without one.
    first_pass : whether the first finished run passed; None if it is not among these runs, or decided nothing.
    chain : chain of the last decided run, else of the last one, as in a :class:`RunEntry`.
    """

    serial: str
    batch: str
    sensor_type: str
    recipe: str
    runs: int
    tries: int
    first: datetime
    last: datetime
    station: str
    operator: str
    end: EndReason
    verdict: Outcome | Altered | None
    reason: str
    overridden_by: str | None
    overridden_why: str | None
    failed_limits: tuple[str, ...]
    failure_codes: tuple[FailureCode, ...]
    first_pass: bool | None
    run: str
    chain: str


@dataclass(frozen=True, slots=True)
class SensorList:
    """Sensors of a selection, the last tested at the end; a sensor is listed once for each recipe."""

    summary: ShiftSummary
    sensors: tuple[SensorEntry, ...]
    notes: tuple[str, ...] = ()


def list_runs(store: Repository, request: ListRequest) -> RunList:
    """List runs.

    Raises
    ------
    RefusedError
        If a name of the selection is of no stored run; the remedy names the nearest one.
    StoreError
        If the database cannot be read; of a damaged run the message names it.
    """
    runs = selected = _select_runs(store, request)
    if request.failed or request.limit:
        selected = [run for run in runs if _has_failed(run, request.limit)][-(request.latest or 0) :]
    notes = (*_notes(request, runs, selected), *trust_notes(store, trust_counts(selected)))
    if (
        selected is runs
        and request.latest is not None
        and (count := store.lists.count_runs(request.selection)) > len(selected)
    ):
        notes = (_LATEST.format(shown=len(selected), count=count), *notes)
    return RunList(summarise_runs(selected), tuple(map(RunEntry.from_run, selected)), notes)


def list_sensors(store: Repository, request: ListRequest) -> SensorList:
    """List sensors, each with the verdict of its last decided run among the selected ones. Raises as list_runs."""
    runs = _select_runs(store, replace(request, latest=None))
    groups = group_by_sensor(runs)
    if request.failed or request.limit:
        groups = [
            own for own in groups if any(_has_failed(run, request.limit) for run in select_settled_runs(own)[-1:])
        ]
    groups = groups[-(request.latest or 0) :]
    kept_runs = sorted({run.run: run for own in groups for run in own}.values(), key=lambda run: run.run)
    notes = (*_notes(request, runs, groups), *trust_notes(store, trust_counts(kept_runs)))
    return SensorList(summarise_runs(kept_runs), tuple(map(_state, groups)), notes)


def group_by_sensor(runs: Sequence[ListedRun]) -> list[list[ListedRun]]:
    """Return the runs of each sensor and recipe, the sensor tested last at the end.

    An altered run that does not decide may be of another sensor, and gets a group of its own.
    """
    runs_by_sensor: dict[tuple[str, str], list[ListedRun]] = {}
    for run in runs:
        runs_by_sensor.setdefault((run.serial, run.recipe), []).append(run)
    groups = list(runs_by_sensor.values())
    for own in runs_by_sensor.values():
        groups += [[run] for run in own if run.altered and run not in select_settled_runs(own)[-1:]]
    return sorted(groups, key=lambda own: own[-1].run)


def sensor_runs(store: Repository, serial: str) -> tuple[ListedRun, ...]:
    """Return all runs of one sensor in the order they were made in, checks of a station included; none if unknown.

    Runs of other serial numbers are not looked at: to check 100 000 takes ten seconds.
    """
    return store.lists.read_named(store.sensors.find_runs([serial]))


def run_pages(store: Repository, request: ListRequest, size: int) -> Iterator[RunPage]:
    """Yield the runs that :func:`list_runs` lists in pages, in the order they were made in.

    Only one page is in memory, and the identifiers of all selected runs; with ``latest`` together with ``failed`` or
    ``limit`` so many runs. Runs that begin meanwhile are left out. Raises as list_runs.
    """
    filtered = request.failed or bool(request.limit)
    selection = request.selection if filtered else replace(request.selection, latest=request.latest)
    names = store.lists.read_names(selection)
    if not names:
        _check_each_name(store, selection)
    latest_failed: deque[ListedRun] = deque(maxlen=request.latest)
    for start in range(0, len(names), size):
        page_names = names[start : start + size]
        page = store.lists.read_named(page_names)
        runs_read = start + len(page_names)
        if not filtered:
            yield RunPage(page, runs_read, len(names))
            continue
        latest_failed.extend(run for run in page if _has_failed(run, request.limit))
        if request.latest is None or runs_read == len(names):
            yield RunPage(tuple(latest_failed), runs_read, len(names))
            latest_failed.clear()
        else:
            yield RunPage((), runs_read, len(names))


def _select_runs(store: Repository, request: ListRequest) -> list[ListedRun]:
    filtered = request.failed or bool(request.limit)
    selection = request.selection if filtered else replace(request.selection, latest=request.latest)
    runs = list(store.lists.read_runs(selection))
    if not runs:
        _check_each_name(store, selection)
    return runs


def _check_each_name(store: Repository, selection: RunSelection) -> None:
    """Refuse a name without stored runs."""
    if not all(store.lists.count_runs(of_name) for of_name in _split_selection(selection)):
        check_names(store, selection)


def _split_selection(selection: RunSelection) -> Iterator[RunSelection]:
    """Select the runs of each name of a selection by itself: reading all runs to know the names takes seconds."""
    yield from (RunSelection(serials=(name,)) for name in selection.serials)
    yield from (RunSelection(stations=(name,)) for name in selection.stations)
    yield from (RunSelection(operators=(name,)) for name in selection.operators)
    yield from (RunSelection(recipe=name) for name in (selection.recipe,) if name is not None)
    yield from (RunSelection(batch=name) for name in (selection.batch,) if name is not None)
    yield from (RunSelection(parts=(part,)) for part in selection.parts)


def _notes(request: ListRequest, runs: Sequence[ListedRun], kept: Sequence[object]) -> tuple[str, ...]:
    """Say which limits were failed, if the wanted one was not: it may be misspelt."""
    if kept or not request.limit:
        return ()
    failed = {key.name for run in runs for key in list_failed_limits(run)}
    hint = nearest(request.limit, failed, "failed were") if failed else "no limit was failed"
    return (f"limit {echo(request.limit, 64)} was failed by none of these {plural(len(runs), 'run')}; {hint}",)


def trust_counts(runs: Sequence[ListedRun]) -> Counter[str]:
    """Count runs that were altered, and others by the state of their chain."""
    return Counter("altered" if run.altered else run.chain.label for run in runs)


def trust_notes(store: Repository, counts: Counter[str]) -> tuple[str, ...]:
    """Say how many runs were altered, and of how many nobody can tell; ``counts`` from :func:`trust_counts`."""
    states = ("altered", "unchained", *(("chained",) if store.key_id else ()))
    return tuple(_TRUST[state].format(count=plural(counts[state], "run")) for state in states if counts[state])


def _has_failed(run: ListedRun, limit: str) -> bool:
    """Whether a run failed, or may have failed: lists of failed runs must not lack an altered one."""
    if run.altered:
        return True
    keys = list_failed_limits(run)
    return run.verdict is Outcome.FAIL and (not limit or any(limit in (k.name, k.label, k.title) for k in keys))


def _state(runs: Sequence[ListedRun]) -> SensorEntry:
    last_run, settled = runs[-1], select_settled_runs(runs)
    first_passes = [run.passed for run in settled if not run.earlier and not run.altered]
    decision = settled[-1].decision if settled else None
    verdicts: list[Outcome | Altered | None] = [ALTERED if run.altered else run.verdict for run in settled[-1:]]
    return fill_from_object(
        SensorEntry,
        last_run,
        runs=len(runs),
        tries=sum(run.finished for run in runs),
        first=runs[0].started_at,
        last=last_run.started_at,
        verdict=verdicts[0] if verdicts else None,
        reason=settled[-1].reason if settled else "",
        overridden_by=None if decision is None else decision.operator,
        overridden_why=None if decision is None else decision.why,
        failed_limits=tuple(key.label for run in settled[-1:] for key in list_failed_limits(run)),
        failure_codes=settled[-1].failure_codes if settled else (),
        first_pass=first_passes[0] if first_passes else None,
        chain=(settled[-1] if settled else last_run).chain.label,
    )
