"""One session of a run, new or resumed: drives the plan on an open bench, then evaluates what was stored."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from cbsr_qa.app.command_hints import resume_command
from cbsr_qa.app.run.conclusion import conclude_run, concluding
from cbsr_qa.app.run.control import Control
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.app.run.stopping import stoppable
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import AbortedError, BrokenRunError, StoreError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.run.events import PhaseFinished, PhaseStarted, RunConcluded, RunEnded, RunEvent, RunStarted
from cbsr_qa.domain.run.gate import GateAnswer, gate_warnings
from cbsr_qa.domain.run.run import InstrumentIdentity, RunIdentity, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.report.tables import duration
from cbsr_qa.station.bench import Bench
from cbsr_qa.station.dry_runs import DryRun, dry_run
from cbsr_qa.station.event_sinks import EventSinks
from cbsr_qa.station.execution import Decider, execute
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.station.limits import check_samplers
from cbsr_qa.station.plan import LoadKey
from cbsr_qa.station.prompts import OperatorPrompt
from cbsr_qa.station.setup import open_station, plan_of, station_clock
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import Stages, WallWatch

if TYPE_CHECKING:
    from cbsr_qa.station.forecasts import PressForecast

#: Largest correction of the clock that is made without a warning: networks correct it by seconds.
_CLOCK_MOVED: Final = timedelta(minutes=1)


@dataclass(frozen=True, slots=True)
class Done:
    """Loads, phases and prompts of earlier sessions of a run.

    Parameters
    ----------
    loads : phase and index of each finished press, in the order of pressing.
    phases : indices of finished phases.
    until_s : start of this session on the run's time line [s].
    prompts : number of prompts that were shown.
    record : what is stored of the run; None for a new one.
    """

    loads: tuple[LoadKey, ...] = ()
    phases: frozenset[int] = frozenset()
    until_s: float = 0.0
    prompts: int = 0
    record: RunRecord | None = None


#: Of a new run.
NOTHING_DONE: Final = Done()


class Session:
    """A bench, open while entered, and the plan to carry out on it.

    If a signal interrupts it outside of the plan's steps, the bench is made safe before it is closed.

    Parameters
    ----------
    configuration : checked configuration, see :func:`~cbsr_qa.app.run.preflight.check_configuration`.
    control : the people at the run, and those who follow it.
    done : loads, phases and prompts of earlier sessions of the same run.
    why : operator's reason for files that differ from those of earlier runs.
    gate : answers of the checks before this session.

    Raises
    ------
    ConfigError
        When it is made, if the target of a phase that decides is below what noise allows.
    InstrumentError, ConfigError
        When it is entered, if an instrument does not answer, or differs from the station file.
    """

    _bench: Bench

    def __init__(
        self,
        configuration: Configuration,
        plugins: Plugins,
        control: Control,
        *,
        done: Done = NOTHING_DONE,
        why: str = "",
        gate: Sequence[GateAnswer] = (),
    ) -> None:
        self.configuration = configuration
        self.plugins = plugins
        self.gate = tuple(gate)
        self.warnings: list[str] = []
        self._control = control
        self._done = done
        self._why = why
        self._events = 0
        self._stages = Stages(control.tell)
        self._plan = plan_of(configuration, plugins)
        self.forecasts: tuple[PressForecast, ...] = ()
        self._decider = self._make_decider()
        self._clock = station_clock(configuration)
        self._progress = control.console.show_steps(len(self._plan.phases), self._clock, control.status)
        self._ask = (
            OperatorPrompt(self._ask_operator, control.desk, operator=control.sensor.operator, first=done.prompts)
            if control.console.attended
            else None
        )

    def _make_decider(self) -> Decider | None:
        """What decides between presses, if a sequence of the recipe asks for it; forecast how many there will be."""
        if not self._plan.decides:
            return None
        from cbsr_qa.station.decider import RunDecider  # loads what no other run needs
        from cbsr_qa.station.decisions import PressDecisions
        from cbsr_qa.station.forecasts import forecast_presses

        decisions = PressDecisions.from_configuration(self.configuration, self._plan, self.plugins)
        self.forecasts = forecast_presses(decisions, self._plan, self.configuration.recipe.analysis)
        done = self._done
        return RunDecider(decisions, self._plan, earlier=done.record, ended=done.phases, offset_s=done.until_s)

    def _ask_operator(self, text: str) -> str:
        with self._progress.pause():
            return self._control.console.ask(text)

    def __enter__(self) -> Self:
        # Here, not before: a signal between opening and entering would leave the bench open.
        self._bench = open_station(
            self.configuration, self.plugins, self._clock, resumed_at_s=self._done.until_s, ask=self._ask
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, KeyboardInterrupt):  # nobody else has made it safe
            for silent in self._bench.safe_state():
                on_stderr(f"NOT SAFE: {silent}; check the bench before touching it")
        self._bench.close()

    def walk(self) -> DryRun:
        """Return the remaining plan, and what the station would not allow."""
        check_samplers(self._plan, self._bench.samplers)
        return dry_run(
            self._plan,
            self._bench.frame_source.frame_period_s,
            done=self._done.loads,
            ended=self._done.phases,
            answered=self._ask is not None,
        )

    def instruments(self) -> tuple[InstrumentIdentity, ...]:
        return self._bench.identities()

    def press(self, identity: RunIdentity, store: Repository) -> None:
        """Carry out the plan, and store every event of it.

        Raises
        ------
        BrokenRunError
            If the end of the run could not be stored; stored rows are kept.
        """
        self.warnings += filter(None, [store.describe_clock_fault()])
        self.warnings += gate_warnings(self.gate)
        self._stages.announce("running the station")  # which takes the station's time, and none of the result's
        watch = WallWatch()
        ended = self._drive(identity, store)
        with concluding(identity.run, store):
            _refuse_unstored(identity.run, ended, store)
            self.warnings += filter(None, [clock_warning(watch.clock_change())])

    def conclude(self, identity: RunIdentity, store: Repository) -> RunOutcome:
        """Evaluate what is stored of the run, and tell the station's sinks of events the verdict.

        Raises
        ------
        BrokenRunError
            If the result could not be stored or read back; stored rows are kept.
        """
        outcome = conclude_run(identity.run, store, self.configuration, self.plugins, self._stages, self.warnings)
        deliver_verdict(outcome, identity, self.configuration, self.plugins, number=self._events)
        return outcome

    def _drive(self, identity: RunIdentity, store: Repository) -> RunEnded:
        configuration, control = self.configuration, self._control
        journal = store.open_journal(
            configuration=configuration.canonical,
            sensor_type=configuration.sensor_type,
            material=configuration.material,
            indenter=configuration.station.indenter,
            tell=on_stderr,
            why=self._why,
            gate=self.gate,
        )
        sinks = EventSinks(configuration.station.events, self.plugins, identity, self.warnings.append)
        control.set_plan(self._plan, self._done.loads)
        try:
            with self._progress:
                return execute(
                    self._plan,
                    identity,
                    self._bench,
                    self._clock,
                    [journal, *control.subscribers, self._progress, self._hooks(identity), sinks],
                    done=self._done.loads,
                    ended=self._done.phases,
                    ask=self._ask,
                    desk=control.desk,
                    decider=self._decider,
                    warn=self.warnings.append,
                )
        finally:
            self._events = sinks.number
            with concluding(identity.run, store):
                sinks.end()

    def _hooks(self, identity: RunIdentity) -> Callable[[RunEvent], None]:
        """Notify plugins of events; a failing plugin becomes a warning of the run."""
        tell, warn = self.plugins.tell, self.warnings.append
        names: dict[int, str] = {}

        def plugin_hooks(event: RunEvent) -> None:
            match event:
                case RunStarted():
                    tell("cbsr_run_started", warn, may_abort=True, identity=identity)
                case PhaseStarted():
                    names[event.index] = event.name
                case PhaseFinished():
                    tell("cbsr_phase_finished", warn, may_abort=True, identity=identity, phase=names[event.phase])

        return plugin_hooks


def clock_warning(moved: timedelta) -> str:
    """Return a warning if the computer's clock was set while a run was measured; else empty."""
    if abs(moved) < _CLOCK_MOVED:
        return ""
    direction, shift = "forward" if moved > timedelta() else "back", duration(abs(moved).total_seconds())
    return (
        f"this computer's clock was set {direction} by {shift} while the run was measured, or the computer slept:"
        " check the dates of what follows; times within the run, and the order of runs, are by other clocks"
    )


def deliver_verdict(
    outcome: RunOutcome, identity: RunIdentity, configuration: Configuration, plugins: Plugins, *, number: int = 0
) -> None:
    """Tell the station's sinks of events the verdict, anew: those of the run have ended, and their losses are stored.

    Parameters
    ----------
    number : number of events of the session before this one.
    """
    with suppress(AbortedError), stoppable():
        sinks = EventSinks(configuration.station.events, plugins, identity, on_stderr, first=number)
        files = {"report": str(outcome.report or ""), "calibration": str(outcome.calibration or "")}
        sinks(fill_from_object(RunConcluded, outcome, **files))
        sinks.end()


def _refuse_unstored(run: str, ended: RunEnded, store: Repository) -> None:
    """Raise if the end of a run could not be stored: half a run is not evaluated."""
    if ended.end is EndReason.FINISHED:
        return
    try:
        stored = store.runs.read_last_session(run).end
    except StoreError:
        stored = EndReason.RUNNING
    if stored is EndReason.RUNNING:
        raise BrokenRunError(
            run,
            ended.detail,
            remedy=f"correct that; stored data are kept. To continue the run: {resume_command(run, store)}",
        )
