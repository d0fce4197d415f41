"""Events of a run as documents for other programs: what a run's subscribers see, without the readings themselves.

Each event has one dataclass, whose fields are the keys, and one function that fills it. ``cbsr-qa schema events``
prints the JSON Schema of all. A key without a value is left out.
"""

import json
import re
from dataclasses import asdict, dataclass
from functools import singledispatch
from typing import Any, Final, Literal

import numpy as np

from cbsr_qa.domain.filling import filled
from cbsr_qa.domain.plan import Step
from cbsr_qa.domain.readings import UNUSABLE, FrameBlock, SampleBlock
from cbsr_qa.domain.results import EndReason, Outcome
from cbsr_qa.domain.run.attendance import PromptAnswered, PromptShown, RunContinued, RunPaused
from cbsr_qa.domain.run.loads import EasedStrain
from cbsr_qa.domain.run.run import (
    FramesTaken,
    InstrumentIdentity,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunConcluded,
    RunEnded,
    RunEvent,
    RunIdentity,
    RunStarted,
    SamplesTaken,
    StepRetried,
    StepStarted,
    Unloaded,
)

#: Raised by one when a key is removed or changes its meaning. New keys and new types of events do not raise it.
EVENT_SCHEMA_VERSION: Final = 1


def event_document(event: RunEvent | RunConcluded) -> dict[str, Any]:
    """Return an event as a document that JSON can hold: ``{"type": "load_finished", "time_s": …, …}``.

    Times are seconds on the run's clock. Frames and samples are summarised.
    """
    given = asdict(
        _document(event), dict_factory=lambda pairs: {key: value for key, value in pairs if value is not None}
    )
    document: dict[str, Any] = json.loads(json.dumps(given, default=_number, allow_nan=False))
    return document


def _number(value: np.generic) -> Any:
    """Return a number of numpy, which a sequence may use in its steps, as Python's."""
    return value.item()


@singledispatch
def _document(event: RunEvent | RunConcluded) -> "EventDocument":
    raise TypeError(f"{type(event).__name__} has no document")


@dataclass(frozen=True, slots=True)
class RunStartedDocument:
    """A run begins, or a session of it after an interruption: the same ``run`` again."""

    type: Literal["run_started"]
    schema_version: int
    run: str
    station: str
    recipe: str
    serial: str
    batch: str
    sensor_type: str
    operator: str
    started_at: str
    configuration_digest: str
    software: dict[str, str]
    instruments: tuple[InstrumentIdentity, ...]
    simulated: tuple[str, ...]


@_document.register
def _run_started(event: RunStarted) -> RunStartedDocument:
    who = event.identity
    return filled(
        RunStartedDocument,
        who,
        type="run_started",
        schema_version=EVENT_SCHEMA_VERSION,
        serial=who.sensor.serial,
        batch=who.sensor.batch,
        sensor_type=who.sensor.sensor_type,
        started_at=who.started_at.isoformat(),
        software=dict(who.software),
    )


@dataclass(frozen=True, slots=True)
class PhaseStartedDocument:
    """A sequence of the recipe begins. ``phase`` counts from 0; later events name it by this number."""

    type: Literal["phase_started"]
    phase: int
    name: str
    sequence: str
    role: str
    time_s: float


@_document.register
def _phase_started(event: PhaseStarted) -> PhaseStartedDocument:
    return filled(PhaseStartedDocument, event, type="phase_started", phase=event.index, role=str(event.role))


@dataclass(frozen=True, slots=True)
class StepDocument:
    """A step: its kind, and what that kind needs.

    Place and strain belong to ``press``, the place to ``find_surface``, the strain to ``strain_step``, ``hold_s`` and
    ``acquire`` to ``hold``, ``count`` to ``acquire_frames``, ``text`` to ``prompt``.
    """

    kind: str
    label: str | None = None
    x_mm: float | None = None
    y_mm: float | None = None
    strain: float | None = None
    trial: int | None = None
    hold_s: float | None = None
    acquire: bool | None = None
    count: int | None = None
    text: str | None = None

    @classmethod
    def of(cls, step: Step) -> "StepDocument":
        return filled(cls, getattr(step, "load", step), kind=_snake_case(type(step).__name__))


