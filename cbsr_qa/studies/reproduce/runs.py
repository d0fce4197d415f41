"""Simulated runs of the reproduction: shipped recipes on the simulated bench, reduced to values."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from cbsr_qa.analysis.evaluate import evaluate_run
from cbsr_qa.analysis.run.force import run_force
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import NotReproducedError
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.studies.reproduce.values import SheetValues, StripValues, sheet_values, strip_values
from cbsr_qa.studies.simulated import configuration_of as merged, copy_shipped, simulate_run
from cbsr_qa.system.clock import Stages

#: Seed of every simulated sensor; the first one, not chosen for its result.
SEED: Final = 1

#: Sheet → station, recipe, scene replacing the station's own.
_SETTINGS: Final = {
    "uniform": ("simulated", "paper", "base"),
    "bench": ("simulated", "paper", "everything"),
    "strip": ("simulated-strip", "characterisation", "strip"),
}

_Options = Mapping[str, Mapping[str, Mapping[str, Any]]]

#: Sheet → phase → replaced options of its recipe. The bench sheet is only shown beside the uniform one.
_SHORTER: Final[_Options] = {
    "bench": {
        "noise figure": {"frames": 64, "trials": 1},
        "nine locations": {"strains_percent": [10.0, 20.0, 30.0], "trials": 2},
        "random loads": {"trials": 1},
    },
}

#: The same for the quick version.
_QUICK: Final[_Options] = {
    "uniform": {
        "noise figure": {"frames": 64},
        "nine locations": {"strains_percent": [10.0, 20.0, 30.0], "trials": 2},
        "random loads": {"trials": 1},
    },
    "strip": {"press cycles": {"strains_percent": [10.0, 20.0, 30.0], "cycles": 4}},
}

#: Simulated sensors, in words.
FULL_WORDS: Final = (
    "the uniform sheet (scene base) as in the paper: nine locations at six strains three times, its ten random loads "
    "three times; the bench sheet (scene everything) at three strains twice and the random loads once; the strip "
    "at six strains ten times"
)
QUICK_WORDS: Final = (
    "quick: the uniform sheet (scene base) at three strains twice instead of six three times, the random loads once "
    "instead of three times, four cycles at three strains on the strip instead of ten at six, and no bench sheet"
)


@dataclass(frozen=True, slots=True)
class Job:
    """One simulated sensor: ``"uniform"``, ``"bench"`` or ``"strip"``, of 8 or 9 % carbon black by weight."""

    sheet: str
    percent: int
    quick: bool
    seed: int = SEED

    @property
    def words(self) -> str:
        """Name for a reader."""
        return f"{self.percent} wt% {'strip' if self.sheet == 'strip' else f'{self.sheet} sheet'}"


def all_jobs(*, quick: bool) -> tuple[Job, ...]:
    """Every sensor of the reproduction, the longest first."""
    sheets = ("uniform", "strip") if quick else ("bench", "uniform", "strip")
    return tuple(Job(sheet, percent, quick) for sheet in sheets for percent in (8, 9))


def simulate(job: Job) -> SheetValues | StripValues:
    """Simulate one sensor as ``cbsr-qa run`` does, without a database, and reduce it to values.

    NotReproducedError if the run stopped or could not be analysed; names the run and the reason.
    """
    started, plugins = time.perf_counter(), discover()
    configuration = configuration_of(job)
    record, _ = simulate_run(configuration, "REPRODUCED", plugins)
    conclusion = evaluate_run(record, configuration.recipe, plugins, Stages())
    if conclusion.characterisation is not None:
        return strip_values(conclusion.characterisation, record.station_s, time.perf_counter() - started)
    if conclusion.observation is None:
        raise reproduction_error(job, conclusion.verdict.reason)
    force = run_force(conclusion.observation)
    return sheet_values(
        conclusion.observation,
        conclusion.measurements,
        force,
        job.sheet,
        record.station_s,
        time.perf_counter() - started,
    )


def reproduction_error(job: Job, why: str) -> NotReproducedError:
    """Return the error that ends a reproduction, for the sensor without results."""
    station, recipe, scene = _SETTINGS[job.sheet]
    return NotReproducedError(
        f"the simulated {job.words} (station {station}, recipe {recipe}, scene {scene}, seed {job.seed}) gave no "
        f"figures: {why}",
        remedy="nothing was written; --quick presses fewer loads and leaves the bench sheet out",
    )


def configuration_of(job: Job) -> Configuration:
    """Return shipped station, recipe, sensor type and material of a sensor, with its scene."""
    station_name, recipe_name, scene = _SETTINGS[job.sheet]
    station, recipe = copy_shipped(DocumentKind.STATION, station_name), copy_shipped(DocumentKind.RECIPE, recipe_name)
    station["instruments"]["bench"]["scene"] = scene
    replaced = (_QUICK if job.quick else _SHORTER).get(job.sheet, {})
    for phase in recipe["phases"]:
        phase.update(replaced.get(phase["name"], {}))
    return merged(station, recipe, f"cbsr-{job.percent}wt", seed=job.seed)
