"""Files of labelled presses: readings in a table (row per press) or a recording (frame per press), and labels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cbsr_qa.analysis.recording.reading import read_recording_file
from cbsr_qa.calibration.presses.inputs import LabelledPresses, PressReadings, read_press_readings
from cbsr_qa.calibration.presses.pairs import DistinctPairs
from cbsr_qa.calibration.presses.tables import read_pairs, read_presses, source_file
from cbsr_qa.config.loader import load_pressed_type
from cbsr_qa.domain.errors import RecordingError, RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import UNUSABLE, ScanKind
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
    pattern : of the tables' columns; None if the readings are a recording.
    differences : whether the readings are changes.
    rest : frames of the unloaded sheet, in the form of the readings.
    """

    readings: Path
    presses: Path
    sensor_type: str
    pattern: Path | None = None
    differences: bool = False
    rest: Path | None = None


def read_labelled_presses(files: PressFiles) -> tuple[LabelledPresses, tuple[SourceFile, ...]]:
    """Read presses, with the names of their files.

    Raises
    ------
    RefusedError
        If the tables, the pattern or the sensor type cannot be used; see
        :func:`~cbsr_qa.calibration.presses.inputs.read_press_readings`.
    """
    if files.differences == (files.rest is not None):
        found = "both --differences and --rest are" if files.differences else "neither --differences nor --rest is"
        raise RefusedError(
            f"{found} given",
            remedy="give --differences if the readings are changes, or --rest FILE with frames of the unloaded sheet",
        )
    loaded, sized = load_pressed_type(files.sensor_type)
    presses = read_presses(files.presses)
    labelled = LabelledPresses(loaded.value, sized, _readings(files, loaded.value), presses)
    named = {"readings": files.readings, "presses": files.presses, "pattern": files.pattern}
    named |= {"rest": files.rest, "sensor type": loaded.document.path}
    return labelled, tuple(source_file(role, path) for role, path in named.items() if path is not None)


def read_pressed_frames(path: Path, pattern: DrivePattern, rest: Path | None, reference: int | None) -> PressReadings:
    """Read frames of a recording as rows of its usable readings; NaN where one is missing or saturated.

    Parameters
    ----------
    pattern : of the frames.
    rest : recording of the unloaded sheet; ``reference`` how many first frames are of it. None without any.

    Raises
    ------
    RecordingError
        If a recording cannot be read, has another pattern, holds fewer frames, or frames at rest are not whole.
    """
    frames = _frames(path, pattern, whole=False)
    if reference is not None and not 1 <= reference <= len(frames):
        raise RecordingError(f"--reference {reference} of {path.name}; it holds {len(frames)} frames")
    if rest is None and reference is None:
        return PressReadings(path, distinct_pairs(pattern), frames)
    still = frames[:reference] if rest is None else _frames(rest, pattern)
    if not np.isfinite(still).all():
        raise RecordingError(f"a reading of the first {reference} frames of {path.name} is missing or saturated")
    return PressReadings(path, distinct_pairs(pattern), frames - still.mean(axis=0), still.mean(axis=0))


def distinct_pairs(pattern: DrivePattern) -> DistinctPairs:
    """Return the pairs of the usable readings of a frame, in its order."""
    return DistinctPairs.from_pairs(
        np.array([(*pattern.drive[d], *pattern.measure[m]) for d, m in np.argwhere(pattern.usable())])
    )


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
    distinct = distinct_pairs(pattern)
    frames = _frames(files.readings, pattern)
    if files.rest is None:
        return PressReadings(files.readings, distinct, frames)
    rest = _frames(files.rest, pattern)
    noise = rest.std(axis=0, ddof=1) if len(rest) > 1 else None
    return PressReadings(files.readings, distinct, frames - rest.mean(axis=0), rest.mean(axis=0), noise)


def _frames(path: Path, pattern: DrivePattern, *, whole: bool = True) -> Array:
    """Usable readings (n, m) of a recording, one frame per press; RecordingError if its pattern differs.

    Parameters
    ----------
    whole : refuse frames with readings that are missing or saturated, which are NaN otherwise.
    """
    try:
        recording = read_recording_file(path, discover(), format_=None, dataset=None)
    except RecordingError as error:
        remedy = "; a table of readings needs --pattern" if "no known format" in error.reason else ""
        raise RecordingError(error.reason, remedy=error.remedy + remedy) from error
    frames = recording.frames
    if recording.scan is not ScanKind.FULL or frames.voltages.shape[1:] != pattern.shape or recording.magnitudes_only:
        raise RecordingError(
            f"{path.name} holds frames of {frames.voltages.shape[1]} × {frames.voltages.shape[2]} readings; signed"
            f" ones of {pattern.shape[0]} × {pattern.shape[1]} are needed for the sensor type's pattern",
            remedy="give the sensor type that was recorded",
        )
    usable = pattern.usable()
    bad = np.argwhere(((frames.flags & UNUSABLE) != 0) & usable)
    if len(bad) and whole:
        frame, drive, measure = bad[0].tolist()
        raise RecordingError(
            f"{path.name}: {len(bad)} readings are missing or saturated, first in frame {frame}, drive pair {drive},"
            f" measure pair {measure} (all from 0)",
            remedy="leave out that press in both files",
        )
    return np.where((frames.flags & UNUSABLE) != 0, np.nan, frames.voltages)[:, usable]
