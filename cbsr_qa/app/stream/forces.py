"""Forces and places of single frames, by a calibration of either kind, as a stream tells them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Protocol

import numpy as np

from cbsr_qa.analysis.recording.press_files import distinct_pairs
from cbsr_qa.app.calibration.apply_places import PressedPlaces, pattern_of, read_calibration_file
from cbsr_qa.app.calibration.frame_scale import FrameScale, whole_readings
from cbsr_qa.calibration.force.inverse import NO_FORCE, Flag
from cbsr_qa.calibration.runtime.runtime import Calibration
from cbsr_qa.calibration.runtime.settling_forces import SettlingForces
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import CalibrationError, RecordingError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import FrameBlock
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import Calibration as IssuedByRun
from cbsr_qa.domain.results.press_calibration import PressCalibration
from cbsr_qa.domain.sensor.sensor_type import SensorType

#: Of dᵀΣ⁻¹d that holds 68 % and 95 % of a normal distribution over two axes.
_Q68, _Q95 = (float(-2 * np.log(1 - share)) for share in (0.6827, 0.95))
_AXES: Final = "mm from the sheet's centre, as the sensor type places its electrodes"
_PRESSED_AXES: Final = "mm, in the frame of the labels of the presses that calibrated"


@dataclass(frozen=True, slots=True)
class Estimate:
    """What one frame tells; fields as of :class:`~cbsr_qa.app.stream.messages.FrameMessage`."""

    force_N: float | None
    force_68_N: tuple[float, float] | None
    force_95_N: tuple[float, float] | None
    x_mm: float | None
    y_mm: float | None
    radius_68_mm: float | None
    radius_95_mm: float | None
    touch: bool | None
    flags: tuple[str, ...]
    settled_in_s: float | None


@dataclass(frozen=True, slots=True)
class CalibrationIdentity:
    """What a header says of a calibration; fields as of :class:`~cbsr_qa.app.stream.messages.HeaderMessage`."""

    serial: str
    calibration: str
    calibration_digest: str
    kind: Literal["run", "presses"]
    force: bool
    axes: str


class FrameForces(Protocol):
    """A calibration that turns frames into estimates, one after the other."""

    sensor_type: SensorType
    indenter: Indenter
    identity: CalibrationIdentity

    def scale(self, name: str, first: FrameBlock, reference: int | None) -> tuple[str, ...]:
        """Find the scale of frames by the first ones, and return remarks.

        RecordingError or CalibrationError as of ``cbsr-qa calibration apply``; ``name`` of the frames, in messages.
        """
        ...

    def estimates(self, frames: FrameBlock) -> list[Estimate]:
        """Return what each of the next frames tells."""
        ...


def frame_forces(calibration: Path, sensor_type: str | None = None, public_key: Path | None = None) -> FrameForces:
    """Make a calibration file ready for a stream.

    Parameters
    ----------
    sensor_type : file or name of the sensor type of a calibration from presses; by default the shipped one of its
        name. Calibrations of runs hold their own.
    public_key : file with the key that must have signed the calibration; None: not checked.

    Raises
    ------
    CalibrationError
        If the file cannot be used, or is not signed by that key.
    ConfigError
        If there is no such sensor type, or the key cannot be used.
    """
    issued = read_calibration_file(calibration, public_key)
    if isinstance(issued, PressCalibration):
        return _OfPresses(calibration, issued, load_sensor_type(sensor_type or issued.sensor_type).value)
    if sensor_type is not None:
        raise CalibrationError(f"{calibration} holds its sensor type", remedy="leave --sensor-type out")
    return _OfRun(issued)


class _OfRun:
    def __init__(self, issued: IssuedByRun) -> None:
        self._calibration = Calibration(issued)
        self._follow, self._scale = SettlingForces(self._calibration), FrameScale(1.0)
        self._calibration.force(issued.reference)  # what is worked out once is not waited for in the first frame
        self.sensor_type, self.indenter = issued.sensor_type, issued.indenter
        self.identity = CalibrationIdentity(
            issued.sensor.serial, issued.calibration, issued.digest, "run", True, _AXES
        )

    def scale(self, name: str, first: FrameBlock, reference: int | None) -> tuple[str, ...]:
        self._scale = FrameScale.from_frames(self._calibration, name, first, reference)
        return self._scale.remarks

    def estimates(self, frames: FrameBlock) -> list[Estimate]:
        in_turn = zip(frames.time_s.tolist(), self._scale.voltages(frames), strict=True)
        return [self._estimate(time_s, frame) for time_s, frame in in_turn]

    def _estimate(self, time_s: float, frame: Array) -> Estimate:
        forces, settled_in_s = self._follow.add_frame(time_s, frame)
        force_N, flags, radius_mm = float(forces.force_N[0]), int(forces.flags[0]), float(forces.place_stderr_mm[0])
        intervals = [(float(low[0]), float(high[0])) for low, high in map(forces.interval_N, (0.6827, 0.95))]
        known = bool(np.isfinite(force_N))
        # A released load has a force of exactly 0 as long as the sheet shows it.
        presses = known and force_N != 0 and not flags & Flag.NOT_DETECTED
        placed = presses and bool(np.isfinite([*forces.place_mm[0], radius_mm]).all())
        return Estimate(
            force_N if known else None,
            intervals[0] if np.isfinite(intervals[0]).all() else None,
            intervals[1] if np.isfinite(intervals[1]).all() else None,
            float(forces.place_mm[0, 0]) if placed else None,
            float(forces.place_mm[0, 1]) if placed else None,
            radius_mm * float(np.sqrt(_Q68)) if placed else None,
            radius_mm * float(np.sqrt(_Q95)) if placed else None,
            None if flags & NO_FORCE else presses,
            flag_names(flags),
            float(settled_in_s[0]) if np.isfinite(settled_in_s[0]) else None,
        )


class _OfPresses:
    def __init__(self, file: Path, issued: PressCalibration, sensor_type: SensorType) -> None:
        self.sensor_type, self.indenter = sensor_type, Indenter(13.0)
        pattern, given = pattern_of(issued), sensor_type.pattern
        if (given.drive, given.measure) != (pattern.drive, pattern.measure):
            raise CalibrationError(
                f"sensor type {sensor_type.name!r} has another pattern than the calibration {file}",
                remedy="give --sensor-type FILE, the sensor type that it was learned with",
            )
        self._places, self._usable = PressedPlaces(issued, distinct_pairs(pattern)), pattern.usable()
        self._rest: Array | None = None
        self.identity = CalibrationIdentity(
            "", issued.calibration, issued.digest, "presses", issued.force is not None, _PRESSED_AXES
        )

    def scale(self, name: str, first: FrameBlock, reference: int | None) -> tuple[str, ...]:
        rows = self._rows(first)
        if reference is not None:
            if not np.isfinite(rows).all():
                raise RecordingError(f"a reading of the first {reference} frames of {name} is missing or saturated")
            self._rest = rows.mean(axis=0)
        self._locate(rows[:1])  # refuses frames that cannot be compared with anything
        return ("a calibration from presses states no serial number: that it is of this sensor is not checked",)

    def estimates(self, frames: FrameBlock) -> list[Estimate]:
        return [self._estimate(row) for row in self._rows(frames)]

    def _rows(self, frames: FrameBlock) -> Array:
        return whole_readings(frames)[:, self._usable]

    def _locate(self, rows: Array) -> Any:
        return self._places(rows if self._rest is None else rows - self._rest, relative=self._rest is not None)

    def _estimate(self, row: Array) -> Estimate:
        (frame,) = self._locate(row[None])
        spread = frame.covariance_mm2
        radius_mm = 0.0 if spread is None else float(np.sqrt(max(np.linalg.eigvalsh(spread)[-1], 0.0)))
        blind = "unreadable" in frame.flags
        presses = not blind and "not_detected" not in frame.flags
        placed = presses and spread is not None
        return Estimate(
            frame.force_N,
            frame.force_68_N,
            frame.force_95_N,
            frame.x_mm if placed else None,
            frame.y_mm if placed else None,
            radius_mm * float(np.sqrt(self._places.q68)) if placed else None,
            radius_mm * float(np.sqrt(self._places.q95)) if placed else None,
            None if blind else presses,
            frame.flags,
            None,
        )


def flag_names(flags: int) -> tuple[str, ...]:
    """Return the names of flags, in lower case."""
    return tuple(_NAMES[bit] for bit in _NAMES if flags & bit)


_NAMES: Final[Mapping[int, str]] = {int(flag): str(flag.name).lower() for flag in Flag}
