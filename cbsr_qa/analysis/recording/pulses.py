"""Pulses: presses of one to three frames.

The windows of a step contain both ends of a short press. So pulses are detected separately: a few frames that differ
in the same direction from those before *and* after them. Their noise is estimated as for steps.
"""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA
from cbsr_qa.analysis.recording.changes import Change, threshold_for
from cbsr_qa.domain.numbers import Array

_PULSE_FRAMES = (1, 2, 3)  #: numbers of frames that a pulse may last
_FRAMES_BESIDE = 4  #: frames on either side that a pulse is compared with
_MAX_PULSES = 100


def find_pulses(scores: Array) -> tuple[Change, ...]:
    """Find short presses, in time order.

    Parameters
    ----------
    scores : (n, p) float64, as for :func:`changes.find_steps`.

    Returns
    -------
    Changes whose ``window`` is the number of frames they last.
    """
    n = len(scores)
    candidates: list[Change] = []
    for width in _PULSE_FRAMES:
        frames = np.arange(_FRAMES_BESIDE, n - _FRAMES_BESIDE - width + 1)
        if len(frames) < 4 * _FRAMES_BESIDE:
            continue
        size, place, sign = _find_strongest(scores, frames, width)
        above_threshold = np.flatnonzero(size > threshold_for(len(frames), _FRAMES_BESIDE))
        candidates += [
            Change(int(frames[k]), width, int(place[k]), int(sign[k]), float(size[k])) for k in above_threshold
        ]
    pulses: list[Change] = []
    for pulse in sorted(candidates, key=lambda candidate: -candidate.score)[: 10 * _MAX_PULSES]:
        gaps = (
            max(pulse.frame - (other.frame + other.window), other.frame - (pulse.frame + pulse.window))
            for other in pulses
        )
        if all(gap > _FRAMES_BESIDE for gap in gaps):
            pulses.append(pulse)
    return tuple(sorted(pulses[:_MAX_PULSES], key=lambda pulse: pulse.frame))


def interpolate_pulses(white: Array, pulses: tuple[Change, ...]) -> Array:
    """Interpolate linearly over the frames of pulses, (n, m), for further detection."""
    bridged = white.copy()
    for pulse in pulses:
        frame_before, frame_after = pulse.frame - 1, pulse.frame + pulse.window
        share = (np.arange(frame_before + 1, frame_after) - frame_before) / (frame_after - frame_before)
        before, after = white[frame_before], white[frame_after]
        bridged[frame_before + 1 : frame_after] = (1 - share)[:, None] * before + share[:, None] * after
    return bridged


def _find_strongest(scores: Array, at: NDArray[np.int64], width: int) -> tuple[Array, NDArray[np.int64], Array]:
    """Size, place and sign of the strongest pulse at each moment."""
    total = np.vstack([np.zeros(scores.shape[1]), np.cumsum(scores, axis=0)])
    mean_inside = (total[at + width] - total[at]) / width
    mean_before = (total[at] - total[at - _FRAMES_BESIDE]) / _FRAMES_BESIDE
    mean_after = (total[at + width + _FRAMES_BESIDE] - total[at + width]) / _FRAMES_BESIDE
    rise, fall = _scale_to_noise(mean_inside - mean_before), _scale_to_noise(mean_inside - mean_after)
    size = np.where(rise * fall > 0, np.minimum(np.abs(rise), np.abs(fall)), 0.0)
    place = np.argmax(size, axis=1)
    rows = np.arange(len(at))
    return size[rows, place], place, np.sign(rise[rows, place])


def _scale_to_noise(difference: Array) -> Array:
    noise = MAD_TO_SIGMA * np.median(np.abs(difference - np.median(difference, axis=0)), axis=0)
    return difference / np.maximum(noise, max(float(np.median(noise)), 1e-12))
