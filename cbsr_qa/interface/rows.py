"""Frames as rows of readings of any electrode pairs: tables and arrays, and the pattern that goes with them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cbsr_qa.analysis.recording.table_files import (
    PairFrames,
    TableForm,
    check_form,
    read_table_recording,
    record_pairs,
)
from cbsr_qa.calibration.presses.frame_tables import ComplexPart, FrameTable, check_same_unit, real_readings
from cbsr_qa.calibration.presses.tables import pair_problems, read_pairs
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Indices, array_of, real_numbers
from cbsr_qa.domain.readings.frames import FrameBlock, Recording
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.interface.frames import Frames

#: A table (path), or rows of readings (n, columns) or (columns,), real or complex.
Rows: TypeAlias = "Frames | str | Path"


@dataclass(frozen=True, slots=True, eq=False)
class RowOptions:
    """How rows of readings are to be taken; see :func:`cbsr_qa.analyse`.

    Parameters
    ----------
    pattern : table of pairs (path), or (columns, 4) source, sink, plus, minus.
    rest : rows of the unloaded sheet.
    """

    pattern: Rows
    differences: bool = False
    rest: "Rows | None" = None
    complex_part: str | None = None

    @property
    def part(self) -> ComplexPart | None:
        """Return the part of complex readings that a name stands for. RefusedError for an unknown name."""
        if self.complex_part is None:
            return None
        if self.complex_part not in list(ComplexPart):
            raise RefusedError(
                f"complex_part {self.complex_part!r} is not known", remedy=f"allowed: {', '.join(ComplexPart)}"
            )
        return ComplexPart(self.complex_part)


def rows_recording(
    rows: Rows, options: RowOptions, sensor_type: SensorType, *, time_s: ArrayLike | None = None
) -> tuple[Recording, SensorType]:
    """Return rows of readings as a recording, and the sensor type with their pattern.

    Raises
    ------
    CbsrError
        As of :func:`~cbsr_qa.analysis.recording.table_files.read_table_recording`, and alike for arrays.
    """
    files = [_is_path(rows), _is_path(options.pattern), options.rest is None or _is_path(options.rest)]
    if all(files):
        if time_s is not None:
            raise RefusedError("time_s for a table, which has a column of times if they are known")
        rest = None if options.rest is None else Path(cast("str | Path", options.rest))
        form = TableForm(Path(cast("str | Path", options.pattern)), options.differences, rest, options.part)
        return read_table_recording(Path(cast("str | Path", rows)), form, sensor_type)
    if files[0] or (options.rest is not None and files[2]):
        raise RefusedError("rows as a file with others in memory", remedy="give all as files, or all as arrays")
    check_form(options.part, differences=options.differences, rest=options.rest is not None)
    pairs = _pairs(options.pattern, sensor_type.electrodes.count)
    frames, rest_frames = _tables(rows, options, len(pairs), time_s)
    if not options.differences:
        check_same_unit(frames, rest_frames)
    return record_pairs(
        PairFrames(pairs, frames, rest_frames), sensor_type, options.part, differences=options.differences
    )


def _is_path(given: Any) -> bool:
    return isinstance(given, str | Path)


def _pairs(pattern: Rows, electrodes: int) -> Indices:
    if isinstance(pattern, str | Path):
        return read_pairs(Path(pattern), electrodes)
    pairs = real_numbers(cast(ArrayLike, pattern), "pairs of the pattern")
    if pairs.ndim != 2 or pairs.shape[1] != 4 or not len(pairs):
        raise RefusedError(
            f"a pattern of the shape {pairs.shape}", remedy="give (columns, 4): source, sink, plus, minus"
        )
    for problem in pair_problems(pairs, electrodes):
        raise RefusedError(f"pattern: {problem}", remedy="correct the pairs; row 1 is the first")
    return pairs.astype(np.int64)


def _tables(
    rows: Rows, options: RowOptions, count: int, time_s: ArrayLike | None
) -> tuple[FrameTable, FrameTable | None]:
    given = [_rows(rows, "frames", count, options.part)]
    if options.rest is not None:
        given.append(_rows(options.rest, "frames at rest", count, options.part))
    if options.part is not None:
        unloaded = given[-1].mean(axis=0)
        given = [real_readings(readings.astype(np.complex128), unloaded, options.part) for readings in given]
    times = None if time_s is None else real_numbers(time_s, "times")
    if times is not None and (times.shape != given[0].shape[:1] or (np.diff(times) <= 0).any()):
        raise RefusedError(
            f"{times.size} times for {len(given[0])} frames, or not rising", remedy="give one time for each frame"
        )
    names = tuple(map(str, range(1, count + 1)))
    tables = [
        FrameTable(Path(name), names, np.asarray(readings, dtype=np.float64))
        for name, readings in zip(("array", "rest"), given, strict=False)
    ]
    return FrameTable(tables[0].path, names, tables[0].readings, times), tables[1] if len(tables) > 1 else None


def _rows(values: Rows, what: str, count: int, part: ComplexPart | None) -> NDArray[Any]:
    if hasattr(values, "data_vars") or isinstance(values, FrameBlock):
        raise RefusedError(f"{what} are a dataset, which states its pattern", remedy="leave pattern out")
    array: Any = array_of(cast(ArrayLike, values), what)
    if array.dtype.kind == "c" and part is None:
        raise RefusedError(
            f"{what} are complex numbers", remedy=f"name the part: complex_part= {', '.join(ComplexPart)}"
        )
    array = array.astype(np.complex128) if array.dtype.kind == "c" else real_numbers(array, what)
    array = np.atleast_2d(array)
    if array.ndim != 2 or array.shape[1] != count or not len(array):
        raise RefusedError(
            f"{what} of the shape {array.shape}, the pattern has {count} pairs",
            remedy=f"give rows of {count} readings, in the order of the pairs",
        )
    odd = np.argwhere(~np.isfinite(array))
    if len(odd):
        row, column = odd[0].tolist()
        raise RefusedError(
            f"{what}: row {row + 1}, column {column + 1}: {array[row, column]}, not a finite number",
            remedy="leave that row out",
        )
    return np.asarray(array)
