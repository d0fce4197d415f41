"""Looks after the bench while steps are carried out: samples, limits, and whether everybody is still there."""

from collections.abc import Callable
from functools import partial
from typing import Final, Protocol, TypeVar

from cbsr_qa.clock import Clock
from cbsr_qa.domain.errors import InstrumentError, SafetyError
from cbsr_qa.domain.run_events import SamplesTaken
from cbsr_qa.interfaces import Sampler
from cbsr_qa.runner.bench import Bench
from cbsr_qa.runner.documents import Documents
from cbsr_qa.runner.limits import Limits
from cbsr_qa.runner.plan import Plan
from cbsr_qa.runner.safety import Interlock

T = TypeVar("T")

#: While nothing else happens, force and duration are looked at this often [s].
WATCH_S: Final = 5.0
#: What is due within this time is due [s].
_SOON_S: Final = 1e-3


class Attempt(Protocol):
    """Asks an instrument, and again where that is harmless."""

    def __call__(self, operation: Callable[[], T], what: str) -> T:
        """Return what it answers."""
        ...


class Watch:
    """Takes over what the samplers have, holds the limits, asks who is there.

    Parameters
    ----------
    limits : what is held against the samples and the time.
    attempt : asks an instrument, and again where that is harmless.
    """

    def __init__(
        self,
        plan: Plan,
        bench: Bench,
        clock: Clock,
        documents: Documents,
        interlock: Interlock,
        limits: Limits,
        attempt: Attempt,
    ) -> None:
        self._safety = plan.safety
        self._bench = bench
        self._clock = clock
        self._documents = documents
        self._interlock = interlock
        self._limits = limits
        self._attempt = attempt
        self._drained_s = dict.fromkeys(range(len(bench.samplers)), clock.now())
        self._alive = bench.alive()
        self._asked_s = clock.now()

    def look(self, phase: int) -> None:
        """Look at everything that is due; samples are told as those of this phase.

        Raises
        ------
        SafetyError
            If a limit does not hold, or an instrument has fallen silent (rule ``"heartbeat"``).
        """
        for number, sampler in enumerate(self._bench.samplers):
            self._drain(phase, number, sampler)
        self._limits.check_time(self._clock.now(), touching=self._interlock.touching, down=self._interlock.dwelling)
        if self._silent_s() >= self._safety.heartbeat_s - _SOON_S:
            self._ask_all()

    def next_look_s(self) -> float:
        """How long may be waited until the next look [s]."""
        every_s = min(WATCH_S, self._safety.stale_s / 2) if self._interlock.touching else WATCH_S
        return max(min(every_s, self._safety.heartbeat_s - self._silent_s()), _SOON_S) if self._alive else every_s

    def _silent_s(self) -> float:
        """How long nobody has been asked [s]."""
        return self._clock.now() - self._asked_s

    def _drain(self, phase: int, number: int, sampler: Sampler) -> None:
        who = self._bench.name_of(sampler)
        block = self._attempt(partial(sampler.samples_since, self._drained_s[number]), f"{who}: its samples")
        if len(block):
            self._drained_s[number] = float(block.time_s[-1])
            self._documents.emit(SamplesTaken(phase, block))
            self._limits.check_samples(block, who)  # after the journal has it: it is the evidence

    def _ask_all(self) -> None:
        for instrument in self._alive:
            try:
                self._attempt(instrument.alive, f"{self._bench.name_of(instrument)}: whether it is there")
            except InstrumentError as error:
                raise SafetyError("heartbeat", error.reason, remedy=error.remedy) from error
        self._asked_s = self._clock.now()
