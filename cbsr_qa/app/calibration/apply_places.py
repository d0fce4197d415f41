"""A calibration from labelled presses applied to a table of readings or a recording: a place for every row."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from cbsr_qa.analysis.recording.press_files import read_pressed_frames
from cbsr_qa.calibration.file.entries import Issued
from cbsr_qa.calibration.file.hdf5 import read_in_child, read_issued
from cbsr_qa.calibration.file.signing import check_signed_file
from cbsr_qa.calibration.force.faults import FaultFinder
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.modelled import ModelledEstimator
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.calibration.place.quantity import Quantities, QuantityEstimator
from cbsr_qa.calibration.presses.inputs import read_press_readings
from cbsr_qa.calibration.presses.pairs import DistinctPairs, match_readings
from cbsr_qa.calibration.presses.tables import read_pairs
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.goodness import ALLOWANCE
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.press_calibration import PRESS_QUANTITIES, PressCalibration
from cbsr_qa.domain.results.report import CommandOutcome, Section
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import format_fixed, number, plural, text_table
from cbsr_qa.system.files import csv_text

#: Rows of a table in a terminal.
_MOST_ROWS: Final = 12
_Interval = tuple[float, float]
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
    x_mm, y_mm, covariance_mm2 : None if no place was found.
    flags : names of :class:`~cbsr_qa.calibration.force.inverse.Flag`.
    in_model : whether the readings are like those that calibrated.
    force_N, depth_mm : None where it was not learned, or no press is detected.
    force_68_N, force_95_N, depth_68_mm, depth_95_mm : lowest and highest of the interval that holds it with that
        probability.
    modelled : by the modelled sheet; None where the calibration does not hold it.
    """

    x_mm: float | None
    y_mm: float | None
    covariance_mm2: _Covariance | None
    flags: tuple[str, ...]
    in_model: bool
    force_N: float | None = None
    force_68_N: _Interval | None = None
    force_95_N: _Interval | None = None
    depth_mm: float | None = None
    depth_68_mm: _Interval | None = None
    depth_95_mm: _Interval | None = None
    modelled: ByTheModel | None = None


@dataclass(frozen=True, slots=True)
class AppliedPlaces:
    """Places of the presses in a table of readings.

    Parameters
    ----------
    q68, q95 : the region of that probability is dᵀ Σ⁻¹ d ≤ q, with d the distance from a frame's place and Σ its
        covariance.
    """

    calibration: Path
    readings: Path
    q68: float
    q95: float
    frames: tuple[FramePlace, ...]


def is_press_calibration(calibration: Path) -> bool:
    """Return whether a calibration file was learned from labelled presses; CalibrationError if it is damaged."""
    return isinstance(read_calibration_file(calibration), PressCalibration)


def read_calibration_file(calibration: Path, public_key: Path | None = None) -> Issued:
    """Read a calibration of either kind; CalibrationError if it is damaged, or not signed by a given key."""
    issued = read_in_child(calibration, partial(read_issued, calibration))
    if public_key is not None:
        check_signed_file(calibration, issued, public_key)
    return issued


def apply_to_presses(
    calibration: Path,
    readings: Path,
    pattern: Path | None,
    *,
    differences: bool,
    rest: Path | None,
    reference: int | None = None,
    public_key: Path | None = None,
) -> AppliedPlaces:
    """Turn rows of readings, or frames of a recording, into places.

    Parameters
    ----------
    calibration : file, learned from labelled presses.
    readings : table with a column for each row of ``pattern``; without one, a recording of the sensor type.
    differences : whether the readings are changes; else they are frames, compared with ``rest``, with the
        ``reference`` first frames of the recording, or with the calibration's unloaded frames. Faults
        of pairs, electrodes and clipping are named in frames, and their readings left out.
    public_key : file with the key that must have signed the calibration; None: not checked.

    Raises
    ------
    CalibrationError
        If the calibration is damaged, of another kind or not signed by that key, or a calibrated pair is missing.
    RecordingError
        If a table cannot be used.
    """
    issued = read_calibration_file(calibration, public_key)
    if not isinstance(issued, PressCalibration):
        raise CalibrationError(
            f"{calibration} was issued by a run; --pattern is for calibrations from labelled presses",
            remedy="apply it to recordings, without --pattern",
        )
    if pattern is None:
        read = read_pressed_frames(readings, pattern_of(calibration, issued), rest, reference)
    else:
        read = read_press_readings(readings, read_pairs(pattern, issued.electrodes), rest)
    estimate = PressedPlaces(issued, read.distinct, differences=differences)
    frames = estimate(read.changes, relative=read.rest is not None)
    return AppliedPlaces(calibration, readings, estimate.q68, estimate.q95, frames)


