"""Simulated sensors for the frontier's settings, and a setting's station time."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.steps import AcquireFrames, Hold, Press, Role, Step
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import AdaptiveSequence, Reconstruction, Sequence as LoadSequence, SequenceContext
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.plan import Plan
from cbsr_qa.station.setup import plan_of
from cbsr_qa.studies.frontier.setting import BASE, GRID, HELD_OUT, Setting
from cbsr_qa.studies.simulated import configuration_of, copy_shipped, simulate_run

#: Imperfections of a simulated sensor, besides those of scene ``base``: its response varies by 20 % over 20 mm, and a
#: residue of 3 % decays in five minutes.
SHEET: Final = (
    {"name": "uneven-response", "deviation": 0.2, "correlation_mm": 20.0},
    {"name": "residue", "share": 0.03, "decay_s": 300.0},
)
MATERIAL: Final = "cbsr-8wt"
_FRAMES_BEFORE: Final = 4


@lru_cache(maxsize=256)
def station_seconds(setting: Setting) -> float:
    """Longest time a setting occupies the simulated station, by a dry run with rests, travel and surfaces [s]."""
    configuration = _configuration(setting.recipe(), 1, setting.frame_period_s)
    return dry_run(plan_of(configuration, discover()), setting.frame_period_s).duration_s


def simulate_sensor(
    recipe: Mapping[str, Any], seed: int, frame_period_s: float = 2.5, whole_holds: bool = True
) -> tuple[RunRecord, SheetDesign]:
    """Run a recipe on one sensor at the simulated station; return the run and the sheet's design, which is the truth.

    Only the last frames of rests and of held-out loads are taken; all times are unchanged.

    Parameters
    ----------
    frame_period_s : duration of a frame; the noise of a reading falls with its square root (white noise).
    whole_holds : False to take only the last frames of the grid's holds too.

    Raises
    ------
    NumericsError
        If the run did not finish, with the reason.
    """
    sparse_holds = {HELD_OUT} if whole_holds else {HELD_OUT, GRID}

    def sparse(plan: Plan) -> Plan:
        phases = (
            replace(phase, sequence=_Sparse(phase.sequence, frame_period_s, phase.name not in sparse_holds))
            for phase in plan.phases
        )
        return replace(plan, phases=tuple(phases))

    configuration = _configuration(recipe, seed, frame_period_s)
    record, bench = simulate_run(configuration, f"SIMULATED-{seed}", discover(), sparse)
    if record.end is not EndReason.FINISHED:
        raise NumericsError(f"the simulated run was {record.end}: {record.end_detail}")
    design: SheetDesign = bench.frame_source.world.sheet.design  # type: ignore[attr-defined]
    return record, design


def analyse_run(record: RunRecord, analysis: AnalysisSettings) -> RunObservation:
    """Analyse a run as ``cbsr-qa run`` does, without fits over time."""
    return observe_run(record, _reconstruction(), analysis, over_time=False)


@lru_cache(maxsize=1)
def _reconstruction() -> Reconstruction:
    choice = load_recipe(BASE).value.reconstruction
    method: Reconstruction = create_plugin(discover(), Kind.RECONSTRUCTION, choice, "[reconstruction]")
    return method


class _Sparse:
    """A sequence with only the last frames of its rests, and unchanged times."""

    def __init__(self, sequence: LoadSequence, frame_s: float, whole_holds: bool) -> None:
        self._sequence, self._frame_s, self._whole_holds = sequence, frame_s, whole_holds
        self.role = getattr(sequence, "role", Role.OTHER)
        if isinstance(sequence, AdaptiveSequence):
            self.goal = sequence.goal

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        holds_whole, kept_s = False, _FRAMES_BEFORE * self._frame_s
        for step in self._sequence.steps(context):
            if type(step) is Hold and step.acquire and not holds_whole and step.hold_s > kept_s:
                yield Hold(step.hold_s - kept_s, acquire=False)
                yield AcquireFrames(_FRAMES_BEFORE)
            else:
                yield step
            holds_whole = self._whole_holds and isinstance(step, Press)


def _configuration(recipe: Mapping[str, Any], seed: int, frame_period_s: float) -> Configuration:
    station, scene = copy_shipped(DocumentKind.STATION, "simulated"), copy_shipped(DocumentKind.SCENE, "base")
    scene["effects"] = [*scene["effects"], *(dict(effect) for effect in SHEET)]
    usual_s = scene["scene"]["frame_period_s"]
    scene["scene"]["frame_period_s"] = frame_period_s
    material = copy_shipped(DocumentKind.MATERIAL, MATERIAL)
    material["material"]["relative_noise"]["value"] *= (usual_s / frame_period_s) ** 0.5
    station["instruments"]["bench"]["scene"] = scene
    return configuration_of(station, recipe, material, seed=seed)


def load_analysis(recipe: Mapping[str, Any]) -> AnalysisSettings:
    """Return the settings of a recipe document."""
    return load_recipe(dict(recipe)).value.analysis
