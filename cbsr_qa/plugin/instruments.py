"""Instruments of a bench, and what their factories are given."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from cbsr_qa.domain.plan.plan import Motion, SafetyLimits, Scene
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, SampleBlock
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.domain.run.station import CheckResult
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.system.clock import Clock


@dataclass(frozen=True, slots=True)
class StationContext:
    """Context passed to an instrument's factory.

    Parameters
    ----------
    role : the table's name in the station file.
    clock : the station's; an instrument never sleeps by itself.
    sensor_type, material, indenter : what will be tested.
    seed : of the run, for simulated instruments.
    options : the remaining keys of the instrument's table, already free of ``driver`` and ``provides``.
    scene : what a simulated instrument's world contains; None on a real bench.
    effect_factory : finds an effect's factory by name, for simulated instruments; None on a real bench.
    motion : speeds and hover height of the station; :mod:`cbsr_qa.domain.plan.steps` says how long moves take.
    resumed_at_s : start of this session's clock on the run's time line; 0 for a new run. Effects that depend on the
        time of the run (a drift, an intermittent contact) continue from there.
    safety : what the station allows; a driver that moves by itself (feeling for the surface) keeps to it. None where
        an instrument is opened outside of a station.
    ask : shows a text to the operator and returns the answer; None without an operator.
    read_recording : reads a recording (file, format or None to recognise it, data set or None), for drivers that play
        one back; None where an instrument is opened outside of a station.
    """

    role: str
    clock: Clock
    sensor_type: SensorType
    material: Material
    indenter: Indenter
    seed: int
    options: Mapping[str, Any]
    scene: Scene | None = None
    effect_factory: Callable[[str], Callable[..., Any]] | None = None
    motion: Motion | None = None
    resumed_at_s: float = 0.0
    safety: SafetyLimits | None = None
    ask: Callable[[str], str] | None = None
    read_recording: Callable[[Path, str | None, str | None], Recording] | None = None


class Instrument(Protocol):
    """Anything on the bench."""

    def identity(self) -> InstrumentIdentity:
        """Return the identity; called once after opening. Raises InstrumentError if there is no answer."""
        ...

    def safe_state(self) -> None:
        """Stop doing harm: source off, head up. Must be fast, and may be called at any time, more than once."""
        ...

    def close(self) -> None:
        """Give the connection back."""
        ...


@runtime_checkable
class FrameSource(Instrument, Protocol):
    """Takes whole frames (role ``frame_source``)."""

    @property
    def frame_period_s(self) -> float:
        """How long one frame takes [s]; the dry run counts with it."""
        ...

    def acquire(self, count: int) -> FrameBlock:
        """Take ``count`` ≥ 1 consecutive frames; returns when they are complete."""
        ...


@runtime_checkable
class ForceApplicator(Instrument, Protocol):
    """Moves a head over the sheet and presses (role ``force_applicator``); lengths from the sheet's centre."""

    def home(self) -> None:
        """Find the zero of all axes."""
        ...

    def find_surface(self, x_mm: float, y_mm: float) -> float:
        """Find the zero-strain height at a place, and come back to the hover height.

        The head touches the sheet, and the call returns only when it is up again: the runner checks that force
        data are fresh before it, and force and freshness right after it. During the search that is the driver's
        duty: it goes no deeper without a force sample taken since its last step, and lifts and raises
        InstrumentError where samples fail to come or no contact force is met down to the depth it knows as safe.

        Returns
        -------
        Depth of the surface below the hover height [mm].
        """
        ...

    def move_to(self, x_mm: float, y_mm: float) -> None:
        """Travel at the hover height; returns when there."""
        ...

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Go this far below the surface found here; returns when there.

        A head that is in the sheet already goes straight to the new depth, up or down, at this speed: it neither
        lifts nor overshoots: the sheet remembers from which side a strain was reached (the step ``StrainStep``).
        """
        ...

    def release(self) -> None:
        """Go up to the hover height; returns when there.

        The way out of the sheet is gone at the speed of the last press: the runner takes from it when the head left
        the sheet (:func:`cbsr_qa.domain.plan.steps.lift_off_s`).
        """
        ...


@runtime_checkable
class GuidedApplicator(ForceApplicator, Protocol):
    """A force applicator that is told where the surface is, and how high to travel.

    Optional; a recipe that finds the surface as a plane, or lowers the hover height, is refused without it.
    """

    def expect_surface(self, x_mm: float, y_mm: float, depth_mm: float) -> None:
        """Take the surface at a place as this far below the hover height, as if it had been found there."""
        ...

    def lower_hover(self, by_mm: float) -> None:
        """Lift and travel this far below the hover height from now on, 0 for the hover height; moves nothing.

        ``home`` and ``safe_state`` go to the hover height in any case, and ``home`` ends it.
        """
        ...


@runtime_checkable
class Sampler(Instrument, Protocol):
    """Samples one quantity all the time: a load cell (``force`` in N, compression positive), a thermometer."""

    @property
    def channel(self) -> str:
        """Name of the quantity."""
        ...

    @property
    def unit(self) -> str:
        """Its unit."""
        ...

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the samples taken after a time on the station's clock, up to now."""
        ...


