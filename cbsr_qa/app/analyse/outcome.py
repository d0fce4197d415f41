"""The outcome of ``cbsr-qa analyse``: the recording, and the events and noise found in it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Self

import numpy as np
from pydantic import Field, InstanceOf

from cbsr_qa.domain.errors import CbsrError, RowProblem
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.goodness import Goodness
from cbsr_qa.domain.readings.frames import Recording, ScanKind
from cbsr_qa.domain.results.findings import (
    ChannelReport,
    EventImaging,
    ImagedPlace,
    LoadEvent,
    Motion,
    NoiseReport,
    RecordingResult,
)
from cbsr_qa.domain.results.report import Block, CommandOutcome, Paragraph, Section
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.document import IF_GIVEN, ChosenParameter, Refusal
from cbsr_qa.report.heads import recording_page
from cbsr_qa.report.tables import format_fixed, plural, text_table

_USED_FOR: Final = "images of the events and their descriptions; events are found in the readings, without images"


@dataclass(frozen=True, slots=True)
class ReadRecording:
    """What was read; None if unknown.

    Parameters
    ----------
    sensor_type : sensor type that was given, else the one that the file states.
    problems : rows left out, or used with reservations.
    loads_documented : presses that the file states.
    """

    format: str | None
    dataset: str | None = None
    frames: int = 0
    scan: ScanKind | None = None
    frames_dropped: int = 0
    rows_rejected: int = 0
    problems: tuple[RowProblem, ...] = ()
    frame_rate_hz: float | None = None
    clock: str | None = None
    force_recorded: bool | None = None
    unit: str | None = None
    current_A: float | None = None
    sensor_type: str | None = None
    loads_documented: int = 0
    notes: tuple[str, ...] = ()
    simulated: tuple[str, ...] | None = None

    @classmethod
    def from_recording(
        cls, recording: Recording, frame_rate_hz: float | None = None, sensor_type: SensorType | None = None
    ) -> Self:
        return fill_from_object(
            cls,
            recording,
            dataset=recording.dataset or None,
            frames=len(recording.frames),
            frame_rate_hz=frame_rate_hz,
            force_recorded=any(block.channel == "force" for block in recording.samples),
            unit=recording.frames.unit.value,
            current_A=recording.frames.current_A,
            sensor_type=recording.sensor_type if sensor_type is None else sensor_type.name,
            loads_documented=len(recording.loads),
        )

    @classmethod
    def from_problems(cls, format_: str | None, problems: Sequence[RowProblem]) -> Self:
        """Return the outcome for an unreadable file; ``format_`` is None if it was not recognised."""
        return cls(format_, rows_rejected=sum(problem.rejected for problem in problems), problems=tuple(problems))


@dataclass(frozen=True, slots=True)
class EventReconstruction:
    """How the events were imaged; no parameter if nothing was."""

    name: str
    options: dict[str, Any]
    parameter: ChosenParameter | None
    elements: int | None
    used_for: str = _USED_FOR

    @classmethod
    def from_imaging(cls, imaging: EventImaging) -> Self:
        parameter = None if imaging.choice is None else ChosenParameter.from_choice(imaging.choice)
        return cls(imaging.reconstruction.name, dict(imaging.reconstruction.options), parameter, imaging.elements)


@dataclass(frozen=True, slots=True)
class PlaceInImage:
    """Place and strength of an event in its own image; see :class:`~cbsr_qa.domain.results.findings.ImagedPlace`."""

    x_over_R: float
    y_over_R: float
    r_over_R: float
    electrode: float
    largest_change: float
    area_share: float

    @classmethod
    def from_imaged_place(cls, place: ImagedPlace) -> Self:
        return fill_from_object(cls, place, largest_change=place.largest)


@dataclass(frozen=True, slots=True)
class TrackPoint:
    """Place of a moving object in one frame."""

    time_s: float
    x_over_R: float
    y_over_R: float


@dataclass(frozen=True, slots=True)
class MotionEnd:
    """First or last place of a moving object."""

    electrode: float
    r_over_R: float


@dataclass(frozen=True, slots=True)
class TrackedMotion:
    """How an object moves; see :class:`~cbsr_qa.domain.results.findings.Motion`."""

    begins: Annotated[MotionEnd, Field(serialization_alias="from")]
    ends: Annotated[MotionEnd, Field(serialization_alias="to")]
    turns: float
    nearest_r_over_R: float
    words: str

    @classmethod
    def from_motion(cls, motion: Motion) -> Self:
        return fill_from_object(cls, motion, begins=MotionEnd(*motion.begins), ends=MotionEnd(*motion.ends))


@dataclass(frozen=True, slots=True)
class Event:
    """An event; see ``LoadEvent``. Places in mm, track and motion only where known."""

    start_s: float
    peak_s: float
    end_s: float
    x_over_R: float
    y_over_R: float
    r_over_R: float
    electrode: float
    sign: int
    snr: float
    fate: str | None
    force_N: float | None
    x_mm: Annotated[float | None, IF_GIVEN]
    y_mm: Annotated[float | None, IF_GIVEN]
    image: PlaceInImage | None
    goodness: Goodness | None
    track: Annotated[tuple[TrackPoint, ...] | None, IF_GIVEN]
    motion: Annotated[TrackedMotion | None, IF_GIVEN]

    @classmethod
    def from_load_event(cls, event: LoadEvent) -> Self:
        return fill_from_object(
            cls,
            event,
            fate=event.fate or None,
            image=None if event.imaged is None else PlaceInImage.from_imaged_place(event.imaged),
            track=tuple(TrackPoint(*point) for point in event.track) or None,
            motion=None if event.motion is None else TrackedMotion.from_motion(event.motion),
        )


@dataclass(frozen=True, slots=True)
class Step:
    """A sudden change of noise or level; see :class:`~cbsr_qa.domain.results.findings.NoiseStep`."""

    time_s: float
    first_frame_after: int
    what: str
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of the quiet part of a recording; see :class:`~cbsr_qa.domain.results.findings.NoiseReport`."""

    rms: float | None
    unit: str
    drift_per_min: float | None
    steps: tuple[Step, ...]
    quiet_s: tuple[float, float] | None
    frames: int
    outliers: float | None

    @classmethod
    def from_noise_report(cls, noise: NoiseReport, recording: Recording) -> Self:
        """Return what a document says of it; steps with the first frame after each."""
        frames_after = np.searchsorted(recording.frames.time_s, [step.time_s for step in noise.steps], side="right")
        steps = (
            fill_from_object(Step, one, first_frame_after=int(n))
            for one, n in zip(noise.steps, frames_after, strict=True)
        )
        return fill_from_object(cls, noise, steps=tuple(steps))


