"""Simulate a scene to a recording, in one or several formats."""

import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import cbsr_qa
from cbsr_qa.app.scene_files import Target, Written, checked_targets, made_folder, write_all
from cbsr_qa.app.scene_setting import SceneSetup, effects_of, made_world, naming, set_up
from cbsr_qa.config.scene_checks import edge_remarks
from cbsr_qa.hookspecs import Kind
from cbsr_qa.plugins import Plugins, discover
from cbsr_qa.simulate.limits import NOT_MODELLED
from cbsr_qa.simulate.scene_heads import PressedLoad
from cbsr_qa.simulate.scene_recording import RecordedScene, planned_middles_s, record_scene
from cbsr_qa.simulate.world import SimulatedWorld

_MOST_REHEARSED = 200  # frames


@dataclass(frozen=True, slots=True)
class SceneRunRequest:
    """What a user asks for; see the options of ``cbsr-qa scene run``."""

    scene: str
    output: Path | None = None
    formats: tuple[str, ...] = ()
    seed: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SceneRun:
    """What came of it.

    Parameters
    ----------
    files : the HDF5 recording first.
    remarks : on loads, by their place in the scene's list from 0.
    """

    setup: SceneSetup
    seed: int
    recorded: RecordedScene
    files: tuple[Written, ...]
    remarks: dict[int, str]

    @property
    def duration_s(self) -> float:
        """When the last frame is over, pauses included."""
        transcript, plan = self.recorded.transcript, self.setup.plan
        return plan.frame_count * plan.scene.frame_period_s + sum(dump.pause_s for dump in transcript.dumps)

    def document(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        scene = self.setup.plan.scene
        return {
            "scene": scene.name,
            "seed": self.seed,
            "sensor_type": self.setup.sensor_type.value.name,
            "material": self.setup.material.value.name,
            "frames": len(self.recorded.recording.frames),
            "frames_lost": self.recorded.frames_lost,
            "dumps": len(self.recorded.transcript.dumps),
            "duration_s": self.duration_s,
            "loads": [_load(one, self.remarks.get(one.index)) for one in self.recorded.pressed],
            "files": [
                {"format": file.format, "path": str(file.path), "notes": list(file.notes)} for file in self.files
            ],
            "effects": [choice.name for choice in scene.effects],
            "not_modelled": [*scene.not_modelled, *NOT_MODELLED],
        }

    def analyse_command(self) -> str:
        """The command to try with the recording."""
        # A recording states a sensor type by name, which stands for a shipped one.
        own = self.setup.sensor_type.document.path
        named = [] if own is None else ["--sensor-type", str(own)]
        return shlex.join(["cbsr-qa", "analyse", str(self.files[0].path), *named])


def run_scene(
    request: SceneRunRequest,
    *,
    tell: Callable[[str], None] = lambda stage: None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SceneRun:
    """Simulate a scene and write what its station would have recorded.

    Parameters
    ----------
    tell : told what the computer is busy with.
    progress : told how many frames of how many are taken.

    Raises
    ------
    RefusedError
        With nothing written: a file is wrong, a load or an effect impossible, a format cannot be written or does not
        hold such a recording, or a file exists already.
    """
    plugins = discover()
    setup = set_up(request.scene, recorded=True)
    seed = setup.plan.seed or 0 if request.seed is None else request.seed
    targets = checked_targets(setup.plan.scene.name, seed, request.output, request.formats, plugins)
    tell("making the sheet")
    world = made_world(setup, effects_of(plugins), seed=seed)
    with naming(setup.label):
        _rehearse(world, setup, targets)
    remarks = edge_remarks(setup.plan, setup.sensor_type.value)
    with made_folder(targets[0].path.parent, request.output):
        tell(f"simulating {setup.plan.frame_count} frames")
        with naming(setup.label):
            recorded = record_scene(world, setup.plan, progress=progress)
        recorded = _labelled(recorded, world, setup, plugins, tuple(remarks.values()))
        tell("writing")
        return SceneRun(setup, seed, recorded, write_all(recorded, targets), remarks)


def _rehearse(world: SimulatedWorld, setup: SceneSetup, targets: tuple[Target, ...]) -> None:
    """Write unloaded frames in every format: what cannot be written is refused before anybody has waited.

    One frame, or those up to the first in which a board pauses.
    """
    if len(targets) == 1 or not setup.plan.frame_count:
        return
    dumps = world.transcript(planned_middles_s(setup.plan)).dumps
    frames = 1 + min(dumps[0].frame, _MOST_REHEARSED) if dumps else 1
    plan = replace(setup.plan, loads=(), duration_s=frames * setup.plan.scene.frame_period_s)
    recorded = record_scene(world, plan)
    whole = replace(recorded.transcript, lost=np.zeros_like(recorded.transcript.lost))
    with TemporaryDirectory() as folder:
        there = tuple(replace(target, path=Path(folder) / target.path.name) for target in targets)
        write_all(replace(recorded, transcript=whole), there)


def _labelled(
    recorded: RecordedScene, world: SimulatedWorld, setup: SceneSetup, plugins: Plugins, notes: tuple[str, ...]
) -> RecordedScene:
    """Say in the recording what was simulated, and with which software."""
    on = set(world.chain.names)
    theirs = {(r.distribution, r.version) for r in plugins.registrations(Kind.EFFECT) if r.name in on}
    others = sorted(theirs - {("cbsr-qa", cbsr_qa.__version__)})
    software = ", ".join(f"{name} {version}" for name, version in [("cbsr-qa", cbsr_qa.__version__), *others])
    said = f"scene {setup.plan.scene.name}, seed {world.setting.seed}, {software}"
    return replace(recorded, recording=replace(recorded.recording, notes=notes, simulated=(said,)))


def _load(one: PressedLoad, remark: str | None) -> dict[str, Any]:
    record, press = one.record, one.press
    return {
        "label": record.load.label,
        "head": one.load.head,
        "x_mm": one.load.x_mm,
        "y_mm": one.load.y_mm,
        "strain_percent": 100 * one.load.strain,
        "press_start_s": record.press_start_s,
        "touch_s": one.load.start_s,
        "hold_start_s": record.hold_start_s,
        "release_start_s": record.release_start_s,
        "clear_s": record.clear_s,
        "release_end_s": record.release_end_s,
        "true_x_mm": None if press is None else press.x_mm,
        "true_y_mm": None if press is None else press.y_mm,
        "true_strain_percent": 100 * one.true_strain,
        "remark": remark,
    }
