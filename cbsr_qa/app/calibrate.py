"""``cbsr-qa calibrate``: a calibration from labelled presses, wherever they were made."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.analysis.recording import read_recording_file
from cbsr_qa.app.calibration_file import check_free
from cbsr_qa.calibration.file import write_calibration
from cbsr_qa.calibration.presses import (
    DistinctPairs,
    Identity,
    PressReadings,
    issue_from_presses,
    read_pairs,
    read_press_readings,
    read_presses,
    source_file,
)
from cbsr_qa.config import load_pressed_type
from cbsr_qa.domain import Array, RecordingError, RefusedError
from cbsr_qa.domain.readings import UNUSABLE, ScanKind
from cbsr_qa.domain.results import CommandOutcome, LeftOutPress, PressCalibration, SheetRegistration
from cbsr_qa.domain.sensor import DrivePattern, SensorType
from cbsr_qa.plugin import discover
from cbsr_qa.report import answer, fixed, plural
from cbsr_qa.store import IdSource

#: Rows left out that a terminal shows.
_MOST_ROWS: Final = 10


@dataclass(frozen=True, slots=True)
class CalibrateRequest:
    """What is calibrated from; see the options of ``cbsr-qa calibrate``.

    Parameters
    ----------
    readings : table, or a recording whose frames are of one press each.
    pattern : of the tables' columns; None where the readings are a recording.
    differences : whether the readings are changes.
    rest : frames of the unloaded sheet, in the form of the readings.
    """

    readings: Path
    presses: Path
    sensor_type: str
    to: Path
    pattern: Path | None = None
    differences: bool = False
    rest: Path | None = None


@dataclass(frozen=True, slots=True)
class HeldOutPlaces:
    """Error of place of presses left out [mm]: mean, its standard error, and their number."""

    mean: float | None
    stderr: float | None
    n: int


@dataclass(frozen=True, slots=True)
class HeldOut:
    """What presses left out say of the errors.

    Parameters
    ----------
    coverage : share of the presses left out whose region of 68 and 95 % holds the label.
    """

    place_mm: HeldOutPlaces
    coverage: dict[str, float | None]


@dataclass(frozen=True, slots=True)
class PressesCalibrated:
    """A calibration that was issued from labelled presses.

    Parameters
    ----------
    calibration : its file.
    used : presses that it was learned from.
    left_out : those it was not; rows are counted from 1 below the header.
    explained : share of the readings' changes that the modelled sheet explains.
    """

    calibration: Path
    used: int
    left_out: tuple[LeftOutPress, ...]
    explained: float
    registration: SheetRegistration
    held_out: HeldOut
    warnings: tuple[str, ...]
    digest: str
    size_bytes: int


def calibrate_from_presses(
    request: CalibrateRequest, *, tell: Callable[[str], None] = lambda stage: None
) -> CommandOutcome[PressesCalibrated]:
    """Learn places from labelled presses and write the calibration.

    Raises
    ------
    RefusedError
        If anything about the tables, the pattern, the sensor type or the file to write cannot be used; nothing is
        written then.
    """
    check_free(request.to)
    if request.differences == (request.rest is not None):
        found = "both --differences and --rest are" if request.differences else "neither --differences nor --rest is"
        raise RefusedError(
            f"{found} given",
            remedy="give --differences if the readings are changes, or --rest FILE with frames of the unloaded sheet",
        )
    loaded, sized = load_pressed_type(request.sensor_type)
    sensor_type = loaded.value
    tell("reading the tables")
    presses = read_presses(request.presses)
    readings = _readings(request, sensor_type)
    named = {"readings": request.readings, "presses": request.presses, "pattern": request.pattern}
    named |= {"rest": request.rest, "sensor type": loaded.document.path}
    sources = tuple(source_file(role, path) for role, path in named.items() if path is not None)
    identity = Identity(
        IdSource(lambda: datetime.now(UTC)).new(), datetime.now(UTC).isoformat(timespec="seconds"), sources
    )
    issued = issue_from_presses(identity, sensor_type, readings, presses, radius_stated=sized, tell=tell)
    write_calibration(request.to, issued)
    return _outcome(issued, request.to)


def _readings(request: CalibrateRequest, sensor_type: SensorType) -> PressReadings:
    if request.pattern is not None:
        pairs = read_pairs(request.pattern, sensor_type.electrodes.count)
        return read_press_readings(request.readings, pairs, request.rest)
    if request.readings.suffix.lower() in (".parquet", ".pq"):
        raise RefusedError(
            f"{request.readings} is a table, and --pattern is missing",
            remedy="give --pattern FILE with source,sink,plus,minus of each column",
        )
    pattern = sensor_type.pattern
    distinct = DistinctPairs.of(
        np.array([(*pattern.drive[d], *pattern.measure[m]) for d, m in np.argwhere(pattern.usable())])
    )
    frames = _frames(request.readings, pattern)
    if request.rest is None:
        return PressReadings(request.readings, distinct, frames)
    rest = _frames(request.rest, pattern)
    noise = rest.std(axis=0, ddof=1) if len(rest) > 1 else None
    return PressReadings(request.readings, distinct, frames - rest.mean(axis=0), rest.mean(axis=0), noise)


def _frames(path: Path, pattern: DrivePattern) -> Array:
    """Usable readings (n, m) of a recording, a frame a press. RecordingError if it is of another pattern."""
    try:
        recording = read_recording_file(path, discover(), format_=None, dataset=None)
    except RecordingError as error:
        remedy = "; a table of readings needs --pattern" if "no known format" in error.reason else ""
        raise RecordingError(error.reason, remedy=error.remedy + remedy) from error
    frames = recording.frames
    if recording.scan is not ScanKind.FULL or frames.voltages.shape[1:] != pattern.shape or recording.magnitudes_only:
        raise RecordingError(
            f"{path.name} holds frames of {frames.voltages.shape[1]} × {frames.voltages.shape[2]} readings; signed"
            f" ones of {pattern.shape[0]} × {pattern.shape[1]} are needed for the sensor type's pattern",
            remedy="give the sensor type that was recorded",
        )
    usable = pattern.usable()
    bad = np.argwhere(((frames.flags & UNUSABLE) != 0) & usable)
    if len(bad):
        frame, drive, measure = bad[0].tolist()
        raise RecordingError(
            f"{path.name}: {len(bad)} readings are missing or saturated, first in frame {frame}, drive pair {drive},"
            f" measure pair {measure} (all from 0)",
            remedy="leave out that press in both files",
        )
    return frames.voltages[:, usable]


def _outcome(issued: PressCalibration, file: Path) -> CommandOutcome[PressesCalibrated]:
    held_out = HeldOut(
        HeldOutPlaces(issued.held_out_mm, issued.held_out_stderr_mm, issued.held_out),
        {"68": issued.covered_68, "95": issued.covered_95},
    )
    result = PressesCalibrated(
        calibration=file,
        used=issued.used,
        left_out=issued.left_out,
        explained=issued.registration.signal_share,
        registration=issued.registration,
        held_out=held_out,
        warnings=issued.findings,
        digest=issued.digest,
        size_bytes=file.stat().st_size,
    )
    return answer(
        result,
        "calibrated",
        f"{plural(issued.used, 'press', 'presses')} of a {issued.sensor_type}",
        press_facts(issued),
        printed=(("Calibration", str(file)),),
        warnings=issued.findings,
    )


def press_facts(issued: PressCalibration) -> list[tuple[str, str]]:
    """What a person should know of a calibration from labelled presses, as (name, value)."""
    facts = [("Presses", f"{issued.used} used, {len(issued.left_out)} left out")]
    if issued.held_out_mm is not None:
        error = _with(issued.held_out_mm, issued.held_out_stderr_mm, 2)
        facts.append(
            ("Error of place", f"{error} mm, mean of {plural(issued.held_out, 'press', 'presses')} left out")
        )
    if issued.covered_68 is not None and issued.covered_95 is not None:
        held = f"{issued.covered_68:.0%} (asked 68 %), {issued.covered_95:.0%} (asked 95 %)"
        facts.append(("Regions hold the place", held))
    facts.append(("Explained by the model", f"{issued.registration.signal_share:.0%} of the readings' changes"))
    facts.append(("Sheet", _pose_words(issued.registration)))
    return facts + [(f"Row {each.row} left out", each.why) for each in issued.left_out[:_MOST_ROWS]]


def _pose_words(pose: SheetRegistration) -> str:
    x, y = (_with(*each, 1) for each in zip(pose.shift_mm, pose.shift_stderr_mm, strict=True))
    words = f"centre at ({x}, {y}) mm, turned by {_with(pose.rotation_deg, pose.rotation_stderr_deg, 1)}°"
    words += f"{', mirrored' if pose.mirrored else ''}, scale {_with(pose.scale, pose.scale_stderr, 3)}"
    words += f", radius {_with(pose.radius_mm, pose.radius_stderr_mm, 1)} mm"
    return words if pose.trusted else f"{words}: not used"


def _with(value: float, stderr: float | None, digits: int) -> str:
    return fixed(value, digits) if not stderr else f"{fixed(value, digits)} ± {fixed(stderr, digits)}"
