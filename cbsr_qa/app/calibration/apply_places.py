"""A calibration applied to a table of readings or a recording: a place, with its regions, for every row."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cbsr_qa.analysis.recording.press_files import read_pressed_recording
from cbsr_qa.app.calibration.apply import ApplyRequest, check_serial, follow_recording
from cbsr_qa.calibration.force.inverse import flag_names
from cbsr_qa.calibration.presses.inputs import read_press_readings
from cbsr_qa.calibration.presses.tables import read_pairs
from cbsr_qa.calibration.runtime.estimator import Ability, Estimator, Interval, Touches, read_value
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.report import CommandOutcome, Section
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import format_fixed, number, plural, text_table
from cbsr_qa.system.files import csv_text

#: Rows of a table in a terminal.
_MOST_ROWS: Final = 12
_Covariance = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, slots=True)
class ByTheModel:
    """The same place by the modelled sheet alone.

    Parameters
    ----------
    explained : share of the readings' squares that a touch there explains, noise taken off where it is known.
    in_model : whether the model explains enough, and the registration is trusted; else the place is not to be relied
        on.
    """

    x_mm: float | None
    y_mm: float | None
    covariance_mm2: _Covariance | None
    explained: float
    in_model: bool


@dataclass(frozen=True, slots=True)
class FramePlace:
    """Place of the press in one row, in the frame of the presses that calibrated.

    Parameters
    ----------
    x_mm, y_mm, covariance_mm2 : None if no place was found.
    flags : names of :class:`~cbsr_qa.calibration.force.inverse.Flag`.
    in_model : whether the readings are like those that calibrated.
    force_N, depth_mm : None where it was not learned, or no press is detected.
    force_68_N, force_95_N, depth_68_mm, depth_95_mm : lowest and highest of the interval that holds it with that
        probability.
    modelled : place found with the modelled sheet; None where the calibration does not hold it.
    """

    x_mm: float | None
    y_mm: float | None
    covariance_mm2: _Covariance | None
    flags: tuple[str, ...]
    in_model: bool
    force_N: float | None = None
    force_68_N: Interval | None = None
    force_95_N: Interval | None = None
    depth_mm: float | None = None
    depth_68_mm: Interval | None = None
    depth_95_mm: Interval | None = None
    modelled: ByTheModel | None = None


@dataclass(frozen=True, slots=True)
class AppliedPlaces:
    """Places of the presses in a table of readings.

    Parameters
    ----------
    q68, q95 : the region of that probability is dᵀ Σ⁻¹ d ≤ q, with d the distance from a frame's place and Σ its
        covariance; null where the calibration states none.
    force_error : what errors of force include; None without forces.
    """

    calibration: Path
    readings: Path
    q68: float
    q95: float | None
    frames: tuple[FramePlace, ...]
    force_error: str | None = None


def apply_to_rows(estimator: Estimator, calibration: Path, readings: Path, request: ApplyRequest) -> AppliedPlaces:
    """Turn rows of readings, or frames of a recording, into places.

    Parameters
    ----------
    estimator : the calibration in use; ``calibration`` is its file.
    readings : table with a column for each row of the request's ``pattern``; without one, a recording.

    Raises
    ------
    CalibrationError
        If the calibration states no regions of places, or is of another sensor, or a calibrated pair is missing.
    RecordingError
        If a table cannot be used.
    """
    if request.serial is not None:
        check_serial(estimator, request.serial)
    if request.pattern is not None and Ability.READINGS in estimator.lacks:
        raise CalibrationError(
            f"{calibration} {estimator.lacks[Ability.READINGS]}; --pattern is for calibrations from labelled presses",
            remedy="apply it to recordings, without --pattern",
        )
    regions = estimator.regions
    if regions is None:
        raise CalibrationError(f"{calibration} {estimator.lacks[Ability.REGION]}", remedy="leave --pattern out")
    if request.pattern is None:
        touches = _estimate_recording(estimator, calibration, readings, request)
    else:
        touches = _estimate_table(estimator, readings, request.pattern, request)
    frames = tuple(_frame(touches, row) for row in range(len(touches)))
    force_error = None if Ability.FORCE in estimator.lacks else estimator.force_error
    return AppliedPlaces(calibration, readings, regions.q68, regions.q95, frames, force_error)


def _estimate_recording(estimator: Estimator, calibration: Path, path: Path, request: ApplyRequest) -> Touches:
    if estimator.pattern is None:
        raise CalibrationError(
            f"{calibration} {estimator.lacks[Ability.FRAMES]}",
            remedy="give the readings as a table, with --pattern, or calibrate again",
        )
    recording = read_pressed_recording(path, request.format, request.dataset)
    return follow_recording(estimator, recording, request).estimate(recording.frames)


def _estimate_table(estimator: Estimator, path: Path, pattern: Path, request: ApplyRequest) -> Touches:
    if request.place_mm is not None:
        raise CalibrationError("rows of a table are located; --place is for recordings", remedy="leave --place out")
    press_readings = read_press_readings(path, read_pairs(pattern, estimator.identity.electrodes), request.rest)
    return estimator.estimate_readings(
        press_readings.distinct.pairs,
        press_readings.changes,
        relative=press_readings.rest is not None,
        differences=request.differences,
    )


def _frame(touches: Touches, row: int) -> FramePlace:
    modelled = None
    if touches.modelled is not None:
        by_model = touches.modelled
        place = _place(by_model.place_mm[row], by_model.covariance_mm2[row])
        modelled = ByTheModel(*place, float(by_model.explained[row]), bool(by_model.in_model[row]))
    flags = int(touches.flags[row])
    covariance_mm2 = None if touches.covariance_mm2 is None else touches.covariance_mm2[row]
    return FramePlace(
        *_place(touches.place_mm[row], covariance_mm2),
        flag_names(flags),
        bool(touches.in_model[row]),
        *read_value(touches.force, row),
        *read_value(touches.depth, row),
        modelled,
    )


def _place(place_mm: Array, covariance_mm2: Array | None) -> tuple[float | None, float | None, _Covariance | None]:
    x, y = place_mm.tolist()
    if not np.isfinite([x, y]).all():
        return None, None, None
    if covariance_mm2 is None:
        return x, y, None
    (xx, xy), (yx, yy) = covariance_mm2.tolist()
    return x, y, ((xx, xy), (yx, yy))


def places_csv(applied: AppliedPlaces) -> str:
    """Return all places as a CSV table, a row a frame, each with ``q68`` and ``q95`` of the calibration."""
    bounds = {"q68": applied.q68, "q95": applied.q95}
    rows = [{"row": row, **dict(_cells(frame)), **bounds} for row, frame in enumerate(applied.frames, 1)]
    return csv_text([tuple(rows[0]), *(tuple(row.values()) for row in rows)])


def _cells(frame: FramePlace) -> Iterator[tuple[str, Any]]:
    """Yield columns of a frame and what they hold."""
    for name, value in asdict(frame).items():
        stem, _, unit = name.rpartition("_")
        if name == "covariance_mm2":
            (xx, xy), (_, yy) = value or ((None, None), (None, None))
            yield from {"covariance_xx_mm2": xx, "covariance_xy_mm2": xy, "covariance_yy_mm2": yy}.items()
        elif stem.endswith(("_68", "_95")):
            yield from zip((f"{stem}_low_{unit}", f"{stem}_high_{unit}"), value or (None, None), strict=True)
        elif name != "modelled":
            yield name, "; ".join(value) if name == "flags" else value


def places_outcome(applied: AppliedPlaces, output: Path | None) -> CommandOutcome[AppliedPlaces]:
    """Lay places out in a short table, or name the file that holds them."""
    count = len(applied.frames)
    in_model_count = sum(frame.in_model for frame in applied.frames)
    printed = () if output is None else (("Places", str(output)),)
    facts = [("Like what calibrated", f"{in_model_count} of {plural(count, 'frame')}")]
    if applied.force_error is not None:
        facts.append(("Errors of force include", applied.force_error))
    outcome = answer(applied, "applied", plural(count, "frame"), facts, printed)
    return outcome if output is not None else _with_table(outcome)


def _with_table(outcome: CommandOutcome[AppliedPlaces]) -> CommandOutcome[AppliedPlaces]:
    applied = outcome.result
    count = len(applied.frames)
    row_numbers = sorted({round(n) for n in np.linspace(0, count - 1, min(count, _MOST_ROWS))})
    rows = []
    for row in row_numbers:
        frame = applied.frames[row]
        x, y = ("–" if v is None else format_fixed(v, 1) for v in (frame.x_mm, frame.y_mm))
        ellipse = frame.covariance_mm2
        radius = (
            "–" if ellipse is None else format_fixed(float(np.sqrt(applied.q68 * np.linalg.eigvalsh(ellipse)[-1])), 1)
        )
        force, depth = (
            _with_interval(frame.force_N, frame.force_68_N),
            _with_interval(frame.depth_mm, frame.depth_68_mm),
        )
        rows.append((str(row + 1), x, y, radius, force, depth, "; ".join(frame.flags)))
    spread = (
        ""
        if len(row_numbers) == count
        else f"{len(row_numbers)} of {count} frames, evenly spread; --output has all. "
    )
    caption = f"{spread}Places with the longer half-axis of their 68 % region, force and depth with 68 % intervals."
    columns = ("row", "x [mm]", "y [mm]", "68 % [mm]", "force [N]", "depth [mm]", "flags")
    table = text_table(caption, columns, rows, (0, 1, 2, 3, 4, 5))
    return CommandOutcome(applied, outcome.page, (Section(applied.readings.name, (table,)),), outcome.exit_code)


def _with_interval(value: float | None, within: Interval | None) -> str:
    return "–" if value is None or within is None else f"{number(value)} ({number(within[0])} to {number(within[1])})"
