"""A sensor's calibration applied to recordings: a row of force for every frame."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field, InstanceOf

from cbsr_qa.analysis.recording.reading import read_recording_file
from cbsr_qa.app.calibration.file import check_free, write_text
from cbsr_qa.app.calibration.frame_scale import scale_frames
from cbsr_qa.calibration.file.hdf5 import read_contained
from cbsr_qa.calibration.file.signing import check_signed_file
from cbsr_qa.calibration.force.inverse import Flag, Forces
from cbsr_qa.calibration.runtime.runtime import Calibration
from cbsr_qa.calibration.runtime.settling_forces import SettlingForces
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
    settled_in_s : until the force counts, 0 where it does; None where that is not known.
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
    """How a calibration is applied; see the options of ``cbsr-qa calibration apply``."""

    place_mm: tuple[float, float] | None = None
    format: str | None = None
    dataset: str | None = None
    reference: int | None = None
    serial: str | None = None
    public_key: Path | None = None


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
    calibration: Path, recordings: list[Path], request: ApplyRequest, *, tell: Tell = lambda stage: None
) -> AppliedCalibration:
    """Turn the frames of recordings into force. A recording that is refused is a result, not an exception.

    Raises
    ------
    CalibrationError
        If the calibration cannot be used, is not signed by the stated key, or its sensor is not the stated one.
    ConfigError
        If that serial number is malformed, or the key cannot be used.
    """
    issued = read_contained(calibration)
    if request.public_key is not None:
        check_signed_file(calibration, issued, request.public_key)
    sensor, plugins = Calibration(issued), discover()
    remarks = _serial_remarks(sensor.issued.sensor.serial, request.serial)
    applied = []
    for path in recordings:
        try:
            tell(f"reading {path.name}")
            recording = read_recording_file(path, plugins, format_=request.format, dataset=request.dataset)
            voltages, scaled = scale_frames(sensor, recording, request.reference)
            in_order = _is_increasing(recording.frames.time_s)
            forces = tuple(_forces(sensor, recording, voltages, request, tell, in_order=in_order))
            applied.append(Applied(path, forces, (*scaled, *remarks, *(() if in_order else (_NO_TIMES,)))))
        except CbsrError as error:
            applied.append(Applied(path, refused=fill_from_object(Refusal, error), error=error))
    return AppliedCalibration(calibration, tuple(applied))


def _serial_remarks(own: str, stated: str | None) -> tuple[str, ...]:
    """Remark that a recording's sensor is unknown, unless it was stated."""
    if stated is None:
        why = "recordings state no serial number; --serial states it"
        return (f"not checked: that it is of sensor {own}, as the calibration is ({why})",)
    if validate_serial(stated) != own:
        raise CalibrationError(
            f"the calibration is of sensor {own}, the recordings are of {stated}",
            remedy="apply the calibration that was issued for this sensor",
        )
    return ()


def _is_increasing(time_s: Array) -> bool:
    """Whether loads can be followed over the times of frames."""
    return bool(np.isfinite(time_s).all() and (np.diff(time_s) > 0).all())


def _forces(
    sensor: Calibration, recording: Recording, voltages: Array, request: ApplyRequest, tell: Tell, *, in_order: bool
) -> Iterator[FrameForce]:
    count, follow = len(voltages), SettlingForces(sensor)
    for first in range(0, count, _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        tell(f"{recording.path.name}: frames {first + 1} to {min(first + _AT_ONCE, count)} of {count}")
        times, frames = recording.frames.time_s[part], voltages[part]
        if in_order:
            for time_s, frame in zip(times.tolist(), frames, strict=True):
                yield from _rows([time_s], *follow.add_frame(time_s, frame, place_mm=request.place_mm))
        else:
            yield from _rows(times, sensor.force(frames, place_mm=request.place_mm), np.full(len(times), np.nan))


def _rows(time_s: Iterable[float], f: Forces, settled_in_s: Array) -> Iterator[FrameForce]:
    columns = (time_s, f.force_N, f.stderr_N, *f.place_mm.T, f.place_stderr_mm, f.detectability, settled_in_s)
    for *values, flags in zip(*columns, f.flags.tolist(), strict=True):
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
    good = [recording for recording in applied.recordings if recording.error is None]
    frames = sum(len(recording.frames) for recording in good)
    reason = f"{plural(frames, 'frame')} of {plural(len(good), 'recording')}"
    printed = () if output is None else (("Forces", str(output)),)
    sections = () if output else tuple(Section(recording.file.name, (_table(recording),)) for recording in good)
    remarks = tuple(f"{recording.file.name}: {remark}" for recording in good for remark in recording.remarks)
    outcome = answer(applied, "applied", reason, printed=printed)
    return replace(
        outcome, page=replace(outcome.page, remarks=remarks), sections=sections, exit_code=applied.exit_code
    )


_HEADINGS: Final = ("time [s]", "force [N]", "x [mm]", "y [mm]", "flags", "settled in [s]")
_SETTLED: Final = "A force that has not settled is predicted; rely on it after the time in the last column."


def _table(recording: Applied) -> Table:
    """Tabulate some frames of a recording, evenly spread."""
    count = len(recording.frames)
    chosen = sorted({round(n) for n in np.linspace(0, count - 1, min(count, _MOST_ROWS))})
    rows = []
    for frame in (recording.frames[n] for n in chosen):
        force = "–" if frame.force_N is None else with_uncertainty(frame.force_N, frame.stderr_N)
        time, x, y = (
            "–" if value is None else format_fixed(value, 1) for value in (frame.time_s, frame.x_mm, frame.y_mm)
        )
        rows.append((time, force, x, y, frame.flags, _format_settling(frame)))
    spread = "" if len(chosen) == count else f"{len(chosen)} of {count} frames, evenly spread; --output has all. "
    caption = f"{spread}Force with one standard error, and where the head presses. {_SETTLED}"
    return text_table(caption, _HEADINGS, rows, (0, 1, 2, 3, 5))


def _format_settling(frame: FrameForce) -> str:
    if frame.settled_in_s is None:
        return "–"
    return format_fixed(frame.settled_in_s, 0) if frame.settled_in_s else ""


def write_table(path: Path, table: str) -> None:
    """Write a table to a new file. RefusedError if the file exists already, or cannot be written."""
    check_free(path)
    write_text(path, table)
