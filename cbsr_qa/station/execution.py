"""Execution of a plan: steps, events, and the end of a run."""

import logging
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

from cbsr_qa.domain.errors import AbortedError, CbsrError, ConfigError, InstrumentError, SafetyError
from cbsr_qa.domain.plan.steps import AcquireFrames, Hold, LowerHover, MarkUnloaded, Release, TouchPlane
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.run.events import PhaseFinished, PhaseStarted, RunEnded, RunEvent, RunStarted, StepStarted
from cbsr_qa.domain.run.run import PressDecided, RunIdentity
from cbsr_qa.domain.run.states import SECOND_SIGNAL, EndReason
from cbsr_qa.plugin.instruments import GuidedApplicator
from cbsr_qa.station.bench import Bench
from cbsr_qa.station.control.desk import ControlDesk
from cbsr_qa.station.documents import Documents, Subscriber, Warn
from cbsr_qa.station.dry_runs import DryPhase, DryRun, dry_run
from cbsr_qa.station.interrupts import Interrupts, Stopped, on_stderr
from cbsr_qa.station.limits import check_samplers
from cbsr_qa.station.performer import Ask, Performer
from cbsr_qa.station.plan import LoadKey, Plan, ScheduledStep, describe, ends_rest, split_presses
from cbsr_qa.station.prompts import OperatorPrompt
from cbsr_qa.station.safety import Interlock, UnderWay
from cbsr_qa.station.watchdog import BrokenInto, Watchdog
from cbsr_qa.system.clock import Clock
from cbsr_qa.system.reserve import MemoryReserve
from cbsr_qa.system.words import describe_error

if TYPE_CHECKING:
    from cbsr_qa.station.surface import SheetSurface

#: End of a run: reason and detail.
Ending = tuple[EndReason, str]
#: A step and its expected duration [s].
TimedStep = tuple[ScheduledStep, float]

_log: Final = logging.getLogger(__name__)


def ending(error: BaseException, where: str, *, at_once: str = "", before: Ending | None = None) -> Ending:
    """Return how an error ended a run.

    Parameters
    ----------
    where : place in the run: "while", the current step, and the state of the bench.
    at_once : cause of an end at once, not in order; empty without one.
    before : earlier ending, if this error arose while the head was being lifted.
    """
    with suppress(Exception):
        _log.debug("the run ended while %s", where, exc_info=error)
    if before is not None:
        reason, detail = before
        if isinstance(error, AbortedError | KeyboardInterrupt):
            return reason, f"{detail}; {at_once or SECOND_SIGNAL} ended it at once"
        return reason, f"{detail}; lifting the head failed: {_describe_error(error)}"
    if isinstance(error, AbortedError | KeyboardInterrupt):
        stopper = error.by if isinstance(error, AbortedError | Stopped) else "the operator (Ctrl-C)"
        if at_once:
            stopper = at_once if stopper in at_once else f"{stopper} and at once by {at_once}"
        return EndReason.ABORTED, f"by {stopper}, {where}"
    cause = error.error if isinstance(error, BrokenInto) else error
    remedy = f"; {cause.remedy}" if isinstance(cause, CbsrError) and cause.remedy else ""
    return EndReason.BROKEN, f"{_describe_error(error)}, {where}{remedy}"


def unsafe(end: Ending, silent: tuple[str, ...]) -> Ending:
    """Report instruments that did not reach their safe state; the run is then broken in any case."""
    warnings = [f"NOT SAFE: {instrument}; check the bench before touching it" for instrument in silent]
    reason, detail = end
    ending = f"aborted {detail}" if reason is EndReason.ABORTED else detail
    return EndReason.BROKEN, "; ".join([*filter(None, [ending]), *warnings])


def _describe_error(error: BaseException) -> str:
    match error:
        case BrokenInto():
            return _describe_error(error.error)
        case SafetyError():
            return f"rule {error.rule!r}: {error.reason}"
        case InstrumentError():
            return f"instrument {error.reason}"
        case CbsrError():
            return error.reason
        case _:
            return f"error {describe_error(error)}"


class Decider(Protocol):
    """Decides which press of a phase is next, from what is stored of the run."""

    def follow(self, event: RunEvent) -> None:
        """Take note of an event that is stored."""
        ...

    def begin(self, identity: RunIdentity, phase: int, pressed: int, last: LoadRecord | None) -> None:
        """Begin to decide in another thread, after some presses of a phase.

        Parameters
        ----------
        last : the last of them if its rest has not ended; None if all are among the events.
        """
        ...

    def decide(self, time_s: float) -> tuple[PressDecided, bool]:
        """Wait for the decision; return it, and whether it is new: not of an earlier session."""
        ...


