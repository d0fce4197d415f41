"""Recorded data through the same analysis and to the same report as a run."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cbsr_qa.analysis.recording_analysis import DEFAULT_RECONSTRUCTION, AnalysisChoices, analyse_recording
from cbsr_qa.app.analyse_document import recording_document, result_document, unread_document
from cbsr_qa.app.analyse_reference import with_reference
from cbsr_qa.app.outputs import report_sections
from cbsr_qa.app.read_recording import guarded, recognised
from cbsr_qa.config.documents import DocumentKind, shipped_names
from cbsr_qa.config.echo import echo
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.config.paths import reports_folder
from cbsr_qa.domain.errors import CbsrError, ConfigError, NumericsError, RecordingError
from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.plan import PluginChoice
from cbsr_qa.domain.recording import ReadOptions, Recording
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.hookspecs import Kind
from cbsr_qa.interfaces import Reconstruction, RecordingFormat
from cbsr_qa.plugins import Plugins, discover, made
from cbsr_qa.report.render import render_recording, report_name, write_report

#: Told of each step, in words.
Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class AnalyseRequest:
    """What to analyse, and how.

    Parameters
    ----------
    format : name of a recording plugin; None to let the plugins recognise the file.
    sensor_type : file or shipped name; None for what the recording states, else the nominal disc.
    dataset : one of several data sets in a file.
    reference : a file, and a data set in it, that holds the unloaded domain; it is recognised by itself.
    correct_memory : None to decide by the estimate.
    report : whether to write one.
    reconstruction : plugin that images the events; None for the usual one.
    options : of it.
    """

    format: str | None = None
    sensor_type: str | None = None
    dataset: str | None = None
    reference: tuple[Path, str | None] | None = None
    correct_memory: bool | None = None
    report: bool = True
    reconstruction: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def chosen(self) -> PluginChoice:
        """What images the events."""
        name = DEFAULT_RECONSTRUCTION if self.reconstruction is None else self.reconstruction
        return PluginChoice(name, self.options)


@dataclass(frozen=True, slots=True, eq=False)
class Analysed:
    """What came of one file.

    Parameters
    ----------
    path : the file.
    result : None where it was refused before it could be analysed.
    refused : why, where it was refused.
    report : file; None where none was written.
    document : for ``--json``.
    """

    path: Path
    result: RecordingResult | None
    refused: CbsrError | None
    report: Path | None
    document: dict[str, Any]
    warnings: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """0 analysed, whether or not anything was found; 2 refused."""
        return 0 if self.refused is None else self.refused.exit_code


def analyse_file(path: Path, request: AnalyseRequest, *, tell: Tell = lambda said: None) -> Analysed:
    """Analyse one file. A refusal is a result, not an exception; nothing is written then."""
    plugins = discover()
    recording: Recording | None = None
    datasets: tuple[str, ...] = ()
    name: str | None = None
    try:
        reconstruction = _reconstruction(request, plugins)
        tell(f"reading {path.name}")
        format_, name = recognised(path, request.format, plugins)
        datasets = guarded(path, name, lambda: format_.datasets(path))
        recording = _read(path, format_, name, ReadOptions(request.dataset, request.reference))
        if request.reference is not None:
            recording = with_reference(recording, _empty(*request.reference, path, format_, name, plugins))
        tell(f"analysing {len(recording.frames)} frames")
        return _analysed(path, recording, reconstruction, request, plugins, datasets, tell)
    except CbsrError as error:
        if recording is not None:
            read = recording_document(recording, None)
        else:
            read = unread_document(name, error.problems if isinstance(error, RecordingError) else ())
        return Analysed(path, None, error, None, _refused(path, read, datasets, error))


def _refused(path: Path, read: dict[str, Any], datasets: tuple[str, ...], error: CbsrError) -> dict[str, Any]:
    """Say why, beside what is known; what a reader of many documents looks for is there, and empty."""
    document: dict[str, Any] = {"file": str(path), "recording": read, "channels": {}, "events": [], "warnings": []}
    if datasets:
        document["datasets"] = list(datasets)
    document["refused"] = {"reason": error.reason, "remedy": error.remedy}
    return document


def _reconstruction(request: AnalyseRequest, plugins: Plugins) -> Reconstruction:
    """Make the reconstruction before anything is read: what is wrong with it is wrong for every file."""
    where = "--option" if request.options else "--reconstruction"
    try:
        reconstruction: Reconstruction = made(plugins, Kind.RECONSTRUCTION, request.chosen, where)
    except NumericsError as error:
        raise ConfigError(f"{where}: {request.chosen.name}: {error.reason}", remedy=error.remedy) from error
    return reconstruction


def _read(path: Path, format_: RecordingFormat, name: str, options: ReadOptions) -> Recording:
    return guarded(path, name, lambda: format_.read(path, options))


def _empty(
    other: Path, dataset: str | None, path: Path, format_: RecordingFormat, name: str, plugins: Plugins
) -> Recording:
    """Read the reference by its own format; its problems are its own, not the file's."""
    if other != path:
        format_, name = recognised(other, None, plugins)
    try:
        return _read(other, format_, name, ReadOptions(dataset))
    except RecordingError as error:
        raise RecordingError(f"the reference cannot be used: {error.reason}", remedy=error.remedy) from error


