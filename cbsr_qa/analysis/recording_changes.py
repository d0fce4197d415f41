"""When something changed: steps of the matched patterns, at a controlled rate of false alarms.

For each candidate place the series of scores is scanned with windows before and after each moment, at several
widths. The noise of such a step is not taken from theory but, per place and width, from all moments of the same
recording (the median absolute deviation), so slow drift, relaxation and coloured noise raise the threshold by
themselves (a constant-false-alarm-rate detector). Steps already found are kept out of that estimate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Frames before and after a moment that are compared; wider windows find weaker and slower presses.
WINDOWS = (2, 4, 8)
#: A step counts from this many times its noise. With 200 frames about one recording in 200 of pure noise has one; see
#: tests/recordings/test_event_detection.py, which measures it.
THRESHOLD = 5.5
#: Few moments make a poor noise estimate: the threshold rises by this many times the share window / moments.
_SMALL_SAMPLE = 8.0
_MOST_CHANGES = 60


@dataclass(frozen=True, slots=True)
class Change:
    """A step.

    Parameters
    ----------
    frame : the first frame after it.
    window : frames on either side it was seen with.
    place : index of the candidate place where it is largest.
    sign : +1 where the place conducts more afterwards.
    score : step over its noise.
    """

    frame: int
    window: int
    place: int
    sign: int
    score: float


def find_changes(scores: Array) -> tuple[Change, ...]:
    """Find the steps in the scores of all places, in time order.

    Parameters
    ----------
    scores : (n, p) float64, unit noise if the readings' noise were white and independent.
    """
    found: list[Change] = []
    for window in WINDOWS:
        while len(found) < _MOST_CHANGES:
            change = _strongest(scores, window, found)
            if change is None:
                break
            found.append(change)
    return tuple(sorted(found, key=lambda change: change.frame))


def largest_score(scores: Array) -> float:
    """The largest step over its noise that there is, whether or not it counts; 0 where there are too few frames."""
    steps = [_steps(scores, window, []) for window in WINDOWS]
    return max((float(np.abs(z).max()) for _, z in steps if z.size), default=0.0)


def threshold_for(moments: int, window: int) -> float:
    """Return the threshold for a noise estimate from so many moments."""
    return THRESHOLD * (1 + _SMALL_SAMPLE * window / max(moments, 1) / 8) if moments else np.inf


def _strongest(scores: Array, window: int, found: list[Change]) -> Change | None:
    at, z = _steps(scores, window, found)
    if not z.size:
        return None
    size = np.abs(z).max(axis=1)
    best = int(np.argmax(size))
    if size[best] < threshold_for(len(at), window):
        return None
    place = int(np.argmax(np.abs(z[best])))
    return Change(int(at[best]), window, place, int(np.sign(z[best, place])), float(size[best]))


def _steps(scores: Array, window: int, found: list[Change]) -> tuple[NDArray[np.int64], Array]:
    """Moments whose windows hold no step found before, and each place's step over its noise there."""
    n = len(scores)
    at = np.arange(window, n - window + 1)
    for change in found:
        reach = window + max(change.window, 2) - 1
        at = at[np.abs(at - change.frame) > reach]
    if len(at) < max(2 * window, 5):
        return at.astype(np.int64), np.empty((0, scores.shape[1]))
    total = np.vstack([np.zeros(scores.shape[1]), np.cumsum(scores, axis=0)])
    step = (total[at + window] - 2 * total[at] + total[at - window]) / np.sqrt(2 * window)
    middle = np.median(step, axis=0)
    noise = 1.4826 * np.median(np.abs(step - middle), axis=0)
    noise = np.maximum(noise, max(1.0, float(np.median(noise))))
    return at.astype(np.int64), (step - middle) / noise
