"""Frames brought to the scale of a calibration: by their drive current, or by first frames of the unloaded sheet."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from cbsr_qa.calibration.runtime.estimator import mask_unusable
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, ScanKind, VoltageUnit
from cbsr_qa.domain.results.calibration import Calibration

#: Largest relative difference, once scaled, of unloaded readings of the same sheet from the calibration's: more than
#: drift, and far less than another order of electrodes causes. Chosen by us.
_MOST_APART: Final = 0.2
_REFERENCE: Final = (
    "give --reference N if its first N frames are of the unloaded sheet: they are then scaled to the calibration's"
    " own unloaded frame"
)


@dataclass(frozen=True, slots=True, eq=False)
class FrameScale:
    """Scale and offset that turn readings into voltages at the calibration's current.

    Parameters
    ----------
    ratio : V of the calibration in one unit of the readings.
    own, reference : (drives, measures) unloaded readings, and the calibration's that replace them; 0 to keep those.
    remarks : sentences that say what is done.
    """

    ratio: float
    own: Array | float = 0.0
    reference: Array | float = 0.0
    remarks: tuple[str, ...] = ()

    def voltages(self, frames: FrameBlock) -> Array:
        """Return (n, drives, measures) voltages at the calibration's current [V], NaN where flagged."""
        return (mask_unusable(frames) - self.own) * self.ratio + self.reference

    @classmethod
    def from_frames(cls, issued: Calibration, name: str, frames: FrameBlock, reference: int | None) -> Self:
        """Find the scale of frames.

        Parameters
        ----------
        issued : calibration to whose current they are brought.
        name : name of the frames in messages.
        reference : number of first frames of the unloaded sheet; their mean, scaled by least squares, replaces the
            calibration's reference. None to keep the latter.

        Raises
        ------
        RecordingError
            If unit or current are not stated, or the first frames are not those of this sensor.
        """
        if reference is not None:
            return cls._from_own_reference(issued, name, frames, reference)
        if frames.unit is not VoltageUnit.VOLT:
            raise RecordingError(
                f"{name} holds readings in {frames.unit.value} without their scale; the calibration of"
                f" sensor {issued.sensor.serial} is in volts",
                remedy=_REFERENCE,
            )
        current_A, calibrated_A = frames.current_A, issued.current_A
        if current_A is None:
            raise RecordingError(
                f"{name} does not say its drive current, which scales every reading", remedy=_REFERENCE
            )
        if not current_A > 0:
            raise RecordingError(f"{name} states a drive current of {current_A:g} A")
        if np.isclose(current_A, calibrated_A, rtol=1e-9):
            return cls(1.0)
        remark = f"readings at {1e3 * current_A:.4g} mA were scaled to the calibration's {1e3 * calibrated_A:.4g} mA"
        return cls(calibrated_A / current_A, remarks=(remark,))

    @classmethod
    def _from_own_reference(cls, issued: Calibration, name: str, frames: FrameBlock, count: int) -> Self:
        if not 1 <= count <= len(frames):
            raise RecordingError(
                f"--reference {count} of {name}, which holds {len(frames)} frames; 1 to {len(frames)} are allowed"
            )
        used_mask = issued.reconstruction.problem.used
        mean_frame, reference = mask_unusable(frames)[:count].mean(axis=0), issued.reference
        mean_readings, reference_readings = mean_frame[used_mask], reference[used_mask]
        if not np.isfinite(mean_readings).all():
            raise RecordingError(f"a used reading of the first {count} frames of {name} is missing or saturated")
        power = float(mean_readings @ mean_readings)
        ratio = float(mean_readings @ reference_readings) / power if power > 0 else 0.0
        relative_difference = float(
            np.linalg.norm(ratio * mean_readings - reference_readings) / np.linalg.norm(reference_readings)
        )
        if not (ratio > 0 and relative_difference <= _MOST_APART):
            raise RecordingError(
                f"the first {count} frames of {name} are not those of sensor {issued.sensor.serial}"
                f" unloaded: scaled as well as can be they differ from its reference by {relative_difference:.0%};"
                f" {_MOST_APART:.0%} is allowed",
                remedy="check the sensor, the order of its electrodes, and that nothing pressed",
            )
        remark = (
            f"changes are against the first {count} frames, of which 1 {frames.unit.value} is {ratio:.6g} V of the"
            f" calibration; unloaded they differ from its reference by {relative_difference:.2%}, and their own noise"
            f" (1/{count} of a frame's variance) is not in the standard errors"
        )
        return cls(ratio, mean_frame, reference, (remark,))


def check_recording(issued: Calibration, recording: Recording) -> None:
    """Refuse a recording of another sensor type, scan or geometry than a calibration: RecordingError names it."""
    name = recording.path.name
    if recording.sensor_type not in (None, issued.sensor_type.name):
        raise RecordingError(
            f"{name} is of sensor type {recording.sensor_type}, the calibration is of a {issued.sensor_type.name}",
            remedy="apply the calibration that was issued for this sensor",
        )
    if recording.scan is not ScanKind.FULL or recording.magnitudes_only:
        content = "absolute values" if recording.magnitudes_only else "driven pairs alone"
        raise RecordingError(f"{name} holds {content}; a force needs every reading with its sign")
    frame_shape, calibrated_shape = recording.frames.voltages.shape[1:], issued.reference.shape
    if frame_shape != calibrated_shape:
        raise RecordingError(
            f"{name} holds frames of {frame_shape[0]} × {frame_shape[1]} readings, the calibration is for"
            f" {calibrated_shape[0]} × {calibrated_shape[1]}"
        )
    if not len(recording.frames):
        raise RecordingError(f"{name} holds no frame")
