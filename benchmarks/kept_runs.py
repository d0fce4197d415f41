"""Simulated runs kept in memory, and what metrics say of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from cbsr_qa.analysis.evaluate import ask
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.studies.simulated import configuration_of, copy_shipped, simulate_run

Settings = Mapping[str, Any]

#: Whose settings of imaging and analysis all runs have.
RECIPE = "nine-locations"


@dataclass(frozen=True)
class Figures:
    """What the metrics of one run say."""

    measurements: tuple[Measurement, ...]

    def every(self, name: str, qualifier: str = "") -> list[Measurement]:
        return [one for one in self.measurements if (one.name, one.qualifier) == (name, qualifier)]

    def one(self, name: str, qualifier: str = "") -> Measurement:
        """The measurement of the whole run, or of what was pressed most."""
        return next(one for one in self.every(name, qualifier) if not one.location)


def shipped_phases(*names: str, recipe: str = RECIPE) -> list[Settings]:
    """Phases of a shipped recipe, those of these names or all."""
    return [
        phase for phase in copy_shipped(DocumentKind.RECIPE, recipe)["phases"] if not names or phase["name"] in names
    ]


def simulated(
    phases: Sequence[Settings],
    seed: int,
    *,
    scene: str = "base",
    effects: Sequence[Settings] = (),
    noise: float | None = None,
) -> RunRecord:
    """Run phases on the shipped simulated station.

    Parameters
    ----------
    scene, effects : a shipped scene, and effects beside its own.
    noise : relative noise of a reading in place of the 8 wt% material's.
    """
    station, world = copy_shipped(DocumentKind.STATION, "simulated"), copy_shipped(DocumentKind.SCENE, scene)
    recipe, material = copy_shipped(DocumentKind.RECIPE, RECIPE), copy_shipped(DocumentKind.MATERIAL, "cbsr-8wt")
    world["effects"] = [*world["effects"], *effects]
    station["instruments"]["bench"]["scene"] = world
    recipe |= {"phases": list(phases), "limits": [], "failure_codes": {}}
    recipe["recipe"]["calibrate_phases"] = [phases[0]["name"]]
    if noise is not None:
        material["material"]["relative_noise"]["value"] = noise
    record, _ = simulate_run(configuration_of(station, recipe, material, seed=seed), f"seed-{seed}", discover())
    if record.end is not EndReason.FINISHED:
        raise SystemExit(f"the run was {record.end}: {record.end_detail}")
    return record


def measured(
    record: RunRecord, *metrics: str, settings: AnalysisSettings | None = None, over_time: bool = True
) -> Figures:
    """Image a run and ask metrics of it.

    Parameters
    ----------
    settings : of the analysis; by default those of the recipe.
    over_time : whether relaxations are fitted, which takes most of the time.
    """
    recipe, plugins = load_recipe(RECIPE).value, discover()
    reconstruction = create_plugin(plugins, Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]")
    calibrated = replace(settings or recipe.analysis, calibrate_phases=(record.phases[0].name,))
    run = observe_run(record, reconstruction, calibrated, over_time=over_time)
    asked = [create_plugin(plugins, Kind.METRIC, PluginChoice(name, {}), "[metrics]") for name in metrics]
    return Figures(tuple(measurement for metric in asked for measurement in ask(metric, run)))
