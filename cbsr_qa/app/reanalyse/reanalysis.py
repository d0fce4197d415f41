"""Stored runs analysed again, compared with their valid analyses, and adopted if somebody decides so."""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

from cbsr_qa.app.reanalyse.changes import Changes, Flip, NamedRun
from cbsr_qa.app.reanalyse.judging import judge_stored
from cbsr_qa.app.reanalyse.report import Reanalysed
from cbsr_qa.app.reanalyse.request import ReanalyseRequest
from cbsr_qa.app.reanalyse.work import Job, Worked, analyse_again
from cbsr_qa.app.reanalyse.workers import Workers, cluster_workers, local_workers
from cbsr_qa.app.run.preflight import check_recipe
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.config.merging import canonical_json, restore
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import CbsrError, RefusedError, StoreError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import SEVERITY, Outcome
from cbsr_qa.domain.plan.plan import PhaseSpec
from cbsr_qa.domain.results.fleet import RunLine
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.report.tables import duration, plural
from cbsr_qa.store.engine import parse_url, sqlite_file
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.results.analyses import StoredAnalysis
from cbsr_qa.store.results.reanalyses import Reanalysis, key_of
from cbsr_qa.studies.selection import check_names
from cbsr_qa.system.clock import RealClock

#: Least time between two lines of progress [s].
_SPOKEN_S: Final = 5.0
#: Time below which a step shows no progress [s].
_PATIENCE_S: Final = 1.0

Tell = Callable[[str], None]
#: Enters workers that do the work of jobs.
Begin = Callable[[], AbstractContextManager[Workers[Job, Worked]]]


@dataclass(slots=True)
class _Progress:
    """Runs done by stage: a line now and then, with rate and time left."""

    what: str
    of: int
    tell: Tell
    clock: RealClock = field(default_factory=RealClock)
    done: int = 0
    spoken_s: float = 0.0

    def step(self) -> None:
        self.done += 1
        now_s = self.clock.now()
        if now_s - self.spoken_s < (_SPOKEN_S if self.done < self.of else _PATIENCE_S):
            return
        self.spoken_s = now_s
        rate = self.done / max(now_s, 1e-3)
        time_left = f", {duration((self.of - self.done) / rate)} left" if self.done < self.of else ""
        self.tell(f"{self.what}: {self.done} of {self.of} runs, {rate:.3g} runs/s{time_left}")


