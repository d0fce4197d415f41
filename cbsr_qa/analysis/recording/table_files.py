"""Tables of frames in any pattern as recordings: a row per frame, a column per electrode pair."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.pairs import DistinctPairs, measures_at_driven
from cbsr_qa.calibration.presses.frame_tables import (
    ComplexPart,
    FrameTable,
    check_same_unit,
    read_complex_tables,
    read_frame_table,
)
from cbsr_qa.calibration.presses.odd_labels import list_unused_electrodes
from cbsr_qa.calibration.presses.odd_units import OTHERS_LET_EXPECT, describe_other_unit, find_odd_readings
from cbsr_qa.calibration.presses.tables import read_pairs
from cbsr_qa.domain.errors import RecordingError, RefusedError, RowProblem
from cbsr_qa.domain.numbers import Indices
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, Recording, ScanKind, VoltageUnit
from cbsr_qa.domain.sensor.patterns import DrivePattern, Pairs
from cbsr_qa.domain.sensor.sensor_type import SensorType

#: Most pairs of drive and measure pairs in a frame, whose sensitivities are held: those of 90 electrodes, adjacent.
_MOST_CELLS: Final = 2**13
#: The same where all measure across what they drive, and only those of the table are held: 32 electrodes of an
#: ohmmeter.
_MOST_DIAGONAL: Final = 2**18
#: The same of all frames: half a gigabyte.
_MOST_NUMBERS: Final = 2**26


@dataclass(frozen=True, slots=True)
class TableForm:
    """How a table of frames is to be read; see the options of ``cbsr-qa analyse``.

    Parameters
    ----------
    pattern : table of the columns' electrode pairs.
    differences : whether the readings are changes from the unloaded sheet.
    rest : frames of the unloaded sheet.
    complex_part : what of complex readings is used; None for real ones.
    """

    pattern: Path
    differences: bool = False
    rest: Path | None = None
    complex_part: ComplexPart | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PairFrames:
    """Frames of electrode pairs in any order.

    Parameters
    ----------
    pairs : (columns, 4) source, sink, plus, minus of each column.
    frames, rest : frames, and those of the unloaded sheet or None.
    """

    pairs: Indices
    frames: FrameTable
    rest: FrameTable | None = None


def read_table_recording(path: Path, form: TableForm, sensor_type: SensorType) -> tuple[Recording, SensorType]:
    """Read a table of frames; the sensor type gets the pattern of the table.

    Raises
    ------
    RefusedError
        If options contradict each other.
    RecordingError
        As of :func:`~cbsr_qa.calibration.presses.tables.read_pairs`,
        :func:`~cbsr_qa.calibration.presses.frame_tables.read_frame_table` and
        :func:`~cbsr_qa.calibration.presses.frame_tables.check_same_unit`; or if the frames are too large.
    """
    check_form(form.complex_part, differences=form.differences, rest=form.rest is not None)
    pairs = read_pairs(form.pattern, sensor_type.electrodes.count)
    if form.complex_part is not None:
        tables = read_complex_tables(path, form.rest, len(pairs), form.complex_part)
    else:
        tables = tuple(read_frame_table(file, len(pairs)) for file in (path, form.rest) if file is not None)
    frames, rest = tables[0], tables[1] if form.rest is not None else None
    if not form.differences:
        check_same_unit(frames, rest)
    return record_pairs(PairFrames(pairs, frames, rest), sensor_type, form.complex_part, differences=form.differences)


def check_form(part: ComplexPart | None, *, differences: bool, rest: bool) -> None:
    """Refuse options that contradict each other: RefusedError."""
    if differences and rest:
        raise RefusedError(
            "both differences and frames at rest are given",
            remedy="give --rest FILE (rest=…) for whole frames, or --differences (differences=True) for changes",
        )
    if differences and part not in (None, ComplexPart.REAL):
        raise RefusedError(
            f"differences have no {_MISSING_PART[part]}: the readings of the unloaded sheet are not in them",
            remedy="give whole frames, or take the real part",
        )


def record_pairs(
    table: PairFrames, sensor_type: SensorType, part: ComplexPart | None = None, *, differences: bool = False
) -> tuple[Recording, SensorType]:
    """Return frames of pairs as a recording, and the sensor type with their pattern.

    A frame has a row for each drive and a column for each measure pair; what the table does not hold is missing.
    Columns that repeat a pair are averaged. A row of changes with a single reading in another unit is taken out: it
    becomes one without a load.

    Parameters
    ----------
    part : part that was taken of complex readings; magnitudes have no sign.

    Raises
    ------
    RecordingError
        If there are too many readings.
    """
    distinct = DistinctPairs.from_pairs(table.pairs)
    drives, measures = _name_pairs(distinct.pairs)
    path, count = table.frames.path, len(table.frames.readings)
    cells_per_frame = len(drives) * len(measures)
    most_cells = _MOST_DIAGONAL if measures_at_driven(distinct.pairs).all() else _MOST_CELLS
    if cells_per_frame > most_cells:
        raise RecordingError(
            f"{path}: {len(drives)} drive pairs × {len(measures)} measure pairs are {cells_per_frame} combinations;"
            f" at most {most_cells} are imaged, however many of them are in the table",
            remedy="leave out the columns of some drive or measure pairs",
        )
    if count * cells_per_frame > _MOST_NUMBERS:
        raise RecordingError(
            f"{path}: {count} rows of {len(drives)} drive pairs × {len(measures)} measure pairs; at most"
            f" {_MOST_NUMBERS // cells_per_frame} rows are imaged at a time",
            remedy="give fewer rows at a time",
        )
    cells = np.array([(drives.index((a, b)), measures.index((c, d))) for a, b, c, d in distinct.pairs.tolist()])

    table, problems = _take_out_odd_rows(table, differences=differences)

    def block(rows: FrameTable) -> FrameBlock:
        voltages = np.zeros((len(rows.readings), len(drives), len(measures)))
        voltages[:, *cells.T] = rows.readings @ distinct.merging
        flags = np.full(voltages.shape, ReadingFlag.MISSING.value, dtype=np.uint8)
        flags[:, *cells.T] = 0
        times = np.arange(len(voltages), dtype=np.float64) if rows.time_s is None else rows.time_s
        return FrameBlock(times, voltages, flags, VoltageUnit.TABLE, None)

    has_times = table.frames.time_s is not None
    recording = Recording(
        path=path,
        format="table",
        dataset="",
        scan=ScanKind.FULL,
        frames=block(table.frames),
        reference=None if table.rest is None else block(table.rest),
        still=not has_times and (differences or table.rest is not None),
        magnitudes_only=part is ComplexPart.MAGNITUDE,
        problems=problems,
        clock="given" if has_times else "none",
        notes=tuple(_notes(table, distinct, sensor_type, part, differences=differences)),
        rows=True,
        differences=differences,
    )
    return recording, replace(sensor_type, pattern=DrivePattern(sensor_type.electrodes.count, drives, measures))


def _take_out_odd_rows(table: PairFrames, *, differences: bool) -> tuple[PairFrames, tuple[RowProblem, ...]]:
    """Replace rows of changes with a single reading in another unit by that of the unloaded sheet, and name them."""
    if not differences and table.rest is None:
        return table, ()  # readings that jump for a frame are found in time
    unloaded = np.zeros(len(table.pairs)) if table.rest is None else table.rest.readings.mean(axis=0)
    readings, problems = table.frames.readings.copy(), []
    for row, column, ratio in find_odd_readings(readings - unloaded):
        place = f"row {row + 1}, column {table.frames.columns[column]}"
        words = f"{place}: {describe_other_unit(ratio, OTHERS_LET_EXPECT)}; the row is left out"
        problems.append(RowProblem(row + 2, words, rejected=True))
        readings[row] = unloaded
    return replace(table, frames=replace(table.frames, readings=readings)), tuple(problems)


def _name_pairs(pairs: Indices) -> tuple[Pairs, Pairs]:
    """Return the drive and the measure pairs, in the same order if they are the same."""
    drives: Pairs = tuple(dict.fromkeys((a, b) for a, b, _, _ in pairs.tolist()))
    measures: Pairs = tuple(dict.fromkeys((c, d) for _, _, c, d in pairs.tolist()))
    return drives, drives if set(drives) == set(measures) else measures


def _notes(
    table: PairFrames,
    distinct: DistinctPairs,
    sensor_type: SensorType,
    part: ComplexPart | None,
    *,
    differences: bool,
) -> list[str]:
    notes = [] if table.rest is None else [f"changes are against the mean of {table.rest.path.name}"]
    if differences:
        notes.append("the readings are changes of unknown scale: places and signs count, the size of images does not")
    if part is not None:
        notes.append(f"complex readings: {_PART_WORDS[part]}")
    repeated = int((distinct.repeats > 1).sum())
    if repeated:
        notes.append(f"{repeated} of {len(distinct.pairs)} pairs stand in several columns, which are averaged")
    at_driven = int(measures_at_driven(distinct.pairs).sum())
    if at_driven > 0.9 * len(distinct.pairs):
        notes.append(
            f"{at_driven} of {len(distinct.pairs)} pairs measure at an electrode that they drive: the contacts are in"
            " the readings, and places are less exact"
        )
    return [*notes, *list_unused_electrodes(distinct.pairs, sensor_type.electrodes.count)]


#: Parts that differences do not have, in words.
_MISSING_PART: Final = {ComplexPart.MAGNITUDE: "magnitude", ComplexPart.IN_PHASE: "in-phase part"}
_PART_WORDS: Final = {
    ComplexPart.REAL: "their real parts",
    ComplexPart.MAGNITUDE: "their magnitudes",
    ComplexPart.IN_PHASE: "the parts in phase with the readings of the unloaded sheet",
}
