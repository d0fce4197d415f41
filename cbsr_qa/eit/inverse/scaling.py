"""Scaling of a sensor's voltages to the unit model."""

from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, real_numbers
from cbsr_qa.eit.inverse.problem import reading_name

_LEAST_ALIKE: Final = 0.9  # cosine between a sensor's reference and the model's, in size


def scale_of(reference_voltages: Array, problem: ImagingProblem) -> float:
    """Scale of a sensor against the unit model, s = ⟨V_ref, reference⟩ / ⟨reference, reference⟩.

    A least-squares fit of current over sheet conductance; counts do as well as volts.

    Parameters
    ----------
    reference_voltages : (drives, measures) voltages of the unloaded sensor; only used readings matter.

    Raises
    ------
    NumericsError
        If a used reading is not a finite real number, the shape is another, or the readings are orthogonal to the
        model's.
    """
    readings = _select_frame(reference_voltages, problem)
    scale = float(readings @ problem.reference / (problem.reference @ problem.reference))
    if abs(scale) * np.linalg.norm(problem.reference) <= 1e-6 * np.linalg.norm(readings) or scale == 0:
        raise NumericsError(
            "the reference frame is uncorrelated with the model's (all zero, or electrodes in another order)",
            remedy="check the electrode numbering of the sensor type and that the source was on",
        )
    return scale


def agreement(reference_voltages: Array, problem: ImagingProblem) -> float:
    """Cosine between a reference frame and the unit model's; near −1 the polarity is reversed."""
    readings = _select_frame(reference_voltages, problem)
    length = float(np.linalg.norm(readings) * np.linalg.norm(problem.reference))
    return float(readings @ problem.reference) / length if length else 0.0


def scale_doubts(reference_voltages: Array, problem: ImagingProblem) -> tuple[str, ...]:
    """Warnings about the scale of a reference frame; empty if its cosine with the model's is at least 0.9."""
    cosine = agreement(reference_voltages, problem)
    if abs(cosine) >= _LEAST_ALIKE:
        return ()
    return (
        f"the unloaded frame matches the model's with a cosine of {cosine:.2f} (1 is equal): its readings have an"
        " offset, or electrodes are misplaced or in another order; image amplitudes are not reliable",
    )


def changes(voltages: Array, reference: Array, problem: ImagingProblem, scale: float) -> Array:
    """Scaled changes of the used readings, the input of :meth:`LinearReconstruction.images`.

    Parameters
    ----------
    voltages : (n, drives, measures). reference : (drives, measures). scale : of :func:`scale_of`.

    Returns
    -------
    (n, m) float64.

    Raises
    ------
    NumericsError
        If a used reading or the scale is not a finite real number, the scale is zero or so small that changes over it
        overflow, or shapes disagree.
    """
    _check_scale(scale)
    with np.errstate(over="ignore"):
        changed: Array = (_select_frames(voltages, problem) - _select_frame(reference, problem)) / scale
    bad_entries = np.argwhere(~np.isfinite(changed))
    if bad_entries.size:
        frame, channel = bad_entries[0]
        raise NumericsError(
            f"the change of {reading_name(problem.used, channel)} of frame {frame} over the scale {scale:g} is too"
            " large for a number",
            remedy="use the scale of the sensor's own unloaded frame (scale_of), in the unit of the voltages",
        )
    return changed


def _check_scale(scale: float) -> None:
    number = real_numbers(scale, "scales of a sensor")
    if number.ndim or not np.isfinite(number) or number == 0:
        raise NumericsError(
            f"the scale of the sensor is {scale}; it must be a finite number other than zero",
            remedy="use that of its unloaded frame (scale_of)",
        )


def _select_frame(voltages: Array, problem: ImagingProblem) -> Array:
    frame = real_numbers(voltages, "voltages")
    if frame.shape != problem.used.shape:
        raise NumericsError(
            f"reference of shape {frame.shape} does not match frames of shape {problem.used.shape}",
            remedy="give one frame, by drive and measure pair",
        )
    readings: Array = _select_frames(frame[None], problem)[0]
    return readings


def _select_frames(voltages: Array, problem: ImagingProblem) -> Array:
    voltages = real_numbers(voltages, "voltages")
    if voltages.ndim != 3 or voltages.shape[1:] != problem.used.shape:
        raise NumericsError(
            f"voltages of shape {voltages.shape} do not match frames of shape {problem.used.shape}",
            remedy="give an array of frames, each by drive and measure pair",
        )
    readings: Array = voltages[:, problem.used]
    if not np.isfinite(readings).all():
        frame, channel = np.argwhere(~np.isfinite(readings))[0]
        raise NumericsError(
            f"{reading_name(problem.used, channel)} of frame {frame} is not a finite number",
            remedy="leave its channel out of the problem (`used`)",
        )
    return readings
