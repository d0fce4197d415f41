"""Runs a plan: every step, every document, and one way to end whatever happens."""

import logging
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from cbsr_qa.clock import Clock
from cbsr_qa.domain.errors import AbortedError, InstrumentError, SafetyError
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.run import RunIdentity
from cbsr_qa.domain.run_events import PhaseFinished, PhaseStarted, RunEnded, RunStarted, StepStarted
from cbsr_qa.runner.bench import Bench
from cbsr_qa.runner.documents import Documents, Subscriber, Warn
from cbsr_qa.runner.dry_run import DryPhase, DryRun, dry_run
from cbsr_qa.runner.interrupts import Interrupts, Stopped
from cbsr_qa.runner.performing import Ask, Performer
from cbsr_qa.runner.plan import Plan
from cbsr_qa.runner.safety import Interlock, State
from cbsr_qa.runner.schedule import LoadKey, ScheduledStep
from cbsr_qa.runner.wording import describe

_log: Final = logging.getLogger(__name__)


def execute(
    plan: Plan,
    identity: RunIdentity,
    bench: Bench,
    clock: Clock,
    subscribers: Sequence[Subscriber],
    *,
    done: frozenset[LoadKey] = frozenset(),
    ask: Ask | None = None,
    retries: int = 2,
    warn: Warn = _log.warning,
) -> RunEnded:
    """Run a plan on an open bench and leave the bench safe.

    Parameters
    ----------
    subscribers : told every document in order. The first is the journal: it has stored a document before
        anybody else sees it, and a document it cannot store breaks the run. The others cannot stop the run.
    done : loads (phase, index) finished in an earlier session of the same run; they are not pressed again.
    ask : shows a prompt and returns when it is answered.
    retries : how often an operation that failed retryably is tried again.
    warn : is told about subscribers that fail.

    Returns
    -------
    How the run ended; once it has begun, nothing is raised. The bench is in its safe state, or the detail
    says which instrument is not.

    Raises
    ------
    RefusedError
        Before anything is told or moved: the plan breaks the station's limits, or there is no journal.
    """
    dry = dry_run(plan, bench.frame_source.frame_period_s, done=done, answered=ask is not None)
    dry.refuse()
    with Interrupts() as interrupts:
        documents = Documents(subscribers, interrupts, warn)
        interlock = Interlock(plan, clock.now())
        performer = Performer(plan, bench, clock, documents, interlock, retries=retries, ask=ask)
        walk = _Walk(dry, performer, documents, interlock, clock)
        end, detail = EndReason.BROKEN, ""
        try:
            walk.through(identity)
            interrupts.mask()
            end = EndReason.FINISHED
        except BaseException as error:  # noqa: BLE001 - whatever it is, the head comes up
            interrupts.mask()
            end, detail = _ending(error, walk.where())
        finally:
            silent = interlock.stop(bench)
        if silent:
            end, detail = EndReason.BROKEN, "; ".join([*filter(None, [detail]), *map(_not_safe, silent)])
        return documents.finish(RunEnded(end, detail, clock.now(), performer.spent.table()))


class _Walk:
    """Goes through the scheduled steps and remembers where it is."""

    def __init__(
        self, dry: DryRun, performer: Performer, documents: Documents, interlock: Interlock, clock: Clock
    ) -> None:
        self._dry = dry
        self._performer = performer
        self._documents = documents
        self._interlock = interlock
        self._clock = clock
        self._left_s = dry.duration_s
        self._at: tuple[DryPhase, ScheduledStep] | None = None

    def through(self, identity: RunIdentity) -> None:
        """Tell and carry out everything."""
        self._documents.emit(RunStarted(identity))
        self._interlock.to(State.ARMED)
        for phase in self._dry.phases:
            self._phase(phase)

    def where(self) -> str:
        """Say which step was under way, and what the bench was doing."""
        if self._at is None:
            return f"before the first step, bench {self._interlock.state}"
        phase, step = self._at
        said = f"{describe(step.step)} (phase {phase.scheduled.name!r}, step {step.number})"
        return f"{said}, bench {self._interlock.state}"

    def _phase(self, phase: DryPhase) -> None:
        told = phase.scheduled
        # A phase that an earlier session finished has its documents already; only the bench is set up again.
        if not told.finished:
            began = PhaseStarted(told.index, told.name, told.sequence, self._clock.now(), told.role)
            self._documents.emit(began)
        for step, planned_s in zip(told.steps, phase.durations_s, strict=True):
            self._at = phase, step
            now_s = self._clock.now()
            self._documents.emit(StepStarted(step.phase, step.number, step.step, now_s, max(self._left_s, 0.0)))
            self._performer.perform(step)
            self._left_s -= planned_s
        self._performer.finish_load()
        if not told.finished:
            self._documents.emit(PhaseFinished(told.index, self._clock.now()))


def _ending(error: BaseException, where: str) -> tuple[EndReason, str]:
    with suppress(Exception):
        _log.debug("the run ended while %s", where, exc_info=error)
    match error:
        case AbortedError() | Stopped():
            return EndReason.ABORTED, f"by {error.by}, while {where}"
        case KeyboardInterrupt():
            return EndReason.ABORTED, f"by the operator (Ctrl-C), while {where}"
        case SafetyError():
            return EndReason.BROKEN, f"rule {error.rule!r}: {error.reason}, while {where}"
        case InstrumentError():
            return EndReason.BROKEN, f"{error.reason}, while {where}"
        case _:
            return EndReason.BROKEN, f"{type(error).__name__}: {error}, while {where}"


def _not_safe(said: str) -> str:
    return f"NOT SAFE: {said}; look at the bench before touching it"
