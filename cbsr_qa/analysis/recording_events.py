"""Presses in a recording nobody annotated: one press, one event.

The sheet is slow: it creeps while it is held, keeps much of the change after the release (two thirds, two seconds
later, on the lab's recordings), and relaxes for long. So a press is looked for as a *step* (:mod:`recording_changes`)
and everything after it is read off the trace of its own pattern: where the step began, where the trace was largest,
where its final decline set in. Steps at the same place before the trace has fallen belong to the same press.
Each press is imaged against the frames just before it, so residues of earlier ones do not matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_changes import Change
from cbsr_qa.analysis.recording_places import Matcher, Place, find_places

Array = NDArray[np.float64]

_BEFORE_FRAMES = 8  #: at most so many frames before a press are its reference
_ROUGH_AFTER_FRAMES = 24  #: and so many after the step give its first, rough pattern
_SAME_PLACE = 0.4  #: of the radius: two steps nearer than this are at the same place
_NEW_PRESS_LOSS = 0.4  #: a step at the same place is a new press if the trace had lost this share before it
_BEGUN, _REACHED = 0.2, 0.8  #: shares of the plateau at which a press has begun, and is down
_FAINT = 2.0  #: a pattern whose signal is under so many times its noise, in energy, is too faint to follow its rise
_RELEASED = 0.15  #: least share of the trace that a release takes back
_SUDDEN = 0.5  #: a release that takes back this share of its drop within three frames is that step
_DECLINED = 0.25  #: otherwise it is where this share of the drop is passed
_EXPLAINED = 0.5  #: least share of a change that the loads must explain …
_EXPLAINED_SIGMA = 3.0  #: … unless noise may be the reason it is less


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A press found; frames are indices into the series.

    Parameters
    ----------
    start : fractional frame at which the change passed a fifth of its plateau.
    peak : frame of the largest change.
    end : fractional frame of the release, or the last frame.
    before, held : frames of the reference and of the hold.
    places : its loads (several where more than one thing was pressed at once).
    score : of its strongest step.
    """

    start: float
    peak: int
    end: float
    before: slice
    held: slice
    places: tuple[Place, ...]
    score: float


@dataclass(slots=True)
class Found:
    """Presses, and changes that were not taken for one, in words."""

    presses: list[Press] = field(default_factory=list)
    rejected: list[tuple[int, str]] = field(default_factory=list)  #: frame, why


def find_presses(white: Array, match: Matcher, changes: Sequence[Change]) -> Found:
    """Put steps together to presses.

    Parameters
    ----------
    white : (n, m) whitened readings, see :meth:`Matcher.whiten`.
    changes : in time order, of :func:`recording_changes.find_changes`.
    """
    found = Found()
    sign = response_sign(white @ match.patterns, changes)
    own = [change for change in changes if change.sign == sign]
    group: list[Change] = []
    for change in own:
        if group and not _belongs(change, group, white, match):
            _close(group, change.frame - change.window, white, match, sign, found)
            group = []
        group.append(change)
    if group:
        _close(group, len(white), white, match, sign, found)
    return found


def response_sign(scores: Array, changes: Sequence[Change]) -> int:
    """Return what a load does: the sign of the largest excursion from the state the recording begins in.

    A sheet can be more loaded than at the start, hardly less; releases only lead back.
    """
    if not changes:
        return 0
    first = scores[: max(changes[0].frame - changes[0].window, 2)].mean(axis=0)
    largest = 0.0
    for change in changes:
        after = scores[change.frame : change.frame + max(change.window, 4)].mean(axis=0) - first
        excursion = float(after[change.place])
        if abs(excursion) > abs(largest):
            largest = excursion
    return 1 if largest > 0 else -1