@dataclass(frozen=True, slots=True, eq=False)
class Analysed:
    """A recording with all findings, or why it was refused.

    Parameters
    ----------
    channels : empty if nothing could be analysed.
    datasets : datasets of the file, if it holds several.
    compute_s : computing time by stage [s].
    """

    file: Path
    recording: ReadRecording
    channels: ChannelReport | dict[str, None]
    events: tuple[Event, ...] = ()
    warnings: tuple[str, ...] = ()
    reconstruction: EventReconstruction | None = None
    events_why: str = ""
    noise: Noise | None = None
    compute_s: dict[str, float] | None = None
    datasets: Annotated[tuple[str, ...] | None, IF_GIVEN] = None
    report: Path | None = None
    refused: Annotated[Refusal | None, IF_GIVEN] = None
    result: Annotated[InstanceOf[RecordingResult] | None, Field(exclude=True)] = None
    error: Annotated[InstanceOf[CbsrError] | None, Field(exclude=True)] = None

    @classmethod
    def from_result(cls, file: Path, result: RecordingResult) -> Self:
        return fill_from_object(
            cls,
            result,
            file=file,
            recording=ReadRecording.from_recording(result.recording, result.frame_rate_hz, result.sensor_type),
            reconstruction=None if result.imaging is None else EventReconstruction.from_imaging(result.imaging),
            events=tuple(map(Event.from_load_event, result.events)),
            noise=Noise.from_noise_report(result.noise, result.recording),
            compute_s={stage: round(seconds, 4) for stage, seconds in result.compute_s},
            result=result,
        )

    def with_refusal(self, error: CbsrError) -> Self:
        return replace(self, refused=fill_from_object(Refusal, error), error=error)

    @property
    def exit_code(self) -> int:
        """0 analysed, whether or not anything was found; 2 refused."""
        return 0 if self.error is None else self.error.exit_code


