"""Recorded data through the same analysis and to the same report as a run."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cbsr_qa.analysis.recording.analysis import AnalysisChoices, analyse_recording
from cbsr_qa.analysis.recording.reading import find_format, run_guarded
from cbsr_qa.analysis.recording.table_files import TableForm, read_table_recording
from cbsr_qa.app.analyse.outcome import Analysed, ReadRecording
from cbsr_qa.app.analyse.reference import with_reference
from cbsr_qa.app.analyse.request import AnalyseRequest, digest_request
from cbsr_qa.config.documents import DocumentKind, list_shipped
from cbsr_qa.config.loader import load_scanned_type, load_sensor_type
from cbsr_qa.config.paths import reports_folder
from cbsr_qa.domain.errors import (
    CbsrError,
    ConfigError,
    NumericsError,
    PluginError,
    RecordingError,
    RefusedError,
)
from cbsr_qa.domain.readings.frames import ReadOptions, Recording
from cbsr_qa.domain.results.findings import RecordingResult
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import Reconstruction, RecordingFormat
from cbsr_qa.report.render import render_recording, report_name, write_report
from cbsr_qa.report.section import load_sections
from cbsr_qa.system.words import echo

#: Called with each step, in words.
Tell = Callable[[str], None]


def analyse_file(path: Path, request: AnalyseRequest, *, tell: Tell = lambda said: None) -> Analysed:
    """Analyse one file. A refusal is returned, not raised, and nothing is written."""
    plugins = discover()
    recording: Recording | None = None
    datasets: tuple[str, ...] = ()
    name: str | None = None
    try:
        reconstruction = _reconstruction(request, plugins)
        tell(f"reading {path.name}")
        if request.table is not None:
            recording, sensor_type = _read_table(path, request, request.table)
            tell(f"analysing {len(recording.frames)} frames")
            return _build_outcome(path, recording, sensor_type, reconstruction, request, plugins, (), tell)
        format_, name = find_format(path, request.format, plugins)
        datasets = run_guarded(path, name, partial(format_.datasets, path))
        recording = _read(path, format_, name, ReadOptions(request.dataset, request.reference))
        if request.reference is not None:
            recording = with_reference(recording, _empty(*request.reference, path, format_, name, plugins))
        tell(f"analysing {len(recording.frames)} frames")
        return _build_outcome(path, recording, None, reconstruction, request, plugins, datasets, tell)
    except CbsrError as error:
        problems = error.problems if isinstance(error, RecordingError) else ()
        read_recording = (
            ReadRecording.from_problems(name, problems)
            if recording is None
            else ReadRecording.from_recording(recording)
        )
        return Analysed(path, read_recording, {}, datasets=datasets or None).with_refusal(error)


def _reconstruction(request: AnalyseRequest, plugins: Plugins) -> Reconstruction:
    """Create the reconstruction; its errors do not name the file."""
    option_name = "--option" if request.options else "--reconstruction"
    try:
        reconstruction: Reconstruction = create_plugin(plugins, Kind.RECONSTRUCTION, request.chosen, option_name)
    except PluginError as error:
        raise PluginError(
            f"--reconstruction: {error.reason.removeprefix(f'{option_name}: ')}", remedy=error.remedy
        ) from error
    except NumericsError as error:
        raise ConfigError(f"{option_name}: {request.chosen.name}: {error.reason}", remedy=error.remedy) from error
    return reconstruction


def _read(path: Path, format_: RecordingFormat, name: str, options: ReadOptions) -> Recording:
    return run_guarded(path, name, partial(format_.read, path, options))


def _empty(
    other: Path, dataset: str | None, path: Path, format_: RecordingFormat, name: str, plugins: Plugins
) -> Recording:
    """Read the reference by its own format; its problems are reported separately from the file's."""
    if other != path:
        format_, name = find_format(other, None, plugins)
    try:
        return _read(other, format_, name, ReadOptions(dataset))
    except RecordingError as error:
        raise RecordingError(f"the reference cannot be used: {error.reason}", remedy=error.remedy) from error


def _build_outcome(
    path: Path,
    recording: Recording,
    table_type: SensorType | None,
    reconstruction: Reconstruction,
    request: AnalyseRequest,
    plugins: Plugins,
    datasets: tuple[str, ...],
    tell: Tell,
) -> Analysed:
    result, unknown = _result(recording, table_type, reconstruction, request, tell)
    analysed = replace(Analysed.from_result(path, result), datasets=datasets or None)
    if (error := _missing_signal_error(path, result)) is not None:
        return analysed.with_refusal(error)
    report, missing = _report(path, result, request, plugins)
    return replace(analysed, report=report, warnings=(*result.warnings, *unknown, *missing))


