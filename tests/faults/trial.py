"""One short run over the emulated bench with one fault in it, and what became of it."""

import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from judgement import (
    Measured,
    Outcome,
    allowed_s,
    bench_is_wrong,
    came_to_rest_s,
    measured,
    measured_otherwise,
    record_is_wrong,
)
from short_run import NINE_PLACES, configuration, plan_for, plugins

from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.run.events import FramesTaken, RunEnded, RunEvent, StepStarted
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.simulate.instruments.rig import Emulation
from cbsr_qa.simulate.instruments.streams import Fault
from cbsr_qa.station.bench import Bench
from cbsr_qa.station.execution import execute
from cbsr_qa.station.setup import open_station, station_clock
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import RealClock

#: Roles of the station that faults strike, and which.
OF_INSTRUMENTS = {
    "source_meter": ("drop", "silence", "garble", "delay", "stale", "reset", "compliance"),
    "multiplexer": ("drop", "silence", "garble", "delay", "stale", "reset"),
    "applicator": ("drop", "silence", "garble", "delay", "stale", "reset", "resend", "busy"),
    "load_cell": ("drop", "silence", "garble", "reset", "overload"),
    "thermometer": ("drop", "silence", "garble"),
}

#: Faults beside the instruments.
OF_THE_COMPUTER = {"store": ("disk full",), "plugin": ("listener raises", "frame source raises", "applicator raises")}

#: Faults that are over once they were met: one run can be struck with them at one step after the other.
PASSING = frozenset({"garble", "delay", "stale", "resend", "busy", "listener raises"})


@dataclass(frozen=True, slots=True)
class Injected:
    """A fault, the role it strikes, and the number of the step (from 0) at whose beginning it does.

    With ``again`` it strikes every later step as well, but for those at whose beginning it still waits to be met.
    """

    role: str
    fault: str
    step: int
    again: bool = False

    def strikes(self, step: int) -> bool:
        """Whether it is armed at the beginning of a step."""
        return step == self.step or (self.again and step > self.step)


class Watch:
    """Strikes at the beginning of a step, and remembers what was delivered."""

    def __init__(self, injected: Injected | None, strike: Callable[[Injected], None]) -> None:
        self.steps: list[str] = []
        self.frames = 0
        self._injected = injected
        self._strike = strike

    def struck_by(self, fault: str) -> bool:
        """Whether the step under way is the one that this fault strikes."""
        injected = self._injected
        return injected is not None and injected.fault == fault and injected.strikes(len(self.steps) - 1)

    def __call__(self, event: RunEvent) -> None:
        """Take one document."""
        match event:
            case StepStarted():
                if self._injected is not None and self._injected.strikes(len(self.steps)):
                    self._strike(self._injected)
                self.steps.append(type(event.step).__name__)
            case FramesTaken(frames=frames):
                self.frames += len(frames)


