"""One nine-location run over the emulated bench with one fault in it, and whether everything came to rest."""

import math
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.app.setup import configure, open_station, plan_of, station_clock
from cbsr_qa.clock import RealClock
from cbsr_qa.config.merge import Configuration
from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.kinematics import stroke_s
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.run import RunIdentity, RunRecord
from cbsr_qa.domain.run_events import FramesTaken, RunEnded, RunEvent, StepStarted
from cbsr_qa.domain.sensor import SensorIdentity
from cbsr_qa.domain.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release, Role, Step
from cbsr_qa.emulate.faults import Fault
from cbsr_qa.emulate.rig import EmulatedRig
from cbsr_qa.emulate.start import Emulation
from cbsr_qa.interfaces import Sequence, SequenceContext
from cbsr_qa.plugins import Plugins, discover
from cbsr_qa.runner.bench import Bench
from cbsr_qa.runner.execute import execute
from cbsr_qa.runner.plan import Plan
from cbsr_qa.runner.schedule import ScheduledStep, schedule
from cbsr_qa.store.repository import Repository, open_store

Array = NDArray[np.float64]

#: Of the campaign: nine places; and of its sample: two of them.
NINE_PLACES, TWO_PLACES = (Path(__file__).with_name(name) for name in ("two-frames.toml", "two-places.toml"))
STATION = "bench-emulated"
SEED = 11
#: Fewer of the rested sheet than a sequence may take: the time of a campaign goes into its other steps. And as many
#: as fit into a hold.
UNLOADED_FRAMES, HELD_FRAMES = 4, 2
#: How far readings of two runs may be from each other, in the noise expected of their difference.
MOST_NOISE = 1.5


#: Roles of the station that faults strike, and which.
OF_INSTRUMENTS = {
    "source_meter": ("drop", "silence", "garble", "delay", "stale", "reset", "compliance"),
    "multiplexer": ("drop", "silence", "garble", "delay", "stale", "reset"),
    "applicator": ("drop", "silence", "garble", "delay", "stale", "reset", "resend", "busy"),
    "load_cell": ("drop", "silence", "garble", "reset", "overload"),
    "thermometer": ("drop", "silence", "garble"),
}
#: Faults beside the instruments.
OF_THE_COMPUTER = {
    "store": ("disk full",),
    "plugin": ("listener raises", "frame source raises", "applicator raises"),
}


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


@dataclass(slots=True)
class Outcome:
    """What became of a run.

    Parameters
    ----------
    kind : ``"rode through"``, ``"broken"`` or ``"broken, not safe"``.
    last_step : number of the step that was under way at the end.
    safe_after_s : station time from the moment it was told to stop until head and source were safe.
    wrong : in words, what must not be.
    """

    kind: str
    detail: str
    last_step: int
    safe_after_s: float
    wrong: list[str] = field(default_factory=list)


@lru_cache
def configuration(recipe: Path) -> Configuration:
    """The emulated bench with a short recipe."""
    return configure(STATION, str(recipe), sensor_type=None, material=None, seed=SEED)


class FewerFrames:
    """A sequence that takes :data:`UNLOADED_FRAMES` wherever another takes more."""

    def __init__(self, other: Sequence) -> None:
        self._other = other
        self.role = getattr(other, "role", Role.OTHER)

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the other's steps."""
        for step in self._other.steps(context):
            fewer = isinstance(step, AcquireFrames) and step.count > UNLOADED_FRAMES
            yield AcquireFrames(UNLOADED_FRAMES) if fewer else step


def plan_for(recipe: Path) -> Plan:
    """What a recipe asks of the bench, with few frames of the rested sheet."""
    plan = plan_of(configuration(recipe), plugins())
    return replace(plan, phases=tuple(replace(phase, sequence=FewerFrames(phase.sequence)) for phase in plan.phases))


@lru_cache
def plugins() -> Plugins:
    """Every installed plugin."""
    return discover()


