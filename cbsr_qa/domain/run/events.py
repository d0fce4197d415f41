"""The stream of events of a run: the journal, the screen and the safety log only subscribe to it."""

from dataclasses import dataclass, field
from typing import Literal

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.steps import Role, Step
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.run.attendance import AttendanceEvent
from cbsr_qa.domain.run.run import PressDecided, RunIdentity
from cbsr_qa.domain.run.states import EndReason


@dataclass(frozen=True, slots=True)
class RunStarted:
    """First event of a run."""

    identity: RunIdentity


@dataclass(frozen=True, slots=True)
class PhaseStarted:
    """A sequence begins. ``role`` is its stated purpose."""

    index: int
    name: str
    sequence: str
    time_s: float
    role: Role = Role.OTHER


@dataclass(frozen=True, slots=True)
class StepStarted:
    """A step begins. ``remaining_s`` is the dry run's estimate of the remaining time, this step included."""

    phase: int
    number: int
    step: Step
    time_s: float
    remaining_s: float


@dataclass(frozen=True, slots=True)
class FramesTaken:
    """Frames arrived; the journal commits them before any other listener sees them."""

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

    type: Literal["unloaded"] = field(default="unloaded", kw_only=True, repr=False)
    phase: int
    time_s: float


@dataclass(frozen=True, slots=True)
class LoadFinished:
    """A press was held to its end and released, and its rest has ended."""

    phase: int
    record: LoadRecord


@dataclass(frozen=True, slots=True)
class StepRetried:
    """A step failed in a way that may be retried, and is tried again."""

    type: Literal["step_retried"] = field(default="step_retried", kw_only=True, repr=False)
    phase: int
    number: int
    attempt: int
    why: str


@dataclass(frozen=True, slots=True)
class PhaseFinished:
    """A sequence ended normally."""

    type: Literal["phase_finished"] = field(default="phase_finished", kw_only=True, repr=False)
    phase: int
    time_s: float


@dataclass(frozen=True, slots=True)
class RunEnded:
    """Last event of a run; the bench is in its safe state."""

    end: EndReason
    detail: str
    time_s: float
    spent: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class RunConcluded:
    """The result of a run's session is stored; follows its last event, for sinks alone.

    ``report`` and ``calibration`` are files; empty for none.
    """

    end: EndReason
    outcome: Outcome
    reason: str
    report: str
    calibration: str


RunEvent = (
    RunStarted
    | PhaseStarted
    | StepStarted
    | FramesTaken
    | SamplesTaken
    | Unloaded
    | LoadFinished
    | PressDecided
    | StepRetried
    | PhaseFinished
    | AttendanceEvent
    | RunEnded
)
