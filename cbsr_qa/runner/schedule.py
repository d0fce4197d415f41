"""The steps of all phases in order, each with the load it belongs to.

The schedule is made once and then executed: what the dry run has checked is what moves.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from typing import Final

from cbsr_qa.domain.errors import PluginError, RefusedError
from cbsr_qa.domain.steps import (
    AcquireFrames,
    Ease,
    FindSurface,
    Hold,
    Home,
    MarkUnloaded,
    Press,
    Release,
    Role,
    Step,
)
from cbsr_qa.runner.plan import Plan, PlannedPhase

#: A sequence that makes more steps than this is taken to be endless.
MOST_STEPS: Final = 100_000

#: A load as (phase index, load index within the phase).
LoadKey = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ScheduledStep:
    """One step with its place in the run.

    Parameters
    ----------
    phase : index of its phase.
    number : 0-based within the phase.
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
    role : what the sequence says it is for.
    loads : how many loads it presses, finished ones included.
    finished : it ended in an earlier session; only what sets the bench up is left.
    """

    index: int
    name: str
    sequence: str
    role: Role
    steps: tuple[ScheduledStep, ...]
    loads: int
    finished: bool


def schedule(
    plan: Plan, done: frozenset[LoadKey] = frozenset(), ended: frozenset[int] = frozenset()
) -> tuple[ScheduledPhase, ...]:
    """Ask every sequence for its steps.

    Nobody knows where the head is when a run begins, so a run begins with homing whether its first sequence
    asks for it or not. Loads that are ``done`` are left out with their holds and rests; homing and surface
    finding are not, because the applicator forgets them with the power. A phase that goes on with a later load
    begins again with the rest before its first load, and then with the rest before the load that is next, frames
    included: it is pressed on a sheet that has rested as it was meant to, and its last frames before are fresh.

    Parameters
    ----------
    done : loads finished in an earlier session of the same run.
    ended : phases whose last step was carried out in an earlier session.

    Raises
    ------
    RefusedError
        If there is no phase, or a sequence makes no step or no end of them.
    PluginError
        If a sequence's role is none.
    """
    if not plan.phases:
        raise RefusedError("the recipe has no phase", remedy="give it at least one [[phases]] table")
    return tuple(_scheduled(plan, index, phase, done, index in ended) for index, phase in enumerate(plan.phases))


def _scheduled(plan: Plan, index: int, phase: PlannedPhase, done: frozenset[LoadKey], ended: bool) -> ScheduledPhase:
    steps = tuple(islice(phase.steps(plan.context), MOST_STEPS + 1))
    if not 0 < len(steps) <= MOST_STEPS:
        found = "no step" if not steps else f"more than {MOST_STEPS} steps"
        raise RefusedError(f"sequence {phase.sequence_name!r} of phase {phase.name!r} makes {found}")
    if index == 0 and not isinstance(steps[0], Home):
        steps = tuple(chain([Home()], steps))
    numbered = tuple(_numbered(index, steps))
    loads = sum(isinstance(step, Press) for step in steps)
    first_open = next((load for load in range(loads) if (index, load) not in done), loads)
    if ended:
        left = tuple(s for s in numbered if isinstance(s.step, Home | FindSurface))
    elif first_open:
        left = tuple(_left(numbered, first_open, loads))
    else:
        left = numbered
    return ScheduledPhase(index, phase.name, phase.sequence_name, _role(phase), left, loads, ended)


def _role(phase: PlannedPhase) -> Role:
    role = getattr(phase.sequence, "role", Role.OTHER)
    if not isinstance(role, Role):
        raise PluginError(
            f"sequence {phase.sequence_name!r} of phase {phase.name!r} has role {role!r}, which is no Role",
            remedy=f"a role is one of {', '.join(f'Role.{known.name}' for known in Role)} (cbsr_qa.domain.steps)",
        )
    return role


def _numbered(phase: int, steps: tuple[Step, ...]) -> Iterator[ScheduledStep]:
    pressed = -1
    inside = False
    for number, step in enumerate(steps):
        if isinstance(step, Press):
            pressed, inside = pressed + 1, True
        elif not isinstance(step, Ease | Hold | Release | AcquireFrames):
            inside = False
        yield ScheduledStep(phase, number, step, pressed if inside else None)


def _left(numbered: tuple[ScheduledStep, ...], first_open: int, loads: int) -> Iterator[ScheduledStep]:
    """Yield what is left of a phase whose first loads are done, at least one of them."""
    pressed = -1
    released = False
    for scheduled in numbered:
        step = scheduled.step
        if isinstance(step, Press):
            pressed, released = pressed + 1, False
        if isinstance(step, Home | FindSurface) or pressed >= first_open:
            yield scheduled
        elif first_open == loads:  # nothing is pressed any more: only what comes after the last load
            if pressed == loads - 1 and scheduled.load is None:
                yield scheduled
        elif pressed == -1:
            # The sheet rests again; the unloaded frames that belong to the loads that are done are there already.
            if not isinstance(step, MarkUnloaded | AcquireFrames):
                yield scheduled
        elif pressed == first_open - 1 and (released or scheduled.load is None):
            yield scheduled
        released = released or isinstance(step, Release)


def ends_rest(step: Step) -> bool:
    """Whether the rest after a load is over when this step begins."""
    return not isinstance(step, Ease | Hold | AcquireFrames | Release | MarkUnloaded)
