"""The plan of a run and its schedule; only steps that the dry run has checked move the bench."""

import math
import os
from collections.abc import Collection, Iterator, Sequence as AnySequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from itertools import chain, islice
from typing import Final

from cbsr_qa.domain.errors import ConfigError, PluginError, RefusedError
from cbsr_qa.domain.plan.plan import Motion, SafetyLimits
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.plan.steps import (
    AcquireFrames,
    FindSurface,
    Hold,
    Home,
    LowerHover,
    MarkUnloaded,
    Press,
    Prompt,
    Release,
    Role,
    Settle,
    Step,
    StrainStep,
)
from cbsr_qa.domain.readings.loads import Indenter, Load
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.plugin.failures import blame_plugin
from cbsr_qa.plugin.interfaces import AdaptiveSequence, PressGoal, Sequence, SequenceContext
from cbsr_qa.system.clock import Clock
from cbsr_qa.system.copies import end_copy

#: Share of a frame that must lie inside the hold for it to start. Without it, rounding of the clock would decide
#: whether a hold of exactly 24 frames takes 24 or 25.
WORTHWHILE: Final = 0.1


def is_frame_worthwhile(left_s: float, frame_period_s: float) -> bool:
    """Whether to begin another frame with this much of the hold left."""
    return left_s > WORTHWHILE * frame_period_s


def frames_in_hold(hold_s: float, frame_period_s: float) -> int:
    """Return how many frames a hold takes: one after the other to its end, at least one."""
    return max(1, math.ceil(hold_s / frame_period_s - WORTHWHILE))


class Activity(StrEnum):
    """Kinds of activity, in report order."""

    HOME = "home"
    SURFACE = "surface finding"
    TRAVEL = "travel"
    PRESS = "press"
    HOLD = "hold"
    RELEASE = "release"
    REST = "rest"
    FRAMES = "frames"
    PROMPT = "prompt"
    PAUSE = "pause"


class Spent:
    """Seconds by kind of activity."""

    def __init__(self) -> None:
        self._seconds = dict.fromkeys(Activity, 0.0)

    def add(self, kind: Activity, seconds: float) -> None:
        self._seconds[kind] += seconds

    @contextmanager
    def on(self, kind: Activity, clock: Clock) -> Iterator[None]:
        """Charge the clock time of the body to one kind, also after an error."""
        start_s = clock.now()
        try:
            yield
        finally:
            self.add(kind, clock.now() - start_s)

    def table(self) -> tuple[tuple[str, float], ...]:
        """Return (kind, seconds) of every kind that took time, in report order."""
        return tuple((str(kind), seconds) for kind, seconds in self._seconds.items() if seconds > 0)

    def total_s(self) -> float:
        """Return the sum over all kinds [s]."""
        return sum(self._seconds.values())


#: Steps without anything to say about them.
_DESCRIPTIONS: Final[dict[type, str]] = {
    Home: "homing",
    Release: "releasing",
    MarkUnloaded: "marking the sheet as rested",
}


def describe(step: Step) -> str:
    """Describe a step; an unknown type is named by its class."""
    description = _DESCRIPTIONS.get(type(step), f"an unknown step ({type(step).__name__})")
    match step:
        case FindSurface(x_mm=x_mm, y_mm=y_mm):
            description = f"finding the surface at ({x_mm:zg}, {y_mm:zg}) mm"
        case Press(load=load):
            description = f"pressing {describe_load(load)}"
        case StrainStep(strain=strain):
            description = f"going to {100 * strain:g} %"
        case LowerHover(clearance_mm=clearance_mm):
            description = f"lowering the hover height to {clearance_mm:g} mm"
        case Hold() as hold:
            description = _describe_hold(hold)
        case AcquireFrames(count=count):
            description = f"taking {count} frames"
        case Prompt(text=text):
            description = f"asking: {text}"
    return description


def _describe_hold(hold: Hold) -> str:
    if isinstance(hold, Settle):
        return f"resting for {hold.least_s:g} to {hold.hold_s:g} s until the readings are stable"
    return f"holding still for {hold.hold_s:g} s{', taking frames' if hold.acquire else ''}"


def describe_load(load: Load) -> str:
    """Describe a load: label, place, strain and trial."""
    trial = f", trial {load.trial + 1}" if load.trial else ""
    return f"{load.label} at ({load.x_mm:zg}, {load.y_mm:zg}) mm to {100 * load.strain:g} %{trial}"