@dataclass(frozen=True, slots=True, eq=False)
class AnalysedFiles:
    """Several recordings, in the order they were named."""

    files: tuple[Analysed, ...]


def analyse_outcome(analysed: Analysed, *, imaged: bool) -> CommandOutcome[Analysed]:
    """Lay out an analysed recording for a terminal; its page is the report.

    Parameters
    ----------
    imaged : whether to describe the images of the events, because a reconstruction was chosen.
    """
    assert analysed.result is not None
    result, channels, noise = analysed.result, analysed.result.channels, analysed.result.noise
    facts = [
        ("Channels", f"{len(channels.saturated)} saturated, {len(channels.stuck)} stuck, {channels.used} imaged")
    ]
    if noise.rms is not None:
        steps = f", {plural(len(noise.steps), 'step')}" if noise.steps else ""
        facts.append(("Noise", f"{noise.rms:.3g} {noise.unit} rms{steps}"))
    page = recording_page(result)
    page = replace(
        page,
        identity=(*page.identity, *facts),
        warnings=(),
        remarks=(*result.recording.notes, *analysed.warnings),
        printed=() if analysed.report is None else (("Report", str(analysed.report)),),
    )
    sections = (Section("Events", tuple(_events(result, imaged=imaged))),) if result.events else ()
    return CommandOutcome(analysed, page, sections)


def _events(result: RecordingResult, *, imaged: bool) -> Iterator[Block]:
    timed, in_mm = result.frame_rate_hz is not None, any(event.x_mm is not None for event in result.events)
    in_rows = result.recording.rows and not timed
    columns = [
        "event",
        *(["from [s]", "to [s]"] * timed),
        *(["row"] * in_rows),
        "place",
        *(["x [mm]", "y [mm]"] * in_mm),
        "change",
        "SNR",
    ]
    rows = []
    for number, event in enumerate(result.events, start=1):
        times = [format_fixed(event.start_s, 1), format_fixed(event.end_s, 1)] * timed
        mm = ["–" if length is None else format_fixed(length, 1) for length in (event.x_mm, event.y_mm)] * in_mm
        in_row = [f"{round(event.peak_s) + 1}"] * in_rows
        row = [
            f"E{number}",
            *times,
            *in_row,
            event.place,
            *mm,
            "conducts more" if event.sign > 0 else "conducts less",
        ]
        seen = ["not in it" if event.imaged is None else event.imaged.place] * imaged
        rows.append([*row, format_fixed(event.snr, 1), *seen])
    numeric = [place for place, column in enumerate(columns) if column.endswith("]") or column in ("SNR", "row")]
    yield text_table("Found in the readings.", [*columns, *(["in its image"] * imaged)], rows, numeric)
    choice = None if result.imaging is None else result.imaging.choice
    if imaged and result.imaging is not None and choice is not None:
        name = result.imaging.reconstruction.name
        yield Paragraph(f"Images by {name}, {choice.name} {choice.value:.3g}: {choice.how}.")
    for number, event in enumerate(result.events, start=1):
        if event.motion is not None:
            yield Paragraph(f"E{number} moves: {event.motion.words}; the place above is that of its clearest frame.")