@dataclass(frozen=True, slots=True)
class Measured:
    """What a run measured.

    Parameters
    ----------
    unloaded : (m,) mean readings of the rested sheet [V].
    held : (loads, m) mean change of the readings in each hold [V].
    noise : root mean square over the readings of their standard deviation while resting [V].
    """

    unloaded: Array
    held: Array
    noise: float


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
        journal = store.journal(
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
        safe_after_s = _came_to_rest_s(self._emulation.rig, clock, self._stopped_s + allowed_s())
        finished = ended.end is EndReason.FINISHED
        if safe_after_s is not None:
            safe_after_s -= self._stopped_s
        kind = "rode through" if finished else "broken" if safe_after_s is not None else "broken, not safe"
        outcome = Outcome(kind, ended.detail, max(len(watch.steps) - 1, 0), safe_after_s or 0.0)
        outcome.wrong += _bench_is_wrong(self._emulation.rig, ended, safe_after_s)
        record = store.load_run(run)
        outcome.wrong += _record_is_wrong(record, ended, watch)
        if finished:
            self.measured = measured(record)
        if finished and self._injected is not None:
            outcome.wrong += _measured_otherwise(self.measured, undisturbed(self._recipe))
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


def allowed_s() -> float:
    """How long coming to rest may take: a second to notice, and the head's travel up from its deepest."""
    return 1.0 + stroke_s(configuration(NINE_PLACES).station.motion, deepest_mm())


def deepest_mm() -> float:
    """How deep the station lets the head go."""
    here = configuration(NINE_PLACES)
    return here.station.safety.strain * here.sensor_type.thickness_mm


def is_up(rig: EmulatedRig) -> bool:
    """Whether the head hovers; one that has lost its position goes up by the hover height from where it is."""
    return rig.head.height_mm >= rig.motion.hover_mm - deepest_mm()


def _came_to_rest_s(rig: EmulatedRig, clock: Any, limit_s: float) -> float | None:
    """When source and head were safe, on the station's clock; None if they were not by then.

    Commands that were sent without an answer may still be on their way in real time.
    """
    patience = threading.Event()
    for _ in range(20):
        if rig.wiring.current_A is None and (is_up(rig) or rig.head.moving):
            break
        patience.wait(0.05)
    while clock.now() < limit_s and not (is_up(rig) and rig.wiring.current_A is None):
        clock.sleep(0.05)
    return float(clock.now()) if is_up(rig) and rig.wiring.current_A is None else None


def _bench_is_wrong(rig: EmulatedRig, ended: RunEnded, safe_after_s: float | None) -> list[str]:
    wrong = []
    if safe_after_s is None and "NOT SAFE" not in ended.detail:
        source = "off" if rig.wiring.current_A is None else "ON"
        wrong.append(f"head {rig.head.height_mm:.1f} mm up, source {source}, and nobody is told")
    if safe_after_s is not None and "NOT SAFE" in ended.detail and ended.end is EndReason.FINISHED:
        wrong.append("finished, but not safe")
    if rig.head.dragged:
        wrong.append("the head was dragged through the sheet")
    return wrong


def _record_is_wrong(record: RunRecord, ended: RunEnded, watch: Watch) -> list[str]:
    wrong = []
    if record.end is not ended.end and "journal" not in ended.detail:
        wrong.append(f"the record says {record.end}, the runner {ended.end}")
    frames = [phase.frames for phase in record.phases if phase.frames is not None]
    stored = sum(len(block) for block in frames)
    if stored != watch.frames:
        wrong.append(f"{stored} frames stored, {watch.frames} delivered")
    if any((np.diff(block.time_s) <= 0).any() for block in frames):
        wrong.append("a frame is stored twice, or out of order")
    return wrong


def _measured_otherwise(found: Measured, expected: Measured) -> list[str]:
    """What a run that rode through a fault measured must be what one without measures, within noise.

    A lost step of the multiplexer shifts readings by as much as they are: a thousand times the noise.
    """
    if found.held.shape != expected.held.shape:
        return [f"{len(found.held)} loads measured, {len(expected.held)} asked for"]
    wrong = []
    off = _rms(found.unloaded - expected.unloaded) / (expected.noise * math.sqrt(2 / UNLOADED_FRAMES))
    if off > MOST_NOISE:
        wrong.append(f"unloaded readings are {off:.1f} times the noise off")
    per_load = expected.noise * math.sqrt(2 / HELD_FRAMES + 2 / UNLOADED_FRAMES)
    for number, (change, other) in enumerate(zip(found.held, expected.held, strict=True)):
        off = _rms(change - other) / per_load
        if off > MOST_NOISE:
            wrong.append(f"load {number} is {off:.1f} times the noise off")
    return wrong


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def measured(record: RunRecord) -> Measured:
    """Read what a finished run measured, of the readings an image is made of."""
    (phase,) = record.phases
    assert phase.frames is not None
    assert phase.unloaded_from_s is not None
    usable = record.sensor_type.pattern.usable()
    first_s = phase.loads[0].press_start_s if phase.loads else math.inf
    resting = phase.frames.between(phase.unloaded_from_s, first_s).voltages[:, usable]
    unloaded = resting.mean(axis=0)
    held = [phase.frames.between(load.hold_start_s, load.release_start_s).voltages[:, usable] for load in phase.loads]
    noise = float(np.sqrt(resting.var(axis=0, ddof=1).mean()))
    return Measured(unloaded, np.array([frames.mean(axis=0) - unloaded for frames in held]), noise)


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


@lru_cache
def steps_of_a_run(recipe: Path = NINE_PLACES) -> tuple[str, ...]:
    """What every step of the run does, in words."""
    (phase,) = schedule(plan_for(recipe))
    return tuple(_words(step.step, pressed) for step, pressed in _with_head(phase.steps))


def _with_head(steps: Iterable[ScheduledStep]) -> Iterator[tuple[ScheduledStep, bool]]:
    down = False
    for step in steps:
        down = isinstance(step.step, Press) or (down and not isinstance(step.step, Release))
        yield step, down


def _words(step: Step, pressed: bool) -> str:
    match step:
        case Hold():
            return "hold" if pressed else "rest"
        case FindSurface():
            return "find surface"
        case AcquireFrames():
            return "unloaded frames"
        case MarkUnloaded():
            return "mark"
        case _:
            return type(step).__name__.lower()
