"""Execution of a plan: steps, events, and the end of a run."""

import logging
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from cbsr_qa.domain import AbortedError, CbsrError, InstrumentError, SafetyError
from cbsr_qa.domain.results import EndReason
from cbsr_qa.domain.run import PhaseFinished, PhaseStarted, RunEnded, RunIdentity, RunStarted, StepStarted
from cbsr_qa.plugin import said
from cbsr_qa.station.bench import Bench
from cbsr_qa.station.documents import Documents, Subscriber, Warn
from cbsr_qa.station.dry_runs import DryPhase, DryRun, dry_run
from cbsr_qa.station.interrupts import Interrupts, OperatorPrompt, Stopped, on_stderr
from cbsr_qa.station.limits import check_samplers
from cbsr_qa.station.performer import Ask, Performer
from cbsr_qa.station.plan import LoadKey, Plan, ScheduledStep, describe
from cbsr_qa.station.safety import Interlock, UnderWay
from cbsr_qa.station.watchdog import BrokenInto, Watchdog
from cbsr_qa.system import Clock

#: Reason and detail.
Ending = tuple[EndReason, str]

_log: Final = logging.getLogger(__name__)


def ending(error: BaseException, where: str, *, at_once: bool = False, before: Ending | None = None) -> Ending:
    """Return how an error ended a run.

    Parameters
    ----------
    where : "while", the current step, and the state of the bench.
    before : earlier ending, if this error arose while the head was being lifted.
    """
    with suppress(Exception):
        _log.debug("the run ended while %s", where, exc_info=error)
    if before is not None:
        reason, detail = before
        return reason, f"{detail}; {_during_retreat(error)}"
    if isinstance(error, AbortedError | KeyboardInterrupt):
        how = " and at once by a second signal" if at_once else ""
        return EndReason.ABORTED, f"by {_by(error)}{how}, {where}"
    return EndReason.BROKEN, f"{_what(error)}, {where}{_remedy(error)}"


def unsafe(end: Ending, silent: tuple[str, ...]) -> Ending:
    """Report instruments that did not reach their safe state; the run is then broken in any case."""
    warnings = [f"NOT SAFE: {who}; check the bench before touching it" for who in silent]
    return EndReason.BROKEN, "; ".join([*filter(None, [_told(end)]), *warnings])


def _told(end: Ending) -> str:
    reason, detail = end
    return f"aborted {detail}" if reason is EndReason.ABORTED else detail


def _by(error: BaseException) -> str:
    return error.by if isinstance(error, AbortedError | Stopped) else "the operator (Ctrl-C)"


def _what(error: BaseException) -> str:
    match error:
        case BrokenInto():
            return _what(error.error)
        case SafetyError():
            return f"rule {error.rule!r}: {error.reason}"
        case InstrumentError():
            return f"instrument {error.reason}"
        case CbsrError():
            return error.reason
        case _:
            return f"error {said(error)}"


def _remedy(error: BaseException) -> str:
    cause = error.error if isinstance(error, BrokenInto) else error
    remedy = cause.remedy if isinstance(cause, CbsrError) else ""
    return f"; {remedy}" if remedy else ""


def _during_retreat(error: BaseException) -> str:
    if isinstance(error, AbortedError | KeyboardInterrupt):
        return "a second signal ended it at once"
    return f"lifting the head failed: {_what(error)}"


