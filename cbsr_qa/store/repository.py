"""The store's interface: open a database, journal runs into it, query it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import datetime, timedelta
from functools import update_wrapper
from types import TracebackType
from typing import Concatenate, Final, ParamSpec, Self, TypeVar

from sqlalchemy import Engine

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.changes import ChangeHistory, SensorHistory, VerdictOverride
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.store import changes as changed, fleet as fleets, locks, releases, soundness, stations
from cbsr_qa.store.chain.links import KEY_OPTION
from cbsr_qa.store.damage import address, name_database
from cbsr_qa.store.engine import look_afresh, parse_url, shrink, size_bytes
from cbsr_qa.store.listed import (
    list_runs,
    read_limited_measurements,
    read_measurements,
    run_count,
    run_names,
    runs_named,
)
from cbsr_qa.store.results import (
    analyses as analysed,
    calibrations as issued,
    calibrations_of_before as of_before,
    reanalyses,
)
from cbsr_qa.store.results.reanalyses import Reanalysis
from cbsr_qa.store.runs import archiving, attendance, live, outcomes, runs, sessions
from cbsr_qa.store.runs.journal import Journal
from cbsr_qa.store.runs.live import ChangeNotice
from cbsr_qa.store.runs.sessions import latest_id
from cbsr_qa.store.runs.standing import result_state
from cbsr_qa.store.sync.queue import backlog, name_unread
from cbsr_qa.store.types import IdSource, time_of_id

P = ParamSpec("P")
R = TypeVar("R")

#: Difference of the clocks of computers that share a database below which no warning is given.
_CLOCKS_DIFFER: Final = timedelta(minutes=1)


def _bind(function: Callable[Concatenate[Engine, P], R]) -> Callable[Concatenate["Repository", P], R]:
    """Return a function of an engine as a method of an open database."""

    def method(repository: "Repository", /, *args: P.args, **kwargs: P.kwargs) -> R:
        return function(repository._engine, *args, **kwargs)

    update_wrapper(method, function, updated=())
    return method


class Repository:
    """An open database. Made by :func:`open_store`; use it as a context manager, or close it."""

    def __init__(self, engine: Engine, wall: Callable[[], datetime]) -> None:
        self._engine = engine
        self._wall = wall
        self._ids = IdSource(wall)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._engine.dispose()

    @property
    def shown(self) -> str:
        """The database, for people; a password is hidden."""
        return name_database(self._engine.url)

    @property
    def address(self) -> str:
        """Value of ``--database``, quoted for a shell; a password is hidden."""
        return address(self._engine.url)

    @property
    def key_id(self) -> str | None:
        """Names the key that signs new links; None if none is set."""
        key = self._engine.get_execution_options().get(KEY_OPTION)
        return None if key is None else str(key.key_id)

    def is_at(self, url: str) -> bool:
        return parse_url(url) == self._engine.url

    def new_id(self) -> str:
        """Return a new time-ordered identifier for a run, an analysis or a calibration.

        It sorts after all that are stored, even if the clock was set back.
        """
        self._ids.follow(latest_id(self._engine))
        return self._ids.new()

    def from_the_future(self) -> str:
        """Return a warning if the latest stored identifier lies in the clock's future; else empty."""
        latest, now = time_of_id(latest_id(self._engine)), self._wall()
        if latest is None or latest - now < _CLOCKS_DIFFER:
            return ""
        return (
            f"{self.shown} holds something made at {latest:%Y-%m-%d %H:%M} UTC, and this computer's clock says"
            f" {now:%Y-%m-%d %H:%M}: one of the clocks was wrong, or was set back; the order of runs is kept"
        )

    journal = _bind(Journal)

    def writing_alone(self, run: str, operator: str = "") -> AbstractContextManager[None]:
        """Hold the right to write a run while entered; StoreError names another process that holds it."""
        return locks.writing_alone(self._engine, run, locks.this_process(operator))

    @contextmanager
    def seed_claimed(self, serial: str, seed: int, operator: str = "") -> Iterator[bool]:
        """Claim a seed for a run of a sensor while entered; yields False if another of its runs has it."""
        with locks.seed_claimed(self._engine, serial, seed, locks.this_process(operator)) as other:
            yield not other and seed not in self.seeds_of(serial)

    def sensor_claimed(self, serial: str, recipe: str, operator: str = "") -> AbstractContextManager[str]:
        """Claim a sensor for a run of a recipe while entered; yields who else tests it now, empty for nobody."""
        return locks.sensor_claimed(self._engine, serial, recipe, locks.this_process(operator))

    seeds_of = _bind(outcomes.seeds_of)
    find_altered_elsewhere = _bind(outcomes.find_altered_elsewhere)
    writer_of = _bind(locks.writer_of)

    load_run = _bind(runs.load_run)
    whole_run = _bind(runs.whole_run)
    identity = _bind(runs.identity)
    configuration = _bind(runs.configuration_of)
    find_runs = _bind(runs.find_runs)
    resolve = _bind(runs.resolve)
    check_resumable = _bind(runs.check_resumable)
    list_finished_loads = _bind(runs.list_finished_loads)
    list_ended_phases = _bind(runs.list_ended_phases)
    state_of = _bind(runs.state_of)
    result_state = _bind(result_state)
    goes_on_at_s = _bind(runs.goes_on_at_s)
    prompts_shown = _bind(attendance.prompts_shown)
    incomplete_runs = _bind(sessions.incomplete_runs)
    counts = _bind(sessions.counts)

    archivable = _bind(archiving.archivable)
    archive_folder = _bind(archiving.archive_folder)
    archive_run = _bind(archiving.archive_run)
    unarchive_run = _bind(archiving.unarchive_run)
    size_bytes = _bind(size_bytes)
    shrink = _bind(shrink)

    change_notice = _bind(ChangeNotice)
    links_of = _bind(live.links_of)
    run_tail = _bind(live.run_tail)
    frames_between = _bind(live.frames_between)
    latest_run_at = _bind(live.latest_run_at)
    look_at = _bind(live.look_at)

    analyses = _bind(analysed.analyses_of)
    data_sha256 = _bind(reanalyses.data_sha256)
    find_reanalysis = _bind(reanalyses.find_reanalysis)
    reanalysis = _bind(reanalyses.load_reanalysis)
    reanalyses_of = _bind(reanalyses.reanalyses_of)
    adoptions = _bind(reanalyses.adoptions)
    run_lines = _bind(fleets.run_lines)
    fleet = _bind(fleets.fleet_table)
    list_runs = _bind(list_runs)
    run_count = _bind(run_count)
    run_names = _bind(run_names)
    runs_named = _bind(runs_named)
    read_limited_measurements = _bind(read_limited_measurements)
    read_measurements = _bind(read_measurements)
    find_altered_records = _bind(changed.find_altered_records)
    changes = _bind(changed.all_changes)
    overrides = _bind(changed.overrides)
    calibrations = _bind(issued.calibrations_of)
    calibration_file = _bind(issued.calibration_file)
    calibration_of_before = _bind(of_before.load_calibration_of_before)

    save_chart_references = _bind(stations.save_references)
    chart_references = _bind(stations.current_references)
    all_chart_references = _bind(stations.all_references)
    save_station_check = _bind(stations.save_check)
    latest_station_check = _bind(stations.latest_check)
    latest_golden_check = _bind(stations.latest_golden_check)
    runs_since = _bind(stations.runs_since)
    station_check_ring = _bind(stations.ring_of)

    backlog = _bind(backlog)

    file_problems = _bind(soundness.file_problems)
    order_problems = _bind(soundness.order_problems)
    find_misplaced_rows = _bind(soundness.find_misplaced_rows)
    find_odd_rows = _bind(soundness.find_odd_rows)
    name_unread_entries = _bind(name_unread)
    check_stored_run = _bind(soundness.check_stored_run)
    seal_problems = _bind(soundness.seal_problems)
    ring_problems = _bind(soundness.ring_problems)

    save_release = _bind(releases.save_release)
    latest_release = _bind(releases.latest_release)
    all_releases = _bind(releases.all_releases)
    name_unread_releases = _bind(releases.name_unread_releases)

    def sensor_history(self, sensor: SensorIdentity, recipe: str, before: str = "") -> SensorHistory:
        """Return the runs of a sensor that began before a run (empty: all), as seen from a run of this recipe."""
        return SensorHistory(sensor, recipe, outcomes.earlier_runs(self._engine, sensor.serial, before))

    def save_result(self, result: RunResult, *, software: Sequence[tuple[str, str]] | None = None) -> str:
        """Store the results of a run, including its calibration, in one transaction, and read them back.

        Parameters
        ----------
        software : versions used for the analysis; by default those of the run.

        Returns
        -------
        Identifier of the new analysis; earlier ones stay.

        Raises
        ------
        StoreError
            If the run was altered, or the stored analysis cannot be read back.
        """
        look_afresh(self._engine)
        analysis = self.new_id()
        versions = result.record.identity.software if software is None else software
        analysed.save_result(
            self._engine, result, analysis=analysis, analysed_at=self._wall(), software=tuple(versions)
        )
        look_afresh(self._engine)
        self.analyses(result.record.identity.run)
        return analysis

    def save_reanalysis(self, made: Reanalysis) -> str:
        """Store a re-analysis beside the valid analysis of its run, and return its identifier."""
        reanalysis = self.new_id()
        reanalyses.save_reanalysis(self._engine, made, reanalysis=reanalysis, analysed_at=self._wall())
        return reanalysis

    def adopt(self, reanalysis: str, *, operator: str, why: str) -> str:
        """Make a re-analysis the valid analysis of its run, and return that; see :mod:`.results.reanalyses`."""
        analysis, now = self.new_id(), self._wall()
        reanalyses.adopt(self._engine, reanalysis, analysis=analysis, operator=operator, why=why, adopted_at=now)
        return analysis

    def change_history(self, record: RunRecord) -> ChangeHistory:
        """Return the changes of a run's files since its sensor type last passed its recipe."""
        return changed.history_of(self._engine, record.identity, record.material.name)

    def override_verdict(self, run: str, outcome: Outcome, *, operator: str, why: str) -> VerdictOverride:
        """Store a decision beside the verdict of a run, which is kept. StoreError where the run has no verdict."""
        return changed.save_override(
            self._engine,
            run,
            outcome,
            override=self.new_id(),
            operator=operator,
            why=why,
            noted_at=self._wall(),
        )
