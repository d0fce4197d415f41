"""Labelled presses from tables of readings, places and pairs: combined and checked for consistency."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.distance import pdist
from scipy.special import fdtrc

from cbsr_qa.calibration.place.pairs import DistinctPairs
from cbsr_qa.calibration.presses.frame_tables import check_same_unit, read_frame_table
from cbsr_qa.calibration.presses.tables import PressTable
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.geometry.outlines import Disc, Polygon, SheetOutline
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_place import MOST_PRESSES
from cbsr_qa.domain.results.press_calibration import SheetRegistration
from cbsr_qa.domain.sensor.sensor_type import SensorType

#: Allowed distance of a press beyond the edge of the sheet, of its radius, and of places from each other, of the
#: farthest on the sheet: labels, scale and radius are inexact.
_BEYOND = 1.15
_MOST_NAMED = 5
#: Difference of readings between presses, relative to their size, below which they are equal.
_ALIKE = 1e-6
#: Presses were made in the order of their places if these explain more than half of the times' variance, which they
#: do by chance in one case of a thousand.
_UNORDERED, _BY_CHANCE = 0.5, 1e-3
#: Least change of a press's largest reading. Fourth powers of changes below about 1e-77 are no floats of full
#: precision; the rest is room for smaller readings of the press.
_SMALLEST = 1e-60
_WHAT_READINGS = "give the readings of the presses, several pairs of electrodes each"


@dataclass(frozen=True, slots=True, eq=False)
class PressReadings:
    """Readings of presses, repeats averaged.

    Parameters
    ----------
    path : path of their table.
    distinct : distinct pairs of the readings.
    changes : (n, m) changes by each press.
    rest : (m,) reference of frames; None if the table has changes.
    noise : (m,) standard deviation of one frame; None with fewer than two frames at rest.
    time_s : (n,) times of the presses [s]; None if the table has none.
    columns : (m,) names of the readings' first columns; empty if they are of a recording.
    """

    path: Path
    distinct: DistinctPairs
    changes: Array
    rest: Array | None = None
    noise: Array | None = None
    time_s: Array | None = None
    columns: tuple[str, ...] = ()

    def select(self, rows: Indices) -> "PressReadings":
        """Select presses, in the order of ``rows``."""
        return replace(self, changes=self.changes[rows], time_s=None if self.time_s is None else self.time_s[rows])


@dataclass(frozen=True, slots=True, eq=False)
class LabelledPresses:
    """Readings and labels of presses, in the same order.

    Parameters
    ----------
    radius_stated : True if the sensor type states the sheet's size; False to estimate it.
    row_shift : number of rows by which the places were shifted.
    """

    sensor_type: SensorType
    radius_stated: bool
    readings: PressReadings
    presses: PressTable
    row_shift: int = 0

    def select(self, rows: Indices) -> "LabelledPresses":
        """Select presses, in the order of ``rows``."""
        return replace(self, readings=self.readings.select(rows), presses=self.presses.select(rows))

    def follow_places(self) -> bool:
        """Whether presses were made in order of places, as on a raster, so that drift cannot be separated from place.

        Decided by the share of the times' variance explained by a quadratic function of place, and its F-test.
        """
        x, y = (self.presses.place_mm - self.presses.place_mm.mean(axis=0)).T
        time = np.arange(len(x)) if self.presses.time_s is None else self.presses.time_s
        design = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
        design /= np.maximum(np.abs(design).max(axis=0), np.finfo(float).tiny)
        residual = time - design @ np.linalg.lstsq(design, time, rcond=None)[0]
        degrees = len(x) - design.shape[1]
        unexplained = float(np.sum(residual**2) / np.sum((time - time.mean()) ** 2))
        if degrees < 1 or unexplained > _UNORDERED:
            return False
        ratio = (1 - unexplained) / max(unexplained, 1e-12) * degrees / (design.shape[1] - 1)
        return bool(fdtrc(design.shape[1] - 1, degrees, ratio) < _BY_CHANCE)

    def check(self) -> None:
        """Check that readings and labels match and may be from one sheet; RecordingError names file and rows."""
        check_rows(self.readings, self.presses)
        if self.radius_stated:
            check_near(self.presses, self.sensor_type.outline)


def read_press_readings(path: Path, pairs: Indices, rest: Path | None) -> PressReadings:
    """Read changes, or whole frames if a table of frames at rest is given.

    Parameters
    ----------
    pairs : (columns, 4) electrode pairs of the tables' columns, in their order.

    Raises
    ------
    RecordingError
        As of :func:`~cbsr_qa.calibration.presses.frame_tables.read_frame_table`, and
        :func:`~cbsr_qa.calibration.presses.frame_tables.check_same_unit`.
    """
    distinct = DistinctPairs.from_pairs(pairs)
    table = read_frame_table(path, len(pairs))
    readings = table.readings @ distinct.merging
    columns = distinct.name_readings(table.columns)
    if rest is None:
        return PressReadings(path, distinct, readings, time_s=table.time_s, columns=columns)
    rest_table = read_frame_table(rest, len(pairs))
    check_same_unit(table, rest_table)
    frames = rest_table.readings @ distinct.merging
    mean = frames.mean(axis=0)
    noise = frames.std(axis=0, ddof=1) if len(frames) > 1 else None
    return PressReadings(path, distinct, readings - mean, mean, noise, table.time_s, columns)


def shift_rows(labelled: LabelledPresses, shift: int) -> LabelledPresses:
    """Return presses whose places stand so many rows below their readings; rows without a partner are left out.

    RecordingError if the tables differ in their numbers of rows, or none is left.
    """
    check_rows(labelled.readings, labelled.presses)
    count = len(labelled.presses.place_mm)
    if abs(shift) >= count:
        raise RecordingError(
            f"{labelled.presses.table.path} has {count} rows; a shift by {shift} rows leaves none",
            remedy="give a shift by a few rows",
        )
    rows = np.arange(max(0, -shift), count - max(0, shift))
    readings, presses = labelled.readings.select(rows), labelled.presses.select(rows + shift)
    return replace(labelled, readings=readings, presses=presses, row_shift=shift)


def check_rows(readings: PressReadings, presses: PressTable) -> None:
    """Check that readings and labels belong to the same presses; RecordingError names file and rows."""
    table, changes = presses.table, readings.changes
    if len(changes) != len(presses.place_mm):
        raise RecordingError(
            f"{readings.path} has {len(changes)} rows, {table.path} has {len(presses.place_mm)}; both must have one"
            " row per press",
            remedy="leave out rows of presses that are not in both tables",
        )
    if len(changes) > MOST_PRESSES:
        raise RecordingError(
            f"{readings.path} has {len(changes)} rows; at most {MOST_PRESSES} presses are learned from",
            remedy="leave out rows evenly over the sheet, in both tables",
        )
    changing_mask = np.any(changes != 0, axis=1)
    if not changing_mask.any():
        raise RecordingError(f"{readings.path}: no reading changes in any row", remedy=_WHAT_READINGS)
    _refuse_tiny(readings)
    directions = changes[changing_mask] / np.linalg.norm(changes[changing_mask], axis=1, keepdims=True)
    if np.ptp(directions, axis=0).max() < _ALIKE:
        raise RecordingError(
            f"{readings.path}: all rows are proportional to each other, wherever the press was"
            if len(directions) > 1
            else f"{readings.path}: only one row with changes",
            remedy=_WHAT_READINGS,
        )
    for first_row, second_row in _find_repeated(changes):
        if changing_mask[second_row]:
            place_remark = (
                "" if np.array_equal(*presses.place_mm[[first_row, second_row]]) else ", though the places differ"
            )
            raise RecordingError(
                f"{readings.path} row {second_row + 1} repeats row {first_row + 1} in every column{place_remark}:"
                " the press appears twice",
                remedy="leave out one of the two, in both tables",
            )
    if presses.time_s is not None:
        labels = np.column_stack([presses.place_mm, presses.time_s])
        for first_row, second_row in _find_repeated(labels):
            raise RecordingError(
                f"{table.path} row {second_row + 1}, columns x_mm, y_mm and time_s: the same as row"
                f" {first_row + 1}; the press appears twice",
                remedy="leave out one of the two, in both tables",
            )


def _refuse_tiny(readings: PressReadings) -> None:
    """Refuse readings whose powers are below the smallest floats; RecordingError names them."""
    largest = np.abs(readings.changes).max(axis=1)
    tiny = np.flatnonzero((largest > 0) & (largest < _SMALLEST))
    if tiny.size:
        raise RecordingError(
            f"{readings.path}: the largest change in row {tiny[0] + 1} is {largest[tiny[0]]:.3g}, and {tiny.size} of"
            f" {len(largest)} rows change by so little; at least {_SMALLEST:g} is allowed, or no change",
            remedy="give the readings in a smaller unit",
        )


def find_outline(sensor_type: SensorType, registration: SheetRegistration) -> SheetOutline:
    """Return the outline of a registered sheet, in its axes; of a disc the radius may be estimated."""
    return Disc(registration.radius_mm) if sensor_type.polygon is None else sensor_type.polygon


def check_near(presses: PressTable, outline: SheetOutline) -> None:
    """Check that presses may lie within a sheet in any pose; RecordingError names file, rows and places."""
    distance_mm = np.linalg.norm(presses.place_mm - np.median(presses.place_mm, axis=0), axis=1)
    farthest_mm = 2 * outline.radius_mm
    if isinstance(outline, Polygon):
        farthest_mm = float(pdist(np.array(outline.corners_mm)).max())
    _refuse_outside(presses, distance_mm > _BEYOND * farthest_mm, outline)


def check_inside(presses: PressTable, registration: SheetRegistration, outline: SheetOutline) -> None:
    """Check that presses lie on the registered sheet; RecordingError names file, rows and places."""
    clearance_mm = outline.clearance_mm(registration.on_sheet_mm(presses.place_mm))
    _refuse_outside(presses, clearance_mm < (1 - _BEYOND) * outline.radius_mm, outline)


def _refuse_outside(presses: PressTable, outside: Mask, outline: SheetOutline) -> None:
    rows = np.flatnonzero(outside)
    if not rows.size:
        return
    row_list = "; ".join(
        f"row {row + 1}, columns x_mm and y_mm: ({x:zg}, {y:zg}) mm"
        for row, (x, y) in zip(rows[:_MOST_NAMED], presses.place_mm[rows[:_MOST_NAMED]], strict=True)
    )
    raise RecordingError(
        f"{presses.table.path}: {rows.size} of {len(outside)} presses are outside the sheet, which {outline.words()}:"
        f" {row_list}",
        remedy="correct the places, or the size in the sensor type",
    )


def _find_repeated(rows: Array) -> Iterator[tuple[int, int]]:
    """Yield rows that are equal to an earlier one, as (earlier, later)."""
    row_by_bytes: dict[bytes, int] = {}
    for number, row in enumerate(np.ascontiguousarray(rows + 0.0)):
        first = row_by_bytes.setdefault(row.tobytes(), number)
        if first != number:
            yield first, number
