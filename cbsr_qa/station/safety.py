"""Safety of a run: allowed transitions of the bench, its safe state, and monitoring."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Final, Protocol, TypeVar

from cbsr_qa.domain.errors import InstrumentError, SafetyError
from cbsr_qa.domain.run.events import SamplesTaken
from cbsr_qa.plugin.instruments import Sampler
from cbsr_qa.station.bench import Bench
from cbsr_qa.station.documents import Documents
from cbsr_qa.station.interrupts import Interrupts
from cbsr_qa.station.limits import Limits
from cbsr_qa.station.plan import Plan
from cbsr_qa.station.watchdog import Watchdog
from cbsr_qa.system.clock import Clock


class State(StrEnum):
    """States of the bench."""

    IDLE = "idle"  #: no command yet
    CLEARING = "clearing"  #: every instrument is brought to its safe state before the run
    ARMED = "armed"  #: the head is up and still; steps may begin
    MOVING = "moving"  #: the head travels or homes
    FEELING = "feeling"  #: the head searches the surface, and touches it
    PRESSING = "pressing"  #: the head goes down
    PRESSED = "pressed"  #: the head is down and still
    EASING = "easing"  #: the head goes to another depth without leaving the sheet
    RELEASING = "releasing"  #: the head goes up
    STOPPING = "stopping"  #: every instrument is brought to its safe state
    SAFE = "safe"  #: every instrument reached it
    UNSAFE = "unsafe"  #: at least one did not: check the bench

    @property
    def in_words(self) -> str:
        """Activity of the head, for the sentence that says where a run ended."""
        return _IN_WORDS.get(self, f"bench {self.value}")


_IN_WORDS: Final[dict[State, str]] = {
    State.ARMED: "head up",
    State.MOVING: "head travelling",
    State.FEELING: "head searching the surface",
    State.PRESSING: "head going down",
    State.PRESSED: "head down",
    State.EASING: "head changing its depth",
    State.RELEASING: "head going up",
}

#: States that may follow each state. STOPPING may follow every one but the two it ends in.
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
#: States in which the head is in the sheet and stays there.
DWELLING: Final = frozenset({State.PRESSED, State.EASING})


class Interlock:
    """Holds the state of the bench and checks transitions."""

    def __init__(self) -> None:
        self.state = State.IDLE

    def to(self, state: State) -> None:
        """Change to a state. SafetyError with rule ``"order"`` if it may not follow the present one."""
        if state not in TRANSITIONS[self.state]:
            raise SafetyError("order", f"the bench is {self.state}; it cannot be {state} next")
        self.state = state

    @contextmanager
    def passing(self, through: State, into: State) -> Iterator[None]:
        """Be in one state during the body and in the next after it; after an error stay in the first."""
        self.to(through)
        yield
        self.to(into)

    @property
    def touching(self) -> bool:
        """Whether the head touches, or may touch, the sheet."""
        return self.state in TOUCHING

    @property
    def dwelling(self) -> bool:
        """Whether the head stays in the sheet, still or eased."""
        return self.state in DWELLING

    def clear(self, bench: Bench) -> None:
        """Bring the bench to its safe state first: a killed process left the head where it was.

        SafetyError with rule ``"safe start"`` if an instrument failed to reach it.
        """
        self.to(State.CLEARING)
        failed = bench.safe_state()
        if failed:
            self.to(State.STOPPING)
            self.to(State.UNSAFE)
            raise SafetyError(
                "safe start",
                f"the bench could not be brought to a safe state before the run: {'; '.join(failed)}",
                remedy="nothing was moved or stored; check the bench before touching it",
            )
        self.to(State.ARMED)

    def stop(self, bench: Bench) -> tuple[str, ...]:
        """Bring the bench to its safe state; return descriptions of instruments that failed."""
        self.state = State.STOPPING  # from anywhere: stopping is never refused
        failed = bench.safe_state()
        self.to(State.UNSAFE if failed else State.SAFE)
        return failed


T = TypeVar("T")

#: Interval of checks of force and duration while idle [s].
WATCH_S: Final = 5.0
#: Time ahead of a check at which it is done already [s].
_SOON_S: Final = 1e-3


@dataclass(frozen=True, slots=True)
class UnderWay:
    """The parts of a run in progress."""

    plan: Plan
    bench: Bench
    clock: Clock
    documents: Documents
    interlock: Interlock
    interrupts: Interrupts
    watchdog: Watchdog


class Attempt(Protocol):
    """Calls an instrument, with retries if harmless."""

    def __call__(self, operation: Callable[[], T], what: str) -> T: ...


class Watch:
    """Collects samples, checks the limits, and checks that instruments respond.

    ``attempt``: function that queries an instrument, with retries if harmless.
    """

    def __init__(self, run: UnderWay, limits: Limits, attempt: Attempt) -> None:
        self._safety, self._bench, self._clock = run.plan.safety, run.bench, run.clock
        self._documents, self._interlock = run.documents, run.interlock
        self._limits = limits
        self._attempt = attempt
        self._drained_s = dict.fromkeys(range(len(run.bench.samplers)), run.clock.now())
        self._alive = run.bench.alive()
        self._asked_s = self._looked_s = run.clock.now()

    def is_due(self) -> bool:
        """Whether the next check is due; asked by a run that waits in short steps."""
        return self._clock.now() - self._looked_s >= WATCH_S - _SOON_S or (
            bool(self._alive) and self._silent_s() >= self._safety.heartbeat_s - _SOON_S
        )

    def look(self, phase: int) -> None:
        """Do everything that is due; samples are stored under this phase.

        SafetyError if a limit is violated, or an instrument does not respond (rule ``"heartbeat"``).
        """
        self._looked_s = self._clock.now()
        for number, sampler in enumerate(self._bench.samplers):
            self._drain(phase, number, sampler)
        self._limits.check_time(self._clock.now(), touching=self._interlock.touching, down=self._interlock.dwelling)
        if self._silent_s() >= self._safety.heartbeat_s - _SOON_S:
            self._ask_all()

    def wait_s(self) -> float:
        """Longest wait until the next check [s]."""
        every_s = min(WATCH_S, self._safety.stale_s / 2) if self._interlock.touching else WATCH_S
        return max(min(every_s, self._safety.heartbeat_s - self._silent_s()), _SOON_S) if self._alive else every_s

    def _silent_s(self) -> float:
        """Time since the last liveness check [s]."""
        return self._clock.now() - self._asked_s

    def _drain(self, phase: int, number: int, sampler: Sampler) -> None:
        sampler_name = self._bench.name_of(sampler)
        block = self._attempt(
            partial(sampler.samples_since, self._drained_s[number]), f"{sampler_name}: reading its samples"
        )
        if len(block):
            self._drained_s[number] = float(block.time_s[-1])
            self._documents.emit(SamplesTaken(phase, block))
            self._limits.check_samples(block, sampler_name)  # after the journal has stored it as evidence

    def _ask_all(self) -> None:
        for instrument in self._alive:
            try:
                self._attempt(instrument.alive, f"{self._bench.name_of(instrument)}: checking that it responds")
            except InstrumentError as error:
                raise SafetyError("heartbeat", error.reason, remedy=error.remedy) from error
        self._asked_s = self._clock.now()
