"""Carry-over between readings: each keeps a share of the one taken just before it.

A multiplexer and a converter that do not settle fully mix a share m of the previous reading into each one, s[n] = (1
− m) x[n] + m s[n−1]. A passive sheet is reciprocal (V_ij = V_ji), carry-over is not, so m appears in the
antisymmetric part of the frame: A(s)[n] = m A(s[n−1]) + noise, a regression through the origin.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.frames import FrameBlock, VoltageUnit

#: Number of its own standard errors that an estimate must be away from zero to count, …
_SIGNIFICANT = 5.0
#: … and least share by which its removal must improve reciprocity.
_WORTHWHILE = 0.2
_LARGEST = 0.5
#: Error above which more than a quarter of the readings' power is not reciprocal: no passive sheet was measured. A
#: correction must get clearly below it to explain the readings.
RECIPROCITY_LIMIT = 1.0


@dataclass(frozen=True, slots=True)
class CarryOver:
    """Carry-over of one recording.

    Parameters
    ----------
    share, stderr : m, dimensionless.
    error, error_corrected : reciprocity error before and after taking it out, see :func:`reciprocity_error`.
    """

    share: float
    stderr: float
    error: float
    error_corrected: float

    @property
    def worth_correcting(self) -> bool:
        """Whether the estimate is significant and plausible, and its correction clearly improves reciprocity."""
        return _SIGNIFICANT * self.stderr < self.share < _LARGEST and self.error_corrected < (1 - _WORTHWHILE) * min(
            self.error, RECIPROCITY_LIMIT
        )


def scan_order(block: FrameBlock) -> NDArray[np.int64]:
    """Order in which a frame was read, (drives·measures,) indices into the flattened frame.

    The order follows the readings' own times if recorded, else it is row by row (the boards' order).
    """
    count = block.voltages[0].size
    if block.reading_time_s is None:
        return np.arange(count, dtype=np.int64)
    reading_times = block.reading_time_s.reshape(len(block), count)
    return np.argsort(np.median(reading_times - reading_times[:, :1], axis=0), kind="stable").astype(np.int64)


def correct_carry_over(voltages: Array, share: float, order: NDArray[np.int64]) -> Array:
    """Remove the carry-over: x[n] = (s[n] − m s[n−1]) / (1 − m) along the scan, frame after frame.

    Parameters
    ----------
    voltages : (n, drives, measures). A constant offset passes through unchanged, so it need not be known.
    order : see :func:`scan_order`. The very first reading has no predecessor and stays.
    """
    stream = voltages.reshape(len(voltages), -1)[:, order].ravel()
    without = stream.copy()
    without[1:] = (stream[1:] - share * stream[:-1]) / (1 - share)
    corrected = np.empty((len(voltages), len(order)))
    corrected[:, order] = without.reshape(len(voltages), -1)
    return corrected.reshape(voltages.shape)


def offset_of(frame: Array, used: Mask, *, counts: bool) -> float:
    """Offset of a frame: the median of its used readings for counts (far readings are small), else 0."""
    return float(np.median(frame[used])) if counts else 0.0


def reciprocity_error(frame: Array, used: Mask, offset: float) -> float | None:
    """Rms of V_ij − V_ji over rms of V_ij − offset, over used pairs; None without such pairs.

    A passive sheet gives 0, uncorrelated noise √2. Raw recordings of a board with memory reach 0.6 to 0.9 without
    any electrode being loose.
    """
    both_mask = used & used.T if used.shape[0] == used.shape[1] else np.zeros_like(used)
    level = float(np.sqrt(np.mean((frame - offset)[both_mask] ** 2))) if both_mask.any() else 0.0
    if level == 0.0:
        return None
    return float(np.sqrt(np.mean((frame - frame.T)[both_mask] ** 2))) / level


def estimate_carry_over(block: FrameBlock, used: Mask) -> CarryOver | None:
    """Estimate m from reciprocity on the mean frame.

    Parameters
    ----------
    used : (drives, measures) bool, readings that touch no driven electrode.

    Returns
    -------
    CarryOver, or None if drives and measures are not the same pairs or the frame is uninformative.
    """
    both_mask = used & used.T if used.shape[0] == used.shape[1] else np.zeros_like(used)
    order = scan_order(block)
    frame = block.voltages.mean(axis=0)
    previous = np.empty(frame.size)
    previous[order] = np.roll(frame.ravel()[order], 1)
    frame_before = previous.reshape(frame.shape)
    own_difference, previous_difference = (frame - frame.T)[both_mask], (frame_before - frame_before.T)[both_mask]
    power = float(previous_difference @ previous_difference)
    offset = offset_of(frame, used, counts=block.unit is VoltageUnit.COUNT)
    error = reciprocity_error(frame, used, offset)
    if power == 0.0 or error is None:
        return None
    share = float(own_difference @ previous_difference) / power
    # Every pair appears twice with opposite sign, so there are half as many residuals as entries.
    residual = own_difference - share * previous_difference
    stderr = float(np.sqrt(residual @ residual / max(both_mask.sum() / 2 - 1, 1) / power))
    corrected = correct_carry_over(frame[None], share, order)[0] if share < 1 else frame
    remaining = reciprocity_error(corrected, used, offset_of(corrected, used, counts=block.unit is VoltageUnit.COUNT))
    return CarryOver(share, stderr, error, error if remaining is None else remaining)
