"""Simulation of a scene to a recording, in one or several formats.

The files that a simulated scene is written to.
"""

import os
import re
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import cbsr_qa
from cbsr_qa.config import edge_remarks, scenes_folder, writable_folder
from cbsr_qa.domain import CbsrError, ConfigError, PluginError, RefusedError
from cbsr_qa.domain.plan import PluginChoice
from cbsr_qa.plugin import Kind, Plugins, RecordingWriter, discover, made
from cbsr_qa.simulate import NOT_MODELLED, PressedLoad, RecordedScene, SimulatedWorld, planned_middles_s, record_scene
from cbsr_qa.studies.scenes.setting import SceneSetup, effects_of, made_world, naming, set_up

#: Format every scene is written in.
OWN_FORMAT = "cbsr-recording"
#: Last word of a format's name → suffix of its files.
_SUFFIXES = {"csv": ".csv", "mat": ".mat", "text": ".txt", "txt": ".txt", "json": ".json", "recording": ".h5"}


@dataclass(frozen=True, slots=True)
class Target:
    """A file to write, and what writes it."""

    format: str
    path: Path
    writer: RecordingWriter


@dataclass(frozen=True, slots=True)
class Written:
    """A file that was written.

    Parameters
    ----------
    notes : what the format cannot say, in words.
    """

    format: str
    path: Path
    notes: tuple[str, ...]


def checked_targets(
    scene: str, seed: int, output: Path | None, formats: tuple[str, ...], plugins: Plugins
) -> tuple[Target, ...]:
    """Say where a scene goes in each format, our own first; nothing of it exists yet.

    Raises
    ------
    PluginError
        If a format is unknown or cannot be written.
    RefusedError
        If a file exists already, or the output's name is that of another format.
    """
    own = scenes_folder() / f"{_file_name(scene)}-seed{seed}.h5" if output is None else output
    targets = [Target(OWN_FORMAT, own, _writer(OWN_FORMAT, plugins))]
    for name in dict.fromkeys(formats):
        if name != OWN_FORMAT:
            writer = _writer(name, plugins)  # first: an unknown name may be no part of a file's
            beside = own.with_name(f"{own.stem}.{name}{_SUFFIXES.get(name.rpartition('-')[2], '')}")
            targets.append(Target(name, beside, writer))
    _check_suffix(own)
    for target in targets:
        if os.path.lexists(target.path):
            other = "another seed, or another file with --output" if output is None else "another file"
            raise RefusedError(f"{target.path} exists already", remedy=f"remove it first, or name {other}")
    return tuple(targets)


def _check_suffix(own: Path) -> None:
    """Refuse to write HDF5 under a name that promises, to people and to other programs, something else."""
    if own.suffix.lower() in set(_SUFFIXES.values()) - {_SUFFIXES["recording"]}:
        raise RefusedError(
            f"{own} must be an HDF5 file; its suffix is {own.suffix}",
            remedy=f"use .h5, e.g. {own.with_suffix('.h5')}; --format writes other files beside it",
        )


def write_all(recorded: RecordedScene, targets: tuple[Target, ...]) -> tuple[Written, ...]:
    """Write every file or, where one is refused, none.

    Raises
    ------
    RefusedError
        If a format cannot hold such a recording, or a file is there by now.
    """
    begun: list[Path] = []
    try:
        written: list[Written] = []
        for target in targets:
            if os.path.lexists(target.path):  # simulating takes a while; what came meanwhile is somebody's
                raise RefusedError(f"{target.path} was created in the meantime", remedy="name another file")
            begun.append(target.path)
            written.append(_written(recorded, target))
    except BaseException:
        for path in begun:
            with suppress(OSError):  # a folder, or a name that no file can have
                path.unlink()
        raise
    return tuple(written)


def _written(recorded: RecordedScene, target: Target) -> Written:
    recording = replace(recorded.recording, path=target.path)
    try:
        notes = target.writer.write(target.path, recording, recorded.transcript)
    except CbsrError as error:
        reason = f"the scene cannot be written as {target.format}: {error.reason}"
        raise RefusedError(reason, remedy=error.remedy) from error
    except OSError as error:
        raise RefusedError(f"{target.path} cannot be written: {error.strerror or error}") from error
    except Exception as error:
        raise _failed(target, f"{type(error).__name__}: {error}") from error
    if not isinstance(notes, tuple) or not all(isinstance(note, str) for note in notes):
        raise _failed(target, f"it returned {type(notes).__name__} instead of a tuple of texts")
    if not target.path.is_file():
        raise _failed(target, f"there is no {target.path}")
    return Written(target.format, target.path, notes)


def _failed(target: Target, said: str) -> PluginError:
    return PluginError(
        f"format {target.format!r} failed to write the scene: {said}", remedy="report it to its author, or omit it"
    )


def _writer(name: str, plugins: Plugins) -> RecordingWriter:
    format_: Any = made(plugins, Kind.RECORDING, PluginChoice(name), "--format")
    if not isinstance(format_, RecordingWriter):
        raise PluginError(f"format {name!r} is read-only", remedy=f"writable: {', '.join(_writable(plugins))}")
    return format_


def _writable(plugins: Plugins) -> list[str]:
    found = []
    for name in plugins.in_order(Kind.RECORDING):
        try:
            if isinstance(made(plugins, Kind.RECORDING, PluginChoice(name), "--format"), RecordingWriter):
                found.append(name)
        except Exception:  # noqa: BLE001 - a stranger's code may raise anything; it is no help here
            continue
    return found


def _file_name(scene: str) -> str:
    """A scene's name as part of a file's: other signs than letters, digits, . _ - become a dash."""
    return re.sub(r"[^\w.-]+", "-", scene).strip(".-") or "scene"


@contextmanager
def made_folder(folder: Path, output: Path | None) -> Iterator[None]:
    """Make the folder that a scene is written to, and take away what of it is new and empty if it fails.

    Parameters
    ----------
    output : what the user named, if anything; the remedy depends on it.

    Raises
    ------
    ConfigError
        If it cannot be written to.
    """
    new = [above for above in (folder, *folder.parents) if not above.exists()]
    try:
        _check_writable(folder, output)
        yield
    except BaseException:
        for above in new:
            with suppress(OSError):  # somebody's files are in it
                above.rmdir()
        raise


def _check_writable(folder: Path, output: Path | None) -> None:
    try:
        writable_folder(folder)
    except ConfigError as error:
        remedy = error.remedy if output is None else "name a file in another folder with --output"
        raise ConfigError(error.reason, remedy=remedy) from error


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
    tell("creating the sheet")
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
    """Write unloaded frames in every format, so a format that fails is refused before the simulation.

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
    """Describe the simulation and the software in the recording."""
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
