"""The analysis of one stored run in a worker, which reads the database and writes nothing."""

import json
import os
import sys
from dataclasses import dataclass
from functools import cache

from cbsr_qa.analysis.evaluate import evaluate_run
from cbsr_qa.app.run.decisions import compare_decisions
from cbsr_qa.config.loader import load_standards
from cbsr_qa.config.merging import restore, restore_recipe
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.results.reanalyses import Reanalysis
from cbsr_qa.system.clock import Stages


@dataclass(frozen=True, slots=True)
class Job:
    """One run to analyse again.

    Parameters
    ----------
    database : URL, by which every worker reaches it.
    recipe : canonical JSON of the recipe's file.
    software : versions that the result must be of.
    data_sha256 : digest of what was measured in the run.
    key_sha256 : key of the result, see :class:`~cbsr_qa.store.results.reanalyses.Reanalysis`.
    """

    run: str
    database: str
    recipe: str
    software: tuple[tuple[str, str], ...]
    data_sha256: str
    key_sha256: str


@dataclass(frozen=True, slots=True)
class Worked:
    """Result of a job.

    Parameters
    ----------
    result : None if the run could not be analysed; ``why`` then gives the reason.
    differing : versions of this worker that are not those of the job, in words; nothing was computed then.
    worker : computer and process.
    peak_mb : largest resident memory of the worker so far [MB]; None where the system does not tell.
    """

    result: Reanalysis | None
    why: str = ""
    differing: str = ""
    worker: str = ""
    peak_mb: float | None = None


def analyse_again(job: Job) -> Worked:
    """Analyse a stored run by another recipe or other software; errors become the reason in the result."""
    plugins = _plugins()
    worker = f"{os.uname().nodename}, process {os.getpid()}"
    if differing := _differing(job.software, software_versions(plugins)):
        return Worked(None, differing=differing, worker=worker)
    stages = Stages()
    try:
        with open_store(job.database, create=False) as store:
            record = store.runs.load(job.run)
            configuration = store.runs.read_configuration(job.run)
        content = json.loads(configuration)
        # The batch's model is the run's own, whatever recipe is tried.
        recipe = restore_recipe(content | {"recipe": json.loads(job.recipe)})
        station = content.get("station", {})
        standards = load_standards(station).value if station.get("standards") else ()
        conclusion = evaluate_run(record, recipe, plugins, stages, standards=standards)
        with stages.stage("deciding again"):
            decided = tuple(compare_decisions(record, restore(configuration), plugins)) if record.decisions else ()
    except CbsrError as error:
        return Worked(None, error.reason, worker=worker, peak_mb=_peak_mb())
    observation = conclusion.observation
    if observation is None and conclusion.characterisation is None:
        return Worked(None, conclusion.verdict.reason, worker=worker, peak_mb=_peak_mb())
    result = Reanalysis(
        run=job.run,
        key_sha256=job.key_sha256,
        recipe=job.recipe,
        software=job.software,
        verdict=conclusion.verdict,
        measurements=conclusion.measurements,
        warnings=(*conclusion.warnings, *decided),
        noise_weighting="" if observation is None else observation.settings.noise_weighting,
        weight_ratio=None if observation is None else observation.weight_ratio,
        compute_s=stages.table(),
    )
    return Worked(result, worker=worker, peak_mb=_peak_mb())


@cache
def _plugins() -> Plugins:
    return discover()


def _differing(wanted: tuple[tuple[str, str], ...], here: tuple[tuple[str, str], ...]) -> str:
    wanted_versions, installed_versions = dict(wanted), dict(here)
    return ", ".join(
        f"{name} {installed_versions.get(name, 'not installed')} in place of {wanted_versions.get(name, 'none')}"
        for name in dict.fromkeys((*wanted_versions, *installed_versions))
        if wanted_versions.get(name) != installed_versions.get(name)
    )


def _peak_mb() -> float | None:
    if sys.platform == "win32":
        return None
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 / 1024)