class _Session:
    """One re-analysis over an open database."""

    def __init__(self, request: ReanalyseRequest, store: Repository, plugins: Plugins, tell: Tell) -> None:
        self._request, self._store, self._tell = request, store, tell
        self._plugins = plugins
        self._software = software_versions(plugins)
        loaded_recipe = None if request.recipe is None else load_recipe(request.recipe, plugins)
        self.recipe = None if loaded_recipe is None else loaded_recipe.value
        self._canonical = None if loaded_recipe is None else canonical_json(loaded_recipe.document.data)
        self._clock = RealClock()
        self.lines: dict[str, RunLine] = {}
        self.other_plan: list[NamedRun] = []
        self.not_analysed: list[NamedRun] = []
        self.stored: dict[str, str] = {}  #: run → re-analysis
        self.reused = self.judged = 0
        self.peak_mb: float | None = None
        self.elapsed_s = 0.0

    def select(self) -> list[Job]:
        """Return the remaining jobs and name runs that cannot be analysed. Raise RefusedError if none is selected."""
        lines = self._store.fleet.read_lines(self._request.selection)
        if not lines:
            check_names(self._store, self._request.selection)
            raise RefusedError(
                "no stored run is selected; nothing was computed, and the database is unchanged",
                remedy="cbsr-qa runs with the same options lists runs; golden runs of checks need --checks",
            )
        self.lines = {line.run: line for line in lines}
        jobs, progress = [], _Progress("looking up", len(lines), self._tell)
        for line in lines:
            try:
                job = self._job(line)
            except CbsrError as error:
                self._leave_out(line, error.reason)
            else:
                jobs += [] if job is None else [job]
            progress.step()
        return jobs

    def _job(self, line: RunLine) -> Job | None:
        """Return the job of a run; None if it is stored already, or the run cannot be analysed."""
        if line.altered:
            self._leave_out(line, line.altered)
            return None
        if not line.finished:
            self._leave_out(line, f"it has not finished ({line.end})")
            return None
        content = json.loads(self._store.runs.read_configuration(line.run))
        recipe = canonical_json(content["recipe"])
        if self._canonical is not None and self.recipe is not None:
            if differing := phase_difference(_phases(recipe), self.recipe.phases):
                self.other_plan.append(NamedRun.from_line(line, differing))
                return None
            recipe = self._canonical
        data = self._store.reanalyses.digest_data(line.run)
        key = key_of(data, recipe, self._software)
        stored_name = None if self._request.fresh else self._store.reanalyses.find(line.run, key)
        if stored_name is not None:
            self.stored[line.run] = stored_name
            self.reused += 1
            return None
        return Job(line.run, absolute_url(self._request.database), recipe, self._software, data, key)

    def check(self, jobs: Iterable[Job]) -> None:
        """Check the recipe's plugins and options on the first run's sensor type, before anything is computed."""
        first_job = next(iter(jobs), None)
        if first_job is not None and self.recipe is not None:
            check_recipe(
                self.recipe, restore(self._store.runs.read_configuration(first_job.run)).sensor_type, self._plugins
            )

    def judge(self, jobs: list[Job]) -> list[Job]:
        """Do the jobs for which stored measurements need only to be judged; return those that are left."""
        jobs_left, progress = [], _Progress("judging", len(jobs), self._tell)
        for job in jobs:
            judged = None if self._request.fresh else judge_stored(self._store, job)
            if judged is None:
                jobs_left.append(job)
            else:
                self.stored[job.run] = self._store.reanalyses.save(judged)
                self.judged += 1
            progress.step()
        return jobs_left

    def compute(self, jobs: list[Job], workers: Workers[Job, Worked]) -> None:
        """Analyse runs, and store each result as soon as it is there."""
        progress, begun_s = _Progress("analysing", len(jobs), self._tell), self._clock.now()
        for job, job_result in workers.run_jobs(jobs):
            line = self.lines[job.run]
            if isinstance(job_result, str):
                self._leave_out(line, job_result)
            else:
                self._keep(line, job_result)
            progress.step()
        self.elapsed_s = self._clock.now() - begun_s

    def _keep(self, line: RunLine, worked: Worked) -> None:
        if worked.differing:
            raise RefusedError(
                f"worker {worked.worker} has other software than this computer: {worked.differing}",
                remedy="install the same versions on all workers; what was analysed so far is stored",
            )
        if worked.peak_mb is not None:
            self.peak_mb = max(worked.peak_mb, self.peak_mb or 0.0)
        if worked.result is None:
            self._leave_out(line, worked.why)
            return
        self.stored[line.run] = self._store.reanalyses.save(worked.result)

    def _leave_out(self, line: RunLine, why: str) -> None:
        self.not_analysed.append(NamedRun.from_line(line, why.removeprefix(f"run {line.run}: ")))

    def conclude(self, computed: int, where: str) -> Reanalysed:
        """Compare the stored results with the valid analyses, and adopt them if that was requested."""
        changes, flips, warnings = Changes(), list[Flip](), Counter[str]()
        decision_by_run = {
            line.run: line.overridden_to for line in self._store.fleet.read_lines(self._request.selection)
        }
        overridden_runs: list[NamedRun] = []
        unchanged = adopted = 0
        progress = _Progress("comparing", len(self.stored), self._tell)
        for line in [line for line in self.lines.values() if line.run in self.stored]:
            try:
                analyses = self._store.analyses.load(line.run)
                valid_analysis = next(iter(analyses), None)
                reanalysis = self._store.reanalyses.load(self.stored[line.run])
            except StoreError as error:
                self._leave_out(line, error.reason)
                continue
            valid_measurements = () if valid_analysis is None else valid_analysis.measurements
            changes.add(line, valid_measurements, reanalysis.measurements)
            warnings.update(
                set(reanalysis.warnings).difference(() if valid_analysis is None else valid_analysis.warnings)
            )
            overridden = None if valid_analysis is None else decision_by_run.get(line.run)
            if valid_analysis is None or valid_analysis.verdict.outcome is not reanalysis.verdict.outcome:
                flips.append(_flip(line, analyses, reanalysis, overridden))
            unchanged += valid_analysis is not None and (valid_analysis.measurements, valid_analysis.verdict) == (
                reanalysis.measurements,
                reanalysis.verdict,
            )
            if self._request.adopt and overridden is not None:
                overridden_runs.append(NamedRun.from_line(line, f"overridden to {overridden}"))
            elif self._request.adopt:
                adoption, stored = None if valid_analysis is None else valid_analysis.adoption, self.stored[line.run]
                if adoption is None or adoption.reanalysis != stored:
                    self._store.reanalyses.adopt(stored, operator=self._request.by, why=self._request.why)
                    adopted += 1
            progress.step()
        sha256 = None if self._canonical is None else hashlib.sha256(self._canonical.encode()).hexdigest()
        return Reanalysed(
            recipe=None if self.recipe is None else self.recipe.name,
            recipe_sha256=sha256,
            software=self._software,
            selected=len(self.lines),
            computed=computed,
            judged=self.judged,
            reused=self.reused,
            adopted=adopted,
            unchanged=unchanged,
            values=tuple(changes.values()),
            flips=tuple(sorted(flips, key=lambda flip: (SEVERITY.index(flip.now), flip.run))),
            not_analysed=tuple(self.not_analysed),
            other_plan=tuple(self.other_plan),
            left_overridden=tuple(overridden_runs),
            new_warnings=dict(warnings.most_common()),
            workers=where,
            elapsed_s=self.elapsed_s,
            runs_per_s=computed / self.elapsed_s if computed and self.elapsed_s else None,
            peak_worker_mb=self.peak_mb,
        )


