"""What a plugin implements: small Protocols, one verb each where possible.

A factory registered under a kind (see :mod:`cbsr_qa.hookspecs`) is called with the options of the station,
recipe or scene file and returns an object with these methods. There is nothing to subclass.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from cbsr_qa.clock import Clock
from cbsr_qa.domain.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.plan import Motion, SafetyLimits, Scene
from cbsr_qa.domain.reconstruction import ImagingProblem, PreparedReconstruction
from cbsr_qa.domain.recording import ReadOptions, Recording
from cbsr_qa.domain.report import RunResult, Section
from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.domain.scene import Moment, SheetDesign, Transcript
from cbsr_qa.domain.sensor import Material, SensorType
from cbsr_qa.domain.station_check import CheckResult
from cbsr_qa.domain.steps import Step

# --- instruments -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StationContext:
    """What an instrument's factory is given.

    Parameters
    ----------
    role : the table's name in the station file.
    clock : the station's; an instrument never sleeps by itself.
    sensor_type, material, indenter : what will be tested.
    seed : of the run, for simulated instruments.
    options : the remaining keys of the instrument's table, already free of ``driver`` and ``provides``.
    scene : what a simulated instrument's world contains; None on a real bench.
    effect_factory : finds an effect's factory by name, for simulated instruments; None on a real bench.
    motion : speeds and hover height of the station; :mod:`cbsr_qa.domain.kinematics` says how long moves take.
    resumed_at_s : when on the run's own time line this session's clock began; 0 for a new run. What changes with the
        time of the run (a drift, a contact that opens now and then) goes on from there.
    safety : what the station allows; a driver that moves by itself (feeling for the surface) keeps to it. None where
        an instrument is opened outside of a station.
    ask : shows a text to the operator and returns the answer; None where nobody is there.
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
        """Say who you are; called once after opening. Raises InstrumentError if nobody answers."""
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
        """Take this many frames one after the other, at least one; returns when they are there."""
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
        lifts nor overshoots, since the sheet remembers from which side a strain was reached (the step ``Ease``).
        """
        ...

    def release(self) -> None:
        """Go up to the hover height; returns when there.

        The way out of the sheet is gone at the speed of the last press: the runner takes from it when the head left
        the sheet (:func:`cbsr_qa.domain.kinematics.lift_off_s`).
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
    """An instrument that can be asked whether it is there, without anything else coming of it.

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
        """Be told, before each step, which one of which phase of the recipe it is (both from 0)."""
        ...


@runtime_checkable
class Linked(Instrument, Protocol):
    """An instrument that needs others of its bench: a scanner its meter, a head that feels for the surface its force.

    Optional; asked for once, after every instrument was opened and before any is used.
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

        Nothing may move and no current may flow when it returns. Raises InstrumentError if nobody answers.
        """
        ...


@dataclass(frozen=True, slots=True)
class MeterReading:
    """One measurement of a source-measure unit.

    Parameters
    ----------
    volts : the mean over the readings it was asked for [V].
    current_A : what the source gave, where it is measured; else what it was told to give.
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


# --- sequences -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SequenceContext:
    """What a sequence may know when it makes its steps.

    Parameters
    ----------
    sensor_type, indenter : what is tested.
    seed : of the run; a sequence that draws numbers addresses them by its own name.
    """

    sensor_type: SensorType
    indenter: Indenter
    seed: int


