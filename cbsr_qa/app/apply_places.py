"""A calibration from labelled presses applied to a table of readings: a place for every row."""

from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.calibration.file import read_issued
from cbsr_qa.calibration.place import ModelledEstimator, PlaceEstimator, Places
from cbsr_qa.calibration.presses import PressReadings, matched_readings, read_pairs, read_press_readings
from cbsr_qa.calibration.runtime import Flag
from cbsr_qa.domain import ALLOWANCE, Array, CalibrationError
from cbsr_qa.domain.results import CommandOutcome, PressCalibration, Section
from cbsr_qa.report import answer, fixed, plural, text_table
from cbsr_qa.system import csv_text, read_untrusted

#: Rows of a table in a terminal.
_MOST_ROWS: Final = 12
_Covariance = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, slots=True)
class ByTheModel:
    """The same place by the modelled sheet alone.

    Parameters
    ----------
    explained : share of the readings' squares that a touch there explains, noise taken off where it is known.
    in_model : whether that is enough, and the registration trusted; else the place is not to be relied on.
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
    x_mm, y_mm, covariance_mm2 : None where there is no place.
    flags : what is unusual: names of :class:`~cbsr_qa.calibration.Flag`.
    in_model : whether the readings are like those that calibrated.
    force_N : None where it was not learned.
    modelled : by the modelled sheet; None where the calibration does not hold it.
    """

    x_mm: float | None
    y_mm: float | None
    covariance_mm2: _Covariance | None
    flags: tuple[str, ...]
    in_model: bool
    force_N: float | None = None
    modelled: ByTheModel | None = None


@dataclass(frozen=True, slots=True)
class AppliedPlaces:
    """Places of the presses in a table of readings.

    Parameters
    ----------
    q68, q95 : the region of that probability is all d with dᵀ Σ⁻¹ d ≤ q, Σ a frame's covariance and d a place less
        its own.
    """

    calibration: Path
    readings: Path
    q68: float
    q95: float
    frames: tuple[FramePlace, ...]


def apply_to_table(
    calibration: Path, readings: Path, pattern: Path, *, differences: bool, rest: Path | None
) -> AppliedPlaces:
    """Turn rows of readings into places.

    Parameters
    ----------
    calibration : file, learned from labelled presses.
    readings : table with a column for each row of ``pattern``.
    differences : whether the readings are changes; else they are frames, and changes are against ``rest`` or, without
        it, the unloaded frames that the calibration was made with.

    Raises
    ------
    CalibrationError
        If the calibration is not sound or of another kind, or a calibrated pair is missing.
    RecordingError
        If a table cannot be used.
    """
    issued = read_untrusted(calibration, lambda: read_issued(calibration), refusal=CalibrationError)
    if not isinstance(issued, PressCalibration):
        raise CalibrationError(
            f"{calibration} was issued by a run; --pattern is for calibrations from labelled presses",
            remedy="apply it to recordings, without --pattern",
        )
    read = read_press_readings(readings, read_pairs(pattern, issued.electrodes), rest)
    changes = _changes(issued, read, differences=differences)
    modelled = None if issued.modelled is None else ModelledEstimator(issued.modelled, issued.registration)
    estimator = PlaceEstimator(issued.place, modelled)
    places, by_model = estimator(changes), None if modelled is None else modelled(changes)
    frames = tuple(_frame(places, by_model, number) for number in range(len(changes)))
    return AppliedPlaces(calibration, readings, float(estimator.q68), float(estimator.q95), frames)


def _changes(issued: PressCalibration, read: PressReadings, *, differences: bool) -> Array:
    matched: Array = read.changes @ matched_readings(issued.pairs, read.distinct)
    if differences or read.rest is not None:
        return matched
    if issued.rest is None:
        raise CalibrationError(
            "the calibration was made from changes and holds no unloaded frame",
            remedy="give --differences if the readings are changes, or --rest FILE with frames of the unloaded sheet",
        )
    return matched - issued.rest


def _frame(places: Places, by_model: Places | None, number: int) -> FramePlace:
    modelled = None
    if by_model is not None:
        share = 1 / (1 + ALLOWANCE * float(by_model.misfit[number]))
        modelled = ByTheModel(*_place(by_model, number), share, bool(by_model.in_model[number]))
    return FramePlace(
        *_place(places, number),
        flags=tuple(str(flag.name).lower() for flag in Flag if flag & int(places.flags[number])),
        in_model=bool(places.in_model[number]),
        modelled=modelled,
    )


def _place(places: Places, number: int) -> tuple[float | None, float | None, _Covariance | None]:
    x, y = places.place_mm[number].tolist()
    if not np.isfinite([x, y]).all():
        return None, None, None
    (xx, xy), (yx, yy) = places.covariance_mm2[number].tolist()
    return x, y, ((xx, xy), (yx, yy))


def places_csv(applied: AppliedPlaces) -> str:
    """Return all places as a CSV table, a row a frame."""
    names = [field.name for field in fields(FramePlace) if field.name not in ("covariance_mm2", "modelled")]
    at = names.index("flags")
    header = [*names[:2], "covariance_xx_mm2", "covariance_xy_mm2", "covariance_yy_mm2", *names[2:]]
    rows = []
    for frame in applied.frames:
        x, y, covariance, *others, _ = astuple(frame)
        (xx, xy), (_, yy) = covariance or ((None, None), (None, None))
        others[at - 2] = "; ".join(others[at - 2])
        rows.append((x, y, xx, xy, yy, *others))
    return csv_text([header, *rows])


def places_outcome(applied: AppliedPlaces, output: Path | None) -> CommandOutcome[AppliedPlaces]:
    """Lay places out in a short table, or name the file that holds them."""
    count = len(applied.frames)
    inside = sum(frame.in_model for frame in applied.frames)
    printed = () if output is None else (("Places", str(output)),)
    facts = (("Like what calibrated", f"{inside} of {plural(count, 'frame')}"),)
    outcome = answer(applied, "applied", plural(count, "frame"), facts, printed)
    return outcome if output is not None else _with_table(outcome)


def _with_table(outcome: CommandOutcome[AppliedPlaces]) -> CommandOutcome[AppliedPlaces]:
    applied = outcome.result
    count = len(applied.frames)
    chosen = sorted({round(n) for n in np.linspace(0, count - 1, min(count, _MOST_ROWS))})
    rows = []
    for number in chosen:
        frame = applied.frames[number]
        x, y, force = ("–" if v is None else fixed(v, 1) for v in (frame.x_mm, frame.y_mm, frame.force_N))
        ellipse = frame.covariance_mm2
        radius = "–" if ellipse is None else fixed(float(np.sqrt(applied.q68 * np.linalg.eigvalsh(ellipse)[-1])), 1)
        rows.append((str(number + 1), x, y, radius, force, "; ".join(frame.flags)))
    spread = "" if len(chosen) == count else f"{len(chosen)} of {count} frames, evenly spread; --output has all. "
    caption = f"{spread}Places with the longer half-axis of their 68 % region."
    columns = ("row", "x [mm]", "y [mm]", "68 % [mm]", "force [N]", "flags")
    table = text_table(caption, columns, rows, (0, 1, 2, 3, 4))
    return CommandOutcome(applied, outcome.page, (Section(applied.readings.name, (table,)),), outcome.exit_code)