def execute(
    plan: Plan,
    identity: RunIdentity,
    bench: Bench,
    clock: Clock,
    subscribers: Sequence[Subscriber],
    *,
    done: frozenset[LoadKey] = frozenset(),
    ended: frozenset[int] = frozenset(),
    ask: Ask | None = None,
    retries: int = 2,
    warn: Warn = _log.warning,
    tell: Warn = on_stderr,
) -> RunEnded:
    """Run a plan on an open bench and leave the bench safe.

    The bench is brought to its safe state before anything else: an earlier session may have been killed. Returns how
    the run ended; after its start nothing is raised. The bench is in its safe state, or the detail names instruments
    that are not. Before any event or motion, RefusedError if the plan violates the station's limits, a limit cannot
    be monitored, or there is no journal; SafetyError if the bench could not be made safe.

    Parameters
    ----------
    subscribers : called with every document in order. The first is the journal, which stores a document before the
        others see it; a document it cannot store breaks the run. The others cannot stop the run.
    done : loads (phase, index) finished in an earlier session of the same run; they are not pressed again.
    ended : phases that ended in an earlier session; only homing and surface finding of them are done again.
    ask : shows a prompt and returns when it is answered; an :class:`~cbsr_qa.station.OperatorPrompt` if instruments
        ask through it as well, so that one that waits for the operator does not count as hanging.
    retries : how often an operation that failed retryably is tried again.
    warn : called with subscribers that fail.
    tell : called from a signal's handler with its effect and that of another one.
    """
    dry = dry_run(plan, bench.frame_source.frame_period_s, done=done, ended=ended, answered=ask is not None)
    dry.refuse()
    check_samplers(plan, bench.samplers)
    interlock = Interlock()
    prompt = ask if isinstance(ask, OperatorPrompt) else OperatorPrompt(ask)
    with (
        Interrupts(tell) as interrupts,
        Watchdog(
            plan.safety.answer_s,
            break_in=interrupts.break_in,
            make_safe=bench.safe_state,
            tell=tell,
            excused=prompt.is_waiting,
        ) as watchdog,
    ):
        interlock.clear(bench)
        interrupts.hurry, interrupts.waiting = watchdog.hurry, prompt.is_waiting
        documents = Documents(subscribers, interrupts, warn)
        run = UnderWay(plan, bench, clock, documents, interlock, interrupts, watchdog)
        performer = Performer(run, retries=retries, ask=None if ask is None else prompt)
        end, detail = _Execution(dry, run, performer).to_its_end(identity)
        return documents.finish(RunEnded(end, detail, clock.now(), performer.spent.table()))


class _Execution:
    """Executes the scheduled steps, and keeps track of the current one."""

    def __init__(self, dry: DryRun, run: UnderWay, performer: Performer) -> None:
        self._dry = dry
        self._clock, self._documents, self._interlock = run.clock, run.documents, run.interlock
        self._bench, self._interrupts, self._watchdog = run.bench, run.interrupts, run.watchdog
        self._performer = performer
        self._left_s = dry.duration_s
        self._at: tuple[DryPhase, ScheduledStep] | None = None
        self._end: Ending | None = None

    def to_its_end(self, identity: RunIdentity) -> Ending:
        """Execute the plan and leave the bench safe in any case; never raises."""
        interrupts = self._interrupts
        silent: tuple[str, ...] = ()
        try:
            with interrupts.heard():
                self._through_or_back(identity)
        except BaseException as error:  # noqa: BLE001 - whatever it is, the head comes up
            interrupts.mask()
            self._end = ending(error, self.where(), at_once=interrupts.urgent, before=self._end)
        finally:
            interrupts.mask()
            self._watchdog.end()
            silent = self._interlock.stop(self._bench)
        assert self._end is not None
        return unsafe(self._end, silent) if silent else self._end

    def _through_or_back(self, identity: RunIdentity) -> None:
        """Execute the plan; if stopped, lift the head as after any press."""
        try:
            self._through(identity)
        except (AbortedError, KeyboardInterrupt) as error:
            urgent = self._interrupts.urgent
            self._end = ending(error, self.where(), at_once=urgent)
            if not urgent:
                self._performer.retreat()
        else:
            self._end = EndReason.FINISHED, ""

    def _through(self, identity: RunIdentity) -> None:
        self._documents.emit(RunStarted(identity))
        for phase in self._dry.phases:
            self._phase(phase)

    def where(self) -> str:
        if self._at is None:
            return "before the first step"
        phase, step = self._at
        text = f"while {describe(step.step)} (phase {phase.scheduled.name!r}, step {step.number})"
        return f"{text}, bench {self._interlock.state}"

    def _phase(self, phase: DryPhase) -> None:
        scheduled = phase.scheduled
        # A phase finished in an earlier session is already stored; only the bench is set up again.
        if not scheduled.finished:
            began = PhaseStarted(
                scheduled.index, scheduled.name, scheduled.sequence, self._clock.now(), scheduled.role
            )
            self._documents.emit(began)
        for step, planned_s in zip(scheduled.steps, phase.durations_s, strict=True):
            self._at = phase, step
            now_s = self._clock.now()
            self._documents.emit(StepStarted(step.phase, step.number, step.step, now_s, max(self._left_s, 0.0)))
            self._performer.perform(step)
            self._left_s -= planned_s
        self._performer.finish_load()
        if not scheduled.finished:
            self._documents.emit(PhaseFinished(scheduled.index, self._clock.now()))
