"""A calibration applied to recordings: a row of force, with its standard error, for every frame."""

from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field, InstanceOf

from cbsr_qa.analysis.recording.press_files import read_whole_frames
from cbsr_qa.analysis.recording.reading import read_recording_file
from cbsr_qa.app.calibration.file import check_free, write_text
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.estimator import (
    Ability,
    Estimator,
    FrameSequence,
    Touches,
    UnloadedFrames,
    require_ability,
)
from cbsr_qa.config.serials import validate_serial
from cbsr_qa.domain.errors import CalibrationError, CbsrError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import Recording
from cbsr_qa.domain.results.report import CommandOutcome, Section, Table
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.report.document import IF_GIVEN, Refusal
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import format_fixed, plural, text_table, with_uncertainty
from cbsr_qa.system.files import csv_text

_NO_TIMES: Final = (
    "frames have no times, or not in order: whether loads had settled is not known; until then forces read low, and"
    " after a release high"
)
#: Called with each step, in words.
Tell = Callable[[str], None]

#: Frames processed between two messages.
_AT_ONCE: Final = 500
#: Rows of a table in a terminal.
_MOST_ROWS: Final = 12
_SAID: Final = {
    Flag.NOT_DETECTED: "no load detected",
    Flag.OUTSIDE: "outside what was calibrated",
    Flag.BELOW_RANGE: "below the calibrated forces",
    Flag.ABOVE_RANGE: "above the calibrated forces",
    Flag.WRONG_SIGN: "changes the other way than under a load",
    Flag.MORE_THAN_ONE: "not that of one such head",
    Flag.UNREADABLE: "readings are missing or unusable",
    Flag.OTHER_SENSOR: "not a frame of this sensor",
    Flag.OTHER_HEAD: "a head of another size than was calibrated",
    Flag.NOT_AS_MODELLED: "not as on the modelled sheet",
    Flag.SPIKE: "a reading stood out alone: its reciprocal counts for both",
    Flag.DEAD_PAIR: "a pair hardly drives or measures: left out",
    Flag.OPEN_ELECTRODE: "nothing comes through an electrode: left out",
    Flag.SATURATED: "readings stand at one extreme value: left out",
    Flag.OFFSET: "one offset on all readings",
    Flag.MISSING: "some readings are missing: left out",
    Flag.UNSETTLED: "has not settled",
}


@dataclass(frozen=True, slots=True)
class FrameForce:
    """Force in one frame, or None; ``flags`` in words.

    Parameters
    ----------
    settled_in_s : time until the force counts [s], 0 where it does; None where that is not known.
    """

    time_s: float | None
    force_N: float | None
    stderr_N: float | None
    x_mm: float | None
    y_mm: float | None
    place_stderr_mm: float | None
    detectability: float | None
    settled_in_s: float | None
    flags: str


COLUMNS: Final = tuple(field.name for field in fields(FrameForce))


@dataclass(frozen=True, slots=True)
class ApplyRequest:
    """How a calibration is applied; see the options of ``cbsr-qa calibration apply``.

    Parameters
    ----------
    place_mm : place of the touch [mm]; None to estimate it.
    format, dataset : format and dataset of the recordings; None as detected.
    reference : number of first frames of a recording that are of the unloaded sheet.
    serial : serial number of the recorded sensor, if it is stated.
    pattern : pairs of the columns of a table of readings; None for recordings.
    differences : whether the readings are changes; else they are frames, compared with those of ``rest``, with the
        ``reference`` first ones, or with the calibration's unloaded frame. Faults of pairs, electrodes and clipping
        are named in frames, and their readings left out.
    rest : frames of the unloaded sheet, in the form of the readings.
    """

    place_mm: tuple[float, float] | None = None
    format: str | None = None
    dataset: str | None = None
    reference: int | None = None
    serial: str | None = None
    pattern: Path | None = None
    differences: bool = False
    rest: Path | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Applied:
    """Forces of one recording and remarks on its readings, or why it was refused."""

    file: Path
    frames: tuple[FrameForce, ...] = ()
    remarks: tuple[str, ...] = ()
    refused: Annotated[Refusal | None, IF_GIVEN] = None
    error: Annotated[InstanceOf[CbsrError] | None, Field(exclude=True)] = None


