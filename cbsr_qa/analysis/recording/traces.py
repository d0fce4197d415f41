"""Traces of presses: strength of one pattern from frame to frame.

The trace is 0 before a press and 1 on the mean of its hold. The press begins at its rise and ends when its final
decline sets in (the sheet keeps much of a change, so the trace may not return to 0).
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA
from cbsr_qa.analysis.recording.changes import Change
from cbsr_qa.domain.numbers import Array

BEFORE_FRAMES = 8  #: at most so many frames before a press are its reference
_ROUGH_AFTER_FRAMES = 24  #: and so many after the step give its first, rough pattern
_BEGUN, _REACHED = 0.2, 0.8  #: shares of the plateau at which a press has begun, and is down
_RELEASED = 0.15  #: least share of the trace that a release reverses
#: A release is sudden if within three frames it takes this share of what is left to lose, and of the steepest fall.
_SUDDEN = 0.5
_LET_GO = 0.25  #: least share of the top that a sudden release takes
_STAYED = 0.5  #: a trace that keeps this share of its top, and decays from there on, was not released
_HELD = 0.15  #: a trace held first lies above the straight line from top to end by this share of the decline
_SMOOTH_SHARE = 10  #: averaged over this part of the time, against noise
_STEADY = 0.25  #: share of the steepest fall that still belongs to the same release
_STILL_HELD = 0.4  #: least share of the decline that is left at the end of a hold
_NEARLY = 0.1  #: share of the decline that does not matter
_DECLINED = 0.25  #: otherwise the end is where this share of the drop is passed


def rough(change: Change, limit: int, n: int) -> tuple[slice, slice]:
    """Frames before a step, and after it up to ``limit``, for its first pattern."""
    before_end = max(change.frame - change.window, 1)
    begin_after = min(change.frame + max(1, change.window // 2), max(limit - 1, change.frame), n - 1)
    return (
        slice(max(before_end - BEFORE_FRAMES, 0), before_end),
        slice(begin_after, max(min(begin_after + _ROUGH_AFTER_FRAMES, limit), begin_after + 1)),
    )


def difference(white: Array, before: slice, held: slice) -> Array:
    """Mean of the hold minus mean of the frames before: (m,)."""
    change: Array = white[held].mean(axis=0) - white[before].mean(axis=0)
    return change


def trace(white: Array, before: slice, held: slice, besides: Sequence[Array] = ()) -> Array:
    """Amplitude along the press's own pattern: 0 before it, 1 on the mean of the hold.

    Parameters
    ----------
    besides : (m,) patterns of simultaneous changes, fitted too.
    """
    base = white[before].mean(axis=0)
    basis = np.column_stack([white[held].mean(axis=0) - base, *besides])
    along: Array = np.linalg.lstsq(basis, (white - base).T, rcond=None)[0][0]
    return along


def smooth(along: Array, window: int = 2) -> Array:
    """Running median over the odd number of frames above a window: weak presses are only seen with wide windows."""
    half_window = window // 2
    if len(along) < 2 * half_window + 1:
        return along
    return median_filter(along, 2 * half_window + 1, mode="nearest")


def rise(along: Array, first: Change, end: int) -> tuple[float, int]:
    """Start of the press (fractional frame), and the first frame in which it is down."""
    slice_after = slice(first.frame, max(end, first.frame + 1))
    plateau = float(np.median(along[slice_after]))
    earliest = max(first.frame - 2 * first.window, 0)
    first_down = next((k for k in range(earliest, slice_after.stop) if along[k] >= _REACHED * plateau), first.frame)
    k = max(first_down, 1)
    while k > earliest + 1 and along[k - 1] > _BEGUN * plateau:
        k -= 1
    low, high = float(along[k - 1]), float(along[k])
    share = (_BEGUN * plateau - low) / (high - low) if high > low else 0.0
    return k - 1 + min(max(share, 0.0), 1.0), max(first_down, k)


def slow_rise(along: Array, held: int) -> float:
    """Start of a press that rose too slowly for a step: the last frame before the hold without it."""
    below = np.flatnonzero(along[:held] < _BEGUN)
    return float(below[-1]) + 0.5 if len(below) else 0.0


def step_start(first: Change, end: int) -> tuple[float, int]:
    """Start of a rise too faint to follow: the largest step."""
    return first.frame - 0.5, min(first.frame + first.window // 2, max(end, first.frame))


def noise_energy(white: Array, before: slice, held: slice) -> float:
    """Energy that noise alone gives the difference of two means."""
    return float(white.shape[1] * (1 / (before.stop - before.start) + 1 / (held.stop - held.start)))


def signal_energy(white: Array, before: slice, held: slice) -> float:
    """Energy of the difference of two means in excess of noise."""
    change = difference(white, before, held)
    return max(float(change @ change) - noise_energy(white, before, held), 1e-12)


def end_of(along: Array, begin: int, limit: int) -> float:
    """Start of a trace's final decline; the last frame if it does not decline, or only decays."""
    span = along[begin:limit]
    if len(span) < 4:
        return float(limit - 1)
    top = int(np.argmax(span))
    last_level = float(span[-min(3, len(span)) :].mean())
    drop = float(span[top]) - last_level
    noise = MAD_TO_SIGMA * float(np.median(np.abs(np.diff(span)))) / np.sqrt(2)
    if drop < max(_RELEASED * float(span[top]), 4 * noise):
        return float(limit - 1)
    reach = min(3, len(span) - 1 - top)
    if reach > 0:
        falls = span[top:-reach] - span[top + reach :]
        # A load that relaxed while it was held has less to lose than at its top.
        least = max(_LET_GO * float(span[top]), 4 * noise, _SUDDEN * float(falls.max()))
        sudden = np.flatnonzero(falls >= np.maximum(_SUDDEN * (span[top:-reach] - last_level), least))
        if len(sudden):
            last_fall = sudden[sudden >= sudden[-1] - reach]
            steepest = int(last_fall[np.argmax(falls[last_fall])])
            onset = steepest
            while onset > 0 and falls[onset - 1] >= _STEADY * falls[steepest]:
                onset -= 1
            if steepest - onset > reach:  # a slow release, at last over what is left
                return _crossing(span, top + onset, _find_release_level(span[top + onset], last_level)) + begin
            return _crossing(span, top + steepest, float(span[top + steepest]) - falls[steepest] / 2) + begin
    reached = int(np.argmax(span >= _REACHED * span[top]))
    if limit == len(along) and last_level >= _STAYED * float(span[top]) and _fades(span[reached:], drop, noise):
        return float(limit - 1)
    held_until = top + _last_held(span[top:], drop, noise)
    return _crossing(span, held_until, _find_release_level(span[held_until], last_level), last=True) + begin


