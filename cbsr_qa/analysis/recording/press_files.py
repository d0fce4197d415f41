"""Files of labelled presses: readings in a table (row per press) or a recording (frame per press), and labels."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cbsr_qa.analysis.recording.reading import read_recording_file
from cbsr_qa.calibration.place.pairs import DistinctPairs
from cbsr_qa.calibration.presses.inputs import LabelledPresses, PressReadings, read_press_readings, shift_rows
from cbsr_qa.calibration.presses.tables import read_pairs, read_presses, source_file
from cbsr_qa.calibration.runtime.press_calibration import check_pressed_recording
from cbsr_qa.config.loader import load_pressed_type
from cbsr_qa.domain.errors import RecordingError, RefusedError
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock, Recording
from cbsr_qa.domain.results.press_calibration import SourceFile
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.plugin.discovery import discover


@dataclass(frozen=True, slots=True)
class PressFiles:
    """Input of learning; see the options of ``cbsr-qa calibrate``.

    Parameters
    ----------
    readings : table, or a recording with one frame per press.
    sensor_type : name or file.
    pattern : pattern of the tables' columns; None if the readings are a recording.
    differences : whether the readings are changes.
    rest : frames of the unloaded sheet, in the form of the readings.
    row_shift : number of rows by which places stand below their readings; rows without a partner are left out.
    """

    readings: Path
    presses: Path
    sensor_type: str
    pattern: Path | None = None
    differences: bool = False
    rest: Path | None = None
    row_shift: int = 0


def read_labelled_presses(files: PressFiles) -> tuple[LabelledPresses, tuple[SourceFile, ...]]:
    """Read presses, with the names of their files.

    Raises
    ------
    RefusedError
        If the tables, the pattern or the sensor type cannot be used; see
        :func:`~cbsr_qa.calibration.presses.inputs.read_press_readings`.
    """
    if files.differences == (files.rest is not None):
        given_options = (
            "both --differences and --rest are" if files.differences else "neither --differences nor --rest is"
        )
        raise RefusedError(
            f"{given_options} given",
            remedy="give --differences if the readings are changes, or --rest FILE with frames of the unloaded sheet",
        )
    loaded_type, sized = load_pressed_type(files.sensor_type, scanned=files.pattern is not None)
    presses = read_presses(files.presses)
    labelled = LabelledPresses(loaded_type.value, sized, _readings(files, loaded_type.value), presses)
    if files.row_shift:
        labelled = shift_rows(labelled, files.row_shift)
    if labelled.presses.time_s is None and labelled.readings.time_s is not None:
        labelled = replace(labelled, presses=replace(labelled.presses, time_s=labelled.readings.time_s))
    named_paths = {"readings": files.readings, "presses": files.presses, "pattern": files.pattern}
    named_paths |= {"rest": files.rest, "sensor type": loaded_type.document.path}
    return labelled, tuple(source_file(role, path) for role, path in named_paths.items() if path is not None)


def read_pressed_recording(path: Path, format_: str | None = None, dataset: str | None = None) -> Recording:
    """Read a recording of presses; RecordingError as of any other, with the hint that tables have a pattern.

    Parameters
    ----------
    format_, dataset : format, and data set of several; by default as detected.
    """
    try:
        return read_recording_file(path, discover(), format_=format_, dataset=dataset)
    except RecordingError as error:
        remedy = "; a table of readings needs --pattern" if "no known format" in error.reason else ""
        raise RecordingError(error.reason, remedy=error.remedy + remedy) from error


def read_whole_frames(path: Path, pattern: DrivePattern) -> FrameBlock:
    """Read frames of presses, or of the unloaded sheet, whose usable readings must all be there.

    Raise RecordingError if the recording cannot be read, has another pattern, or a reading is missing or saturated.
    """
    recording = read_pressed_recording(path)
    check_pressed_recording(recording, pattern)
    bad = np.argwhere(((recording.frames.flags & UNUSABLE) != 0) & pattern.usable())
    if len(bad):
        frame, drive, measure = bad[0].tolist()
        raise RecordingError(
            f"{path.name}: {len(bad)} readings are missing or saturated, first in frame {frame}, drive pair {drive},"
            f" measure pair {measure} (all from 0)",
            remedy="leave out that press in both files",
        )
    return recording.frames


def _readings(files: PressFiles, sensor_type: SensorType) -> PressReadings:
    if files.pattern is not None:
        pairs = read_pairs(files.pattern, sensor_type.electrodes.count)
        return read_press_readings(files.readings, pairs, files.rest)
    if files.readings.suffix.lower() in (".parquet", ".pq"):
        raise RefusedError(
            f"{files.readings} is a table, and --pattern is missing",
            remedy="give --pattern FILE with source,sink,plus,minus of each column",
        )
    pattern = sensor_type.pattern
    distinct = DistinctPairs.from_pattern(pattern)
    frames = read_whole_frames(files.readings, pattern).voltages[:, pattern.usable()]
    if files.rest is None:
        return PressReadings(files.readings, distinct, frames)
    rest_readings = read_whole_frames(files.rest, pattern).voltages[:, pattern.usable()]
    noise = rest_readings.std(axis=0, ddof=1) if len(rest_readings) > 1 else None
    return PressReadings(
        files.readings, distinct, frames - rest_readings.mean(axis=0), rest_readings.mean(axis=0), noise
    )
