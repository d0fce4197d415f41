"""Steps grouped into presses, and pulses: presses of one to three frames.

A step at the place of an earlier one and of its sign continues that press, unless its trace has largely decayed by
then; one of the other sign reverses it. A step elsewhere begins a press if it leads away from the initial state of
the recording. One that leads back to that state without an earlier press releases a load that rose too slowly to be a
step.

The windows of a step contain both ends of a short press. So pulses are detected separately: a few frames that differ
in the same direction from those before *and* after them. Their noise is estimated as for steps.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA
from cbsr_qa.analysis.recording.changes import Change, threshold_for
from cbsr_qa.analysis.recording.places import Matcher
from cbsr_qa.analysis.recording.traces import BEFORE_FRAMES, difference, rough, smooth, trace
from cbsr_qa.domain.numbers import Array

SAME_PLACE = 0.4  #: of the radius: two steps closer than this are at the same place
_NEW_PRESS_LOSS = 0.4  #: a step at the same place is a new press if the trace had lost this share before it
_CROSSED = 0.5  #: a step of the other sign that overshoots the state before the press by this share is a new one
_TAKEN_BACK = 0.5  #: a step is a release if an earlier press explains this share of what the best place explains


@dataclass(slots=True)
class Group:
    """Steps of one press.

    Parameters
    ----------
    changes : changes of the press's sign, in time order; for a slow press only its release.
    sign : +1 where the place conducts more.
    releases : steps that reverse it.
    slow : whether it rose too slowly to be detected as a step.
    """

    changes: list[Change]
    sign: int
    releases: list[Change] = field(default_factory=list)
    slow: bool = False

    @property
    def frame(self) -> int:
        """Frame of its first step."""
        return self.changes[0].frame

    def limit(self, others: list["Group"], n: int) -> int:
        """Last frame for the first pattern: before its release, and before another press."""
        limits = [change.frame - change.window // 2 for change in self.releases]
        limits += [other.frame - other.changes[0].window for other in others if other.frame > self.frame]
        return max(min([*limits, n]), self.frame + 1)


def group_changes(white: Array, match: Matcher, changes: tuple[Change, ...]) -> list[Group]:
    """Combine steps into groups.

    Parameters
    ----------
    white : (n, m) whitened readings. changes : in time order.
    """
    groups: list[Group] = []
    for k, change in enumerate(changes):
        if any(_add_to_group(change, group, white, match) for group in reversed(groups)):
            continue
        group = Group([change], change.sign)
        # Drift also leads away: a step that a later one reverses is a press, whatever it led back to.
        undone = any(c.sign != change.sign and _apart(c, group, match) <= SAME_PLACE for c in changes[k + 1 :])
        if not undone and _leads_back(change, white, match):
            if not any(_explains(group, change, white, match) for group in groups):
                groups.append(Group([change], -change.sign, [change], slow=True))
        else:
            groups.append(group)
    return groups


def same_place(earlier: Group, other: Group, match: Matcher) -> bool:
    """Whether two presses are at the same place, so that the later one ends the earlier."""
    return min(_apart(change, other, match) for change in earlier.changes) <= SAME_PLACE


def _apart(change: Change, group: Group, match: Matcher) -> float:
    return min(float(np.hypot(*(match.places[change.place] - match.places[step.place]))) for step in group.changes)


def _add_to_group(change: Change, group: Group, white: Array, match: Matcher) -> bool:
    """Add a step to a press at the same place, as its continuation or its release."""
    if _apart(change, group, match) > SAME_PLACE:
        return False
    if group.slow:
        return change.sign != group.sign
    if change.sign == group.sign:
        if not _continues(change, group, white):
            return False
        group.changes.append(change)
        return True
    along = trace(white, *rough(group.changes[0], min(group.limit([], len(white)), change.frame), len(white)))
    level_after = float(along[change.frame : change.frame + max(change.window, 2)].mean())
    if level_after < -_CROSSED:
        return False
    group.releases.append(change)
    return True


def _continues(change: Change, group: Group, white: Array) -> bool:
    """Whether the trace kept its level until a further step."""
    first_change = group.changes[0]
    along = trace(white, *rough(first_change, min(group.limit([], len(white)), change.frame), len(white)))
    until = max(change.frame - change.window // 2, group.changes[-1].frame + 1)
    rise_so_far = smooth(along[first_change.frame : until])
    return len(rise_so_far) == 0 or float(rise_so_far[-1]) > (1 - _NEW_PRESS_LOSS) * float(rise_so_far.max())


def _sides(change: Change, n: int) -> tuple[slice, slice]:
    slice_before = slice(max(change.frame - change.window - max(change.window // 2, 1), 0), max(change.frame - 1, 1))
    begin_after = min(change.frame + max(change.window // 2, 1), n - 1)
    return slice_before, slice(begin_after, min(begin_after + change.window, n))


def _leads_back(change: Change, white: Array, match: Matcher) -> bool:
    """Whether a step returns its place towards the initial state."""
    slice_before, slice_after = _sides(change, len(white))
    start = slice(0, max(min(BEFORE_FRAMES, slice_before.start), 2))
    middle = (white[slice_before].mean(axis=0) + white[slice_after].mean(axis=0)) / 2 - white[start].mean(axis=0)
    return float(middle @ match.patterns[:, change.place]) * change.sign < 0


def _explains(group: Group, change: Change, white: Array, match: Matcher) -> bool:
    """Whether a step may release a press: one still held, or one of the same pattern if its place is slightly off."""
    if group.slow or change.sign == group.sign:
        return False
    if not group.releases:
        return True
    step = difference(white, *_sides(change, len(white)))
    pattern = difference(white, *rough(group.changes[0], group.limit([], change.frame), len(white)))
    along = float(step @ pattern) / float(np.linalg.norm(pattern))
    best = float(np.abs(step @ match.patterns).max())
    return along < 0 and along**2 >= _TAKEN_BACK * best**2


_WIDTHS = (1, 2, 3)  #: frames a pulse may last
_BESIDE = 4  #: frames on either side it is compared with
_MOST_PULSES = 100


def find_pulses(scores: Array) -> tuple[Change, ...]:
    """Find short presses, in time order.

    Parameters
    ----------
    scores : (n, p) float64, as for :func:`changes.find_changes`.

    Returns
    -------
    Changes whose ``window`` is the number of frames they last.
    """
    n = len(scores)
    candidates: list[Change] = []
    for width in _WIDTHS:
        frames = np.arange(_BESIDE, n - _BESIDE - width + 1)
        if len(frames) < 4 * _BESIDE:
            continue
        size, place, sign = _strongest(scores, frames, width)
        above_threshold = np.flatnonzero(size > threshold_for(len(frames), _BESIDE))
        candidates += [
            Change(int(frames[k]), width, int(place[k]), int(sign[k]), float(size[k])) for k in above_threshold
        ]
    pulses: list[Change] = []
    for pulse in sorted(candidates, key=lambda change: -change.score)[: 10 * _MOST_PULSES]:
        if all(_frames_between(pulse, other) > _BESIDE for other in pulses):
            pulses.append(pulse)
    return tuple(sorted(pulses[:_MOST_PULSES], key=lambda change: change.frame))


def interpolate_pulses(white: Array, pulses: tuple[Change, ...]) -> Array:
    """Interpolate linearly over the frames of pulses, (n, m), for further detection."""
    bridged = white.copy()
    for pulse in pulses:
        frame_before, frame_after = pulse.frame - 1, pulse.frame + pulse.window
        share = (np.arange(frame_before + 1, frame_after) - frame_before) / (frame_after - frame_before)
        bridged[frame_before + 1 : frame_after] = (1 - share)[:, None] * white[frame_before] + share[:, None] * white[
            frame_after
        ]
    return bridged


def _strongest(scores: Array, at: NDArray[np.int64], width: int) -> tuple[Array, NDArray[np.int64], Array]:
    """Size, place and sign of the strongest pulse at each moment."""
    total = np.vstack([np.zeros(scores.shape[1]), np.cumsum(scores, axis=0)])
    mean_inside = (total[at + width] - total[at]) / width
    mean_before = (total[at] - total[at - _BESIDE]) / _BESIDE
    mean_after = (total[at + width + _BESIDE] - total[at + width]) / _BESIDE
    rise, fall = _scale_to_noise(mean_inside - mean_before), _scale_to_noise(mean_inside - mean_after)
    size = np.where(rise * fall > 0, np.minimum(np.abs(rise), np.abs(fall)), 0.0)
    place = np.argmax(size, axis=1)
    rows = np.arange(len(at))
    return size[rows, place], place, np.sign(rise[rows, place])


def _scale_to_noise(difference: Array) -> Array:
    noise = MAD_TO_SIGMA * np.median(np.abs(difference - np.median(difference, axis=0)), axis=0)
    return difference / np.maximum(noise, max(float(np.median(noise)), 1e-12))


def _frames_between(earlier: Change, other: Change) -> int:
    return max(earlier.frame - (other.frame + other.window), other.frame - (earlier.frame + earlier.window))
