"""Whether one recording can be the reference of another."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RecordingError, RowProblem
from cbsr_qa.domain.frames import ReadingFlag
from cbsr_qa.domain.recording import Recording, ScanKind

#: Ratio of the readings' sizes. Rods in a tank change it by 8 %, a sheet measured again differs by 16 %.
_MOST_SCALE: Final = 1.5
#: Correlation of the frames. Two rods in a tank leave 0.98; a chest against a tank, by one instrument, has 0.85.
_LEAST_ALIKE: Final = 0.9
#: Difference of the offsets of counts, in sizes of the readings.
_MOST_OFFSET: Final = 0.5
#: The same drive current, as far as it is stated.
_SAME_CURRENT: Final = 0.1

Array = NDArray[np.float64]
_REMEDY: Final = "name a recording of the same domain, empty, by the same instrument with the same settings"


def with_reference(recording: Recording, empty: Recording) -> Recording:
    """Return a recording with another one's frames as its reference.

    Parameters
    ----------
    recording, empty : each as its own format read it.

    Raises
    ------
    RecordingError
        If the two are not of one instrument and scale: then every reading would have "changed".
    """
    name = f"{empty.path.name}:{empty.dataset}" if empty.dataset else empty.path.name
    why = _difference(recording, empty)
    if why:
        raise RecordingError(f"{name} cannot be the reference of {recording.path.name}: {why}", remedy=_REMEDY)
    noted = tuple(RowProblem(p.line, f"reference {name}: {p.what}", False) for p in empty.problems)
    return replace(
        recording,
        reference=empty.frames,
        problems=(*recording.problems, *noted),
        notes=(*recording.notes, f"changes are against {'the mean of ' if len(empty.frames) > 1 else ''}{name}"),
        simulated=(*recording.simulated, *(f"in the reference {name}: {what}" for what in empty.simulated)),
    )


def _difference(recording: Recording, empty: Recording) -> str:
    """Say what tells two recordings apart; empty if they can be compared."""
    own, other = recording.frames, empty.frames
    if other.voltages.shape[1:] != own.voltages.shape[1:] or empty.scan is not recording.scan:
        return f"its frames are {_shape(empty)}, not {_shape(recording)}"
    if other.unit is not own.unit:
        return f"its readings are in {other.unit.value}, not in {own.unit.value}"
    if empty.magnitudes_only is not recording.magnitudes_only:
        held = {True: "absolute values", False: "values with their sign"}
        return f"it holds {held[empty.magnitudes_only]}, not {held[recording.magnitudes_only]}"
    return _stated_difference(recording, empty) or _scale_difference(recording, empty)


def _stated_difference(recording: Recording, empty: Recording) -> str:
    """Compare what both files state; what one of them leaves open does not count."""
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
    """Compare level, size and pattern of the typical frames, over readings both hold."""
    missing = ReadingFlag.MISSING.value
    held = ((recording.frames.flags & missing) == 0).any(axis=0) & ((empty.frames.flags & missing) == 0).any(axis=0)
    own, other = (np.median(each.frames.voltages, axis=0)[held] for each in (recording, empty))
    if own.size == 0:
        return "they have no reading in common"
    offset, other_offset = (
        (0.0, 0.0) if recording.magnitudes_only else (float(np.median(own)), float(np.median(other)))
    )
    size, other_size = _size(own - offset), _size(other - other_offset)
    if size == 0.0:
        return ""  # an unconnected recording is refused for that
    if other_size == 0.0:
        return f"all its readings are {other[0]:.4g} {empty.frames.unit.value}: nothing was connected"
    if not 1 / _MOST_SCALE <= other_size / size <= _MOST_SCALE:
        return f"its readings are {other_size / size:.3g} times as large"
    if abs(other_offset - offset) > _MOST_OFFSET * max(size, other_size):
        unit = recording.frames.unit.value
        return f"its readings lie about {other_offset:.4g} {unit}, not {offset:.4g} {unit}"
    alike = float((own - offset) @ (other - other_offset)) / (size * other_size * own.size)
    return "" if alike >= _LEAST_ALIKE else f"its readings have another pattern (correlation {alike:.2f})"


def _size(readings: Array) -> float:
    return float(np.sqrt(np.mean(readings**2)))
