"""A recording compared with a reference that was recorded apart."""

from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import RecordingError, RowProblem
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import ReadingFlag, Recording, ScanKind

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