def _read_table(path: Path, request: AnalyseRequest, form: TableForm) -> tuple[Recording, SensorType]:
    """Read a table of frames in the pattern that it brings. RefusedError if options are missing or of recordings."""
    for name, given in (
        ("--format", request.format),
        ("--dataset", request.dataset),
        ("--reference", request.reference),
    ):
        if given is not None:
            remedy = (
                "give frames of the unloaded sheet with --rest FILE" if name == "--reference" else f"leave {name} out"
            )
            raise RefusedError(f"{name} is for recordings; {path.name} is a table with --pattern", remedy=remedy)
    if request.sensor_type is None:
        raise RefusedError("--pattern without --sensor-type", remedy="name a sensor type, or its file")
    return read_table_recording(path, form, load_scanned_type(request.sensor_type).value)


def analyse_frames(
    recording: Recording,
    request: AnalyseRequest,
    sensor_type: SensorType | None = None,
    *,
    tell: Tell = lambda said: None,
) -> Analysed:
    """Analyse frames in memory as :func:`analyse_file` does those of a file; no report is written.

    Parameters
    ----------
    sensor_type : with the pattern of the frames, of a table; by default that of the request or the recording.

    Raises
    ------
    RecordingError
        If they hold no signal of a sensor, or do not fit the sensor type.
    CbsrError
        For the same reasons as the analysis of a file.
    """
    reconstruction = _reconstruction(request, discover())
    _check_shape(recording, sensor_type or _sensor_type(recording, request)[0])
    tell(f"analysing {len(recording.frames)} frames")
    result, unknown = _result(recording, sensor_type, reconstruction, request, tell)
    if (error := _missing_signal_error(recording.path, result)) is not None:
        raise error
    return replace(Analysed.from_result(recording.path, result), warnings=(*result.warnings, *unknown))


def _result(
    recording: Recording,
    table_type: SensorType | None,
    reconstruction: Reconstruction,
    request: AnalyseRequest,
    tell: Tell,
) -> tuple[RecordingResult, list[str]]:
    """Analyse a recording; returns remarks on its sensor type too, if that is not of a table."""
    sensor_type, unknown = _sensor_type(recording, request) if table_type is None else (table_type, [])
    choices = AnalysisChoices(request.correct_carry_over, sensor_type, request.chosen)
    return analyse_recording(recording, reconstruction, choices, tell=tell), unknown


def _check_shape(recording: Recording, sensor_type: SensorType | None) -> None:
    """Refuse frames in memory that are not those of the sensor type, or without one not of a ring of electrodes."""
    shape = recording.frames.voltages.shape[1:]
    if sensor_type is not None and shape != sensor_type.pattern.shape:
        expected_shapes = f"those of sensor type {sensor_type.name!r} are {sensor_type.pattern.shape}"
    elif sensor_type is None and shape[0] != shape[1]:
        expected_shapes = "without a sensor type, as many measure pairs as drive pairs are expected"
    else:
        return
    raise RecordingError(
        f"{recording.path.name} has frames of {shape}: drive pairs, measure pairs; {expected_shapes}",
        remedy="give whole frames, NaN for readings that were not measured, or the sensor type that was recorded",
    )


def _missing_signal_error(path: Path, result: RecordingResult) -> RecordingError | None:
    """Return the refusal of readings that show no sensor; None if they do."""
    recording = result.recording
    if result.channels.not_connected:
        return RecordingError(
            f"{path.name} holds no signal: all {len(recording.frames)} frames read"
            f" {np.median(recording.frames.voltages):g} {recording.frames.unit.value} everywhere, within their noise;"
            " nothing is connected",
            remedy="connect the sensor and record again",
        )
    if len(result.channels.saturated) == recording.frames.voltages[0].size:
        remedy = "lower the drive current or the amplifier's gain, and record again"
        return RecordingError(f"{path.name} is {result.events_why}", remedy=remedy)
    return None


def _sensor_type(recording: Recording, request: AnalyseRequest) -> tuple[SensorType | None, list[str]]:
    if request.sensor_type is not None:
        return load_sensor_type(request.sensor_type).value, []
    if recording.sensor_type is None:
        return None, []
    # A name, never a path: a file of unknown origin must not open others.
    if recording.sensor_type in list_shipped(DocumentKind.SENSOR_TYPE):
        return load_sensor_type(recording.sensor_type).value, []
    said = f"the recording states sensor type {echo(recording.sensor_type)}, which is not a shipped one"
    return None, [f"{said}; it is imaged on a nominal disc; give the file of the sensor type with --sensor-type"]


def _report(
    path: Path, result: RecordingResult, request: AnalyseRequest, plugins: Plugins
) -> tuple[Path | None, list[str]]:
    if not request.report:
        return None, []
    sections, warnings = load_sections((), plugins)
    file = reports_folder() / report_name(path.stem, result.recording.dataset, digest_request(path, request))
    write_report(file, render_recording(result, sections, warnings=warnings))
    return file, warnings
