"""A scripted bench: no physics, every call recorded, failing on demand.

For tests of the runner, and for authors of sequences and instruments who want to see what the runner asks of a
bench. To see what a *sensor* answers, use the simulated bench.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from cbsr_qa.config.loader import load_material, load_sensor_type, load_station
from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.domain.plan.steps import Role, Step
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.run.run import InstrumentIdentity, RunIdentity
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity, SensorType
from cbsr_qa.plugin.interfaces import SequenceContext
from cbsr_qa.station.bench import FORCE_APPLICATOR, FORCE_CHANNEL, FRAME_SOURCE, Bench, Mounted
from cbsr_qa.station.plan import Plan, PlannedPhase
from cbsr_qa.system.clock import Clock

#: Role of the scripted bench's load cell.
LOAD_CELL = "load_cell"

Action = Callable[[], object]


@dataclass(frozen=True, slots=True)
class Call:
    """One call the runner made.

    Parameters
    ----------
    name : ``"role.method"``, e.g. ``"force_applicator.press"``.
    arguments : as given.
    time_s : on the station's clock, when it was made.
    """

    name: str
    arguments: tuple[object, ...]
    time_s: float


@dataclass(slots=True)
class Script:
    """Recorded calls of the bench, and actions to carry out within them.

    Parameters
    ----------
    clock : the station's.
    took_s : how long calls take, by name; every other call takes no time.
    force_N : what the load cell reads at a time, given whether the head is down; None for no sample.
    """

    clock: Clock
    took_s: Mapping[str, float] = field(default_factory=dict)
    force_N: Callable[[float, bool], float | None] = lambda _, down: 1.0 if down else 0.0
    calls: list[Call] = field(default_factory=list)
    _by_name: dict[tuple[str, int], Action] = field(default_factory=dict)
    _by_number: dict[int, Action] = field(default_factory=dict)

    def on(self, name: str, action: Action, *, call: int = 1) -> None:
        """Do something inside the n-th call (from 1) of a method: raise, block, advance the clock."""
        self._by_name[name, call] = action

    def do_at(self, number: int, action: Action) -> None:
        """Do something inside the n-th call (from 0) of all."""
        self._by_number[number] = action

    def names(self) -> list[str]:
        return [call.name for call in self.calls]

    def count(self, name: str) -> int:
        return self.names().count(name)

    def record_call(self, name: str, *arguments: object) -> None:
        """Write a call down, let its time pass, and do what was scripted for it."""
        number = len(self.calls)
        self.calls.append(Call(name, arguments, self.clock.now()))
        self.clock.sleep(self.took_s.get(name, 0.0))
        for action in (self._by_number.get(number), self._by_name.get((name, self.count(name)))):
            if action is not None:
                action()


def raising(error: BaseException) -> Action:
    """Return an action that raises."""

    def act() -> None:
        raise error

    return act


class ScriptedInstrument:
    """Base of scripted instruments; by itself one that only reports its identity.

    Parameters
    ----------
    simulated : as in its identity.
    """

    def __init__(self, role: str, script: Script, *, simulated: bool = True) -> None:
        self.role = role
        self.script = script
        self.simulated = simulated

    def identity(self) -> InstrumentIdentity:
        self.script.record_call(f"{self.role}.identity")
        return InstrumentIdentity(self.role, "scripted", "scripted", "", "", simulated=self.simulated)

    def safe_state(self) -> None:
        self.script.record_call(f"{self.role}.safe_state")

    def close(self) -> None:
        self.script.record_call(f"{self.role}.close")


class ScriptedFrames(ScriptedInstrument):
    """Frames of ones."""

    def __init__(self, script: Script, shape: tuple[int, int], frame_period_s: float) -> None:
        super().__init__(FRAME_SOURCE, script)
        self.frame_period_s = frame_period_s
        self._shape = shape

    def acquire(self, count: int) -> FrameBlock:
        self.script.record_call(f"{self.role}.acquire", count)
        if count < 1:
            raise InstrumentError(self.role, "the script", f"{count} frames were asked for; at least 1 is needed")
        times_s = self.script.clock.now() + self.frame_period_s * (np.arange(count, dtype=np.float64) + 0.5)
        self.script.clock.sleep(count * self.frame_period_s)
        frames = np.ones((count, *self._shape))
        return FrameBlock(times_s, frames, np.zeros(frames.shape, np.uint8), VoltageUnit.VOLT, 1e-3)


class ScriptedApplicator(ScriptedInstrument):
    """A head that is down or up."""

    def __init__(self, script: Script) -> None:
        super().__init__(FORCE_APPLICATOR, script)
        self.down = False

    def home(self) -> None:
        self.script.record_call(f"{self.role}.home")

    def find_surface(self, x_mm: float, y_mm: float) -> float:
        """Find it 20 mm below the hover height."""
        self.script.record_call(f"{self.role}.find_surface", x_mm, y_mm)
        return 20.0

    def move_to(self, x_mm: float, y_mm: float) -> None:
        self.script.record_call(f"{self.role}.move_to", x_mm, y_mm)

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Be down, also when the call fails: a real head may be anywhere then."""
        self.down = True
        self.script.record_call(f"{self.role}.press", depth_mm, speed_mm_s)

    def release(self) -> None:
        self.script.record_call(f"{self.role}.release")
        self.down = False

    def safe_state(self) -> None:
        super().safe_state()
        self.down = False