@runtime_checkable
class Alive(Instrument, Protocol):
    """An instrument with a liveness check that has no other effect.

    Optional. The runner asks while it rests or holds, at least every ``heartbeat_s`` of the station's safety limits,
    between frames: one that has fallen silent is noticed in the rest, not when it is needed next.
    """

    def alive(self) -> None:
        """Return if it answers, soon; raise InstrumentError if it does not, or has been reset since it was used."""
        ...


@runtime_checkable
class Addressed(Instrument, Protocol):
    """A simulated instrument whose random numbers are addressed by what is measured, not by when.

    Optional. A step that is done again after an interruption then gives the numbers it would have given at first.
    """

    def begin_step(self, phase: int, number: int) -> None:
        """Called before each step with its phase and number in the recipe (both from 0)."""
        ...


@runtime_checkable
class Linked(Instrument, Protocol):
    """An instrument that needs others of its bench: a scanner its meter, a head that feels for the surface its force.

    Optional; called once, after every instrument was opened and before any is used.
    """

    def link(self, peers: Mapping[str, "Instrument"]) -> None:
        """Be given every instrument of the bench by the roles it provides.

        Raises
        ------
        ConfigError
            If one that is needed is not there, or is not what it should be.
        """
        ...


@runtime_checkable
class SelfTesting(Instrument, Protocol):
    """An instrument that can test itself. Optional; ``cbsr-qa station check`` asks."""

    def self_test(self) -> tuple[CheckResult, ...]:
        """Test yourself and say what came of it, a line for each thing; a finding is no exception.

        Nothing may move and no current may flow when it returns. Raises InstrumentError if there is no answer.
        """
        ...


@dataclass(frozen=True, slots=True)
class MeterReading:
    """One measurement of a source-measure unit.

    Parameters
    ----------
    volts : the mean over the requested readings [V].
    current_A : measured source current, or else the requested one.
    compliance : the source was at its voltage limit.
    saturated : the meter was at the end of its range.
    time_s : middle of the measurement on the station's clock.
    """

    volts: float
    current_A: float
    compliance: bool
    saturated: bool
    time_s: float


@runtime_checkable
class SourceMeter(Instrument, Protocol):
    """Gives a current and measures a voltage (role ``source_meter``)."""

    @property
    def reading_period_s(self) -> float:
        """How long one measurement takes the instrument [s]."""
        ...

    @property
    def compliance_V(self) -> float:
        """Voltage the source will not exceed [V]."""
        ...

    def source(self, current_A: float) -> None:
        """Set the current and switch the output on; the value is read back and must agree."""
        ...

    def off(self) -> None:
        """Switch the output off."""
        ...

    def measure(self) -> MeterReading:
        """Take one measurement."""
        ...


@runtime_checkable
class Multiplexer(Instrument, Protocol):
    """Connects source and meter to pairs of electrodes (role ``multiplexer``)."""

    def order(self) -> tuple[tuple[int, int], ...]:
        """(drive, measure) indices into the sensor type's pattern, in the order the hardware steps through them."""
        ...

    def start(self) -> None:
        """Connect the first combination of :meth:`order`, wherever it was before."""
        ...

    def step(self) -> None:
        """Connect the next combination; after the last the first."""
        ...

    def position(self) -> int:
        """Ask which combination is connected, as an index into :meth:`order`: a lost step must not stay unseen."""
        ...
