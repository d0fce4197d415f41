"""What happens in a run, as a stream of documents. The journal, the screen and the safety log only subscribe."""

from dataclasses import dataclass

from cbsr_qa.domain.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.loads import LoadRecord
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.run import RunIdentity
from cbsr_qa.domain.steps import Role, Step


@dataclass(frozen=True, slots=True)
class RunStarted:
    """First document of a run."""

    identity: RunIdentity


@dataclass(frozen=True, slots=True)
class PhaseStarted:
    """A sequence begins. ``role`` is what it says it is for."""

    index: int
    name: str
    sequence: str
    time_s: float
    role: Role = Role.OTHER


@dataclass(frozen=True, slots=True)
class StepStarted:
    """A step begins. ``remaining_s`` is the dry run's estimate of what is left, this step included."""

    phase: int
    number: int
    step: Step
    time_s: float
    remaining_s: float


@dataclass(frozen=True, slots=True)
class FramesTaken:
    """Frames arrived; the journal commits them before anybody else sees them."""

    phase: int
    frames: FrameBlock


@dataclass(frozen=True, slots=True)
class SamplesTaken:
    """Samples of another channel arrived."""

    phase: int
    samples: SampleBlock


@dataclass(frozen=True, slots=True)
class Unloaded:
    """The sheet counts as rested from this time on."""

    phase: int
    time_s: float


@dataclass(frozen=True, slots=True)
class LoadFinished:
    """A press was held to its end and released, and its rest is over."""

    phase: int
    record: LoadRecord


@dataclass(frozen=True, slots=True)
class StepRetried:
    """A step failed in a way that may be tried again."""

    phase: int
    number: int
    attempt: int
    why: str


@dataclass(frozen=True, slots=True)
class PhaseFinished:
    """A sequence has run to its end."""

    index: int
    time_s: float


@dataclass(frozen=True, slots=True)
class RunEnded:
    """Last document of a run; the bench is in its safe state."""

    end: EndReason
    detail: str
    time_s: float
    spent: tuple[tuple[str, float], ...]


RunEvent = (
    RunStarted
    | PhaseStarted
    | StepStarted
    | FramesTaken
    | SamplesTaken
    | Unloaded
    | LoadFinished
    | StepRetried
    | PhaseFinished
    | RunEnded
)
