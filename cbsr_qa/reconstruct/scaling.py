"""From a sensor's volts to the unit model's."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem

Array = NDArray[np.float64]


def scale_of(reference_voltages: Array, problem: ImagingProblem) -> float:
    """Scale of a sensor against the unit model, s = ⟨V_ref, reference⟩ / ⟨reference, reference⟩.

    A least-squares fit of current over sheet conductance; counts do as well as volts.

    Parameters
    ----------
    reference_voltages : (drives, measures) of the unloaded sensor; only used readings are looked at.

    Raises
    ------
    NumericsError
        If a used reading is not finite, or the readings have nothing in common with the model's.
    """
    readings = _used(reference_voltages[None], problem)[0]
    scale = float(readings @ problem.reference / (problem.reference @ problem.reference))
    if abs(scale) * np.linalg.norm(problem.reference) <= 1e-6 * np.linalg.norm(readings) or scale == 0:
        raise NumericsError(
            "the reference frame has nothing in common with the model's (all zero, or electrodes in another order)",
            remedy="check the electrode numbering of the sensor type and that the source was on",
        )
    return scale


def agreement(reference_voltages: Array, problem: ImagingProblem) -> float:
    """Cosine between a reference frame and the unit model's, in −1 … 1.

    Near 1 the geometry, electrode order and polarity are right; near −1 the polarity is turned.
    """
    readings = _used(reference_voltages[None], problem)[0]
    length = float(np.linalg.norm(readings) * np.linalg.norm(problem.reference))
    return float(readings @ problem.reference) / length if length else 0.0


def changes(voltages: Array, reference: Array, problem: ImagingProblem, scale: float) -> Array:
    """Scaled changes of the used readings, what :meth:`LinearReconstruction.images` takes.

    Parameters
    ----------
    voltages : (n, drives, measures). reference : (drives, measures). scale : of :func:`scale_of`.

    Returns
    -------
    (n, m) float64.

    Raises
    ------
    NumericsError
        If a used reading or the scale is not a finite number, the scale is zero, or shapes disagree.
    """
    if not np.isfinite(scale) or scale == 0:
        raise NumericsError(f"the scale of the sensor is {scale}; it must be a finite number other than zero")
    changed: Array = (_used(voltages, problem) - _used(reference[None], problem)) / scale
    return changed


def _used(voltages: Array, problem: ImagingProblem) -> Array:
    if voltages.ndim != 3 or voltages.shape[1:] != problem.used.shape:
        raise NumericsError(f"voltages of shape {voltages.shape} do not fit frames of {problem.used.shape}")
    readings = np.asarray(voltages[:, problem.used], dtype=np.float64)
    if not np.isfinite(readings).all():
        frame, channel = np.argwhere(~np.isfinite(readings))[0]
        drive, measure = np.argwhere(problem.used)[channel]
        raise NumericsError(
            f"reading (drive {drive}, measure {measure}) of frame {frame} is not a finite number",
            remedy="leave its channel out of the problem (`used`)",
        )
    return readings
