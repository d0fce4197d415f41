"""Documents of what happens within a phase: steps, frames, samples and presses."""

import re
from dataclasses import dataclass
from functools import singledispatch
from typing import Any, Literal

import numpy as np

from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.steps import Step
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock, SampleBlock
from cbsr_qa.domain.readings.loads import EasedStrain
from cbsr_qa.domain.run.events import FramesTaken, LoadFinished, SamplesTaken, StepStarted


@singledispatch
def document_of(event: object) -> Any:
    """Return the document of an event, a dataclass. TypeError for anything else."""
    raise TypeError(f"{type(event).__name__} has no document")


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
    def from_step(cls, step: Step) -> "StepDocument":
        snake_case = re.sub(r"(?<!^)(?=[A-Z])", "_", type(step).__name__).lower()
        return fill_from_object(cls, getattr(step, "load", step), kind=snake_case)


@dataclass(frozen=True, slots=True)
class StepStartedDocument:
    """A step begins. ``remaining_s`` is the estimate of the run's remaining time, this step included."""

    type: Literal["step_started"]
    phase: int
    number: int
    step: StepDocument
    time_s: float
    remaining_s: float


@document_of.register
def _step_started(event: StepStarted) -> StepStartedDocument:
    return fill_from_object(StepStartedDocument, event, type="step_started", step=StepDocument.from_step(event.step))


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


@document_of.register
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


@document_of.register
def _samples_taken(event: SamplesTaken) -> SamplesTakenDocument:
    block = event.samples
    finite = block.values[np.isfinite(block.values)]  # JSON has no NaN
    values = (float(finite.min()), float(finite.max()), float(finite[-1])) if len(finite) else (None, None, None)
    channel, unit, count = block.channel, block.unit, len(block)
    return SamplesTakenDocument("samples_taken", event.phase, channel, unit, count, *_times(block), *values)


def _times(block: FrameBlock | SampleBlock) -> tuple[float | None, float | None]:
    return (float(block.time_s[0]), float(block.time_s[-1])) if len(block) else (None, None)


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


@document_of.register
def _load_finished(event: LoadFinished) -> LoadFinishedDocument:
    load, record = event.record.load, event.record
    place = {"label": load.label, "x_mm": load.x_mm, "y_mm": load.y_mm, "strain": load.strain, "trial": load.trial}
    return fill_from_object(
        LoadFinishedDocument, record, type="load_finished", phase=event.phase, time_s=record.rest_end_s, **place
    )
