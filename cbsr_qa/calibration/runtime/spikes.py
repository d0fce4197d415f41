"""Spikes in single frames: readings far from their reciprocals, which replace them. Numpy alone."""

import numpy as np

from cbsr_qa.calibration.runtime.fewer_readings import reading_noise
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.rules import MOST_SPIKES, SPIKE_SIGMA, reciprocal_unchanged
from cbsr_qa.domain.sensor.patterns import DrivePattern

_MAD_TO_SIGMA = 1.4826


class SpikeFilter:
    """Replaces spikes.

    Parameters
    ----------
    pattern : drive pattern of the frames.
    used : (drives, measures) mask of the used readings, with m True entries.
    merging : (rows, m) merging of the force model, which gives the readings' noise.
    """

    def __init__(self, pattern: DrivePattern, used: Mask, merging: Array) -> None:
        pairs, sign = pattern.reciprocal_pairs()
        both_used = used.ravel()[pairs].all(axis=1)
        number = np.cumsum(used.ravel()) - 1
        self._first, self._other = number[pairs[both_used]].T
        self._sign = sign[both_used]
        noise = reading_noise(merging)
        self._noise = np.hypot(noise[self._first], noise[self._other])

    def __call__(self, changes: Array) -> Mask:
        """Replace spikes in changes (n, m) in place; return whether each frame (n,) had any.

        Frames with more than 5 % disagreeing pairs are unchanged, as these are not single spikes.
        """
        direct, reciprocal = changes[:, self._first], self._sign * changes[:, self._other]
        relative_difference = np.abs(direct - reciprocal) / self._noise
        far_mask = relative_difference > SPIKE_SIGMA
        if not far_mask.any():
            return np.zeros(len(changes), dtype=np.bool_)
        unrest = np.maximum(_MAD_TO_SIGMA * np.median(relative_difference, axis=1), 1.0)
        larger = np.abs(direct) > np.abs(reciprocal)
        large, small = np.where(larger, direct, reciprocal), np.where(larger, reciprocal, direct)
        spike_mask = (relative_difference > SPIKE_SIGMA * unrest[:, None]) & reciprocal_unchanged(large, small)
        spike_mask[spike_mask.mean(axis=1) > MOST_SPIKES] = False
        frame, pair = np.nonzero(spike_mask)
        changes[frame, self._first[pair]] = small[frame, pair]
        changes[frame, self._other[pair]] = self._sign[pair] * small[frame, pair]
        spiky_frames: Mask = spike_mask.any(axis=1)
        return spiky_frames