class PressedPlaces:
    """Turns readings into places, forces and depths.

    CalibrationError if a calibrated pair is missing.

    Parameters
    ----------
    issued : what was learned from presses.
    distinct : pairs of the readings.
    differences : whether readings are changes, in which faults cannot be found.
    """

    def __init__(self, issued: PressCalibration, distinct: DistinctPairs, *, differences: bool = False) -> None:
        self._issued, self._differences = issued, differences
        self._selection = match_readings(issued.pairs, distinct)
        self._modelled = None if issued.modelled is None else ModelledEstimator(issued.modelled, issued.registration)
        self._place = PlaceEstimator(issued.place, self._modelled, issued.pairs, issued.held_out_mm)
        self._faults: FaultFinder | None = None
        if issued.rest is not None and not differences:
            noise = np.zeros(len(issued.rest)) if issued.noise is None else issued.noise
            self._faults = FaultFinder(issued.pairs, issued.rest, noise)
        self._quantities = {
            f"{name}_{{}}{unit}": QuantityEstimator(learned)
            for name, unit in PRESS_QUANTITIES.items()
            if (learned := getattr(issued, name)) is not None
        }
        self.q68, self.q95 = float(self._place.q68), float(self._place.q95)

    def __call__(self, readings: Array, *, relative: bool) -> tuple[FramePlace, ...]:
        """Locate the press in each row of readings (n, k); ``relative`` to the unloaded sheet, or else whole frames.

        CalibrationError if frames are whole, and the calibration does not hold the unloaded one.
        """
        issued, changes = self._issued, self._changes(readings, relative=relative)
        whole, faults = changes, None
        if self._faults is not None:
            assert issued.rest is not None
            faults = self._faults(issued.rest + changes)
            whole = np.where(faults.left_out, np.nan, changes)
        places = self._place(changes, faults)
        by_model = None if self._modelled is None else self._modelled(whole)
        with np.errstate(over="ignore"):  # of frames without a touch, which have none
            quantities = {name: estimate(places) for name, estimate in self._quantities.items()}
        return tuple(_frame(places, by_model, quantities, number) for number in range(len(changes)))

    def _changes(self, readings: Array, *, relative: bool) -> Array:
        missing, selection = np.isnan(readings), self._selection
        matched: Array = np.where(missing @ (selection != 0), np.nan, np.where(missing, 0.0, readings) @ selection)
        if self._differences or relative:
            return matched
        if self._issued.rest is None:
            raise CalibrationError(
                "the calibration was made from changes and holds no unloaded frame",
                remedy="give --differences if the readings are changes, --rest FILE with frames of the unloaded"
                " sheet, or --reference N if the first N frames of a recording are",
            )
        return matched - self._issued.rest


def pattern_of(calibration: Path, issued: PressCalibration) -> DrivePattern:
    """Return the pattern of frames that a calibration was learned from; CalibrationError if it does not state it."""
    if not issued.drive:
        raise CalibrationError(
            f"{calibration} does not state the order of the pairs in a frame: it was issued before calibrations did",
            remedy="give the readings as a table, with --pattern, or calibrate again",
        )
    return DrivePattern(issued.electrodes, issued.drive, issued.measure)


def _frame(places: Places, by_model: Places | None, quantities: Mapping[str, Quantities], row: int) -> FramePlace:
    modelled = None
    if by_model is not None:
        share = 1 / (1 + ALLOWANCE * float(by_model.misfit[row]))
        modelled = ByTheModel(*_place(by_model, row), share, bool(by_model.in_model[row]))
    flags = int(places.flags[row])
    told: dict[str, Any] = {}
    for name, each in quantities.items():
        if np.isfinite(each.values[row]):
            told[name.format("")] = float(each.values[row])
            for level, within in (("68_", each.within_68), ("95_", each.within_95)):
                told[name.format(level)] = tuple(within[row].tolist())
            flags |= Flag.BELOW_RANGE * int(each.below[row]) | Flag.ABOVE_RANGE * int(each.above[row])
    return FramePlace(
        *_place(places, row),
        flags=tuple(str(flag.name).lower() for flag in Flag if flag & flags),
        in_model=bool(places.in_model[row]),
        modelled=modelled,
        **told,
    )


def _place(places: Places, number: int) -> tuple[float | None, float | None, _Covariance | None]:
    x, y = places.place_mm[number].tolist()
    if not np.isfinite([x, y]).all():
        return None, None, None
    (xx, xy), (yx, yy) = places.covariance_mm2[number].tolist()
    return x, y, ((xx, xy), (yx, yy))


def places_csv(applied: AppliedPlaces) -> str:
    """Return all places as a CSV table, a row a frame, each with ``q68`` and ``q95`` of the calibration."""
    bounds = {"q68": applied.q68, "q95": applied.q95}
    rows = [{"row": row, **dict(_cells(frame)), **bounds} for row, frame in enumerate(applied.frames, 1)]
    return csv_text([tuple(rows[0]), *(tuple(row.values()) for row in rows)])


def _cells(frame: FramePlace) -> Iterator[tuple[str, Any]]:
    """Yield columns of a frame and what they hold."""
    for name, value in asdict(frame).items():
        before, _, unit = name.rpartition("_")
        if name == "covariance_mm2":
            (xx, xy), (_, yy) = value or ((None, None), (None, None))
            yield from {"covariance_xx_mm2": xx, "covariance_xy_mm2": xy, "covariance_yy_mm2": yy}.items()
        elif before.endswith(("_68", "_95")):
            yield from zip((f"{before}_low_{unit}", f"{before}_high_{unit}"), value or (None, None), strict=True)
        elif name != "modelled":
            yield name, "; ".join(value) if name == "flags" else value


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
    for row in chosen:
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
    spread = "" if len(chosen) == count else f"{len(chosen)} of {count} frames, evenly spread; --output has all. "
    caption = f"{spread}Places with the longer half-axis of their 68 % region, force and depth with 68 % intervals."
    columns = ("row", "x [mm]", "y [mm]", "68 % [mm]", "force [N]", "depth [mm]", "flags")
    table = text_table(caption, columns, rows, (0, 1, 2, 3, 4, 5))
    return CommandOutcome(applied, outcome.page, (Section(applied.readings.name, (table,)),), outcome.exit_code)


def _with_interval(value: float | None, within: _Interval | None) -> str:
    return "–" if value is None or within is None else f"{number(value)} ({number(within[0])} to {number(within[1])})"