def _snake_case(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


@dataclass(frozen=True, slots=True)
class StepStartedDocument:
    """A step begins. ``remaining_s`` is the estimate of the run's remaining time, this step included."""

    type: Literal["step_started"]
    phase: int
    number: int
    step: StepDocument
    time_s: float
    remaining_s: float


@_document.register
def _step_started(event: StepStarted) -> StepStartedDocument:
    return filled(StepStartedDocument, event, type="step_started", step=StepDocument.of(event.step))


@dataclass(frozen=True, slots=True)
class FramesTakenDocument:
    """Frames are stored: how many, of how many readings each, and when the first and the last were taken.

    ``unusable`` counts readings that are saturated, at the compliance limit or missing.
    """

    type: Literal["frames_taken"]
    phase: int
    count: int
    readings: int
    unusable: int
    first_s: float | None = None
    time_s: float | None = None


@_document.register
def _frames_taken(event: FramesTaken) -> FramesTakenDocument:
    frames = event.frames
    unusable = int(np.count_nonzero(frames.flags & UNUSABLE))
    readings = int(np.prod(frames.voltages.shape[1:]))
    return FramesTakenDocument("frames_taken", event.phase, len(frames), readings, unusable, *_times(frames))


@dataclass(frozen=True, slots=True)
class SamplesTakenDocument:
    """Samples of a channel (force, temperature) are stored: how many, their range and the last one, in ``unit``."""

    type: Literal["samples_taken"]
    phase: int
    channel: str
    unit: str
    count: int
    first_s: float | None = None
    time_s: float | None = None
    smallest: float | None = None
    largest: float | None = None
    last: float | None = None


@_document.register
def _samples_taken(event: SamplesTaken) -> SamplesTakenDocument:
    block = event.samples
    finite = block.values[np.isfinite(block.values)]  # JSON has no NaN
    values = (float(finite.min()), float(finite.max()), float(finite[-1])) if len(finite) else (None, None, None)
    channel, unit, count = block.channel, block.unit, len(block)
    return SamplesTakenDocument("samples_taken", event.phase, channel, unit, count, *_times(block), *values)


def _times(block: FrameBlock | SampleBlock) -> tuple[float | None, float | None]:
    return (float(block.time_s[0]), float(block.time_s[-1])) if len(block) else (None, None)


@dataclass(frozen=True, slots=True)
class UnloadedDocument:
    """The sheet counts as rested from this time on."""

    type: Literal["unloaded"]
    phase: int
    time_s: float


@_document.register
def _unloaded(event: Unloaded) -> UnloadedDocument:
    return filled(UnloadedDocument, event, type="unloaded")


@dataclass(frozen=True, slots=True)
class LoadFinishedDocument:
    """A press was held to its end and released, and its rest has ended (``time_s``).

    The head starts down, is down, starts up, is up: ``press_start_s`` … ``release_end_s``. It left the sheet at
    ``clear_s``. ``index`` counts the presses of the phase from 0, ``trial`` repetitions of one load; ``strain`` is a
    fraction; ``eased`` are strains that the press was brought to after the first.
    """

    type: Literal["load_finished"]
    phase: int
    index: int
    label: str
    x_mm: float
    y_mm: float
    strain: float
    trial: int
    press_start_s: float
    hold_start_s: float
    release_start_s: float
    release_end_s: float
    time_s: float
    eased: tuple[EasedStrain, ...]
    clear_s: float | None = None


@_document.register
def _load_finished(event: LoadFinished) -> LoadFinishedDocument:
    load, record = event.record.load, event.record
    place = {"label": load.label, "x_mm": load.x_mm, "y_mm": load.y_mm, "strain": load.strain, "trial": load.trial}
    return filled(
        LoadFinishedDocument, record, type="load_finished", phase=event.phase, time_s=record.rest_end_s, **place
    )


@dataclass(frozen=True, slots=True)
class StepRetriedDocument:
    """A step failed in a way that may be retried, and is tried again."""

    type: Literal["step_retried"]
    phase: int
    number: int
    attempt: int
    why: str


@_document.register
def _step_retried(event: StepRetried) -> StepRetriedDocument:
    return filled(StepRetriedDocument, event, type="step_retried")


@dataclass(frozen=True, slots=True)
class PhaseFinishedDocument:
    """A sequence ended normally."""

    type: Literal["phase_finished"]
    phase: int
    time_s: float


@_document.register
def _phase_finished(event: PhaseFinished) -> PhaseFinishedDocument:
    return PhaseFinishedDocument("phase_finished", event.index, event.time_s)


@dataclass(frozen=True, slots=True)
class RunPausedDocument:
    """The run waits between two presses, with the head up."""

    type: Literal["run_paused"]
    phase: int
    time_s: float
    by: str


@_document.register
def _run_paused(event: RunPaused) -> RunPausedDocument:
    return filled(RunPausedDocument, event, type="run_paused")


@dataclass(frozen=True, slots=True)
class RunContinuedDocument:
    """A pause has ended."""

    type: Literal["run_continued"]
    phase: int
    time_s: float
    by: str


@_document.register
def _run_continued(event: RunContinued) -> RunContinuedDocument:
    return filled(RunContinuedDocument, event, type="run_continued")


@dataclass(frozen=True, slots=True)
class PromptShownDocument:
    """The operator is asked something. ``prompt`` names it within the run, ``picture`` is an image's file name."""

    type: Literal["prompt_shown"]
    phase: int
    prompt: int
    text: str
    picture: str
    time_s: float


@_document.register
def _prompt_shown(event: PromptShown) -> PromptShownDocument:
    return filled(PromptShownDocument, event, type="prompt_shown")


@dataclass(frozen=True, slots=True)
class PromptAnsweredDocument:
    """The answer to a prompt, and who gave it."""

    type: Literal["prompt_answered"]
    phase: int
    prompt: int
    answer: str
    by: str
    time_s: float


@_document.register
def _prompt_answered(event: PromptAnswered) -> PromptAnsweredDocument:
    return filled(PromptAnsweredDocument, event, type="prompt_answered")


@dataclass(frozen=True, slots=True)
class RunEndedDocument:
    """The bench is in its safe state; the analysis follows. ``spent_s`` are station seconds by kind of step."""

    type: Literal["run_ended"]
    end: EndReason
    detail: str
    time_s: float
    spent_s: dict[str, float]


@_document.register
def _run_ended(event: RunEnded) -> RunEndedDocument:
    return filled(RunEndedDocument, event, type="run_ended", spent_s=dict(event.spent))


@dataclass(frozen=True, slots=True)
class RunConcludedDocument:
    """The verdict is stored. ``report`` and ``calibration`` are files on the station's computer."""

    type: Literal["run_concluded"]
    end: EndReason
    outcome: Outcome
    reason: str
    report: str | None = None
    calibration: str | None = None


@_document.register
def _run_concluded(event: RunConcluded) -> RunConcludedDocument:
    files = {"report": event.report or None, "calibration": event.calibration or None}
    return filled(RunConcludedDocument, event, type="run_concluded", **files)


#: The document of any event.
EventDocument = (
    RunStartedDocument
    | PhaseStartedDocument
    | StepStartedDocument
    | FramesTakenDocument
    | SamplesTakenDocument
    | UnloadedDocument
    | LoadFinishedDocument
    | StepRetriedDocument
    | PhaseFinishedDocument
    | RunPausedDocument
    | RunContinuedDocument
    | PromptShownDocument
    | PromptAnsweredDocument
    | RunEndedDocument
    | RunConcludedDocument
)


@dataclass(frozen=True, slots=True)
class EventMessage:
    """An event as sinks deliver it: with its run, so that each message can be understood by itself.

    ``session`` is when this session of the run began: a resumed run has several. ``number`` counts the events of the
    session from 0, so that a gap is a lost event. A message may arrive twice, with the same ``run``, ``session`` and
    ``number``.
    """

    station: str
    run: str
    serial: str
    session: str
    number: int
    event: EventDocument


def event_message(identity: RunIdentity, number: int, document: dict[str, Any]) -> dict[str, Any]:
    """Return the message of an event's document; its keys are those of :class:`EventMessage`."""
    return {
        "station": identity.station,
        "run": identity.run,
        "serial": identity.sensor.serial,
        "session": identity.started_at.isoformat(),
        "number": number,
        "event": document,
    }
