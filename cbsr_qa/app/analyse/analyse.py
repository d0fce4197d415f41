"""Recorded data through the same analysis and to the same report as a run."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from cbsr_qa.analysis.recording.analysis import DEFAULT_RECONSTRUCTION, AnalysisChoices, analyse_recording
from cbsr_qa.analysis.recording.reading import find_format, run_guarded
from cbsr_qa.analysis.recording.table_files import TableForm, read_table_recording
from cbsr_qa.app.analyse.outcome import Analysed, ReadRecording
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
    RowProblem,
)
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.readings.frames import ReadingFlag, ReadOptions, Recording, ScanKind
from cbsr_qa.domain.results.findings import RecordingResult
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import Reconstruction, RecordingFormat
from cbsr_qa.report.render import render_recording, report_name, write_report
from cbsr_qa.report.section import report_sections
from cbsr_qa.system.foreign import open_foreign
from cbsr_qa.system.words import echo

#: Ratio of the readings' sizes. Rods in a tank change it by 8 %, a sheet measured again differs by 16 %.
_MOST_SCALE: Final = 1.5
#: Correlation of the frames. Two rods in a tank leave 0.98; a chest against a tank, by one instrument, has 0.85.
_LEAST_ALIKE: Final = 0.9
#: Largest difference of the offsets of counts, relative to the size of the readings.
_MOST_OFFSET: Final = 0.5
#: Tolerance within which two stated drive currents are the same.
_SAME_CURRENT: Final = 0.1

_REMEDY: Final = "name a recording of the same domain, empty, by the same instrument with the same settings"


def with_reference(recording: Recording, empty: Recording) -> Recording:
    """Return a recording that takes its reference from another one.

    Parameters
    ----------
    recording, empty : recordings as read by their formats.

    Raises
    ------
    RecordingError
        If instrument or scale differ, so that every reading would have "changed".
    """
    name = f"{empty.path.name}:{empty.dataset}" if empty.dataset else empty.path.name
    difference = _difference(recording, empty)
    if difference:
        raise RecordingError(f"{name} cannot be the reference of {recording.path.name}: {difference}", remedy=_REMEDY)
    reference_problems = tuple(RowProblem(p.line, f"reference {name}: {p.what}", False) for p in empty.problems)
    return replace(
        recording,
        reference=empty.frames,
        problems=(*recording.problems, *reference_problems),
        notes=(*recording.notes, f"changes are against {'the mean of ' if len(empty.frames) > 1 else ''}{name}"),
        simulated=(*recording.simulated, *(f"in the reference {name}: {what}" for what in empty.simulated)),
    )


def _difference(recording: Recording, empty: Recording) -> str:
    """Return why two recordings cannot be compared; empty if they can."""
    own_frames, empty_frames = recording.frames, empty.frames
    if empty_frames.voltages.shape[1:] != own_frames.voltages.shape[1:] or empty.scan is not recording.scan:
        return f"its frames are {_shape(empty)}, not {_shape(recording)}"
    if empty_frames.unit is not own_frames.unit:
        return f"its readings are in {empty_frames.unit.value}, not in {own_frames.unit.value}"
    if empty.magnitudes_only is not recording.magnitudes_only:
        held = {True: "absolute values", False: "values with their sign"}
        return f"it holds {held[empty.magnitudes_only]}, not {held[recording.magnitudes_only]}"
    return _metadata_difference(recording, empty) or _scale_difference(recording, empty)


def _metadata_difference(recording: Recording, empty: Recording) -> str:
    current_A, other_A = recording.frames.current_A, empty.frames.current_A
    if recording.layout and empty.layout and empty.layout != recording.layout:
        return "its electrodes are numbered or placed in another way"
    if recording.sensor_type and empty.sensor_type and empty.sensor_type != recording.sensor_type:
        return f"it is of sensor type {empty.sensor_type}, not {recording.sensor_type}"
    if current_A and other_A and abs(other_A / current_A - 1) > _SAME_CURRENT:
        return f"its drive current is {other_A:.3g} A, not {current_A:.3g} A"
    return ""


def _shape(recording: Recording) -> str:
    drives, measures = recording.frames.voltages.shape[1:]
    return "one row of driven pairs" if recording.scan is ScanKind.DRIVEN_PAIRS else f"{drives} × {measures} readings"


def _scale_difference(recording: Recording, empty: Recording) -> str:
    """Compare level, size and pattern of the typical frames, over the readings they share."""
    missing = ReadingFlag.MISSING.value
    held = ((recording.frames.flags & missing) == 0).any(axis=0) & ((empty.frames.flags & missing) == 0).any(axis=0)
    own_readings, empty_readings = (np.median(each.frames.voltages, axis=0)[held] for each in (recording, empty))
    if own_readings.size == 0:
        return "they have no reading in common"
    offset, other_offset = (
        (0.0, 0.0)
        if recording.magnitudes_only
        else (float(np.median(own_readings)), float(np.median(empty_readings)))
    )
    size, other_size = _size(own_readings - offset), _size(empty_readings - other_offset)
    if size == 0.0:
        return ""  # an unconnected recording is refused as such
    if other_size == 0.0:
        return f"all its readings are {empty_readings[0]:.4g} {empty.frames.unit.value}: nothing was connected"
    if not 1 / _MOST_SCALE <= other_size / size <= _MOST_SCALE:
        return f"its readings are {other_size / size:.3g} times as large"
    if abs(other_offset - offset) > _MOST_OFFSET * max(size, other_size):
        unit = recording.frames.unit.value
        return f"its readings lie about {other_offset:.4g} {unit}, not {offset:.4g} {unit}"
    correlation = float((own_readings - offset) @ (empty_readings - other_offset)) / (
        size * other_size * own_readings.size
    )
    return "" if correlation >= _LEAST_ALIKE else f"its readings have another pattern (correlation {correlation:.2f})"


def _size(readings: Array) -> float:
    return float(np.sqrt(np.mean(readings**2)))


#: Called with each step, in words.
Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class AnalyseRequest:
    """What to analyse, and how.

    Parameters
    ----------
    format : name of a recording plugin; None to let the plugins recognise the file.
    sensor_type : file or shipped name; None for the one the recording states, else the nominal disc.
    dataset : one of several data sets in a file.
    reference : file, and a data set in it, with the unloaded domain; its format is recognised separately.
    correct_carry_over : None to decide by the estimate.
    report : whether to write a report.
    reconstruction, options : plugin that images the events (None for the usual one), and its options.
    table : how a table of frames is read; None if the file is a recording.
    """

    format: str | None = None
    sensor_type: str | None = None
    dataset: str | None = None
    reference: tuple[Path, str | None] | None = None
    correct_carry_over: bool | None = None
    report: bool = True
    reconstruction: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    table: TableForm | None = None

    @property
    def chosen(self) -> PluginChoice:
        name = DEFAULT_RECONSTRUCTION if self.reconstruction is None else self.reconstruction
        return PluginChoice(name, self.options)


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
    sections, warnings = report_sections((), plugins)
    file = reports_folder() / report_name(path.stem, result.recording.dataset, _request_digest(path, request))
    write_report(file, render_recording(result, sections, warnings=warnings))
    return file, warnings


def _request_digest(path: Path, request: AnalyseRequest) -> str:
    """Return eight digits of content and request, so that reports do not overwrite each other."""
    sha = hashlib.sha256()
    table = request.table
    others = [] if request.reference is None else [request.reference[0]]
    others += [] if table is None else [each for each in (table.pattern, table.rest) if each is not None]
    for each in (path, *others):
        with open_foreign(each) as file:
            sha.update(hashlib.file_digest(file, "sha256").digest())
    dataset = None if request.reference is None else request.reference[1]
    settings: tuple[object, ...] = (request.format, request.sensor_type, dataset, request.correct_carry_over)
    if request.reconstruction is not None or request.options:
        settings = (*settings, request.chosen.name, sorted(request.options.items()))
    if table is not None:
        settings = (*settings, table.differences, table.rest is None, table.complex_part)
    sha.update(repr(settings).encode())
    return sha.hexdigest()[:8]
