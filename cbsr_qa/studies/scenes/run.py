"""Simulation of a scene to a recording."""

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

import cbsr_qa
from cbsr_qa.config.scene_checks import edge_remarks
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.readings.frames import Recording
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.simulate.chain import NOT_MODELLED
from cbsr_qa.simulate.recording import PressedLoad, RecordedScene, frame_middles_s, record_scene
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.studies.scenes.files import Target, Written, check_targets, make_folder, write_all
from cbsr_qa.studies.scenes.setting import SceneSetup, make_world, name_scene_file, set_up

_MOST_REHEARSED: Final = 200  # frames


@dataclass(frozen=True, slots=True)
class SceneRunRequest:
    """A user's request; see the options of ``cbsr-qa scene run``."""

    scene: str
    output: Path | None = None
    formats: tuple[str, ...] = ()
    seed: int | None = None


@dataclass(frozen=True, slots=True)
class RecordedLoad:
    """A load as commanded and timed, with its true place and depth (no place if it never touched).

    Parameters
    ----------
    touch_s, clear_s : times at which the head reaches and leaves the nominal surface.
    """

    label: str
    head: int
    x_mm: float
    y_mm: float
    strain_percent: float
    press_start_s: float
    touch_s: float
    hold_start_s: float
    release_start_s: float
    clear_s: float | None
    release_end_s: float
    true_x_mm: float | None
    true_y_mm: float | None
    true_strain_percent: float
    remark: str | None


@dataclass(frozen=True, slots=True)
class SceneRun:
    """A simulated and written scene.

    Parameters
    ----------
    frames_lost, dumps : frames cut by lost rows, and pauses of a board.
    duration_s : end of the last frame, including pauses.
    files : the HDF5 recording first; none of a scene in memory.
    analyse : the command to try with the recording; empty without one.
    """

    scene: str
    seed: int
    sensor_type: str
    material: str
    frames: int
    frames_lost: int
    dumps: int
    duration_s: float
    loads: tuple[RecordedLoad, ...]
    files: tuple[Written, ...]
    effects: tuple[str, ...]
    not_modelled: tuple[str, ...]
    analyse: str


