"""Estimates that a stream sends of single frames, by a calibration of any kind."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cbsr_qa.calibration.force.inverse import flag_names
from cbsr_qa.calibration.loading import load_foreign_calibration
from cbsr_qa.calibration.runtime.estimator import Ability, Estimator, Interval, Touches, read_value
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.sensor_type import SensorType


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimate of one frame, with the fields of :class:`~cbsr_qa.app.stream.messages.FrameMessage`."""

    force_N: float | None
    force_68_N: Interval | None
    force_95_N: Interval | None
    x_mm: float | None
    y_mm: float | None
    radius_68_mm: float | None
    radius_95_mm: float | None
    touch: bool | None
    flags: tuple[str, ...]
    settled_in_s: float | None


def prepare_estimator(
    calibration: Path,
    sensor_type: str | None = None,
    public_key: Path | None = None,
    certificate: Path | None = None,
    withdrawn: Path | None = None,
) -> tuple[Estimator, SensorType]:
    """Make a calibration file ready for a stream, and find the sensor type of its frames.

    Parameters
    ----------
    sensor_type : file or name of the sensor type of a calibration that keeps only its name; by default the shipped
        one of that name.
    public_key, certificate, withdrawn : as :func:`~cbsr_qa.calibration.loading.load_calibration`.

    Raises
    ------
    CalibrationError
        If the file cannot be used, is not signed by that key, or its certificate has lapsed or was withdrawn.
    ConfigError
        If there is no such sensor type, or the key cannot be used.
    """
    estimator = load_foreign_calibration(calibration, public_key, certificate, withdrawn)
    if estimator.sensor_type is not None:
        if sensor_type is not None:
            raise CalibrationError(f"{calibration} holds its sensor type", remedy="leave --sensor-type out")
        estimator.prepare()
        return estimator, estimator.sensor_type
    given_type = load_sensor_type(sensor_type or estimator.identity.sensor_type).value
    calibrated_pattern = estimator.pattern
    if calibrated_pattern is None:
        raise CalibrationError(f"{calibration} {estimator.lacks[Ability.FRAMES]}", remedy="calibrate again")
    if (given_type.pattern.drive, given_type.pattern.measure) != (
        calibrated_pattern.drive,
        calibrated_pattern.measure,
    ):
        raise CalibrationError(
            f"sensor type {given_type.name!r} has another pattern than the calibration {calibration}",
            remedy="give --sensor-type FILE, the sensor type that it was learned with",
        )
    estimator.prepare()
    return estimator, given_type


def list_estimates(touches: Touches) -> list[Estimate]:
    """Return the estimate of each frame. An estimate has a place only where something presses."""
    return [_estimate_frame(touches, frame) for frame in range(len(touches))]


def _estimate_frame(touches: Touches, frame: int) -> Estimate:
    place = (*touches.place_mm[frame].tolist(), float(touches.radius_68_mm[frame]))
    has_place = bool(touches.touch[frame] and touches.readable[frame] and np.isfinite(place).all())
    x_mm, y_mm, radius_mm = place if has_place else (None, None, None)
    return Estimate(
        *read_value(touches.force, frame),
        x_mm,
        y_mm,
        radius_mm,
        _read_number(touches.radius_95_mm, frame) if has_place else None,
        bool(touches.touch[frame]) if touches.readable[frame] else None,
        flag_names(int(touches.flags[frame])),
        _read_number(touches.settled_in_s, frame),
    )


def _read_number(column: Array | None, frame: int) -> float | None:
    """Return a number of one frame; None where the calibration or the frame does not have it."""
    return None if column is None or not np.isfinite(column[frame]) else float(column[frame])