def duration(seconds: float) -> str:
    """Format a duration for people: ``"40 s"``, ``"18 min"``, ``"5.4 h"``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


@dataclass(frozen=True, slots=True)
class PlannedPhase:
    """One phase with its sequence."""

    name: str
    sequence_name: str
    sequence: Sequence

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the sequence's steps; ConfigError if its options give none, PluginError if its code fails."""
        with blame_plugin(f"sequence {self.sequence_name!r} of phase {self.name!r}"):
            process = os.getpid()
            try:
                for step in self.sequence.steps(context):
                    end_copy(process)
                    yield step
            except ConfigError as error:
                raise ConfigError(f"phase {self.name!r}: {error.reason}", remedy=error.remedy) from error


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything that runner and dry run need; it cannot move anything.

    Parameters
    ----------
    motion, safety : speeds of the station, and limits that hold whatever the recipe asks for.
    seed : seed of the run; sequences that draw numbers address them by their own name.
    standards : reference standards of the station, which must cover the loads.
    """

    phases: tuple[PlannedPhase, ...]
    sensor_type: SensorType
    material: Material
    indenter: Indenter
    motion: Motion
    safety: SafetyLimits
    seed: int
    standards: tuple[ReferenceStandard, ...] = ()

    @property
    def decides(self) -> bool:
        """Whether a sequence decides between its presses."""
        return any(isinstance(phase.sequence, AdaptiveSequence) for phase in self.phases)

    @property
    def context(self) -> SequenceContext:
        return SequenceContext(self.sensor_type, self.indenter, self.seed, self.material)


#: Most steps of a sequence; one with more counts as endless.
MOST_STEPS: Final = 100_000

#: A load as (phase index, load index within the phase).
LoadKey = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ScheduledStep:
    """One step with its place in the run.

    Parameters
    ----------
    number : number of the step within the phase, from 0.
    load : index within the phase of the load it presses, eases, holds, releases, rests after; None before the first.
    """

    phase: int
    number: int
    step: Step
    load: int | None


@dataclass(frozen=True, slots=True)
class ScheduledPhase:
    """The steps of one phase.

    Parameters
    ----------
    finished : whether it ended in an earlier session, so that only set-up steps remain.
    goal : when a sequence that decides ends; ``steps`` then list every press that may be chosen. None of others.
    pressed : presses done in earlier sessions.
    """

    index: int
    name: str
    sequence: str
    role: Role
    steps: tuple[ScheduledStep, ...]
    loads: int
    finished: bool
    goal: PressGoal | None = None
    pressed: int = 0


def schedule(
    plan: Plan, done: Collection[LoadKey] = (), ended: frozenset[int] = frozenset()
) -> tuple[ScheduledPhase, ...]:
    """Collect the steps of every sequence.

    The head's position is unknown at the start, so every run begins with homing. Loads that are ``done`` are left out
    with their holds and rests; homing and surface finding are not, because the applicator forgets them with the
    power. A phase resumed at a later load repeats the rest before its first load, then the rest before the next load
    with its frames, so that the sheet has rested as intended and the reference frames are recent. RefusedError if
    there is no phase, or a sequence yields no steps or endless ones; PluginError if a sequence's role is invalid.

    Parameters
    ----------
    done : loads finished in an earlier session of the same run, in the order of pressing.
    ended : phases whose last step was carried out in an earlier session.
    """
    if not plan.phases:
        raise RefusedError("the recipe has no phase", remedy="add at least one [[phases]] table")
    return tuple(_schedule_phase(plan, index, phase, done, index in ended) for index, phase in enumerate(plan.phases))


def _schedule_phase(
    plan: Plan, index: int, phase: PlannedPhase, done: Collection[LoadKey], ended: bool
) -> ScheduledPhase:
    steps = tuple(islice(phase.steps(plan.context), MOST_STEPS + 1))
    if not 0 < len(steps) <= MOST_STEPS:
        count = "no step" if not steps else f"more than {MOST_STEPS} steps"
        raise RefusedError(f"sequence {phase.sequence_name!r} of phase {phase.name!r} yields {count}")
    if index == 0 and not isinstance(steps[0], Home):
        steps = tuple(chain([Home()], steps))
    numbered_steps = tuple(_number_steps(index, steps))
    loads = sum(isinstance(step, Press) for step in steps)
    pressed = [load for of_phase, load in done if of_phase == index]
    first_open = next((load for load in range(loads) if load not in pressed), loads)
    goal = phase.sequence.goal if isinstance(phase.sequence, AdaptiveSequence) else None
    if ended:
        remaining_steps = tuple(s for s in numbered_steps if isinstance(s.step, Home | FindSurface))
    elif goal is not None and pressed:
        remaining_steps = tuple(_skip_pressed(numbered_steps, pressed))
    elif first_open:
        remaining_steps = tuple(_skip_finished(numbered_steps, first_open, loads))
    else:
        remaining_steps = numbered_steps
    role = _role(phase)
    return ScheduledPhase(
        index, phase.name, phase.sequence_name, role, remaining_steps, loads, ended, goal, len(pressed)
    )


def _role(phase: PlannedPhase) -> Role:
    role = getattr(phase.sequence, "role", Role.OTHER)
    if not isinstance(role, Role):
        raise PluginError(
            f"sequence {phase.sequence_name!r} of phase {phase.name!r} has role {role!r}, which is not a Role",
            remedy=f"allowed roles: {', '.join(f'Role.{member.name}' for member in Role)} (cbsr_qa.domain.plan)",
        )
    return role


def _number_steps(phase: int, steps: tuple[Step, ...]) -> Iterator[ScheduledStep]:
    load_index = -1
    in_load = False
    for number, step in enumerate(steps):
        if isinstance(step, Press):
            load_index, in_load = load_index + 1, True
        elif not isinstance(step, StrainStep | Hold | Release | AcquireFrames):
            in_load = False
        yield ScheduledStep(phase, number, step, load_index if in_load else None)


def _skip_finished(numbered: tuple[ScheduledStep, ...], first_open: int, loads: int) -> Iterator[ScheduledStep]:
    """Yield the remaining steps of a phase after its first, completed loads (at least one)."""
    load_index = -1
    released = False
    for scheduled in numbered:
        step = scheduled.step
        if isinstance(step, Press):
            load_index, released = load_index + 1, False
        if isinstance(step, Home | FindSurface) or load_index >= first_open:
            yield scheduled
        elif first_open == loads:  # all loads are done: only the steps after the last one remain
            if load_index == loads - 1 and scheduled.load is None:
                yield scheduled
        elif load_index == -1:
            # The sheet rests again; the unloaded frames of finished loads are already stored.
            if not isinstance(step, MarkUnloaded | AcquireFrames):
                yield scheduled
        elif load_index == first_open - 1 and (released or scheduled.load is None):
            yield scheduled
        released = released or isinstance(step, Release)


def _skip_pressed(numbered: tuple[ScheduledStep, ...], pressed: AnySequence[int]) -> Iterator[ScheduledStep]:
    """Yield the remaining steps of a phase that decides: set-up, a rest as before any press, presses still to choose.

    The unloaded frames of finished presses are already stored.
    """
    before, presses = split_presses(numbered)
    yield from (scheduled for scheduled in before if not isinstance(scheduled.step, MarkUnloaded | AcquireFrames))
    released = False
    for scheduled in presses[pressed[-1]]:
        if released:
            yield scheduled
        released = released or isinstance(scheduled.step, Release)
    for load, steps in presses.items():
        if load not in pressed:
            yield from steps


def split_presses(
    steps: AnySequence[ScheduledStep],
) -> tuple[tuple[ScheduledStep, ...], dict[int, tuple[ScheduledStep, ...]]]:
    """Return the steps before the first press, and those of each press by its load.

    A press begins with the surface finding of its place right before it, if there is one.
    """
    starts = [
        number - (number > 0 and type(steps[number - 1].step) is FindSurface)
        for number, scheduled in enumerate(steps)
        if isinstance(scheduled.step, Press)
    ]
    presses = [tuple(steps[start:end]) for start, end in zip(starts, [*starts[1:], len(steps)], strict=True)]
    by_load = {scheduled.load: press for press in presses for scheduled in press if isinstance(scheduled.step, Press)}
    return tuple(steps[: min(starts, default=len(steps))]), {k: v for k, v in by_load.items() if k is not None}


def ends_rest(step: Step) -> bool:
    """Whether this step ends the rest after a load."""
    return not isinstance(step, StrainStep | Hold | AcquireFrames | Release | MarkUnloaded)
