"""Safety as a state machine: what the bench may do next, and how it comes to rest whatever happens."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Final

from cbsr_qa.domain.errors import SafetyError
from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.loads import Load
from cbsr_qa.runner.bench import FORCE_CHANNEL, Bench
from cbsr_qa.runner.plan import Plan
from cbsr_qa.runner.rules import Violation, load_violations, place_violations
from cbsr_qa.runner.wording import duration


class State(StrEnum):
    """States of the bench as the runner knows it."""

    IDLE = "idle"  #: nothing was touched yet
    ARMED = "armed"  #: the head is up and still; steps may begin
    MOVING = "moving"  #: the head travels or homes
    FEELING = "feeling"  #: the head feels for the surface, and touches it
    PRESSING = "pressing"  #: the head goes down
    PRESSED = "pressed"  #: the head is down and still
    EASING = "easing"  #: the head goes to another depth without leaving the sheet
    RELEASING = "releasing"  #: the head goes up
    STOPPING = "stopping"  #: every instrument is being told to reach its safe state
    SAFE = "safe"  #: every instrument said it did
    UNSAFE = "unsafe"  #: at least one did not: somebody must look


#: Which state may follow which. STOPPING may follow every one but the two it ends in.
TRANSITIONS: Final[dict[State, frozenset[State]]] = {
    State.IDLE: frozenset({State.ARMED, State.STOPPING}),
    State.ARMED: frozenset({State.MOVING, State.FEELING, State.PRESSING, State.STOPPING}),
    State.MOVING: frozenset({State.ARMED, State.STOPPING}),
    State.FEELING: frozenset({State.ARMED, State.STOPPING}),
    State.PRESSING: frozenset({State.PRESSED, State.STOPPING}),
    State.PRESSED: frozenset({State.EASING, State.RELEASING, State.STOPPING}),
    State.EASING: frozenset({State.PRESSED, State.STOPPING}),
    State.RELEASING: frozenset({State.ARMED, State.STOPPING}),
    State.STOPPING: frozenset({State.SAFE, State.UNSAFE}),
    State.SAFE: frozenset(),
    State.UNSAFE: frozenset(),
}

#: States in which the head touches, or may touch, the sheet.
TOUCHING: Final = frozenset({State.FEELING, State.PRESSING, State.PRESSED, State.EASING, State.RELEASING})


class Interlock:
    """Holds the state, allows transitions, and checks the station's limits while steps are executed.

    The limits were checked by the dry run; they are checked again here because the dry run only knows what
    was planned. Every check raises :class:`SafetyError` naming its rule.

    Parameters
    ----------
    plan : with the station's limits.
    started_s : on the run's clock.
    """

    def __init__(self, plan: Plan, started_s: float) -> None:
        self.state = State.IDLE
        self._plan = plan
        self._started_s = started_s
        self._force_time_s = started_s

    def to(self, state: State) -> None:
        """Go to a state.

        Raises
        ------
        SafetyError
            With rule ``"order"`` if it may not follow the present one.
        """
        if state not in TRANSITIONS[self.state]:
            raise SafetyError("order", f"the bench is {self.state}; it cannot be {state} next")
        self.state = state

    @contextmanager
    def passing(self, through: State, into: State) -> Iterator[None]:
        """Be in one state while something happens and in the next after it; an error leaves the first."""
        self.to(through)
        yield
        self.to(into)

    @property
    def touching(self) -> bool:
        """Whether the head touches, or may touch, the sheet."""
        return self.state in TOUCHING

    def check_load(self, load: Load) -> None:
        """Check strain, expected force and place of a press before it."""
        self._refuse(load_violations(load, self._plan))

    def check_place(self, x_mm: float, y_mm: float) -> None:
        """Check a place before the head goes there."""
        self._refuse(place_violations(x_mm, y_mm, self._plan))

    def check_samples(self, block: SampleBlock) -> None:
        """Hold measured force against the ceiling, pull as well as push, and remember how fresh it is."""
        if block.channel != FORCE_CHANNEL or not len(block):
            return
        peak_N = float(abs(block.values).max())
        if not math.isfinite(peak_N):
            raise SafetyError("force", "the force is not a number", remedy="check the load cell and its cable")
        if peak_N > self._plan.safety.force_N:
            raise SafetyError("force", f"{peak_N:.3g} N measured; the station allows {self._plan.safety.force_N:g} N")
        self._force_time_s = max(self._force_time_s, float(block.time_s[-1]))

    def check_time(self, now_s: float) -> None:
        """Check the run's duration, and while the head touches the age of the last force sample."""
        safety = self._plan.safety
        if now_s - self._started_s > safety.duration_s:
            raise SafetyError(
                "duration", f"the run takes longer than the station allows ({duration(safety.duration_s)})"
            )
        age_s = now_s - self._force_time_s
        if self.touching and age_s > safety.stale_s:
            raise SafetyError(
                "stale force",
                f"the last force sample is {age_s:.3g} s old; the station allows {safety.stale_s:g} s while the head"
                " touches the sheet",
                remedy="check the load cell and its cable",
            )

    def stop(self, bench: Bench) -> tuple[str, ...]:
        """Bring the whole bench to its safe state; returns who did not get there, in words."""
        self.state = State.STOPPING  # from anywhere: stopping is never refused
        failed = bench.safe_state()
        self.to(State.UNSAFE if failed else State.SAFE)
        return failed

    @staticmethod
    def _refuse(violations: Iterator[Violation]) -> None:
        for violation in violations:
            raise SafetyError(violation.rule, violation.what)
