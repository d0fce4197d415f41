"""Interfaces of plugins: sequences, recording formats, sections, reconstructions, metrics and effects."""

from collections.abc import Iterator, Mapping, Sequence as AnySequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from cbsr_qa.domain.imaging import ImagingProblem, PreparedReconstruction
from cbsr_qa.domain.plan.steps import Step
from cbsr_qa.domain.plan.world import Moment, SheetDesign, Transcript
from cbsr_qa.domain.readings.frames import ReadOptions, Recording
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.findings import RecordingResult
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.domain.results.report import Section
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType


class RecordingFormat(Protocol):
    """Reads one family of files, in a child process that it is pickled for."""

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether this is such a file, by its name and first 4096 bytes."""
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


class Reconstruction(Protocol):
    """Turns a linearised problem into images; a linear method into one matrix (LinearReconstruction).

    A reconstruction may say by two attributes what ``analyse``, which images single presses, must hand it beyond
    their changes: ``sequences = True`` where a frame's image depends on the frames beside it, for consecutive frames;
    ``absolute = True`` where it wants the unloaded sensor's own readings (:attr:`ImagingProblem.measured`), with
    changes in the same one scale. ``weighs_noise = False`` if it weights all readings equally despite
    :attr:`ImagingProblem.noise_variance`: a recipe that requests weights is then refused.
    """

    def prepare(self, problem: ImagingProblem) -> PreparedReconstruction:
        """Prepare once per sensor type; NumericsError where the problem cannot be solved."""
        ...


@runtime_checkable
class LoadMetric(Protocol):
    """A metric of one press.

    A metric of either kind has an attribute ``measures``, a mapping from the names of its measurements to their
    units. Limits are checked against it before anything moves; a recipe with a metric that lacks it is refused.
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


#: Allowed effects of a scene.
AnyEffect = Effect | SheetEffect | RecordingEffect


@dataclass(frozen=True, slots=True)
class SequenceContext:
    """Information for a sequence to yield its steps.

    Parameters
    ----------
    seed : of the run; a sequence that draws numbers addresses them by its own name.
    material : of the sensor; None where steps are made outside of a run.
    """

    sensor_type: SensorType
    indenter: Indenter
    seed: int
    material: Material | None = None


class Sequence(Protocol):
    """Makes steps. It never touches an instrument: the runner does, and a dry run only counts.

    A sequence may have an attribute ``role`` (``Role``) that states its purpose; metrics
    and report sections look for roles. Without it the role is OTHER.
    """

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones on every call."""
        ...


@dataclass(frozen=True, slots=True)
class PressGoal:
    """When a sequence that decides ends: the force error of the calibration is good enough, or presses are enough.

    Parameters
    ----------
    target_N : force error, root mean square over the loads that matter, of which ``confidence`` is demanded.
    at_least, at_most : fewest and most presses of the sequence.
    radius_mm, strains : loads that matter: every radius up to this, and every strain (a fraction) between these.
    confidence : probability with which the error shall be below the target.
    """

    target_N: float
    at_least: int
    at_most: int
    radius_mm: float
    strains: tuple[float, float]
    confidence: float


@runtime_checkable
class AdaptiveSequence(Protocol):
    """A sequence whose presses are a choice: the run decides after each which one is next, and when to end.

    Its steps list every press that may be chosen, once, so that a dry run checks all of them before anything moves.
    What comes before the first press is done once; the steps of a press begin with it, or with the surface finding
    right before it, and end where those of the next one begin. Its phase must be one that calibrates.
    """

    @property
    def goal(self) -> PressGoal:
        """When it ends."""
        ...

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones on every call."""
        ...


class EventSink(Protocol):
    """Delivers the events of a run elsewhere: to a file, a broker, a server.

    Creating it opens nothing and starts nothing; the check of a station file does so too. A run then calls it from
    one thread of its own, which may wait: the run does not. After a failure the same messages are delivered again.
    """

    @property
    def largest_batch(self) -> int:
        """Most messages it takes in one call."""
        ...

    def deliver(self, messages: AnySequence[Mapping[str, Any]]) -> None:
        """Deliver messages (see ``EventMessage``) in order; return once they are taken.

        Raises
        ------
        DeliveryError
            If they are not taken; any other exception counts as one. It is final if they would never be taken:
            they then count as lost, and the next ones follow.
        """
        ...

    def close(self) -> None:
        """Close what it has opened; may be called more than once."""
        ...