@dataclass(frozen=True, slots=True, eq=False)
class AppliedCalibration:
    """Forces of several recordings."""

    calibration: Path
    recordings: tuple[Applied, ...]

    @property
    def exit_code(self) -> int:
        """2 where a recording was refused, else 0."""
        return max(0 if recording.error is None else recording.error.exit_code for recording in self.recordings)


def apply_calibration(
    estimator: Estimator,
    calibration: Path,
    recordings: list[Path],
    request: ApplyRequest,
    *,
    tell: Tell = lambda stage: None,
) -> AppliedCalibration:
    """Turn the frames of recordings into force. A recording that is refused is a result, not an exception.

    Parameters
    ----------
    estimator : the calibration in use; ``calibration`` is its file.

    Raises
    ------
    CalibrationError
        If the calibration cannot be used, or its sensor is not the stated one.
    ConfigError
        If that serial number is malformed.
    """
    plugins = discover()
    if request.serial is not None:
        check_serial(estimator, request.serial)
    applied = []
    for path in recordings:
        try:
            tell(f"reading {path.name}")
            recording = read_recording_file(path, plugins, format_=request.format, dataset=request.dataset)
            remarks = _compare_serial(estimator, recording, request.serial)
            sequence = follow_recording(estimator, recording, request)
            forces = tuple(_estimate_frames(sequence, recording, tell))
            no_times = () if is_increasing(recording.frames.time_s) else (_NO_TIMES,)
            applied.append(Applied(path, forces, (*sequence.remarks, *remarks, *no_times)))
        except CbsrError as error:
            applied.append(Applied(path, refused=fill_from_object(Refusal, error), error=error))
    return AppliedCalibration(calibration, tuple(applied))


def follow_recording(estimator: Estimator, recording: Recording, request: ApplyRequest) -> FrameSequence:
    """Begin to follow the frames of a recording.

    Raises
    ------
    RecordingError
        If they are not those of the calibrated sensor, or cannot be brought to its scale.
    CalibrationError
        If the calibration lacks what is asked for, or an unloaded frame to compare with.
    """
    estimator.check_recording(recording)
    rest_frames = None
    if request.rest is not None:
        require_ability(estimator, Ability.READINGS)
        require_ability(estimator, Ability.FRAMES)
        assert estimator.pattern is not None
        rest_frames = read_whole_frames(request.rest, estimator.pattern)
    return estimator.follow(
        recording.path.name,
        recording.frames,
        UnloadedFrames(request.reference, rest_frames, request.differences),
        timed=is_increasing(recording.frames.time_s),
        place_mm=request.place_mm,
    )


def _compare_serial(estimator: Estimator, recording: Recording, stated: str | None) -> tuple[str, ...]:
    """Compare the sensor that a recording states with the calibration's; remark if neither it nor ``stated`` does.

    Raise CalibrationError if it is another one, or not the stated one.
    """
    calibrated, recorded = estimator.identity.serial, recording.serial
    if not calibrated or (recorded is None and stated is not None):
        return ()
    if recorded is None:
        why = "the recording states no serial number; --serial states it"
        return (f"not checked: that it is of sensor {calibrated}, as the calibration is ({why})",)
    if stated not in (None, recorded):
        raise CalibrationError(
            f"{recording.path.name} is of sensor {recorded}, and --serial states {stated}",
            remedy="leave --serial out, or name the recording of that sensor",
        )
    check_serial(estimator, recorded)
    return ()


def check_serial(estimator: Estimator, stated: str) -> None:
    """Check that a calibration is of a sensor. Raise CalibrationError if not, or if it states none."""
    require_ability(estimator, Ability.SERIAL, "leave --serial out: of which sensor it is cannot be checked")
    if validate_serial(stated) != estimator.identity.serial:
        raise CalibrationError(
            f"the calibration is of sensor {estimator.identity.serial}, the recordings are of {stated}",
            remedy="apply the calibration that was issued for this sensor",
        )


def is_increasing(time_s: Array) -> bool:
    """Whether loads can be followed over the times of frames."""
    return bool(np.isfinite(time_s).all() and (np.diff(time_s) > 0).all())


