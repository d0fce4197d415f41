"""Change detection: steps of the matched patterns, at a controlled false alarm rate.

For each candidate place the series of scores is scanned with windows before and after each moment, at several widths.
The noise of such a step is estimated per place and width from all moments of the same recording (median absolute
deviation), so slow drift, relaxation and coloured noise raise the threshold (a constant-false-alarm-rate detector).
Steps already found are excluded from that estimate.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA
from cbsr_qa.domain.numbers import Array

#: Frames compared before and after a moment; wider windows find weaker and slower presses.
WINDOWS = (2, 4, 8)
#: Threshold of a step over its noise; it is raised by the share window / moments, as few moments make a poor noise
#: estimate. With 200 frames about one recording in 200 of pure noise has a step
#: (tests/analysis/recording/test_event_detection.py).
THRESHOLD = 5.5
_MAX_STEPS = 400


@dataclass(frozen=True, slots=True)
class Change:
    """A detected step, or a pulse (:mod:`pulses`).

    Parameters
    ----------
    frame : the first frame after a step, or of a pulse.
    window : frames on either side used to detect a step; frames that a pulse lasts.
    place : index of the candidate place with the largest change.
    sign : +1 where the place conducts more afterwards, or during a pulse.
    score : size over its noise.
    """

    frame: int
    window: int
    place: int
    sign: int
    score: float


def find_steps(scores: Array) -> tuple[Change, ...]:
    """Find the steps in the scores of all places, in time order.

    Parameters
    ----------
    scores : (n, p) float64, unit noise if the readings' noise were white and independent.
    """
    steps: list[Change] = []
    for window in WINDOWS:
        while len(steps) < _MAX_STEPS:
            further = _find_strongest(scores, window, steps)
            if not further:
                break
            steps += further
    return tuple(sorted(_rescore(scores, steps), key=lambda step: step.frame))


def nearest_step(scores: Array) -> tuple[float, float]:
    """Return the step closest to the threshold, over its noise, and that threshold.

    Each window has its own threshold. With too few frames for any window the step is 0.
    """
    steps = [(0.0, threshold_for(len(scores), WINDOWS[0]))]
    for window in WINDOWS:
        quiet_frames, z = _steps(scores, window, [])
        if z.size:
            steps.append((float(np.abs(z).max()), threshold_for(len(quiet_frames), window)))
    return max(steps, key=lambda step: step[0] / step[1])


def threshold_for(moments: int, window: int) -> float:
    """Return the threshold for a noise estimate from this many moments."""
    return THRESHOLD * (1 + window / moments) if moments else np.inf


def _find_strongest(scores: Array, window: int, known: list[Change]) -> list[Change]:
    """Steps above the threshold, strongest first, none within the windows of a stronger one."""
    frames, z = _steps(scores, window, known)
    if not z.size:
        return []
    size = np.abs(z).max(axis=1)
    threshold = threshold_for(len(frames), window)
    strongest: list[Change] = []
    for candidate in np.argsort(-size, kind="stable"):
        if size[candidate] < threshold:
            break
        if all(abs(int(frames[candidate]) - other.frame) > _reach(window, other) for other in strongest):
            place = int(np.argmax(np.abs(z[candidate])))
            strongest.append(
                Change(
                    int(frames[candidate]), window, place, int(np.sign(z[candidate, place])), float(size[candidate])
                )
            )
    return strongest


def _reach(window: int, change: Change) -> int:
    """Frames around a step to exclude so that windows of this width do not see it."""
    return window + max(change.window, 2) - 1


def _steps(scores: Array, window: int, known: list[Change]) -> tuple[NDArray[np.int64], Array]:
    """Moments whose windows contain no step found before, and each place's step over its noise there."""
    quiet_frames = _quiet(len(scores), window, known)
    if len(quiet_frames) < _enough(window):
        return quiet_frames, np.empty((0, scores.shape[1]))
    step = _differences(scores, quiet_frames, window)
    middle, noise = _spread(step)
    return quiet_frames, (step - middle) / noise


def _quiet(frames: int, window: int, known: list[Change]) -> NDArray[np.int64]:
    quiet_frames = np.arange(window, frames - window + 1, dtype=np.int64)
    for change in known:
        quiet_frames = quiet_frames[np.abs(quiet_frames - change.frame) > _reach(window, change)]
    return quiet_frames


def _enough(window: int) -> int:
    return max(2 * window, 5)


def _differences(scores: Array, at: NDArray[np.int64], window: int) -> Array:
    """Mean after minus mean before each moment, in units of its white noise: (moments, p)."""
    total = np.vstack([np.zeros(scores.shape[1]), np.cumsum(scores, axis=0)])
    step: Array = (total[at + window] - 2 * total[at] + total[at - window]) / np.sqrt(2 * window)
    return step


def _spread(step: Array) -> tuple[Array, Array]:
    middle: Array = np.median(step, axis=0)
    noise = MAD_TO_SIGMA * np.median(np.abs(step - middle), axis=0)
    return middle, np.maximum(noise, max(1.0, float(np.median(noise))))


def _rescore(scores: Array, changes: list[Change]) -> list[Change]:
    rescored: list[Change] = []
    for window in WINDOWS:
        window_changes = [change for change in changes if change.window == window]
        quiet_frames = _quiet(len(scores), window, changes)
        if not window_changes or len(quiet_frames) < _enough(window):
            rescored += window_changes
            continue
        middle, noise = _spread(_differences(scores, quiet_frames, window))
        steps = (_differences(scores, np.array([change.frame for change in window_changes]), window) - middle) / noise
        for change, step in zip(window_changes, steps, strict=True):
            rescored.append(replace(change, score=max(abs(float(step[change.place])), change.score)))
    return rescored