def _analysed(
    path: Path,
    recording: Recording,
    reconstruction: Reconstruction,
    request: AnalyseRequest,
    plugins: Plugins,
    datasets: tuple[str, ...],
    tell: Tell,
) -> Analysed:
    sensor_type, unknown = _sensor_type(recording, request)
    choices = AnalysisChoices(request.correct_memory, sensor_type, request.chosen)
    result = analyse_recording(recording, reconstruction, choices, tell=tell)
    document: dict[str, Any] = {"file": str(path), **result_document(result)}
    if datasets:
        document["datasets"] = list(datasets)
    if result.channels.not_connected:
        error = RecordingError(
            f"{path.name} holds no signal: all {len(recording.frames)} frames read"
            f" {recording.frames.voltages.flat[0]:g} {recording.frames.unit.value} everywhere, nothing is connected",
            remedy="connect the sensor and record again",
        )
        document["refused"] = {"reason": error.reason, "remedy": error.remedy}
        return Analysed(path, result, error, None, document)
    report, missing = _report(path, result, request, plugins)
    document["report"] = None if report is None else str(report)
    warnings = (*result.warnings, *unknown, *missing)
    document["warnings"] = list(warnings)
    return Analysed(path, result, None, report, document, warnings)


def _sensor_type(recording: Recording, request: AnalyseRequest) -> tuple[SensorType | None, list[str]]:
    if request.sensor_type is not None:
        return load_sensor_type(request.sensor_type).value, []
    if recording.sensor_type is None:
        return None, []
    # A name, never a path: a file of unknown origin opens no other.
    if recording.sensor_type in shipped_names(DocumentKind.SENSOR_TYPE):
        return load_sensor_type(recording.sensor_type).value, []
    said = f"the recording states sensor type {echo(recording.sensor_type)}, which is not a shipped one"
    return None, [f"{said}; it is imaged on a nominal disc; give the file of the sensor type with --sensor-type"]


def _report(
    path: Path, result: RecordingResult, request: AnalyseRequest, plugins: Plugins
) -> tuple[Path | None, list[str]]:
    if not request.report:
        return None, []
    sections, missing = report_sections((), plugins)
    file = reports_folder() / report_name(path.stem, result.recording.dataset, _told_apart(path, request))
    write_report(file, render_recording(result, sections, warnings=missing))
    return file, missing


def _told_apart(path: Path, request: AnalyseRequest) -> str:
    """Eight digits of the content and of what was asked: no other file's or analysis's report is overwritten."""
    sha = hashlib.sha256()
    for each in (path, *(() if request.reference is None else request.reference[:1])):
        with each.open("rb") as file:
            sha.update(hashlib.file_digest(file, "sha256").digest())
    dataset = None if request.reference is None else request.reference[1]
    asked: tuple[object, ...] = (request.format, request.sensor_type, dataset, request.correct_memory)
    if request.reconstruction is not None or request.options:
        asked = (*asked, request.chosen.name, sorted(request.options.items()))
    sha.update(repr(asked).encode())
    return sha.hexdigest()[:8]
