"""A sensor's calibration applied to recordings: a row of force for every frame."""

from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, InstanceOf

from cbsr_qa.analysis.recording import read_recording_file
from cbsr_qa.app.calibration_file import check_free, write_text
from cbsr_qa.calibration.file import read_contained
from cbsr_qa.calibration.runtime import Calibration, Flag, SettlingForces
from cbsr_qa.config import validate_serial
from cbsr_qa.domain import CalibrationError, CbsrError, RecordingError, filled
from cbsr_qa.domain.readings import FrameBlock, ReadingFlag, Recording, ScanKind, VoltageUnit
from cbsr_qa.domain.results import CommandOutcome, Section, Table
from cbsr_qa.plugin import discover
from cbsr_qa.report import IF_GIVEN, Refusal, answer, fixed, plural, text_table, with_uncertainty
from cbsr_qa.system import csv_text

Array = NDArray[np.float64]
#: (n, drives, measures) voltages at the calibration's current [V], NaN where flagged; and what was done to them.
_Scaled = tuple[Array, tuple[str, ...]]

#: Largest relative difference, once scaled, of unloaded readings of the same sheet from the calibration's: more than
#: drift, and far less than another order of electrodes causes. Chosen by us.
_MOST_APART: Final = 0.2
_BAD: Final = int(ReadingFlag.SATURATED | ReadingFlag.COMPLIANCE | ReadingFlag.MISSING)
_REFERENCE: Final = (
    "give --reference N if its first N frames are of the unloaded sheet: they are then scaled to the calibration's"
    " own unloaded frame"
)


def recorded_frames(calibration: Calibration, recording: Recording, reference: int | None) -> _Scaled:
    """Bring the frames of a recording to the calibration's scale.

    Parameters
    ----------
    reference : number of first frames of the unloaded sheet; their mean, scaled by least squares, replaces the
        calibration's reference. None to keep the latter.

    Raises
    ------
    RecordingError
        If the recording is of another sensor type, scan, geometry, unit or scale, or its first frames are not those
        of this sensor.
    """
    _check(calibration, recording)
    frames = recording.frames
    voltages = np.where((frames.flags & _BAD) != 0, np.nan, frames.voltages)
    if reference is not None:
        return _against_own(calibration, recording, voltages, reference)
    if frames.unit is not VoltageUnit.VOLT:
        raise RecordingError(
            f"{recording.path.name} holds readings in {frames.unit.value} without their scale; the calibration of"
            f" sensor {calibration.issued.sensor.serial} is in volts",
            remedy=_REFERENCE,
        )
    ratio, remarks = _current_ratio(calibration, recording, frames)
    return voltages * ratio, remarks


def _check(calibration: Calibration, recording: Recording) -> None:
    issued, name = calibration.issued, recording.path.name
    if recording.sensor_type not in (None, issued.sensor_type.name):
        raise RecordingError(
            f"{name} is of sensor type {recording.sensor_type}, the calibration is of a {issued.sensor_type.name}",
            remedy="apply the calibration that was issued for this sensor",
        )
    if recording.scan is not ScanKind.FULL or recording.magnitudes_only:
        held = "absolute values" if recording.magnitudes_only else "driven pairs alone"
        raise RecordingError(f"{name} holds {held}; a force needs every reading with its sign")
    found, wanted = recording.frames.voltages.shape[1:], issued.reference.shape
    if found != wanted:
        raise RecordingError(
            f"{name} holds frames of {found[0]} × {found[1]} readings, the calibration is for"
            f" {wanted[0]} × {wanted[1]}"
        )
    if not len(recording.frames):
        raise RecordingError(f"{name} holds no frame")


def _current_ratio(
    calibration: Calibration, recording: Recording, frames: FrameBlock
) -> tuple[float, tuple[str, ...]]:
    current_A, own_A = frames.current_A, calibration.issued.current_A
    if current_A is None:
        raise RecordingError(
            f"{recording.path.name} does not say its drive current, which scales every reading", remedy=_REFERENCE
        )
    if not current_A > 0:
        raise RecordingError(f"{recording.path.name} states a drive current of {current_A:g} A")
    if np.isclose(current_A, own_A, rtol=1e-9):
        return 1.0, ()
    remark = f"readings at {1e3 * current_A:.4g} mA were scaled to the calibration's {1e3 * own_A:.4g} mA"
    return own_A / current_A, (remark,)


