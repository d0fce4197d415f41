"""Steps put together: which of them begin a press, which belong to one, and which take one back.

A sheet is pressed and released, and both are steps. A step at the place of an earlier one and of its sign goes on
with that press, unless the press had lost much of its trace by then; one of the other sign takes it back. A step
elsewhere begins a press of its own sign if it leads away from the state the recording began in. One that leads back
to that state, though nothing that was seen to be pressed explains it, releases a load that
came too slowly to be a step.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_changes import Change
from cbsr_qa.analysis.recording_places import Matcher
from cbsr_qa.analysis.recording_traces import BEFORE_FRAMES, difference, rough, smooth, trace

Array = NDArray[np.float64]

SAME_PLACE = 0.4  #: of the radius: two steps nearer than this are at the same place
_NEW_PRESS_LOSS = 0.4  #: a step at the same place is a new press if the trace had lost this share before it
_CROSSED = 0.5  #: a step of the other sign that goes beyond the state before the press by this share is a new one
_TAKEN_BACK = 0.5  #: a step is a release if an earlier press explains this share of what the best place does


@dataclass(slots=True)
class Group:
    """Steps of one press.

    Parameters
    ----------
    changes : of the press's sign, in time order; for a press that came slowly only its release.
    sign : +1 where the place conducts more.
    releases : steps that take it back.
    slow : whether it came too slowly for its beginning to be a step.
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
        """Frame up to which the first pattern may be taken: before its release, and before another press."""
        after = [change.frame - change.window // 2 for change in self.releases]
        after += [other.frame - other.changes[0].window for other in others if other.frame > self.frame]
        return max(min([*after, n]), self.frame + 1)


def group_changes(white: Array, match: Matcher, changes: tuple[Change, ...]) -> list[Group]:
    """Put steps together.

    Parameters
    ----------
    white : (n, m) whitened readings. changes : in time order.
    """
    groups: list[Group] = []
    for k, change in enumerate(changes):
        if any(_taken(change, group, white, match) for group in reversed(groups)):
            continue
        group = Group([change], change.sign)
        # Drift leads away as well: a step that a later one takes back is a press, whatever it led back to.
        undone = any(c.sign != change.sign and _apart(c, group, match) <= SAME_PLACE for c in changes[k + 1 :])
        if not undone and _leads_back(change, white, match):
            if not any(_explains(group, change, white, match) for group in groups):
                groups.append(Group([change], -change.sign, [change], slow=True))
        else:
            groups.append(group)
    return groups


def same_place(one: Group, other: Group, match: Matcher) -> bool:
    """Whether two presses are at one place, so that the later one ends the earlier."""
    return min(_apart(change, other, match) for change in one.changes) <= SAME_PLACE


def _apart(change: Change, group: Group, match: Matcher) -> float:
    return min(float(np.hypot(*(match.places[change.place] - match.places[one.place]))) for one in group.changes)


def _taken(change: Change, group: Group, white: Array, match: Matcher) -> bool:
    """Add a step to a press at the same place that it continues or takes back."""
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
    after = float(along[change.frame : change.frame + max(change.window, 2)].mean())
    if after < -_CROSSED:
        return False
    group.releases.append(change)
    return True


def _continues(change: Change, group: Group, white: Array) -> bool:
    """Whether nothing much of the trace was lost before a further step."""
    first = group.changes[0]
    along = trace(white, *rough(first, min(group.limit([], len(white)), change.frame), len(white)))
    until = max(change.frame - change.window // 2, group.changes[-1].frame + 1)
    so_far = smooth(along[first.frame : until])
    return len(so_far) == 0 or float(so_far[-1]) > (1 - _NEW_PRESS_LOSS) * float(so_far.max())


def _sides(change: Change, n: int) -> tuple[slice, slice]:
    """Frames on either side of a step."""
    before = slice(max(change.frame - change.window - max(change.window // 2, 1), 0), max(change.frame - 1, 1))
    after = min(change.frame + max(change.window // 2, 1), n - 1)
    return before, slice(after, min(after + change.window, n))


def _leads_back(change: Change, white: Array, match: Matcher) -> bool:
    """Whether a step brings its place nearer to the state the recording began in."""
    before, after = _sides(change, len(white))
    start = slice(0, max(min(BEFORE_FRAMES, before.start), 2))
    middle = (white[before].mean(axis=0) + white[after].mean(axis=0)) / 2 - white[start].mean(axis=0)
    return float(middle @ match.patterns[:, change.place]) * change.sign < 0


def _explains(group: Group, change: Change, white: Array, match: Matcher) -> bool:
    """Whether a step may be a press taken back: one still held, or along its pattern if its place is a little off."""
    if group.slow or change.sign == group.sign:
        return False
    if not group.releases:
        return True
    step = difference(white, *_sides(change, len(white)))
    pattern = difference(white, *rough(group.changes[0], group.limit([], change.frame), len(white)))
    along = float(step @ pattern) / float(np.linalg.norm(pattern))
    best = float(np.abs(step @ match.patterns).max())
    return along < 0 and along**2 >= _TAKEN_BACK * best**2
