"""Presses in an unannotated recording: one event per press.

The sheet is slow: it creeps while held, keeps much of the change after the release (two thirds, two seconds later, on
the lab's recordings), and relaxes for long. So a press is detected as a *step* (:mod:`changes`), and its start,
maximum and final decline are read from the trace of its own pattern (:mod:`traces`). Each press has its own sign, and
changes elsewhere do not end it. It is imaged relative to the frames just before it, so residues of earlier presses do
not matter.

Not every step is a load: one proportional to the frame itself is a change of gain, one confined to the readings of a
single contact is a contact fault (:mod:`cbsr_qa.analysis.defects`), and others may fit no place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cbsr_qa.analysis.defects.contacts import Suspect, suspect_in
from cbsr_qa.analysis.recording.changes import Change, find_steps
from cbsr_qa.analysis.recording.groups import SAME_PLACE, Group, group_steps, is_same_place
from cbsr_qa.analysis.recording.places import Matcher, Place, find_places, fit_loads
from cbsr_qa.analysis.recording.pulses import find_pulses, interpolate_pulses
from cbsr_qa.analysis.recording.traces import (
    BEFORE_FRAMES,
    difference,
    end_of,
    noise_energy,
    rise,
    rough,
    signal_energy,
    slow_rise,
    smooth,
    step_start,
    trace,
)
from cbsr_qa.domain.numbers import Array

_CLOSE = 3  #: frames: a pulse this close to a press at its place is part of it
_RESIDUE = 0.6  #: a sheet keeps at most this share of a short press
_FAINT = 2.0  #: a pattern whose signal energy is below so many times that of noise is too faint to follow its rise
_EXPLAINED = 0.5  #: least share of a change that the loads must explain …
_EXPLAINED_SIGMA = 3.0  #: … unless noise may explain the rest


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A detected press; frames are indices into the series.

    Parameters
    ----------
    start : fractional frame at which the change passed a fifth of its plateau.
    peak : frame of the largest change.
    end : fractional frame of the release, or the last frame.
    before, held : frames of the reference and of the hold; for a load held from the beginning the reference is later.
    places : places of its loads, several if pressed simultaneously.
    score : score of its strongest step.
    slow : whether only its release was a step.
    released : first frame after its last release that was a step; 0 without any.
    """

    start: float
    peak: int
    end: float
    before: slice
    held: slice
    places: tuple[Place, ...]
    score: float
    slow: bool = False
    released: int = 0


@dataclass(slots=True)
class Found:
    """Presses, and changes that are not presses.

    Parameters
    ----------
    rejected : frame and reason.
    gains : frame and relative growth of all readings.
    suspects : frame and contact.
    """

    presses: list[Press] = field(default_factory=list)
    rejected: list[tuple[int, str]] = field(default_factory=list)
    gains: list[tuple[int, float]] = field(default_factory=list)
    suspects: list[tuple[int, Suspect]] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class NoLoads:
    """Explanations of changes that are not loads.

    Parameters
    ----------
    frame : (m,) whitened change that doubles every reading; zeros if a common gain cannot be determined or does not
        matter.
    suspects : contacts.
    """

    frame: Array
    suspects: tuple[Suspect, ...] = ()


def find_presses(white: Array, match: Matcher, steps: Sequence[Change], no_loads: NoLoads | None = None) -> Found:
    """Combine steps into presses.

    Parameters
    ----------
    white : (n, m) whitened readings, see :meth:`Matcher.whiten`.
    steps : from :func:`changes.find_steps`, in time order.
    no_loads : patterns not to be mistaken for loads.
    """
    no_loads = no_loads or NoLoads(np.zeros(white.shape[1]))
    search = _Search(white, match, no_loads, group_steps(white, match, tuple(steps)))
    for group in search.groups:
        search.close(group)
    return search.found


def search(white: Array, match: Matcher, no_loads: NoLoads) -> tuple[Found, tuple[Change, ...]]:
    """Search for short and for lasting presses.

    Parameters
    ----------
    white : (n, m) whitened readings.

    Returns
    -------
    The presses, and the steps and pulses behind them.
    """
    pulses = find_pulses(white @ match.patterns)
    steps = find_steps(white @ match.patterns)
    presses = find_presses(white, match, steps, no_loads)
    pulses = tuple(
        pulse for pulse in pulses if not any(_belongs_to_press(pulse, press, match) for press in presses.presses)
    )
    if not pulses:
        return presses, steps
    calm = interpolate_pulses(white, pulses)
    steps = find_steps(calm @ match.patterns)
    presses = find_presses(calm, match, steps, no_loads)
    short_search = _Search(white, match, no_loads, [])
    for pulse in pulses:
        short_search.close_short(pulse)
    for press in short_search.found.presses:
        _add_short(press, presses)
    presses.suspects += short_search.found.suspects
    presses.gains += short_search.found.gains
    presses.rejected += short_search.found.rejected
    return presses, (*steps, *pulses)