def reanalyse(request: ReanalyseRequest, *, tell: Tell = lambda line: None, begin: Begin | None = None) -> Reanalysed:
    """Analyse stored runs again and compare the results with their valid analyses.

    Every result is stored as soon as it is there, on trial: verdicts stay as they are, unless ``adopt`` is set. What
    was stored before for the same data, recipe and software is not computed again.

    Parameters
    ----------
    tell : called with progress.
    begin : enters other workers than those of the request, for tests.

    Raises
    ------
    RefusedError
        Before anything is computed: no run is selected, the recipe or a plugin in it cannot be used, or there are no
        workers.
    BrokenError
        If the workers were lost. What was stored stays, and the same request continues.
    """
    request.check()
    with open_store(database_url(request.database), create=False) as store:
        session = _Session(request, store, discover(), tell)
        jobs = session.select()
        session.check(jobs)
        jobs = session.judge(jobs)
        count = min(request.workers or os.cpu_count() or 1, max(len(jobs), 1))
        workers_text = (
            f"Dask cluster at {request.scheduler}" if request.scheduler else f"{count} processes of this computer"
        )
        if jobs:
            tell(f"{plural(len(jobs), 'run')} to analyse, {len(session.stored)} stored already")
            with (begin or _beginning(request, count))() as workers:
                session.compute(jobs, workers)
        computed = len(session.stored) - session.reused - session.judged
        return session.conclude(computed, workers_text if jobs else "")


def _beginning(request: ReanalyseRequest, count: int) -> Begin:
    scheduler = request.scheduler
    if scheduler is None:
        return lambda: nullcontext(local_workers(count, analyse_again))
    return lambda: cluster_workers(scheduler, analyse_again)


def absolute_url(option: str | None) -> str:
    """Return the URL of a database for workers that may have been started elsewhere: with the file's full path."""
    url = parse_url(database_url(option))
    file = sqlite_file(url)
    full = url if file is None else url.set(database=str(Path(file).resolve()))
    return full.render_as_string(hide_password=False)


@cache
def _phases(recipe: str) -> tuple[PhaseSpec, ...]:
    return load_recipe(json.loads(recipe)).value.phases


def phase_difference(run: Iterable[PhaseSpec], recipe: Iterable[PhaseSpec]) -> str:
    """Return how the first phase that differs differs, in words; empty if a run was measured as the recipe says."""
    run_phases, recipe_phases = list(run), list(recipe)
    names = [[phase.name for phase in phases] for phases in (run_phases, recipe_phases)]
    if names[0] != names[1]:
        return f"its phases are {', '.join(names[0])}; the recipe's are {', '.join(names[1])}"
    for old_phase, new_phase in zip(run_phases, recipe_phases, strict=True):
        if old_phase.sequence != new_phase.sequence:
            return f"phase {old_phase.name!r} ran {old_phase.sequence}; the recipe has {new_phase.sequence}"
        for key in dict.fromkeys((*old_phase.options, *new_phase.options)):
            old, new = old_phase.options.get(key), new_phase.options.get(key)
            if old != new:
                return f"phase {old_phase.name!r} ran with {_option(key, old)}; the recipe has {_option(key, new)}"
    return ""


def _option(key: str, value: Any) -> str:
    return f"no {key}" if value is None else f"{key} = {value}"


def _flip(line: RunLine, analyses: Sequence[StoredAnalysis], new: Reanalysis, overridden: Outcome | None) -> Flip:
    return fill_from_object(
        Flip,
        line,
        was=analyses[0].verdict.outcome if analyses else None,
        now=new.verdict.outcome,
        reason=new.verdict.reason,
        overridden_to=overridden,
        calibration=next((analysis.calibration for analysis in analyses if analysis.calibration is not None), None),
    )