def _belongs(change: Change, group: list[Change], white: Array, match: Matcher) -> bool:
    """Whether a step continues the press that is open: same place, and nothing much was lost since."""
    apart = min(np.hypot(*(match.places[change.place] - match.places[one.place])) for one in group)
    if apart > _SAME_PLACE:
        return False
    trace = _trace(white, *_rough(group[0], change.frame, len(white)))
    until = max(change.frame - change.window // 2, group[-1].frame + 1)
    so_far = _smooth(trace[group[0].frame : until])
    return len(so_far) == 0 or float(so_far[-1]) > (1 - _NEW_PRESS_LOSS) * float(so_far.max())


def _rough(change: Change, limit: int, n: int) -> tuple[slice, slice]:
    before_end = max(change.frame - change.window, 1)
    after = min(change.frame + max(1, change.window // 2), n - 1)
    return (
        slice(max(before_end - _BEFORE_FRAMES, 0), before_end),
        slice(after, max(min(after + _ROUGH_AFTER_FRAMES, limit), after + 1)),
    )


def _trace(white: Array, before: slice, held: slice) -> Array:
    """Amplitude along the press's own pattern: 0 before it, 1 on the mean of the hold."""
    base = white[before].mean(axis=0)
    pattern = white[held].mean(axis=0) - base
    trace: Array = (white - base) @ pattern / float(pattern @ pattern)
    return trace


def _smooth(trace: Array, window: int = 2) -> Array:
    """Running median of the odd number of frames above a window: weak presses are seen with wide windows only."""
    half = window // 2
    if len(trace) < 2 * half + 1:
        return trace
    padded = np.pad(trace, half, mode="edge")
    smoothed: Array = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    return smoothed


def _close(group: list[Change], limit: int, white: Array, match: Matcher, sign: int, found: Found) -> None:
    """Work out one press from its steps; ``limit`` is where the next one begins."""
    limit = max(limit, group[-1].frame + 1)
    first = group[0]
    before, held = _rough(first, limit, len(white))
    window = min(change.window for change in group)
    clear = _signal(white, before, held) > _FAINT * _noise(white, before, held)
    for _ in range(2):
        trace = _smooth(_trace(white, before, held), window)
        end = _end_of(trace, first.frame, limit)
        start, down = _rise(trace, first, int(end)) if clear else _at_the_step(first, int(end))
        before = slice(max(int(start) - _BEFORE_FRAMES, 0), max(int(start), 1))
        held = slice(down, max(int(end) + (end == limit - 1), down + 1))
    change = white[held].mean(axis=0) - white[before].mean(axis=0)
    places, explained = find_places(change, match, sign=sign)
    if why := _unlike_a_load(white, explained, before, held):
        found.rejected.append((first.frame, why))
        return
    peak = first.frame + int(np.argmax(trace[first.frame : max(int(np.ceil(end)), first.frame + 1)]))
    score = max(one.score for one in group)
    found.presses.append(Press(start, peak, end, before, held, places, score))


def _rise(trace: Array, first: Change, end: int) -> tuple[float, int]:
    """Where the press began (fractional frame), and the first frame in which it is down."""
    after = slice(first.frame, max(end, first.frame + 1))
    plateau = float(np.median(trace[after]))
    earliest = max(first.frame - 2 * first.window, 0)
    down = next((k for k in range(earliest, after.stop) if trace[k] >= _REACHED * plateau), first.frame)
    k = max(down, 1)
    while k > earliest + 1 and trace[k - 1] > _BEGUN * plateau:
        k -= 1
    low, high = float(trace[k - 1]), float(trace[k])
    share = (_BEGUN * plateau - low) / (high - low) if high > low else 0.0
    return k - 1 + min(max(share, 0.0), 1.0), max(down, k)


def _at_the_step(first: Change, end: int) -> tuple[float, int]:
    """The same where the rise is too faint to follow: where the step is largest is when it happened."""
    return first.frame - 0.5, min(first.frame + first.window // 2, max(end, first.frame))


def _noise(white: Array, before: slice, held: slice) -> float:
    """Energy that noise alone gives the difference of two means."""
    return float(white.shape[1] * (1 / (before.stop - before.start) + 1 / (held.stop - held.start)))


def _signal(white: Array, before: slice, held: slice) -> float:
    """Energy of the difference of two means above what noise gives it."""
    change = white[held].mean(axis=0) - white[before].mean(axis=0)
    return max(float(change @ change) - _noise(white, before, held), 1e-12)


def _end_of(trace: Array, begin: int, limit: int) -> float:
    """Where the final decline of a trace set in; the last frame where it did not decline."""
    part = trace[begin:limit]
    if len(part) < 4:
        return float(limit - 1)
    top = int(np.argmax(part))
    last = float(part[-min(3, len(part)) :].mean())
    drop = float(part[top]) - last
    noise = 1.4826 * float(np.median(np.abs(np.diff(part)))) / np.sqrt(2)
    if drop < max(_RELEASED * float(part[top]), 4 * noise):
        return float(limit - 1)
    reach = min(3, len(part) - 1 - top)
    if reach > 0:
        falls = part[top:-reach] - part[top + reach :]
        steepest = int(np.argmax(falls))
        if falls[steepest] >= _SUDDEN * drop:
            return _crossing(part, top + steepest, float(part[top + steepest]) - falls[steepest] / 2) + begin
    return _crossing(part, top, float(part[top]) - _DECLINED * drop, last=True) + begin


def _crossing(part: Array, begin: int, level: float, *, last: bool = False) -> float:
    """Fractional index at which a falling trace passes a level: the first time from ``begin`` on, or the last."""
    above = np.flatnonzero(part[begin:] >= level) + begin
    if last:
        k = int(above[-1]) if len(above) else begin
    else:
        below = np.flatnonzero(part[begin:] < level) + begin
        k = int(below[0]) - 1 if len(below) else len(part) - 1
    if k + 1 >= len(part):
        return float(len(part) - 1)
    high, low = float(part[k]), float(part[k + 1])
    return k + (min(max((high - level) / (high - low), 0.0), 1.0) if high > low else 0.0)


def _unlike_a_load(white: Array, explained: float, before: slice, held: slice) -> str:
    """Say why a change is not a load's, if even the best places explain too little of it; empty if it may be one."""
    noise, signal = _noise(white, before, held), _signal(white, before, held)
    per_reading = noise / white.shape[1]
    doubt = _EXPLAINED_SIGMA * per_reading * np.sqrt(2 * white.shape[1] + 4 * signal / per_reading)
    share = explained * (signal + noise) / signal
    if share * signal + _EXPLAINED * doubt >= _EXPLAINED * signal:
        return ""
    return f"it does not look like a load: the best places explain {share:.0%} of it"
