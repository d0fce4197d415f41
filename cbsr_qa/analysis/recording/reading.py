"""Reading of recordings: detection of the format, in a sandboxed child process."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from cbsr_qa.domain.errors import CbsrError, PluginError, RecordingError, RefusedError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.readings.frames import ReadOptions, Recording
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import RecordingFormat
from cbsr_qa.system.foreign import UnfitFileError, open_foreign
from cbsr_qa.system.untrusted import read_untrusted

_HEAD_BYTES = 4096
#: Remedy for a file of another layout.
_OWN: Final = "or read the file in Python, and give its frames to cbsr_qa.analyse as an array"

_Read = TypeVar("_Read")


def read_recording_file(path: Path, plugins: Plugins, *, format_: str | None, dataset: str | None) -> Recording:
    """Read one recording in any known format.

    Parameters
    ----------
    format_ : name of a format; None to let the plugins recognise the file.
    dataset : one of several data sets in a file; None to take the only one.

    Raises
    ------
    RecordingError, PluginError
        If the file cannot be read, contains nothing usable, or has an unknown format.
    """
    reader, name = find_format(path, format_, plugins)
    return run_guarded(path, name, partial(reader.read, path, ReadOptions(dataset)))


def find_format(path: Path, format_name: str | None, plugins: Plugins) -> tuple[RecordingFormat, str]:
    """Find the plugin that can read a file.

    Parameters
    ----------
    format_name : a format by name; None to let each plugin check the file's name and beginning.

    Raises
    ------
    RecordingError
        If the file does not exist, is empty or cannot be read, or no format recognises it.
    PluginError
        If the named format is unknown.
    """
    head = _head(path)
    if format_name is not None:
        return create_plugin(plugins, Kind.RECORDING, PluginChoice(format_name), "--format"), format_name
    failures: list[str] = []
    for name in plugins.list_names(Kind.RECORDING):
        try:
            format_: RecordingFormat = plugins.factory(Kind.RECORDING, name)()
            if format_.recognises(path, head):
                return format_, name
        except PluginError as error:
            failures.append(error.reason)
        except Exception as error:  # noqa: BLE001 - a plugin's code may raise anything
            failures.append(f"{name}: {type(error).__name__}: {error}")
    known_formats = ", ".join(plugins.names(Kind.RECORDING))
    raise RecordingError(
        f"{path.name} has no known format",
        remedy="; ".join([f"formats: {known_formats}; name one with --format", _OWN, *failures]),
    )


def _head(path: Path) -> bytes:
    try:
        with open_foreign(path) as file:
            head = file.read(_HEAD_BYTES)
    except FileNotFoundError as error:
        raise RecordingError(f"there is no file {path}", remedy="check its name and folder") from error
    except UnfitFileError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}", remedy="name a recording") from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    if not head.strip():
        raise RecordingError(f"{path.name} is empty", remedy="record it again, or analyse another file")
    return head


def run_guarded(path: Path, name: str, work: Callable[[], _Read]) -> _Read:
    """Run a format's code on a file in a limited child process; exceptions become clear refusals."""
    return read_untrusted(path, partial(_refusing, path, name, work), refusal=RecordingError)


def _refusing(path: Path, name: str, work: Callable[[], _Read]) -> _Read:
    try:
        return work()
    except CbsrError as error:
        if type(error) is not RefusedError:
            raise
        # Errors about frames or samples do not know the file.
        raise RecordingError(f"{path.name}: {error.reason}", remedy=error.remedy) from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    except MemoryError:
        raise
    except (Exception, SystemExit) as error:
        raise RecordingError(
            f"{path.name} cannot be read as {name}: {type(error).__name__}: {error}",
            remedy="the file is damaged, or has another format: give it with --format",
        ) from error