class Trial:
    """One run; use :func:`run_with`."""

    def __init__(self, injected: Injected | None, recipe: Path, folder: Path) -> None:
        #: Measured by a run that finished.
        self.measured: Measured | None = None
        self._injected = injected
        self._recipe = recipe
        self._here = configuration(recipe)
        self._url = f"sqlite:///{folder / 'trial.sqlite'}"
        self._emulation: Emulation | None = None
        self._stopped_s: float | None = None

    def run(self) -> Outcome:
        """Run, look at the bench, read the record back."""
        here = self._here
        clock = station_clock(here)
        bench = _opened(lambda: open_station(here, plugins(), clock, emulated=self._take))
        with open_store(self._url) as store:
            try:
                return self._driven(bench, clock, store)
            finally:
                bench.close()

    def _take(self, emulation: Emulation) -> None:
        self._emulation = emulation

    def _driven(self, bench: Bench, clock: Any, store: Repository) -> Outcome:
        here = self._here
        told = bench.safe_state

        def told_to_stop() -> tuple[str, ...]:
            self._stopped_s = clock.now()
            return told()

        watch = Watch(self._injected, lambda injected: self._strike(injected, bench, store))
        bench.safe_state = told_to_stop
        identity = _identity(store.new_id(), here, bench)
        journal = store.open_journal(
            configuration=here.canonical,
            sensor_type=here.sensor_type,
            material=here.material,
            indenter=here.station.indenter,
        )
        warned: list[str] = []

        def failing(event: RunEvent) -> None:
            if isinstance(event, StepStarted) and watch.struck_by("listener raises"):
                raise ValueError("a plugin's hook failed")

        told_all: list[Callable[[RunEvent], None]] = [journal, watch, failing]
        ended = execute(plan_for(self._recipe), identity, bench, clock, told_all, warn=warned.append)
        return self._judged(ended, watch, clock, store, identity.run)

    def _strike(self, injected: Injected, bench: Bench, store: Repository) -> None:
        if injected.role == "store":
            _fill_disk(store)
        elif injected.role == "plugin" and injected.fault != "listener raises":
            _break(bench.frame_source if injected.fault == "frame source raises" else bench.force_applicator)
        elif injected.role != "plugin":
            assert self._emulation is not None
            if not self._emulation.ports[injected.role].faults.waiting:
                self._emulation.arm(injected.role, Fault(injected.fault))

    def _judged(self, ended: RunEnded, watch: Watch, clock: Any, store: Repository, run: str) -> Outcome:
        assert self._emulation is not None
        assert self._stopped_s is not None
        safe_after_s = came_to_rest_s(self._emulation.rig, clock, self._stopped_s + allowed_s())
        finished = ended.end is EndReason.FINISHED
        if safe_after_s is not None:
            safe_after_s -= self._stopped_s
        kind = "rode through" if finished else "broken" if safe_after_s is not None else "broken, not safe"
        outcome = Outcome(kind, ended.detail, max(len(watch.steps) - 1, 0), safe_after_s or 0.0)
        outcome.wrong += bench_is_wrong(self._emulation.rig, ended, safe_after_s)
        record = store.runs.load(run)
        outcome.wrong += record_is_wrong(record, ended, watch.frames)
        if finished:
            self.measured = measured(record)
        if finished and self._injected is not None:
            outcome.wrong += measured_otherwise(self.measured, undisturbed(self._recipe))
        return outcome


def _opened(bench: Callable[[], Bench], patience_s: float = 30.0) -> Bench:
    """Open a bench; nothing is struck yet, so what goes wrong is this computer's.

    It may be so busy that an answer comes too late. Where a link was dropped in another process, the system hands its
    terminal's number out again at once, and that process keeps the number locked until its run has ended.
    """
    pause = threading.Event()
    until_s = time.monotonic() + patience_s
    while True:
        try:
            return bench()
        except InstrumentError as error:
            if not (error.retryable or "in use by" in error.reason) or time.monotonic() > until_s:
                raise
            pause.wait(0.5)


def run_with(injected: Injected | None, recipe: Path = NINE_PLACES) -> Outcome:
    """Run a short recipe with one fault in it, or none."""
    with tempfile.TemporaryDirectory(prefix="fault-") as folder:
        return Trial(injected, recipe, Path(folder)).run()


@lru_cache
def undisturbed(recipe: Path) -> Measured:
    """What the run without a fault measures."""
    with tempfile.TemporaryDirectory(prefix="fault-") as folder:
        trial = Trial(None, recipe, Path(folder))
        outcome = trial.run()
        assert trial.measured is not None, outcome
        return trial.measured


def _identity(run: str, here: Configuration, bench: Bench) -> RunIdentity:
    instruments = bench.identities()
    return RunIdentity(
        run=run,
        sensor=SensorIdentity("FAULT-1", "", here.sensor_type.name),
        station=here.station.name,
        recipe=here.recipe.name,
        operator="",
        started_at=RealClock().wall(),
        configuration_digest=here.digest,
        software=(),
        instruments=instruments,
    )


def _fill_disk(store: Repository) -> None:
    """Let the database grow no more: SQLite then says what it says of a full disk."""
    with store._engine.connect() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
        connection.exec_driver_sql(f"PRAGMA max_page_count = {pages}")


def _break(instrument: Any) -> None:
    """Let the next call of an instrument's own work raise what no driver should, once."""
    for name in ("acquire", "home", "move_to", "press", "release", "find_surface"):
        if hasattr(instrument, name):
            setattr(instrument, name, _raising(instrument, name))


def _raising(instrument: Any, name: str) -> Callable[..., Any]:
    def raises(*_: Any) -> Any:
        delattr(instrument, name)
        raise ValueError(f"{name} of a plugin failed")

    return raises
