"""Stored measurements judged by other limits: where only those changed, nothing is imaged again."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from cbsr_qa.analysis.evaluate import judge_again
from cbsr_qa.app.reanalyse.work import Job
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.config.merging import canonical_json
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.measurement import decide
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.results.reanalyses import Reanalysis, key_of

#: Tables of a recipe that do not affect how a run is imaged and measured.
_AFTERWARDS: Final = ("limits", "limits_version", "failure_codes", "report")


def judge_stored(store: Repository, job: Job) -> Reanalysis | None:
    """Return the result of a job from stored measurements; None if none were made as its recipe says.

    Also return None if the job's recipe is the run's own: the user then wants to know whether the analysis can be
    repeated.
    """
    own_recipe, wanted_measuring = (
        canonical_json(json.loads(store.runs.read_configuration(job.run))["recipe"]),
        _measuring(job.recipe),
    )
    for stored in _list_candidates(store, job, own_recipe) if own_recipe != job.recipe else ():
        if stored.measurements and stored.software == job.software and _measuring(stored.recipe) == wanted_measuring:
            measurements = judge_again(stored.measurements, load_recipe(json.loads(job.recipe)).value.limits)
            return replace(
                stored,
                key_sha256=job.key_sha256,
                recipe=job.recipe,
                verdict=decide(measurements),
                measurements=measurements,
                compute_s=(),
            )
    return None


def _list_candidates(store: Repository, job: Job, own: str) -> Iterator[Reanalysis]:
    """Yield the re-analyses of a run that are of the same data, then its analyses by its own recipe."""
    for name in store.reanalyses.list_names(job.run):
        candidate = store.reanalyses.load(name)
        if candidate.key_sha256 == key_of(job.data_sha256, candidate.recipe, job.software):
            yield candidate
    for analysis in store.analyses.load(job.run):
        if analysis.adoption is None:
            yield fill_from_object(Reanalysis, analysis, key_sha256="", recipe=own)


def _measuring(recipe: str) -> dict[str, object]:
    return {name: table for name, table in json.loads(recipe).items() if name not in _AFTERWARDS}
