"""Events of a run as documents for other programs: what a run's subscribers see, without the readings themselves.

An event with a ``type`` is its own document: its fields are the keys. Each other event has a dataclass, whose fields
are the keys, and a function that fills it. ``cbsr-qa schema events`` prints the JSON Schema of all. A key without a
value is left out. What happens within a phase is in :mod:`~cbsr_qa.domain.run.step_documents`.
"""

import json
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.attendance import PromptAnswered, PromptShown, RunContinued, RunPaused
from cbsr_qa.domain.run.events import (
    PhaseFinished,
    PhaseStarted,
    RunConcluded,
    RunEnded,
    RunEvent,
    RunStarted,
    StepRetried,
    Unloaded,
)
from cbsr_qa.domain.run.run import InstrumentIdentity, PressDecided, RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.run.step_documents import (
    FramesTakenDocument,
    LoadFinishedDocument,
    SamplesTakenDocument,
    StepStartedDocument,
    document_of,
)
from cbsr_qa.domain.sensor.sensor_type import SensorPart

#: Raised by one when a key is removed or changes its meaning. New keys and new types of events do not raise it.
EVENT_SCHEMA_VERSION: Final = 1


def event_document(event: RunEvent | RunConcluded) -> dict[str, Any]:
    """Return an event as a document that JSON can hold: ``{"type": "load_finished", "time_s": …, …}``.

    Times are seconds on the run's clock. Frames and samples are summarised.
    """
    fields = asdict(
        document_of(event), dict_factory=lambda pairs: {key: value for key, value in pairs if value is not None}
    )
    # A sequence may use numbers of numpy in its steps.
    document: dict[str, Any] = json.loads(json.dumps(fields, default=lambda number: number.item(), allow_nan=False))
    return document


@document_of.register
def _pass_unchanged(
    event: PhaseFinished
    | RunPaused
    | RunContinued
    | PromptShown
    | PromptAnswered
    | Unloaded
    | PressDecided
    | StepRetried,
) -> object:
    return event


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
    parts: tuple[SensorPart, ...]


@document_of.register
def _run_started(event: RunStarted) -> RunStartedDocument:
    identity = event.identity
    return fill_from_object(
        RunStartedDocument,
        identity,
        type="run_started",
        schema_version=EVENT_SCHEMA_VERSION,
        serial=identity.sensor.serial,
        batch=identity.sensor.batch,
        sensor_type=identity.sensor.sensor_type,
        started_at=identity.started_at.isoformat(),
        software=dict(identity.software),
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


@document_of.register
def _phase_started(event: PhaseStarted) -> PhaseStartedDocument:
    return fill_from_object(
        PhaseStartedDocument, event, type="phase_started", phase=event.index, role=str(event.role)
    )


@dataclass(frozen=True, slots=True)
class RunEndedDocument:
    """The bench is in its safe state; the analysis follows. ``spent_s`` are station seconds by kind of step."""

    type: Literal["run_ended"]
    end: EndReason
    detail: str
    time_s: float
    spent_s: dict[str, float]


@document_of.register
def _run_ended(event: RunEnded) -> RunEndedDocument:
    return fill_from_object(RunEndedDocument, event, type="run_ended", spent_s=dict(event.spent))


@dataclass(frozen=True, slots=True)
class RunConcludedDocument:
    """The verdict is stored. ``report`` and ``calibration`` are files on the station's computer."""

    type: Literal["run_concluded"]
    end: EndReason
    outcome: Outcome
    reason: str
    report: str | None = None
    calibration: str | None = None


@document_of.register
def _run_concluded(event: RunConcluded) -> RunConcludedDocument:
    files = {"report": event.report or None, "calibration": event.calibration or None}
    return fill_from_object(RunConcludedDocument, event, type="run_concluded", **files)


#: The document of any event.
EventDocument = (
    RunStartedDocument
    | PhaseStartedDocument
    | StepStartedDocument
    | FramesTakenDocument
    | SamplesTakenDocument
    | Unloaded
    | LoadFinishedDocument
    | PressDecided
    | StepRetried
    | PhaseFinished
    | RunPaused
    | RunContinued
    | PromptShown
    | PromptAnswered
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