class ScriptedLoadCell(ScriptedInstrument):
    """Ten samples per second from the script."""

    channel = FORCE_CHANNEL
    unit = "N"
    rate_hz = 10

    def __init__(self, script: Script, applicator: ScriptedApplicator) -> None:
        super().__init__(LOAD_CELL, script)
        self._applicator = applicator

    def samples_since(self, time_s: float) -> SampleBlock:
        self.script.record_call(f"{self.role}.samples_since", time_s)
        first = int(np.floor(time_s * self.rate_hz + 1e-6)) + 1
        last = int(np.floor(self.script.clock.now() * self.rate_hz + 1e-6))
        times_s = [number / self.rate_hz for number in range(first, last + 1)]
        read = [(t, self.script.force_N(t, self._applicator.down)) for t in times_s]
        kept = [(t, force) for t, force in read if force is not None]
        times, forces = np.array(kept, dtype=np.float64).reshape(-1, 2).T
        return SampleBlock(self.channel, self.unit, times, forces)


def make_scripted_bench(script: Script, sensor_type: SensorType, *, frame_period_s: float = 2.5) -> Bench:
    """Return a bench of three scripted instruments: frame source, force applicator, load cell."""
    applicator = ScriptedApplicator(script)
    frames = ScriptedFrames(script, sensor_type.pattern.shape, frame_period_s)
    mounted = [
        Mounted(
            InstrumentSpec(instrument.role, "scripted", (getattr(instrument, "channel", instrument.role),), {}, None),
            instrument,
        )
        for instrument in (applicator, frames, ScriptedLoadCell(script, applicator))
    ]
    return Bench(mounted, stop_within_s=2.0)


@dataclass(frozen=True, slots=True)
class FixedSequence:
    """A sequence of given steps."""

    given: tuple[Step, ...]
    role: Role = Role.OTHER

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        del context
        yield from self.given


def example_plan(*phases: PlannedPhase | Iterable[Step], seed: int = 0) -> Plan:
    """Return a plan for the shipped 100 mm disc of 8 wt% on the shipped simulated station.

    Parameters
    ----------
    phases : planned ones, or just their steps.
    """
    station = load_station("simulated").value
    planned = tuple(
        phase
        if isinstance(phase, PlannedPhase)
        else PlannedPhase(f"phase {number}", "fixed", FixedSequence(tuple(phase)))
        for number, phase in enumerate(phases)
    )
    return Plan(
        planned,
        load_sensor_type(station.sensor_type).value,
        load_material(station.material).value,
        station.indenter,
        station.motion,
        station.safety,
        seed,
    )


def example_identity() -> RunIdentity:
    """Return the identity of a run that is a test of something else."""
    sensor = SensorIdentity("EXAMPLE-001", "example", "disc-100mm")
    return RunIdentity("example", sensor, "scripted", "example", "", datetime(2026, 1, 1, tzinfo=UTC), "", (), ())
