"""Frames of a recording as the volts a calibration is of, or why they are not."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate.runtime import Calibration
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.frames import FrameBlock, ReadingFlag, VoltageUnit
from cbsr_qa.domain.recording import Recording, ScanKind

Array = NDArray[np.float64]

#: Readings of the same sheet, unloaded, differ from the calibration's by this share of their size at most once they
#: are scaled: more than a sensor drifts by, and far less than another order of electrodes makes. Chosen by us.
_MOST_APART: Final = 0.2
_BAD: Final = int(ReadingFlag.SATURATED | ReadingFlag.COMPLIANCE | ReadingFlag.MISSING)
_REFERENCE: Final = (
    "give --reference N if its first N frames are of the unloaded sheet: they are then scaled to the calibration's"
    " own unloaded frame"
)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrames:
    """Frames that a calibration can be applied to.

    Parameters
    ----------
    voltages : (n, drives, measures) [V] at the calibration's current; NaN where a reading was flagged.
    remarks : what was done to them, in words.
    """

    voltages: Array
    remarks: tuple[str, ...]


def recorded_frames(calibration: Calibration, recording: Recording, reference: int | None) -> RecordedFrames:
    """Bring the frames of a recording to the calibration's scale.

    Parameters
    ----------
    reference : how many of the first frames are of the unloaded sheet; their mean takes the place of the
        calibration's reference, scaled to it by least squares. None where changes are against the calibration's own.

    Raises
    ------
    RecordingError
        If the recording is of another sensor type, scan, geometry, unit or scale, or its first frames are not those
        of this sensor.
    """
    _check(calibration, recording)
    frames = recording.frames
    voltages = np.where((frames.flags & _BAD) != 0, np.nan, frames.voltages)
    if reference is not None:
        return _against_own(calibration, recording, voltages, reference)
    if frames.unit is not VoltageUnit.VOLT:
        raise RecordingError(
            f"{recording.path.name} holds readings in {frames.unit.value} without their scale; the calibration of"
            f" sensor {calibration.issued.sensor.serial} is in volts",
            remedy=_REFERENCE,
        )
    ratio, remarks = _current_ratio(calibration, recording, frames)
    return RecordedFrames(voltages * ratio, remarks)


def _check(calibration: Calibration, recording: Recording) -> None:
    issued, name = calibration.issued, recording.path.name
    if recording.sensor_type not in (None, issued.sensor_type.name):
        raise RecordingError(
            f"{name} is of sensor type {recording.sensor_type}, the calibration is of a {issued.sensor_type.name}",
            remedy="apply the calibration that was issued for this sensor",
        )
    if recording.scan is not ScanKind.FULL or recording.magnitudes_only:
        held = "absolute values" if recording.magnitudes_only else "driven pairs alone"
        raise RecordingError(f"{name} holds {held}; a force needs every reading with its sign")
    found, wanted = recording.frames.voltages.shape[1:], issued.reference.shape
    if found != wanted:
        raise RecordingError(
            f"{name} holds frames of {found[0]} × {found[1]} readings, the calibration is for"
            f" {wanted[0]} × {wanted[1]}"
        )
    if not len(recording.frames):
        raise RecordingError(f"{name} holds no frame")


def _current_ratio(
    calibration: Calibration, recording: Recording, frames: FrameBlock
) -> tuple[float, tuple[str, ...]]:
    current_A, own_A = frames.current_A, calibration.issued.current_A
    if current_A is None:
        raise RecordingError(
            f"{recording.path.name} does not say its drive current, which scales every reading", remedy=_REFERENCE
        )
    if not current_A > 0:
        raise RecordingError(f"{recording.path.name} states a drive current of {current_A:g} A")
    if np.isclose(current_A, own_A, rtol=1e-9):
        return 1.0, ()
    said = f"readings at {1e3 * current_A:.4g} mA were scaled to the calibration's {1e3 * own_A:.4g} mA"
    return own_A / current_A, (said,)


def _against_own(calibration: Calibration, recording: Recording, voltages: Array, count: int) -> RecordedFrames:
    name, frames = recording.path.name, len(voltages)
    if not 1 <= count <= frames:
        raise RecordingError(f"--reference {count} of {name}, which holds {frames} frames; 1 to {frames} are allowed")
    used = calibration.issued.reconstruction.problem.used
    own, reference = voltages[:count].mean(axis=0), calibration.issued.reference
    seen, known = own[used], reference[used]
    if not np.isfinite(seen).all():
        raise RecordingError(f"a used reading of the first {count} frames of {name} is missing or saturated")
    power = float(seen @ seen)
    ratio = float(seen @ known) / power if power > 0 else 0.0
    apart = float(np.linalg.norm(ratio * seen - known) / np.linalg.norm(known))
    if not (ratio > 0 and apart <= _MOST_APART):
        raise RecordingError(
            f"the first {count} frames of {name} are not those of sensor {calibration.issued.sensor.serial} unloaded:"
            f" scaled as well as can be they differ from its reference by {apart:.0%}; {_MOST_APART:.0%} is allowed",
            remedy="check the sensor, the order of its electrodes, and that nothing pressed",
        )
    unit = recording.frames.unit.value
    said = (
        f"changes are against the first {count} frames, of which 1 {unit} is {ratio:.6g} V of the calibration;"
        f" unloaded they differ from its reference by {apart:.2%}, and their own noise (1/{count} of a frame's"
        " variance) is not in the standard errors"
    )
    return RecordedFrames((voltages - own) * ratio + reference, (said,))