def _belongs_to_press(pulse: Change, press: Press, match: Matcher) -> bool:
    """Whether a pulse belongs to a held press or its release.

    A press known only by its release may be just the end of the pulse.
    """
    if press.slow:
        return False
    x, y = match.places[pulse.place]
    distance = min(np.hypot(place.x - x, place.y - y) for place in press.places)
    return bool(distance <= SAME_PLACE and press.start + _CLOSE < pulse.frame < press.end + _CLOSE)


def _add_short(short: Press, presses: Found) -> None:
    """Add a short press, unless it belongs to a lasting one."""
    for press in presses.presses:
        distance = np.hypot(press.places[0].x - short.places[0].x, press.places[0].y - short.places[0].y)
        if distance > SAME_PLACE or not press.start - _CLOSE < short.start < press.end + _CLOSE:
            continue
        # What the sheet keeps of a short press is not released later, as a load that relaxed at first is.
        is_residue = abs(press.places[0].score) < _RESIDUE * abs(short.places[0].score)
        is_residue = is_residue and press.released <= short.end + _CLOSE
        if is_residue and abs(press.start - short.start) < short.end - short.start + _CLOSE:
            # The lasting part is what the sheet keeps of the short press.
            presses.presses.remove(press)
            break
        return
    presses.presses.append(short)


class _Course(NamedTuple):
    """Reference and hold of a press, its fractional first and last frames, and the trace (n,) of its pattern."""

    before: slice
    held: slice
    start: float
    end: float
    along: Array