class Sequence(Protocol):
    """Makes steps. It never touches an instrument: the runner does, and a dry run only counts.

    A sequence may have an attribute ``role`` (:class:`~cbsr_qa.domain.steps.Role`) that says what it is for;
    metrics and report sections look for roles. Without it the role is OTHER.
    """

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time it is asked."""
        ...


# --- imaging and metrics ---------------------------------------------------------------------------------


class Reconstruction(Protocol):
    """Turns a linearised problem into images; a linear method into one matrix (LinearReconstruction).

    A reconstruction may say by two attributes what ``analyse``, which images single presses, must hand it beyond
    their changes: ``sequences = True`` where a frame's image depends on the frames beside it, for consecutive
    frames; ``absolute = True`` where it wants the unloaded sensor's own readings (:attr:`ImagingProblem.measured`),
    with changes in the same one scale. ``weighs_noise = False`` where it lets all readings count alike whatever
    :attr:`ImagingProblem.noise_variance` says: a recipe that asks for weights is then refused.
    """

    def prepare(self, problem: ImagingProblem) -> PreparedReconstruction:
        """Prepare once per sensor type; NumericsError where the problem cannot be solved."""
        ...


@runtime_checkable
class LoadMetric(Protocol):
    """A metric of one press.

    A metric of either kind may have an attribute ``measures``, a mapping from the names of its measurements to
    their units. Limits are then checked against it before anything moves; without it, only after the run.
    """

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; a quantity that cannot be determined is a Measurement without value, never an exception."""
        ...


@runtime_checkable
class RunMetric(Protocol):
    """A metric of a whole run. A metric plugin may be both."""

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; a quantity that cannot be determined is a Measurement without value, never an exception."""
        ...


# --- the simulated world ---------------------------------------------------------------------------------


@runtime_checkable
class Effect(Protocol):
    """One physical effect of a scene. An effect that is off is not imported."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Effects that must be on and come before this one."""
        ...

    @property
    def perturbs(self) -> str:
        """A stage of the moment; :data:`cbsr_qa.simulate.chain.STAGES` lists them."""
        ...

    def apply(self, moment: Moment) -> None:
        """Change the moment. Random numbers come from the stream of (seed, own name, ``moment.index``)."""
        ...


@runtime_checkable
class SwitchingEffect(Protocol):
    """What an effect of the stage ``impedance`` that changes in steps has as well."""

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        """Times of its steps after the first and up to the last [s]; at such a time the step is over."""
        ...


@runtime_checkable
class SheetEffect(Protocol):
    """An effect on the sheet as it is made (stage ``sheet``)."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Effects that must be on and come before this one."""
        ...

    @property
    def perturbs(self) -> str:
        """The stage ``sheet``."""
        ...

    def design(self, design: SheetDesign) -> None:
        """Change the sheet before it is made. Random numbers come from the stream of (seed, own name, 0)."""
        ...


@runtime_checkable
class RecordingEffect(Protocol):
    """An effect on how a scene's frames are written down (stage ``recording``)."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Effects that must be on and come before this one."""
        ...

    @property
    def perturbs(self) -> str:
        """The stage ``recording``."""
        ...

    def record(self, transcript: Transcript) -> None:
        """Change the transcript. Random numbers come from the stream of (seed, own name, frame)."""
        ...


#: What a scene's effects may be.
AnyEffect = Effect | SheetEffect | RecordingEffect


# --- recordings and reports ------------------------------------------------------------------------------


class RecordingFormat(Protocol):
    """Reads one family of files."""

    def recognises(self, path: Path, head: bytes) -> bool:
        """Tell from the name and the first 4096 bytes whether this is such a file."""
        ...

    def datasets(self, path: Path) -> tuple[str, ...]:
        """Name the data sets of a file that can hold several; empty for a file that is one."""
        ...

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read it whole. RecordingError if nothing in it can be used; single bad rows are problems, not errors."""
        ...


@runtime_checkable
class RecordingWriter(Protocol):
    """What a :class:`RecordingFormat` has besides where simulated scenes can be written in it."""

    def write(self, path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
        """Write a file as this format's rig would have, and return what it cannot say, in words.

        Parameters
        ----------
        recording : all frames, also those of which rows are lost.
        transcript : which rows are lost, and where a board dumps its log.

        Raises
        ------
        RefusedError
            If the format cannot hold such a recording, or the file exists already.
        """
        ...


class ReportSection(Protocol):
    """Writes one section of the report."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section, or None where the result has nothing for it."""
        ...