def _against_own(calibration: Calibration, recording: Recording, voltages: Array, count: int) -> _Scaled:
    name, frames = recording.path.name, len(voltages)
    if not 1 <= count <= frames:
        raise RecordingError(f"--reference {count} of {name}, which holds {frames} frames; 1 to {frames} are allowed")
    used = calibration.issued.reconstruction.problem.used
    own, reference = voltages[:count].mean(axis=0), calibration.issued.reference
    seen, known = own[used], reference[used]
    if not np.isfinite(seen).all():
        raise RecordingError(f"a used reading of the first {count} frames of {name} is missing or saturated")
    power = float(seen @ seen)
    ratio = float(seen @ known) / power if power > 0 else 0.0
    apart = float(np.linalg.norm(ratio * seen - known) / np.linalg.norm(known))
    if not (ratio > 0 and apart <= _MOST_APART):
        raise RecordingError(
            f"the first {count} frames of {name} are not those of sensor {calibration.issued.sensor.serial} unloaded:"
            f" scaled as well as can be they differ from its reference by {apart:.0%}; {_MOST_APART:.0%} is allowed",
            remedy="check the sensor, the order of its electrodes, and that nothing pressed",
        )
    unit = recording.frames.unit.value
    remark = (
        f"changes are against the first {count} frames, of which 1 {unit} is {ratio:.6g} V of the calibration;"
        f" unloaded they differ from its reference by {apart:.2%}, and their own noise (1/{count} of a frame's"
        " variance) is not in the standard errors"
    )
    return (voltages - own) * ratio + reference, (remark,)


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
        If the calibration cannot be used, or its sensor is not the stated one.
    ConfigError
        If that serial number is malformed.
    """
    sensor, plugins = Calibration(read_contained(calibration)), discover()
    remarks = _serial_remarks(sensor.issued.sensor.serial, request.serial)
    applied = []
    for path in recordings:
        try:
            tell(f"reading {path.name}")
            recording = read_recording_file(path, plugins, format_=request.format, dataset=request.dataset)
            voltages, scaled = recorded_frames(sensor, recording, request.reference)
            in_order = _in_order(recording.frames.time_s)
            forces = tuple(_forces(sensor, recording, voltages, request, tell, in_order=in_order))
            applied.append(Applied(path, forces, (*scaled, *remarks, *(() if in_order else (_NO_TIMES,)))))
        except CbsrError as error:
            applied.append(Applied(path, refused=filled(Refusal, error), error=error))
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


def _in_order(time_s: Array) -> bool:
    """Whether loads can be followed over the times of frames."""
    return bool(np.isfinite(time_s).all() and (np.diff(time_s) > 0).all())


def _forces(
    sensor: Calibration, recording: Recording, voltages: Array, request: ApplyRequest, tell: Tell, *, in_order: bool
) -> Iterator[FrameForce]:
    count, settling = len(voltages), SettlingForces(sensor)
    for first in range(0, count, _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        tell(f"{recording.path.name}: frames {first + 1} to {min(first + _AT_ONCE, count)} of {count}")
        f = sensor.force(voltages[part], place_mm=request.place_mm)
        times, settled_in_s = recording.frames.time_s[part], np.full(len(f.force_N), np.nan)
        if in_order:
            f, settled_in_s = settling(times, voltages[part], f)
        columns = (times, f.force_N, f.stderr_N, *f.place_mm.T, f.place_stderr_mm, f.detectability, settled_in_s)
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
_SETTLED: Final = "A force that has not settled is predicted; it counts after the time in the last column."


def _table(recording: Applied) -> Table:
    """Tabulate some frames of a recording, evenly spread."""
    count = len(recording.frames)
    chosen = sorted({round(n) for n in np.linspace(0, count - 1, min(count, _MOST_ROWS))})
    rows = []
    for frame in (recording.frames[n] for n in chosen):
        force = "–" if frame.force_N is None else with_uncertainty(frame.force_N, frame.stderr_N)
        time, x, y = ("–" if value is None else fixed(value, 1) for value in (frame.time_s, frame.x_mm, frame.y_mm))
        rows.append((time, force, x, y, frame.flags, _settled_words(frame)))
    spread = "" if len(chosen) == count else f"{len(chosen)} of {count} frames, evenly spread; --output has all. "
    caption = f"{spread}Force with one standard error, and where the head presses. {_SETTLED}"
    return text_table(caption, _HEADINGS, rows, (0, 1, 2, 3, 5))


def _settled_words(frame: FrameForce) -> str:
    if frame.settled_in_s is None:
        return "–"
    return fixed(frame.settled_in_s, 0) if frame.settled_in_s else ""


def write_table(path: Path, table: str) -> None:
    """Write a table to a new file. RefusedError if the file exists already, or cannot be written."""
    check_free(path)
    write_text(path, table)