def _estimate_frames(sequence: FrameSequence, recording: Recording, tell: Tell) -> Iterator[FrameForce]:
    count = len(recording.frames)
    for first_frame in range(0, count, _AT_ONCE):
        tell(f"{recording.path.name}: frames {first_frame + 1} to {min(first_frame + _AT_ONCE, count)} of {count}")
        frames = recording.frames.select(slice(first_frame, first_frame + _AT_ONCE))
        yield from _list_forces(frames.time_s, sequence.estimate(frames))


def _list_forces(time_s: Array, touches: Touches) -> Iterator[FrameForce]:
    unknown, force = np.full(len(touches), np.nan), touches.force
    columns = (
        time_s,
        *((unknown, unknown) if force is None else (force.values, force.stderr)),
        *touches.place_mm.T,
        touches.place_stderr_mm,
        touches.detectability,
        touches.settled_in_s,
    )
    told = (unknown if column is None else column for column in columns)
    for *values, flags in zip(*told, touches.flags.tolist(), strict=True):
        row: list[Any] = [float(value) if np.isfinite(value) else None for value in values]
        row.append(flag_words(flags))
        yield FrameForce(*row)


def flag_words(flags: int) -> str:
    """Return the flags of a frame in words."""
    return "; ".join(words for flag, words in _SAID.items() if flags & flag)


def as_csv(applied: AppliedCalibration) -> str:
    """Return all rows as one CSV table whose first column names the recording."""
    rows = ((recording.file.name, *astuple(frame)) for recording in applied.recordings for frame in recording.frames)
    return csv_text([("recording", *COLUMNS), *rows])


def apply_outcome(applied: AppliedCalibration, output: Path | None) -> CommandOutcome[AppliedCalibration]:
    """Lay the forces of recordings out in short tables, or name the file that holds them.

    Parameters
    ----------
    output : CSV file that was written; None for tables.
    """
    estimated = [recording for recording in applied.recordings if recording.error is None]
    frames = sum(len(recording.frames) for recording in estimated)
    reason = f"{plural(frames, 'frame')} of {plural(len(estimated), 'recording')}"
    printed = () if output is None else (("Forces", str(output)),)
    sections = () if output else tuple(Section(recording.file.name, (_table(recording),)) for recording in estimated)
    remarks = tuple(f"{recording.file.name}: {remark}" for recording in estimated for remark in recording.remarks)
    outcome = answer(applied, "applied", reason, printed=printed)
    return replace(
        outcome, page=replace(outcome.page, remarks=remarks), sections=sections, exit_code=applied.exit_code
    )


_HEADINGS: Final = ("time [s]", "force [N]", "x [mm]", "y [mm]", "flags", "settled in [s]")
_SETTLED: Final = "A force that has not settled is predicted; rely on it after the time in the last column."


def _table(recording: Applied) -> Table:
    """Tabulate some frames of a recording, evenly spread."""
    count = len(recording.frames)
    frame_numbers = sorted({round(n) for n in np.linspace(0, count - 1, min(count, _MOST_ROWS))})
    rows = []
    for frame in (recording.frames[n] for n in frame_numbers):
        force = "–" if frame.force_N is None else with_uncertainty(frame.force_N, frame.stderr_N)
        time, x, y = (
            "–" if value is None else format_fixed(value, 1) for value in (frame.time_s, frame.x_mm, frame.y_mm)
        )
        settled = "–" if frame.settled_in_s is None else ""
        if frame.settled_in_s:
            settled = format_fixed(frame.settled_in_s, 0)
        rows.append((time, force, x, y, frame.flags, settled))
    spread = (
        ""
        if len(frame_numbers) == count
        else f"{len(frame_numbers)} of {count} frames, evenly spread; --output has all. "
    )
    caption = f"{spread}Force with one standard error, and where the head presses. {_SETTLED}"
    return text_table(caption, _HEADINGS, rows, (0, 1, 2, 3, 5))


def write_table(path: Path, table: str) -> None:
    """Write a table to a new file. Raise RefusedError if the file exists already, or cannot be written."""
    check_free(path)
    write_text(path, table)
