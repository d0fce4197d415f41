"""Safety as a state machine: what the bench may do next, and how it comes to rest whatever happens."""

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Final

from cbsr_qa.domain.errors import SafetyError
from cbsr_qa.runner.bench import Bench


class State(StrEnum):
    """States of the bench as the runner knows it."""

    IDLE = "idle"  #: nothing was touched yet
    CLEARING = "clearing"  #: every instrument is being told to reach its safe state, whatever it was left in
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
    State.IDLE: frozenset({State.CLEARING, State.STOPPING}),
    State.CLEARING: frozenset({State.ARMED, State.STOPPING}),
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
#: States in which it is in the sheet and stays there.
DWELLING: Final = frozenset({State.PRESSED, State.EASING})


class Interlock:
    """Holds the state and allows transitions."""

    def __init__(self) -> None:
        self.state = State.IDLE

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

    @property
    def dwelling(self) -> bool:
        """Whether the head is in the sheet and stays there, still or eased."""
        return self.state in DWELLING

    def clear(self, bench: Bench) -> None:
        """Bring the bench to its safe state before anything else: what was killed left the head where it was.

        Raises
        ------
        SafetyError
            With rule ``"safe start"`` if an instrument did not get there; nothing has moved on purpose.
        """
        self.to(State.CLEARING)
        failed = bench.safe_state()
        if failed:
            self.to(State.STOPPING)
            self.to(State.UNSAFE)
            raise SafetyError(
                "safe start",
                f"the bench could not be brought to its safe state before the run: {'; '.join(failed)}",
                remedy="nothing was moved or stored; look at the bench before touching it",
            )
        self.to(State.ARMED)

    def stop(self, bench: Bench) -> tuple[str, ...]:
        """Bring the whole bench to its safe state; returns who did not get there, in words."""
        self.state = State.STOPPING  # from anywhere: stopping is never refused
        failed = bench.safe_state()
        self.to(State.UNSAFE if failed else State.SAFE)
        return failed