@dataclass(slots=True)
class _Search:
    white: Array
    match: Matcher
    no_loads: NoLoads
    groups: list[Group]
    found: Found = field(default_factory=Found)

    def close(self, group: Group) -> None:
        """Evaluate one press from its steps."""
        before, held, start, end, along = self._trace_slow_press(group) if group.slow else self._trace_step(group)
        if places := self._find_loads(group.frame, before, held):
            first_frame = min(int(np.ceil(start)), int(end))
            peak = first_frame + int(np.argmax(along[first_frame : max(int(np.ceil(end)), first_frame + 1)]))
            score = max(step.score for step in group.steps)
            released = max((release.frame for release in group.releases), default=0)
            self.found.presses.append(Press(start, peak, end, before, held, places, score, group.slow, released))

    def close_short(self, pulse: Change) -> None:
        """Evaluate a press of a few frames."""
        frames_before = slice(max(pulse.frame - BEFORE_FRAMES, 0), pulse.frame)
        frames_held = slice(pulse.frame, pulse.frame + pulse.window)
        if places := self._find_loads(pulse.frame, frames_before, frames_held):
            start, end = pulse.frame - 0.5, frames_held.stop - 0.5
            peak = pulse.frame + int(np.argmax(trace(self.white, frames_before, frames_held)[frames_held]))
            self.found.presses.append(Press(start, peak, end, frames_before, frames_held, places, pulse.score))

    def _find_loads(self, frame: int, before: slice, held: slice) -> tuple[Place, ...]:
        """Return the loads that explain a change, or an empty list and the reason."""
        change = difference(self.white, before, held)
        noise = noise_energy(self.white, before, held) / self.white.shape[1]
        places, explained = find_places(change, self.match, noise=noise)
        load = fit_loads(change, self.match, places)
        if suspect := suspect_in(change, load, self.match.nuisance, noise, self.no_loads.suspects):
            self.found.suspects.append((frame, suspect))
        elif share := self._find_common_gain(change):
            self.found.gains.append((frame, share))
        elif reason := _explain_no_load(self.white, explained, before, held):
            self.found.rejected.append((frame, reason))
        else:
            return places
        return ()

    def _trace_step(self, group: Group) -> _Course:
        """Follow a press that started with a step."""
        first_step = group.steps[0]
        limits = self._find_limits(group)
        frames_before, frames_held = rough(first_step, group.limit(self.groups, len(self.white)), len(self.white))
        window = min(step.window for step in group.steps)
        is_clear = signal_energy(self.white, frames_before, frames_held) > _FAINT * noise_energy(
            self.white, frames_before, frames_held
        )
        for _ in range(2):
            end, along = self._find_end(group, frames_before, frames_held, window, limits)
            start, first_held = rise(along, first_step, int(end)) if is_clear else step_start(first_step, int(end))
            frames_before = slice(max(int(start) - BEFORE_FRAMES, 0), max(int(start), 1))
            frames_held = slice(first_held, max(min(int(end) + (end == limits[-1] - 1), limits[0]), first_held + 1))
        return _Course(frames_before, frames_held, start, end, along)

    def _trace_slow_press(self, group: Group) -> _Course:
        """Follow a press of which only the release is a step."""
        release = group.steps[0]
        until = max(release.frame - release.window // 2, 2)
        frames_held = slice(max(until - BEFORE_FRAMES, 1), until)
        frames_before = slice(0, max(min(BEFORE_FRAMES, frames_held.start), 1))
        along = smooth(trace(self.white, frames_before, frames_held), release.window)
        start = slow_rise(along, frames_held.start)
        frames_before = slice(max(int(start) - BEFORE_FRAMES, 0), max(int(start), 1))
        along = smooth(trace(self.white, frames_before, frames_held), release.window)
        end = end_of(along, frames_held.start, self._find_limits(group)[0])
        return _Course(frames_before, frames_held, start, end, along)

    def _find_limits(self, group: Group) -> list[int]:
        """Frames at which other events begin, up to the next press at the same place, or the end."""
        later = [other for other in self.groups if other.frame > group.frame and other is not group]
        limits: list[int] = []
        for other in sorted(later, key=lambda each: each.frame):
            limits.append(max(other.frame - other.steps[0].window, group.steps[-1].frame + 1))
            if is_same_place(group, other, self.match):
                return limits
        return [*limits, len(self.white)]

    def _find_end(
        self, group: Group, before: slice, held: slice, window: int, limits: list[int]
    ) -> tuple[float, Array]:
        """Find the end of a press: before the next step elsewhere, or after it with that pattern fitted too."""
        count = len(self.white)
        along = smooth(trace(self.white, before, held), window)
        end = end_of(along, group.frame, limits[0])
        for before_it, limit in pairwise(limits):
            if end < before_it - 1:
                break
            besides = [
                difference(self.white, *rough(other.steps[0], other.limit(self.groups, count), count))
                for other in self.groups
                if group.frame < other.frame < limit and not other.slow
            ]
            along = smooth(trace(self.white, before, held, besides), window)
            end = end_of(along, group.frame, limit)
        return end, along

    def _find_common_gain(self, change: Array) -> float:
        """Return the common factor of all readings, if it explains a change as well as the best place."""
        power = float(self.no_loads.frame @ self.no_loads.frame)
        if power == 0:
            return 0.0
        along = float(change @ self.no_loads.frame)
        best = float(np.abs(change @ self.match.patterns).max())
        return along / power if along**2 / power >= best**2 else 0.0


def find_initial_loads(presses: Sequence[Press], n: int) -> tuple[list[Press], list[Press]]:
    """Distinguish releases of initial loads from loads that stay to the end.

    Both are a single step that is never reversed. If every press that ends has one sign, such a step of the other
    sign is a release, as a sheet responds alike to all loads.

    Parameters
    ----------
    n : number of frames.

    Returns
    -------
    All presses, with those steps as loads from frame 0 on, and the presses that remain undecided.
    """
    stays = [press.end >= n - 1 for press in presses]
    signs = {_sign_of_first_load(press) for press, to_the_end in zip(presses, stays, strict=True) if not to_the_end}
    corrected: list[Press] = []
    unclear: list[Press] = []
    for press, to_the_end in zip(presses, stays, strict=True):
        if to_the_end and signs == {-_sign_of_first_load(press)}:
            places = tuple(replace(place, score=-place.score) for place in press.places)
            end = max(press.start, 0.0)
            corrected.append(Press(0.0, 0, end, press.held, press.before, places, press.score))
            continue
        corrected.append(press)
        if to_the_end and not signs:
            unclear.append(press)
    return corrected, unclear


def _sign_of_first_load(press: Press) -> int:
    return 1 if press.places[0].score > 0 else -1


def _explain_no_load(white: Array, explained: float, before: slice, held: slice) -> str:
    """Explain why a change is not a load if even the best places explain too little of it; empty otherwise."""
    noise, signal = noise_energy(white, before, held), signal_energy(white, before, held)
    per_reading = noise / white.shape[1]
    doubt = _EXPLAINED_SIGMA * per_reading * np.sqrt(2 * white.shape[1] + 4 * signal / per_reading)
    share = explained * (signal + noise) / signal
    if share * signal + _EXPLAINED * doubt >= _EXPLAINED * signal:
        return ""
    return f"it does not look like a load: the best places explain {share:.0%} of it"