def run_scene(
    request: SceneRunRequest,
    *,
    tell: Callable[[str], None] = lambda stage: None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SceneRun:
    """Simulate a scene and write what its station would have recorded.

    Raises
    ------
    RefusedError
        If a file is wrong, a load or an effect is impossible, a format cannot be written or cannot hold such a
        recording, or a file exists already; nothing is written then.
    """
    plugins = discover()
    setup = set_up(request.scene, plugins, recorded=True)
    seed = setup.plan.seed or 0 if request.seed is None else request.seed
    targets = check_targets(setup.plan.scene.name, seed, request.output, request.formats, plugins)
    world = _world(setup, plugins, seed, tell)
    with name_scene_file(setup.label):
        _rehearse(world, setup, targets)
    with make_folder(targets[0].path.parent, request.output):
        recorded, remarks = _record(world, setup, plugins, tell, progress)
        tell("writing")
        return _scene_run(setup, seed, recorded, write_all(recorded, targets), remarks)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedScene:
    """A scene simulated in memory, with what its station would have recorded and the sensor type simulated."""

    run: SceneRun
    recording: Recording
    sensor_type: SensorType


def simulate_to_memory(
    scene: str,
    seed: int | None = None,
    *,
    tell: Callable[[str], None] = lambda stage: None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SimulatedScene:
    """Simulate a scene without writing anything; the same seed gives the frames of :func:`run_scene`.

    Raises
    ------
    RefusedError
        If a file is wrong, or a load or an effect is impossible.
    """
    plugins = discover()
    setup = set_up(scene, plugins, recorded=True)
    chosen_seed = setup.plan.seed or 0 if seed is None else seed
    world = _world(setup, plugins, chosen_seed, tell)
    recorded, remarks = _record(world, setup, plugins, tell, progress)
    run = _scene_run(setup, chosen_seed, recorded, (), remarks)
    return SimulatedScene(run, recorded.recording, setup.sensor_type.value)


def _world(setup: SceneSetup, plugins: Plugins, seed: int, tell: Callable[[str], None]) -> SimulatedWorld:
    tell("creating the sheet")
    return make_world(setup, partial(plugins.factory, Kind.EFFECT), seed=seed)


def _record(
    world: SimulatedWorld,
    setup: SceneSetup,
    plugins: Plugins,
    tell: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> tuple[RecordedScene, Mapping[int, str]]:
    """Simulate the frames; returns remarks on the loads by their index too."""
    remarks = edge_remarks(setup.plan, setup.sensor_type.value)
    tell(f"simulating {setup.plan.frame_count} frames")
    with name_scene_file(setup.label):
        recorded = record_scene(world, setup.plan, progress=progress)
    return _label_recording(recorded, world, setup, plugins, tuple(remarks.values())), remarks


def _scene_run(
    setup: SceneSetup, seed: int, recorded: RecordedScene, files: tuple[Written, ...], remarks: Mapping[int, str]
) -> SceneRun:
    plan, dumps = setup.plan, recorded.transcript.dumps
    # A recording names its sensor type, which means a shipped one.
    sensor_type_path = setup.sensor_type.document.path
    sensor_type_option = [] if sensor_type_path is None else ["--sensor-type", str(sensor_type_path)]
    return SceneRun(
        scene=plan.scene.name,
        seed=seed,
        sensor_type=setup.sensor_type.value.name,
        material=setup.material.value.name,
        frames=len(recorded.recording.frames),
        frames_lost=recorded.frames_lost,
        dumps=len(dumps),
        duration_s=plan.frame_count * plan.scene.frame_period_s + sum(dump.pause_s for dump in dumps),
        loads=tuple(_load(pressed, remarks.get(pressed.index)) for pressed in recorded.pressed),
        files=files,
        effects=tuple(choice.name for choice in plan.scene.effects),
        not_modelled=(*plan.scene.not_modelled, *NOT_MODELLED),
        analyse=shlex.join(["cbsr-qa", "analyse", files[0].path, *sensor_type_option]) if files else "",
    )


def _rehearse(world: SimulatedWorld, setup: SceneSetup, targets: tuple[Target, ...]) -> None:
    """Write unloaded frames in every format, so that failing formats are refused before the simulation.

    One frame, or those up to a board's first pause.
    """
    if len(targets) == 1 or not setup.plan.frame_count:
        return
    dumps = world.transcript(frame_middles_s(setup.plan)).dumps
    frames = 1 + min(dumps[0].frame, _MOST_REHEARSED) if dumps else 1
    plan = replace(setup.plan, loads=(), duration_s=frames * setup.plan.scene.frame_period_s)
    recorded = record_scene(world, plan)
    complete = replace(recorded.transcript, lost=np.zeros_like(recorded.transcript.lost))
    with TemporaryDirectory() as folder:
        temporary_targets = tuple(replace(target, path=Path(folder) / target.path.name) for target in targets)
        write_all(replace(recorded, transcript=complete), temporary_targets)


def _label_recording(
    recorded: RecordedScene, world: SimulatedWorld, setup: SceneSetup, plugins: Plugins, notes: tuple[str, ...]
) -> RecordedScene:
    active_names = set(world.chain.names)
    distributions = {
        (r.distribution, r.version) for r in plugins.registrations(Kind.EFFECT) if r.name in active_names
    }
    other_distributions = sorted(distributions - {("cbsr-qa", cbsr_qa.__version__)})
    software = ", ".join(
        f"{name} {version}" for name, version in [("cbsr-qa", cbsr_qa.__version__), *other_distributions]
    )
    simulated = f"scene {setup.plan.scene.name}, seed {world.setting.seed}, {software}"
    return replace(recorded, recording=replace(recorded.recording, notes=notes, simulated=(simulated,)))


def _load(pressed: PressedLoad, remark: str | None) -> RecordedLoad:
    load, record, press = pressed.load, pressed.record, pressed.press
    return fill_from_object(
        RecordedLoad,
        record,
        label=record.load.label,
        head=load.head,
        x_mm=load.x_mm,
        y_mm=load.y_mm,
        strain_percent=100 * load.strain,
        touch_s=load.start_s,
        true_x_mm=None if press is None else press.x_mm,
        true_y_mm=None if press is None else press.y_mm,
        true_strain_percent=100 * pressed.true_strain,
        remark=remark,
    )
