"""Files that a simulated scene is written to, in one or several formats."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cbsr_qa.config.paths import scenes_folder, writable_folder
from cbsr_qa.domain.errors import CbsrError, ConfigError, PluginError, RefusedError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import RecordingWriter
from cbsr_qa.simulate.recording import RecordedScene
from cbsr_qa.system.files import writing

#: Format in which every scene is written.
OWN_FORMAT = "cbsr-recording"
#: Last word of a format's name → suffix of its files.
_SUFFIXES = {"csv": ".csv", "mat": ".mat", "text": ".txt", "txt": ".txt", "json": ".json", "recording": ".h5"}


@dataclass(frozen=True, slots=True)
class Target:
    """A file to write, and its writer."""

    format: str
    path: Path
    writer: RecordingWriter


@dataclass(frozen=True, slots=True)
class Written:
    """A written file.

    Parameters
    ----------
    notes : information that the format cannot hold, in words.
    """

    format: str
    path: str
    notes: tuple[str, ...]


def check_targets(
    scene: str, seed: int, output: Path | None, formats: tuple[str, ...], plugins: Plugins
) -> tuple[Target, ...]:
    """Return the file of a scene in each format, our own first; none exists yet.

    Raises
    ------
    PluginError
        If a format is unknown or cannot be written.
    RefusedError
        If a file exists already, or the output's name is that of another format.
    """
    # In a file name other characters than letters, digits, . _ - become a dash.
    file_name = re.sub(r"[^\w.-]+", "-", scene).strip(".-") or "scene"
    own_path = scenes_folder() / f"{file_name}-seed{seed}.h5" if output is None else output
    targets = [Target(OWN_FORMAT, own_path, _writer(OWN_FORMAT, plugins))]
    for name in dict.fromkeys(formats):
        if name != OWN_FORMAT:
            writer = _writer(name, plugins)  # first: an unknown name may not be valid in a file name
            format_path = own_path.with_name(f"{own_path.stem}.{name}{_SUFFIXES.get(name.rpartition('-')[2], '')}")
            targets.append(Target(name, format_path, writer))
    _check_suffix(own_path)
    for target in targets:
        if os.path.lexists(target.path):
            alternative = "another seed, or another file with --output" if output is None else "another file"
            raise RefusedError(f"{target.path} exists already", remedy=f"remove it first, or name {alternative}")
    return tuple(targets)


def _check_suffix(own: Path) -> None:
    """Refuse to write HDF5 under a name that suggests another format."""
    if own.suffix.lower() in set(_SUFFIXES.values()) - {_SUFFIXES["recording"]}:
        raise RefusedError(
            f"{own} must be an HDF5 file; its suffix is {own.suffix}",
            remedy=f"use .h5, e.g. {own.with_suffix('.h5')}; --format writes other files beside it",
        )


def write_all(recorded: RecordedScene, targets: tuple[Target, ...]) -> tuple[Written, ...]:
    """Write every file or, if one is refused, none.

    RefusedError if a format cannot hold such a recording, or a file exists by now.
    """
    begun_paths: list[Path] = []
    try:
        written: list[Written] = []
        for target in targets:
            if os.path.lexists(target.path):  # the simulation takes a while; files created meanwhile are the user's
                raise RefusedError(f"{target.path} was created in the meantime", remedy="name another file")
            begun_paths.append(target.path)
            written.append(_write_target(recorded, target))
    except BaseException:
        for path in begun_paths:
            with suppress(OSError):  # a folder, or an impossible file name
                path.unlink()
        raise
    return tuple(written)


def _write_target(recorded: RecordedScene, target: Target) -> Written:
    recording = replace(recorded.recording, path=target.path)
    with writing(target.path):
        try:
            notes = target.writer.write(target.path, recording, recorded.transcript)
        except CbsrError as error:
            reason = f"the scene cannot be written as {target.format}: {error.reason}"
            raise RefusedError(reason, remedy=error.remedy) from error
        except OSError:
            raise
        except Exception as error:
            raise _writer_error(target, f"{type(error).__name__}: {error}") from error
    if not isinstance(notes, tuple) or not all(isinstance(note, str) for note in notes):
        raise _writer_error(target, f"it returned {type(notes).__name__} instead of a tuple of texts")
    if not target.path.is_file():
        raise _writer_error(target, f"there is no {target.path}")
    return Written(target.format, str(target.path), notes)


def _writer_error(target: Target, why: str) -> PluginError:
    return PluginError(
        f"format {target.format!r} failed to write the scene: {why}", remedy="report it to its author, or omit it"
    )


def _writer(name: str, plugins: Plugins) -> RecordingWriter:
    format_: Any = create_plugin(plugins, Kind.RECORDING, PluginChoice(name), "--format")
    if not isinstance(format_, RecordingWriter):
        raise PluginError(f"format {name!r} is read-only", remedy=f"writable: {', '.join(_writable(plugins))}")
    return format_


def _writable(plugins: Plugins) -> list[str]:
    names = []
    for name in plugins.list_names(Kind.RECORDING):
        try:
            if isinstance(create_plugin(plugins, Kind.RECORDING, PluginChoice(name), "--format"), RecordingWriter):
                names.append(name)
        except Exception:  # noqa: BLE001 - a plugin's code may raise anything; its error is no help here
            continue
    return names


@contextmanager
def make_folder(folder: Path, output: Path | None) -> Iterator[None]:
    """Make the output folder of a scene, and remove new, empty folders on failure.

    Parameters
    ----------
    output : named by the user, or None; the remedy depends on it.

    Raises
    ------
    ConfigError
        If it cannot be written to.
    """
    new_folders = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    try:
        _check_writable(folder, output)
        yield
    except BaseException:
        for parent in new_folders:
            with suppress(OSError):  # it has files of the user
                parent.rmdir()
        raise


def _check_writable(folder: Path, output: Path | None) -> None:
    try:
        writable_folder(folder)
    except ConfigError as error:
        remedy = error.remedy if output is None else "name a file in another folder with --output"
        raise ConfigError(error.reason, remedy=remedy) from error