def _find_release_level(level: float, last_level: float) -> float:
    return float(level - _DECLINED * (level - last_level))


def _last_held(part: Array, drop: float, noise: float) -> int:
    """Index of the last frame of a hold in a trace that declines from its top; 0 if there is no hold.

    A load relaxes while it is held: the trace bends below its straight line down, and its release bends it above.
    """
    window = max(len(part) // _SMOOTH_SHARE, 1)
    calm = np.convolve(part, np.full(window, 1 / window), "valid")
    down = int(np.argmax(calm <= calm[-1] + _NEARLY * drop)) + 1
    above = calm[:down] - np.linspace(calm[0], calm[down - 1], down)
    knee = int(np.argmax(above))
    is_bent = above[knee] > _NEARLY * drop + noise / np.sqrt(window)
    return knee + window // 2 if is_bent and calm[knee] > calm[-1] + _STILL_HELD * drop else 0


def _fades(part: Array, drop: float, noise: float) -> bool:
    """Whether a trace declines throughout, evenly or ever slower, as in creep; a release follows a hold."""
    window = max(len(part) // _SMOOTH_SHARE, 1)
    calm = np.convolve(part, np.full(window, 1 / window), "valid")
    straight = np.linspace(calm[0], calm[-1], len(calm))
    return bool((calm - straight).max() <= _HELD * drop + noise / np.sqrt(window))


def _crossing(part: Array, begin: int, level: float, *, last: bool = False) -> float:
    """Fractional index at which a falling trace passes a level: the first time from ``begin`` on, or the last."""
    frames_above = np.flatnonzero(part[begin:] >= level) + begin
    if last:
        k = int(frames_above[-1]) if len(frames_above) else begin
    else:
        below = np.flatnonzero(part[begin:] < level) + begin
        k = int(below[0]) - 1 if len(below) else len(part) - 1
    if k + 1 >= len(part):
        return float(len(part) - 1)
    high, low = float(part[k]), float(part[k + 1])
    return k + (min(max((high - level) / (high - low), 0.0), 1.0) if high > low else 0.0)
