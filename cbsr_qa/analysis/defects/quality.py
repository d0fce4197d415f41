"""Quality of single readings: signal-to-noise ratio about a straight line in time, and reciprocity error."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import FrameBlock
from cbsr_qa.domain.sensor.patterns import DrivePattern

#: Fewest frames for which scatter about a straight line means anything.
FEWEST_FRAMES: Final = 3
_ROUNDING: Final = 1e-13  # of the largest level: less is rounding


def signal_to_noise_dB(frames: FrameBlock) -> Array | None:
    """Return the signal-to-noise ratio of every reading [dB], (drives, measures).

    The ratio is |mean| over the rms deviation from a straight line in time; drift does not count as noise.

    Returns
    -------
    +∞ for a reading exactly on its line, −∞ for one that is only noise about zero; None with fewer than three frames.
    """
    if len(frames) < FEWEST_FRAMES:
        return None
    level = np.abs(frames.voltages.mean(axis=0))
    readings = frames.voltages.reshape(len(frames), -1)
    squares = (subtract_trend(readings - readings.mean(axis=0), frames.time_s) ** 2).reshape(frames.voltages.shape)
    noise = np.sqrt(squares.sum(axis=0) / (len(frames) - 2))
    silent_mask = noise <= _ROUNDING * level.max(initial=0.0)
    ratio = level / np.where(silent_mask, 1.0, noise)
    loud = ratio > 0
    decibel = np.where(loud, 20 * np.log10(np.where(loud, ratio, 1.0)), -np.inf)
    return np.where(silent_mask, np.inf, decibel)


def reciprocity_errors(
    frame: Array, pattern: DrivePattern, usable: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Array]:
    """Return the reciprocity error of every pair of readings that should be equal.

    Parameters
    ----------
    frame : (drives, measures) float64.
    usable : (drives, measures); pairs with an unusable reading are left out.

    Returns
    -------
    pairs : (k, 2) int64, indices of readings in C order.
    errors : (k,) float64, |V_ij ∓ V_ji| over the rms of all these readings; empty without pairs, or if all readings
    are 0.
    """
    pairs, sign = pattern.reciprocal_pairs()
    usable_pairs = usable.ravel()[pairs].all(axis=1)
    first, second = frame.ravel()[pairs[usable_pairs]].T
    level = float(np.sqrt(np.mean(np.concatenate([first, second]) ** 2))) if usable_pairs.any() else 0.0
    if level == 0:
        return np.empty((0, 2), dtype=np.int64), np.empty(0)
    errors: Array = np.abs(first - sign[usable_pairs] * second) / level
    return pairs[usable_pairs], errors


def largest_by_reading(pairs: NDArray[np.int64], errors: Array, shape: tuple[int, int]) -> Array:
    """Return the largest error of the pairs each reading belongs to, (drives, measures); −1 without any."""
    largest = np.full(shape[0] * shape[1], -1.0)
    # Column by column: numpy's ufunc.at reads beyond operands that it must broadcast.
    for reading in pairs.T:
        np.maximum.at(largest, reading, errors)
    return largest.reshape(shape)


def subtract_trend(readings: Array, time_s: Array) -> Array:
    """Return the deviations of readings (n, m) from their straight lines in time (n,)."""
    q, _ = np.linalg.qr(np.column_stack([np.ones(len(time_s)), time_s - time_s.mean()]))
    return readings - q @ (q.T @ readings)
