"""Reports of results: which sections, in what order, into which file."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from cbsr_qa.domain.errors import PluginError
from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.report import RunResult
from cbsr_qa.hookspecs import Kind
from cbsr_qa.interfaces import ReportSection
from cbsr_qa.plugins import Plugins
from cbsr_qa.report.render import render_recording, render_run, report_name, write_report

#: The order of reading; sections nobody named here stand between, by name.
_FIRST: Final = (
    "recording-events",
    "nine-locations",
    "load-images",
    "mask-comparison",
    "random-loads",
    "relaxation",
    "baseline-conductance",
    "recording-channels",
    "recording-rows",
    "noise-and-contacts",
)
_LAST: Final = ("time-and-accuracy", "limits", "traceability")


def write_run_report(result: RunResult, plugins: Plugins, folder: Path, *, sections: Sequence[str] = ()) -> Path:
    """Render a run's report to ``<serial>-<run>.html``.

    Parameters
    ----------
    folder : made where it is missing.
    sections : names in order; every installed one, in order of reading, where empty.

    Raises
    ------
    RefusedError
        If the folder cannot be written to; nothing was written then.
    """
    identity = result.record.identity
    chosen, warnings = chosen_sections(plugins, sections)
    path = folder / report_name(identity.sensor.serial, identity.run)
    write_report(path, render_run(result, chosen, warnings=warnings))
    return path


def write_recording_report(
    result: RecordingResult, plugins: Plugins, folder: Path, *, sections: Sequence[str] = ()
) -> Path:
    """Render a recording's report to ``<file>[-<data set>].html``; see :func:`write_run_report`."""
    recording = result.recording
    chosen, warnings = chosen_sections(plugins, sections)
    path = folder / report_name(recording.path.stem, recording.dataset)
    write_report(path, render_recording(result, chosen, warnings=warnings))
    return path


def render_again(
    wanted: str,
    rebuild: Callable[[str], RunResult],
    plugins: Plugins,
    folder: Path,
    *,
    sections: Sequence[str] = (),
) -> Path:
    """Render the report of a stored run again.

    Parameters
    ----------
    wanted : a run, or a serial number for its latest run.
    rebuild : makes the result from what is stored.

    Raises
    ------
    StoreError
        From ``rebuild``, if there is no such run or sensor.
    RefusedError
        If the folder cannot be written to.
    """
    return write_run_report(rebuild(wanted), plugins, folder, sections=sections)


def chosen_sections(plugins: Plugins, names: Sequence[str] = ()) -> tuple[list[ReportSection], list[str]]:
    """Make sections by name.

    Returns
    -------
    The sections, and a warning for each that could not be loaded or made: it takes nothing else down.
    """
    sections: list[ReportSection] = []
    warnings: list[str] = []
    for name in names or reading_order(plugins.names(Kind.SECTION)):
        try:
            sections.append(plugins.factory(Kind.SECTION, name)())
        except PluginError as error:
            warnings.append(f"The report section {name} is left out: {error.reason}")
        except Exception as error:  # noqa: BLE001 - a stranger's factory may raise anything
            warnings.append(f"The report section {name} is left out: {type(error).__name__}: {error}")
    return sections, warnings


def reading_order(names: Sequence[str]) -> list[str]:
    """Sort section names as a report is read: what was found, then a stranger's, then what it rests on."""
    middle = sorted(set(names) - set(_FIRST) - set(_LAST))
    return [name for name in (*_FIRST, *middle, *_LAST) if name in names]
