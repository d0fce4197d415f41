"""Short presses: up there for one to three frames, and gone again.

Windows of a step hold the beginning and the end of such a press at once. So it is looked for by itself: a pulse is a
few frames that stand out of the frames before *and* of the frames after them, to the same side. As with steps the
noise of that comparison is estimated per place from all moments of the same recording.
"""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_changes import Change, threshold_for

Array = NDArray[np.float64]

_WIDTHS = (1, 2, 3)  #: frames a pulse may last
_BESIDE = 4  #: frames on either side it is compared with
_MOST_PULSES = 100


def find_pulses(scores: Array) -> tuple[Change, ...]:
    """Find short presses, in time order.

    Parameters
    ----------
    scores : (n, p) float64, as for :func:`recording_changes.find_changes`.

    Returns
    -------
    Changes whose ``window`` is the number of frames they last.
    """
    n = len(scores)
    candidates: list[Change] = []
    for width in _WIDTHS:
        at = np.arange(_BESIDE, n - _BESIDE - width + 1)
        if len(at) < 4 * _BESIDE:
            continue
        size, place, sign = _strongest(scores, at, width)
        over = np.flatnonzero(size > threshold_for(len(at), _BESIDE))
        candidates += [Change(int(at[k]), width, int(place[k]), int(sign[k]), float(size[k])) for k in over]
    taken: list[Change] = []
    for one in sorted(candidates, key=lambda change: -change.score)[: 10 * _MOST_PULSES]:
        if all(_apart(one, other) > _BESIDE for other in taken):
            taken.append(one)
    return tuple(sorted(taken[:_MOST_PULSES], key=lambda change: change.frame))


def without_pulses(white: Array, pulses: tuple[Change, ...]) -> Array:
    """Bridge the frames of pulses by straight lines: (n, m), for what is looked for besides."""
    bridged = white.copy()
    for pulse in pulses:
        first, last = pulse.frame - 1, pulse.frame + pulse.window
        share = (np.arange(first + 1, last) - first) / (last - first)
        bridged[first + 1 : last] = (1 - share)[:, None] * white[first] + share[:, None] * white[last]
    return bridged


def _strongest(scores: Array, at: NDArray[np.int64], width: int) -> tuple[Array, NDArray[np.int64], Array]:
    """For each moment the size, the place and the sign of the pulse that stands out most."""
    total = np.vstack([np.zeros(scores.shape[1]), np.cumsum(scores, axis=0)])
    inside = (total[at + width] - total[at]) / width
    before = (total[at] - total[at - _BESIDE]) / _BESIDE
    after = (total[at + width + _BESIDE] - total[at + width]) / _BESIDE
    rise, fall = _scaled(inside - before), _scaled(inside - after)
    size = np.where(rise * fall > 0, np.minimum(np.abs(rise), np.abs(fall)), 0.0)
    place = np.argmax(size, axis=1)
    rows = np.arange(len(at))
    return size[rows, place], place, np.sign(rise[rows, place])


def _scaled(difference: Array) -> Array:
    noise = 1.4826 * np.median(np.abs(difference - np.median(difference, axis=0)), axis=0)
    scaled: Array = difference / np.maximum(noise, max(float(np.median(noise)), 1e-12))
    return scaled


def _apart(one: Change, other: Change) -> int:
    return max(one.frame - (other.frame + other.window), other.frame - (one.frame + one.window))
