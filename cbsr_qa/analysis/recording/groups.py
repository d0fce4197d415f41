"""Steps grouped into presses.

A step at the place of an earlier one and of its sign continues that press, unless its trace has largely decayed by
then; one of the other sign reverses it. A step elsewhere begins a press if it leads away from the initial state of
the recording. One that leads back to that state without an earlier press releases a load that rose too slowly to be a
step.
"""

from dataclasses import dataclass, field

import numpy as np

from cbsr_qa.analysis.recording.changes import Change
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
    steps : those of the press's sign, in time order; for a slow press only its release.
    sign : +1 where the place conducts more.
    releases : steps that reverse it.
    slow : whether it rose too slowly to be detected as a step.
    """

    steps: list[Change]
    sign: int
    releases: list[Change] = field(default_factory=list)
    slow: bool = False

    @property
    def frame(self) -> int:
        """Frame of its first step."""
        return self.steps[0].frame

    def limit(self, others: list["Group"], n: int) -> int:
        """Last frame for the first pattern: before its release, and before another press."""
        limits = [release.frame - release.window // 2 for release in self.releases]
        limits += [other.frame - other.steps[0].window for other in others if other.frame > self.frame]
        return max(min([*limits, n]), self.frame + 1)


def group_steps(white: Array, match: Matcher, steps: tuple[Change, ...]) -> list[Group]:
    """Combine steps into groups.

    Parameters
    ----------
    white : (n, m) whitened readings. steps : in time order.
    """
    groups: list[Group] = []
    for k, step in enumerate(steps):
        if any(_add_to_group(step, group, white, match) for group in reversed(groups)):
            continue
        group = Group([step], step.sign)
        # Drift also leads away: a step that a later one reverses is a press, whatever it led back to.
        undone = any(
            later.sign != step.sign and _measure_distance(later, group, match) <= SAME_PLACE
            for later in steps[k + 1 :]
        )
        if not undone and _leads_back(step, white, match):
            if not any(_explains(group, step, white, match) for group in groups):
                groups.append(Group([step], -step.sign, [step], slow=True))
        else:
            groups.append(group)
    return groups


def is_same_place(earlier: Group, other: Group, match: Matcher) -> bool:
    """Whether two presses are at the same place, so that the later one ends the earlier."""
    return min(_measure_distance(step, other, match) for step in earlier.steps) <= SAME_PLACE


def _measure_distance(step: Change, group: Group, match: Matcher) -> float:
    place = match.places[step.place]
    return min(float(np.hypot(*(place - match.places[other.place]))) for other in group.steps)


def _add_to_group(step: Change, group: Group, white: Array, match: Matcher) -> bool:
    """Add a step to a press at the same place, as its continuation or its release."""
    if _measure_distance(step, group, match) > SAME_PLACE:
        return False
    if group.slow:
        return step.sign != group.sign
    if step.sign == group.sign:
        if not _continues(step, group, white):
            return False
        group.steps.append(step)
        return True
    along = trace(white, *rough(group.steps[0], min(group.limit([], len(white)), step.frame), len(white)))
    level_after = float(along[step.frame : step.frame + max(step.window, 2)].mean())
    if level_after < -_CROSSED:
        return False
    group.releases.append(step)
    return True


def _continues(step: Change, group: Group, white: Array) -> bool:
    """Whether the trace kept its level until a further step."""
    first_step = group.steps[0]
    along = trace(white, *rough(first_step, min(group.limit([], len(white)), step.frame), len(white)))
    until = max(step.frame - step.window // 2, group.steps[-1].frame + 1)
    rise_so_far = smooth(along[first_step.frame : until])
    return len(rise_so_far) == 0 or float(rise_so_far[-1]) > (1 - _NEW_PRESS_LOSS) * float(rise_so_far.max())


def _frames_beside(step: Change, n: int) -> tuple[slice, slice]:
    before = slice(max(step.frame - step.window - max(step.window // 2, 1), 0), max(step.frame - 1, 1))
    first_after = min(step.frame + max(step.window // 2, 1), n - 1)
    return before, slice(first_after, min(first_after + step.window, n))


def _leads_back(step: Change, white: Array, match: Matcher) -> bool:
    """Whether a step returns its place towards the initial state."""
    before, after = _frames_beside(step, len(white))
    start = slice(0, max(min(BEFORE_FRAMES, before.start), 2))
    middle = (white[before].mean(axis=0) + white[after].mean(axis=0)) / 2 - white[start].mean(axis=0)
    return float(middle @ match.patterns[:, step.place]) * step.sign < 0


def _explains(group: Group, step: Change, white: Array, match: Matcher) -> bool:
    """Whether a step may release a press: one still held, or one of the same pattern if its place is slightly off."""
    if group.slow or step.sign == group.sign:
        return False
    if not group.releases:
        return True
    jump = difference(white, *_frames_beside(step, len(white)))
    pattern = difference(white, *rough(group.steps[0], group.limit([], step.frame), len(white)))
    along = float(jump @ pattern) / float(np.linalg.norm(pattern))
    best = float(np.abs(jump @ match.patterns).max())
    return along < 0 and along**2 >= _TAKEN_BACK * best**2