def execute(
    plan: Plan,
    identity: RunIdentity,
    bench: Bench,
    clock: Clock,
    subscribers: Sequence[Subscriber],
    *,
    done: Collection[LoadKey] = (),
    ended: frozenset[int] = frozenset(),
    ask: Ask | None = None,
    desk: ControlDesk | None = None,
    decider: Decider | None = None,
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
    subscribers : functions called with every document in order. The first is the journal, which stores a document
        before the others see it; a document it cannot store breaks the run. The others cannot stop the run.
    done : loads (phase, index) finished in an earlier session of the same run, in the order of pressing; they are
        not pressed again.
    ended : phases that ended in an earlier session; only homing and surface finding of them are done again.
    ask : function that shows a prompt and returns when it is answered; an ``OperatorPrompt`` if instruments
        ask through it as well, so that one that waits for the operator does not count as hanging.
    desk : desk that takes requests to pause, to continue, and to stop.
    decider : decides between presses; needed by plans with a sequence that decides.
    retries : most repetitions of an operation that failed retryably.
    warn : function called with a message for each subscriber that fails.
    tell : function called in a signal's handler with its effect and that of another signal.
    """
    dry = dry_run(plan, bench.frame_source.frame_period_s, done=done, ended=ended, answered=ask is not None)
    dry.refuse()
    check_samplers(plan, bench.samplers)
    surface = _follow_surface(dry, plan, bench)
    interlock = Interlock()
    prompt = ask if isinstance(ask, OperatorPrompt) else OperatorPrompt(ask)
    reserve = MemoryReserve()

    def make_safe() -> tuple[str, ...]:
        reserve.give_back()
        return bench.safe_state()

    with (
        Interrupts(tell) as interrupts,
        Watchdog(
            plan.safety.answer_s,
            break_in=interrupts.break_in,
            make_safe=make_safe,
            tell=tell,
            excused=prompt.is_waiting,
        ) as watchdog,
    ):
        interlock.clear(bench)
        interrupts.hurry, interrupts.waiting = watchdog.hurry, prompt.is_waiting
        follow = [] if decider is None else [decider.follow]
        documents = Documents([subscribers[0], *follow, *subscribers[1:]], interrupts, warn)
        run = UnderWay(plan, bench, clock, documents, interlock, interrupts, watchdog)
        performer = Performer(run, retries=retries, ask=None if ask is None else prompt, surface=surface)
        execution = _Execution(dry, run, performer, prompt, desk or ControlDesk(), decider, reserve)
        end, detail = execution.to_its_end(identity)
        return documents.finish(RunEnded(end, detail, clock.now(), performer.spent.table()))


def _follow_surface(dry: DryRun, plan: Plan, bench: Bench) -> "SheetSurface | None":
    """Return what follows the surface for a recipe with steps that need it, or None.

    ConfigError if the bench's force applicator cannot be told where the surface is.
    """
    steps = [scheduled.step for phase in dry.phases for scheduled in phase.scheduled.steps]
    if not any(isinstance(step, TouchPlane | LowerHover) for step in steps):
        return None
    from cbsr_qa.station.surface import SheetSurface  # other recipes need none

    applicator = bench.force_applicator
    if not isinstance(applicator, GuidedApplicator):
        raise ConfigError(
            f"{bench.name_of(applicator)} does not take a surface, or a hover height",
            remedy='let the recipe\'s phases have surface = "each" and no clearance_mm',
        )
    return SheetSurface(applicator, plan.motion, plan.safety.travel_radius_mm + plan.indenter.reach_mm)


@dataclass(frozen=True, slots=True)
class _Brakes:
    """Stops a run under way, from another thread."""

    interrupts: Interrupts
    watchdog: Watchdog

    def stop(self, by: str) -> bool:
        return self.interrupts.ask_to_stop(f"{by} (remote)")

    def emergency(self, by: str) -> bool:
        heard = self.interrupts.ask_to_stop(f"{by} (remote)", at_once=True)
        if heard:
            self.watchdog.insist()
        return heard


class _Execution:
    """Executes the scheduled steps, and keeps track of the current one."""

    def __init__(
        self,
        dry: DryRun,
        run: UnderWay,
        performer: Performer,
        prompt: OperatorPrompt[Any],
        desk: ControlDesk,
        decider: Decider | None,
        reserve: MemoryReserve,
    ) -> None:
        self._dry, self._decider, self._reserve = dry, decider, reserve
        self._clock, self._documents, self._interlock = run.clock, run.documents, run.interlock
        self._bench, self._interrupts, self._watchdog = run.bench, run.interrupts, run.watchdog
        self._performer = performer
        self._prompt, self._desk = prompt, desk
        self._left_s = dry.duration_s
        self._at: tuple[DryPhase, ScheduledStep] | None = None
        self._end: Ending | None = None

    def to_its_end(self, identity: RunIdentity) -> Ending:
        """Execute the plan and leave the bench safe in any case; never raises."""
        interrupts = self._interrupts
        silent: tuple[str, ...] = ()
        try:
            with interrupts.listen():
                self._desk.open(_Brakes(interrupts, self._watchdog))
                self._execute_or_lift(identity)
        except BaseException as error:  # noqa: BLE001 - after any error the head comes up
            self._reserve.give_back()
            interrupts.mask()
            self._end = ending(error, self.describe_place(), at_once=interrupts.urgent_by, before=self._end)
        finally:
            self._reserve.give_back()
            interrupts.mask()
            self._desk.close()
            self._prompt.unheard()
            self._watchdog.end()
            silent = self._interlock.stop(self._bench)
        assert self._end is not None
        return unsafe(self._end, silent) if silent else self._end

    def _execute_or_lift(self, identity: RunIdentity) -> None:
        """Execute the plan; if stopped, lift the head as after any press."""
        try:
            self._execute_plan(identity)
        except (AbortedError, KeyboardInterrupt) as error:
            urgent_by = self._interrupts.urgent_by
            self._end = ending(error, self.describe_place(), at_once=urgent_by)
            if not urgent_by:
                self._performer.retreat()
        else:
            self._end = EndReason.FINISHED, ""

    def _execute_plan(self, identity: RunIdentity) -> None:
        self._identity = identity
        self._documents.emit(RunStarted(identity))
        self._prompt.report_to(
            self._documents.emit, self._clock, lambda: 0 if self._at is None else self._at[1].phase
        )
        for phase in self._dry.phases:
            self._phase(phase)

    def describe_place(self) -> str:
        if self._at is None:
            return "before the first step"
        phase, step = self._at
        text = f"while {describe(step.step)} (phase {phase.scheduled.name!r}, step {step.number})"
        return f"{text}, {self._interlock.state.in_words}"

    def _phase(self, phase: DryPhase) -> None:
        scheduled = phase.scheduled
        # A phase finished in an earlier session is already stored; only the bench is set up again.
        if not scheduled.finished:
            started_event = PhaseStarted(
                scheduled.index, scheduled.name, scheduled.sequence, self._clock.now(), scheduled.role
            )
            self._documents.emit(started_event)
        left_s = self._left_s - phase.duration_s
        steps = list(zip(scheduled.steps, phase.durations_s, strict=True))
        performed: list[TimedStep] = []
        if scheduled.goal is None or scheduled.finished:
            self._perform_all(phase, steps, performed)
        else:
            self._press_chosen(phase, steps, performed)
        self._left_s = left_s
        self._performer.finish_load()
        if not scheduled.finished:
            self._documents.emit(PhaseFinished(scheduled.index, self._clock.now()))

    def _press_chosen(self, phase: DryPhase, steps: Sequence[TimedStep], performed: list[TimedStep]) -> None:
        """Press what is decided after each press, until it is decided that the phase ends."""
        assert self._decider is not None
        scheduled, decider, pressed = phase.scheduled, self._decider, phase.scheduled.pressed
        planned_s = {step.number: seconds for step, seconds in steps}
        before, presses = split_presses(scheduled.steps)
        decider.begin(self._identity, scheduled.index, pressed, None)
        self._perform_all(phase, [(step, planned_s[step.number]) for step in before], performed)
        while True:
            decided, new = self._performer.wait_for("the next press", decider.decide)
            self._performer.finish_load()
            if new:
                self._documents.emit(decided)
            if decided.load is None:
                return
            chosen = [(step, planned_s[step.number]) for step in presses[decided.load]]
            up = 1 + next(number for number, (step, _) in enumerate(chosen) if isinstance(step.step, Release))
            self._perform_all(phase, chosen[:up], performed)
            pressed += 1
            decider.begin(self._identity, scheduled.index, pressed, self._performer.load_so_far())
            self._perform_all(phase, chosen[up:], performed)

    def _perform_all(self, phase: DryPhase, steps: Sequence[TimedStep], performed: list[TimedStep]) -> None:
        for step, planned_s in steps:
            if self._desk.pause_wanted() and ends_rest(step.step):
                self._at = phase, step
                self._pause(phase, step, performed)
            self._perform(phase, step, planned_s)
            performed.append((step, planned_s))

    def _perform(self, phase: DryPhase, step: ScheduledStep, planned_s: float) -> None:
        self._at = phase, step
        now_s = self._clock.now()
        self._documents.emit(StepStarted(step.phase, step.number, step.step, now_s, max(self._left_s, 0.0)))
        self._performer.perform(step)
        self._left_s -= planned_s

    def _pause(self, phase: DryPhase, step: ScheduledStep, performed: Sequence[TimedStep]) -> None:
        """Wait before a step; then take the frames before it again, so that a press has recent reference frames."""
        if not self._performer.pause(step, self._desk):
            return
        repeated_steps = _frames_before(performed)
        self._left_s += sum(planned_s for _, planned_s in repeated_steps)
        for repeated, planned_s in repeated_steps:
            self._perform(phase, repeated, planned_s)


def _frames_before(performed: Sequence[TimedStep]) -> list[TimedStep]:
    """Return the last of the performed steps with the head up, and their durations, without mere rests.

    The pause was a rest already.
    """
    steps = []
    for step, planned_s in reversed(performed):
        if not isinstance(step.step, Hold | AcquireFrames | MarkUnloaded):
            break
        if not isinstance(step.step, Hold) or step.step.acquire:
            steps.append((step, planned_s))
    return steps[::-1]
