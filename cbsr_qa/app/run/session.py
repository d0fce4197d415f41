"""One session of a run, new or resumed: drives the plan on an open bench, then evaluates what was stored."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Self

from cbsr_qa.analysis import calibrated, evaluate_run
from cbsr_qa.app.changes import unexplained
from cbsr_qa.app.command_hints import report_command, resume_command
from cbsr_qa.app.run.control import Control
from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.app.run.outputs import write_outputs
from cbsr_qa.app.run.preflight import check_cycles, check_recipe, check_unloaded, station_key
from cbsr_qa.calibration.file import signed
from cbsr_qa.config import Configuration
from cbsr_qa.domain import AbortedError, BrokenRunError, RefusedError, StoreError, UnconcludedError, filled
from cbsr_qa.domain.results import Calibration, EndReason, RunResult
from cbsr_qa.domain.run import (
    GateAnswer,
    InstrumentIdentity,
    PhaseFinished,
    PhaseStarted,
    RunConcluded,
    RunEnded,
    RunEvent,
    RunIdentity,
    RunRecord,
    RunStarted,
    gate_warnings,
)
from cbsr_qa.plugin import Plugins, left_running
from cbsr_qa.report import duration
from cbsr_qa.station import (
    DryRun,
    EventSinks,
    LoadKey,
    OperatorPrompt,
    RunProgress,
    check_samplers,
    dry_run,
    execute,
    on_stderr,
    open_station,
    plan_of,
    station_clock,
)
from cbsr_qa.station.control import RunStatus
from cbsr_qa.store import Repository
from cbsr_qa.studies.charts import charts_after
from cbsr_qa.system import RealClock, Redelivery, Stages


@contextmanager
def stoppable() -> Iterator[None]:
    """Let the first signal (Ctrl-C, termination, hang-up) interrupt the block; ignore others until it has cleaned up.

    Raises
    ------
    AbortedError
        After the clean-up, if a signal or the keyboard interrupted it.
    """
    heard: list[str] = []
    redelivery = Redelivery()

    def stop(number: int, frame: FrameType | None) -> None:
        if not heard or redelivery.was_dropped():
            heard.append(signal.Signals(number).name)
            redelivery.number = number
            raise KeyboardInterrupt

    here = threading.current_thread() is threading.main_thread()
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if here and hasattr(signal, name)]
    numbers = [getattr(signal, name) for name in names]
    # A signal inherited as ignored stays ignored, as the caller intended.
    before = {n: signal.signal(n, stop) for n in numbers if signal.getsignal(n) not in (signal.SIG_IGN, None)}
    try:
        with redelivery:
            yield
    except KeyboardInterrupt as error:
        raise AbortedError(f"signal {heard[0]}" if heard else "the keyboard") from error
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


Ask = Callable[[str], str]


@dataclass(frozen=True, slots=True)
class Done:
    """What earlier sessions of a run have done.

    Parameters
    ----------
    loads : (phase, index) of finished presses.
    phases : finished ones.
    until_s : start of this session on the run's time line [s].
    prompts : how many were shown.
    """

    loads: frozenset[LoadKey] = frozenset()
    phases: frozenset[int] = frozenset()
    until_s: float = 0.0
    prompts: int = 0


def check_configuration(configuration: Configuration, plugins: Plugins) -> None:
    """Check recipe, plugins and limits before anything moves. RefusedError if one fails."""
    check_recipe(configuration.recipe, configuration.sensor_type, plugins)
    planned = plan_of(configuration, plugins)
    station_key(configuration.station)
    check_unloaded(planned, configuration.recipe)
    check_cycles(planned, configuration.recipe)


class Session:
    """An open bench and the plan to carry out on it.

    Parameters
    ----------
    configuration : checked, see :func:`check_configuration`.
    ask : shows a text to the operator and returns the answer; None without an operator.
    done : by earlier sessions of the same run.
    why : operator's reason for files that differ from those of earlier runs.
    gate : answers of the checks before this session.
    control : takes requests and prompts of others; None: nobody is served.
    show : called with lines on what the station does; None shows them on stderr.

    Raises
    ------
    InstrumentError, ConfigError
        If an instrument does not answer, or differs from the station file.
    """

    def __init__(
        self,
        configuration: Configuration,
        plugins: Plugins,
        stages: Stages,
        ask: Ask | None,
        done: Done | None = None,
        why: str = "",
        gate: Sequence[GateAnswer] = (),
        control: Control | None = None,
        show: Callable[[str], None] | None = None,
    ) -> None:
        self._configuration = configuration
        self._plugins = plugins
        self._stages = stages
        self._asks = ask
        self._why = why
        self.gate = tuple(gate)
        self._show = show
        self._done = done or Done()
        self._progress: RunProgress | None = None
        self._events = 0
        self.warnings: list[str] = []
        self._plan = plan_of(configuration, plugins)
        self._clock = station_clock(configuration)
        self._control = control
        self._ask = self._prompt(control)
        self._bench = open_station(
            configuration, plugins, self._clock, resumed_at_s=self._done.until_s, ask=self._ask
        )

    def _prompt(self, control: Control | None) -> OperatorPrompt[str] | None:
        """Return who asks the operator; None if nobody answers."""
        desk = None if control is None else control.desk
        if self._asks is None and not (desk is not None and desk.answers):
            return None
        who = "" if control is None else control.operator
        return OperatorPrompt(self._asked, desk, operator=who, first=self._done.prompts)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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

    def run(self, identity: RunIdentity, store: Repository) -> RunOutcome:
        """Drive the bench, then evaluate the stored run.

        Raises
        ------
        BrokenRunError
            If the run or its result could not be stored or read back; stored rows are kept.
        """
        self.warnings += filter(None, [store.from_the_future()])
        self.warnings += gate_warnings(self.gate)
        with self._stages.stage("running the station"):
            ended = self._drive(identity, store)
        _refuse_unstored(identity.run, ended, store)
        outcome = concluded(identity.run, store, self._configuration, self._plugins, self._stages, self.warnings)
        deliver_verdict(outcome, identity, self._configuration, self._plugins, number=self._events)
        return outcome

    def _asked(self, text: str) -> str:
        """Ask the operator; progress display pauses meanwhile."""
        assert self._asks is not None
        with nullcontext() if self._progress is None else self._progress.paused():
            return self._asks(text)

    def _drive(self, identity: RunIdentity, store: Repository) -> RunEnded:
        configuration = self._configuration
        journal = store.journal(
            configuration=configuration.canonical,
            sensor_type=configuration.sensor_type,
            material=configuration.material,
            indenter=configuration.station.indenter,
            tell=on_stderr,
            why=self._why,
            gate=self.gate,
        )
        sinks = EventSinks(configuration.station.events, self._plugins, identity, self.warnings.append)
        watching = self._watching()
        status = RunStatus(None) if self._control is None else self._control.status
        try:
            with RunProgress(len(self._plan.phases), self._clock, status, tell=self._show) as progress:
                self._progress = progress
                return execute(
                    self._plan,
                    identity,
                    self._bench,
                    self._clock,
                    [journal, *watching, progress, self._hooks(identity), sinks],
                    done=self._done.loads,
                    ended=self._done.phases,
                    ask=self._ask,
                    desk=None if self._control is None else self._control.desk,
                    warn=self.warnings.append,
                )
        finally:
            self._events = sinks.number
            with _concluding(identity.run, store):
                sinks.end()

    def _watching(self) -> tuple[Callable[[RunEvent], None], ...]:
        if self._control is None:
            return ()
        self._control.planned(self._plan, self._done.loads)
        return self._control.subscribers

    def _hooks(self, identity: RunIdentity) -> Callable[[RunEvent], None]:
        """Notify plugins of events; a failing plugin becomes a warning of the run."""
        tell, warn = self._plugins.tell, self.warnings.append
        names: dict[int, str] = {}

        def plugin_hooks(event: RunEvent) -> None:
            match event:
                case RunStarted():
                    tell("cbsr_run_started", warn, may_abort=True, identity=identity)
                case PhaseStarted():
                    names[event.index] = event.name
                case PhaseFinished():
                    tell("cbsr_phase_finished", warn, may_abort=True, identity=identity, phase=names[event.index])

        return plugin_hooks


def deliver_verdict(
    outcome: RunOutcome, identity: RunIdentity, configuration: Configuration, plugins: Plugins, *, number: int = 0
) -> None:
    """Tell the station's sinks of events the verdict, anew: those of the run have ended, and their losses are stored.

    Parameters
    ----------
    number : of events of the session before this one.
    """
    with suppress(AbortedError), stoppable():
        sinks = EventSinks(configuration.station.events, plugins, identity, on_stderr, first=number)
        files = {"report": str(outcome.report or ""), "calibration": str(outcome.calibration or "")}
        sinks(filled(RunConcluded, outcome, **files))
        sinks.end()


def _refuse_unstored(run: str, ended: RunEnded, store: Repository) -> None:
    """Raise if the end of a run could not be stored: half a run is not evaluated."""
    if ended.end is EndReason.FINISHED:
        return
    try:
        stored = store.state_of(run).end
    except StoreError:
        stored = EndReason.RUNNING
    if stored is EndReason.RUNNING:
        raise BrokenRunError(
            run,
            ended.detail,
            remedy=f"correct that; stored data are kept, and this continues the run: {resume_command(run, store)}",
        )


def concluded(
    run: str,
    store: Repository,
    configuration: Configuration,
    plugins: Plugins,
    stages: Stages,
    warnings: Sequence[str],
) -> RunOutcome:
    """Evaluate a stored run, and write its report and calibration file.

    Raises
    ------
    BrokenRunError
        If the result could not be stored or read back, or its calibration not be signed; the run's rows are kept.
    UnconcludedError
        If a signal or the keyboard stopped it.
    """
    try:
        with _concluding(run, store):
            return _concluded(run, store, configuration, plugins, stages, warnings)
    except StoreError as error:
        remedy = "; if the database then holds the run, this continues it: ".join(
            filter(None, [error.remedy, resume_command(run, store)])
        )
        raise BrokenRunError(run, error.reason, remedy=remedy) from error


@contextmanager
def _concluding(run: str, store: Repository) -> Iterator[None]:
    """Let a signal or the keyboard stop what follows a run. UnconcludedError, with the next command, if it did."""
    try:
        with stoppable():
            yield
    except AbortedError as error:
        following = report_command(run, store) if store.analyses(run) else resume_command(run, store)
        raise UnconcludedError(run, following, error.by) from error


def _concluded(
    run: str,
    store: Repository,
    configuration: Configuration,
    plugins: Plugins,
    stages: Stages,
    warnings: Sequence[str],
) -> RunOutcome:
    with stages.stage("reading the run back"):
        record = store.whole_run(run)
    recipe, history, threads = configuration.recipe, store.change_history(record), threading.enumerate()
    earlier = store.sensor_history(record.identity.sensor, record.identity.recipe, run)
    conclusion = evaluate_run(record, recipe, plugins, stages)
    issued_at = RealClock().wall().isoformat()
    paused = _paused(record)
    charts = charts_after(store, record.identity, conclusion.measurements)
    calibration, why = calibrated(conclusion, recipe, calibration=store.new_id(), issued_at=issued_at)
    if calibration is not None:
        calibration = _signed(calibration, configuration, store)
    result = filled(
        RunResult,
        conclusion,
        record=record,
        calibration=calibration,
        calibration_why=why,
        compute_s=stages.table(),
        warnings=(
            *conclusion.warnings,
            *warnings,
            *paused,
            *map(str, plugins.failures),
            *left_running(threads),
            *(charts.warnings() if charts else ()),
            *unexplained(history.of(run)),
            *record.chain.warnings,
            *earlier.warnings,
        ),
        limits_version=recipe.limits_version,
        station_check=store.latest_station_check(record.identity.station, record.identity.started_at),
        station_charts=charts,
        history=history,
        sensor_history=earlier,
    )
    store.save_result(result)
    resume = "" if record.end is EndReason.FINISHED else resume_command(run, store)
    return write_outputs(result, recipe, plugins, stages, configuration.seed, resume=resume)


def _signed(calibration: Calibration, configuration: Configuration, store: Repository) -> Calibration:
    """Sign a calibration with the station's key, if it has one. BrokenRunError if the key cannot be used any more."""
    try:
        key = station_key(configuration.station)
    except RefusedError as error:
        again = f"{error.remedy}; then this computes the result: {resume_command(calibration.run, store)}"
        raise BrokenRunError(
            calibration.run, f"its calibration cannot be signed, and is not issued: {error.reason}", remedy=again
        ) from error
    return calibration if key is None else signed(calibration, key, RealClock().wall())


def _paused(record: RunRecord) -> Iterator[str]:
    """Yield a note if pauses made rests before presses longer than the recipe says."""
    lasted_s = [pause.duration_s for pause in record.pauses if pause.duration_s is not None]
    if lasted_s:
        times = "once" if len(lasted_s) == 1 else f"{len(lasted_s)} times"
        yield (
            f"the run was paused {times}, for {duration(sum(lasted_s))} in all: before the next press"
            " the sheet rested longer than the recipe states"
        )
