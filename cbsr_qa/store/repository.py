"""The store's interface: open a database, journal runs into it, query it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import datetime, timedelta
from functools import update_wrapper
from types import TracebackType
from typing import Concatenate, Final, ParamSpec, Self, TypeVar

from sqlalchemy import Engine

from cbsr_qa.domain.results import Outcome, RunResult
from cbsr_qa.domain.run import ChangeHistory, RunRecord, SensorHistory, VerdictOverride
from cbsr_qa.domain.sensor import SensorIdentity
from cbsr_qa.store import changes as changed, fleet as fleets, locks, releases, soundness, stations
from cbsr_qa.store.chain import KEY_OPTION
from cbsr_qa.store.damage import address, shown
from cbsr_qa.store.engine import look_afresh, parsed_url, shrink, size_bytes
from cbsr_qa.store.listed import judged_measurements, listed_runs, measured_runs, run_count, run_names, runs_named
from cbsr_qa.store.results import (
    Reanalysis,
    analyses as analysed,
    calibrations as issued,
    calibrations_of_before as of_before,
    reanalyses,
)
from cbsr_qa.store.runs import ChangeNotice, Journal, archiving, attendance, latest_id, live, outcomes, runs, sessions
from cbsr_qa.store.standing import result_state
from cbsr_qa.store.sync import backlog
from cbsr_qa.store.types import IdSource, made_at

P = ParamSpec("P")
R = TypeVar("R")

#: Difference of the clocks of computers that share a database below which no warning is given.
_CLOCKS_DIFFER: Final = timedelta(minutes=1)


def _of_engine(function: Callable[Concatenate[Engine, P], R]) -> Callable[Concatenate["Repository", P], R]:
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
        return shown(self._engine.url)

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
        return parsed_url(url) == self._engine.url

    def new_id(self) -> str:
        """Return a new time-ordered identifier for a run, an analysis or a calibration.

        It sorts after all that are stored, even if the clock was set back.
        """
        self._ids.follow(latest_id(self._engine))
        return self._ids.new()

    def from_the_future(self) -> str:
        """Return a warning if the latest stored identifier lies in the clock's future; else empty."""
        latest, now = made_at(latest_id(self._engine)), self._wall()
        if latest is None or latest - now < _CLOCKS_DIFFER:
            return ""
        return (
            f"{self.shown} holds something made at {latest:%Y-%m-%d %H:%M} UTC, and this computer's clock says"
            f" {now:%Y-%m-%d %H:%M}: one of the clocks was wrong, or was set back; the order of runs is kept"
        )

    journal = _of_engine(Journal)

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

    seeds_of = _of_engine(outcomes.seeds_of)
    altered_elsewhere = _of_engine(outcomes.altered_elsewhere)
    writer_of = _of_engine(locks.writer_of)

    load_run = _of_engine(runs.load_run)
    whole_run = _of_engine(runs.whole_run)
    identity = _of_engine(runs.identity)
    configuration = _of_engine(runs.configuration_of)
    find_runs = _of_engine(runs.find_runs)
    resolve = _of_engine(runs.resolve)
    check_resumable = _of_engine(runs.check_resumable)
    finished_loads = _of_engine(runs.finished_loads)
    ended_phases = _of_engine(runs.ended_phases)
    state_of = _of_engine(runs.state_of)
    result_state = _of_engine(result_state)
    goes_on_at_s = _of_engine(runs.goes_on_at_s)
    prompts_shown = _of_engine(attendance.prompts_shown)
    incomplete_runs = _of_engine(sessions.incomplete_runs)
    counts = _of_engine(sessions.counts)

    archivable = _of_engine(archiving.archivable)
    archive_folder = _of_engine(archiving.archive_folder)
    archive_run = _of_engine(archiving.archive_run)
    unarchive_run = _of_engine(archiving.unarchive_run)
    size_bytes = _of_engine(size_bytes)
    shrink = _of_engine(shrink)

    change_notice = _of_engine(ChangeNotice)
    links_of = _of_engine(live.links_of)
    run_tail = _of_engine(live.run_tail)
    frames_between = _of_engine(live.frames_between)
    latest_run_at = _of_engine(live.latest_run_at)
    look_at = _of_engine(live.look_at)

    analyses = _of_engine(analysed.analyses_of)
    data_sha256 = _of_engine(reanalyses.data_sha256)
    find_reanalysis = _of_engine(reanalyses.find_reanalysis)
    reanalysis = _of_engine(reanalyses.load_reanalysis)
    reanalyses_of = _of_engine(reanalyses.reanalyses_of)
    adoptions = _of_engine(reanalyses.adoptions)
    run_lines = _of_engine(fleets.run_lines)
    fleet = _of_engine(fleets.fleet_table)
    listed_runs = _of_engine(listed_runs)
    run_count = _of_engine(run_count)
    run_names = _of_engine(run_names)
    runs_named = _of_engine(runs_named)
    judged_measurements = _of_engine(judged_measurements)
    measured_runs = _of_engine(measured_runs)
    altered_records = _of_engine(changed.altered_records)
    changes = _of_engine(changed.all_changes)
    overrides = _of_engine(changed.overrides)
    calibrations = _of_engine(issued.calibrations_of)
    calibration_file = _of_engine(issued.calibration_file)
    calibration_of_before = _of_engine(of_before.load_calibration_of_before)

    save_chart_references = _of_engine(stations.save_references)
    chart_references = _of_engine(stations.current_references)
    all_chart_references = _of_engine(stations.all_references)
    save_station_check = _of_engine(stations.save_check)
    latest_station_check = _of_engine(stations.latest_check)
    latest_golden_check = _of_engine(stations.latest_golden_check)
    runs_since = _of_engine(stations.runs_since)
    station_check_ring = _of_engine(stations.ring_of)

    backlog = _of_engine(backlog)

    file_problems = _of_engine(soundness.file_problems)
    order_problems = _of_engine(soundness.order_problems)
    misplaced_rows = _of_engine(soundness.misplaced_rows)
    check_stored_run = _of_engine(soundness.check_stored_run)
    seal_problems = _of_engine(soundness.seal_problems)
    ring_problems = _of_engine(soundness.ring_problems)

    save_release = _of_engine(releases.save_release)
    latest_release = _of_engine(releases.latest_release)
    all_releases = _of_engine(releases.all_releases)

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
