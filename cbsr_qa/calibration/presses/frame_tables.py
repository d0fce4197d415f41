"""Tables of frames: a row per frame, a column per pair of a pattern, and a column of times if there is one."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.presses.number_tables import NumberTable, read_table
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.numbers import Array

TIME_COLUMN: Final = "time_s"
_TIMES: Final = frozenset({"time", "times", "timestamp", "t"})
#: Ratio of sizes from which they are in different units: prefixes are 1000 apart, loads change frames by far less.
_OTHER_UNIT: Final = 30.0
#: Rows from which one of them is odd against the others.
_FEWEST_ROWS: Final = 3


class ComplexPart(StrEnum):
    """What of complex readings is used."""

    REAL = "real"
    MAGNITUDE = "magnitude"
    #: Component along the phase of the unloaded reading, with the polarity that the reading has.
    IN_PHASE = "in-phase"


@dataclass(frozen=True, slots=True, eq=False)
class FrameTable:
    """Frames of a table.

    Parameters
    ----------
    path : path of the file.
    columns : (m,) names of the readings' columns.
    readings : (n, m) readings, in the table's own unit.
    time_s : (n,) times, rising; None without such a column.
    """

    path: Path
    columns: tuple[str, ...]
    readings: Array
    time_s: Array | None = None


def read_frame_table(path: Path, pairs: int) -> FrameTable:
    """Read frames of real readings.

    Parameters
    ----------
    pairs : number of pairs of the pattern: the number of columns besides the times.

    Raises
    ------
    RecordingError
        As for :func:`~cbsr_qa.calibration.presses.number_tables.read_table`; if a cell is not a finite real number,
        the columns are not as many as the pairs, or times do not rise or have no unit.
    """
    table = read_table(path)
    columns, time_s = _split_columns(table, pairs)
    return FrameTable(path, columns, table.numbers(columns), time_s)


def read_complex_tables(path: Path, rest: Path | None, pairs: int, part: ComplexPart) -> tuple[FrameTable, ...]:
    """Read frames of complex readings, and those at rest if there are any, as real numbers.

    Errors as of :func:`read_frame_table`, and if all numbers are real.

    Parameters
    ----------
    rest : frames of the unloaded sheet, whose mean has the phases; without them it is the mean of all frames.
    """
    tables = [read_table(file) for file in (path, rest) if file is not None]
    if all(table.imaginary is None for table in tables):
        tables[0].refuse(["no complex number in it"], f"leave --complex-part {part} out")
    split = [_split_columns(table, pairs) for table in tables]
    values = [table.complex_numbers(columns) for table, (columns, _) in zip(tables, split, strict=True)]
    unloaded = values[-1].mean(axis=0)
    return tuple(
        FrameTable(table.path, columns, real_readings(readings, unloaded, part), time_s)
        for table, (columns, time_s), readings in zip(tables, split, values, strict=True)
    )


def real_readings(readings: NDArray[np.complex128], unloaded: NDArray[np.complex128], part: ComplexPart) -> Array:
    """Return one part (n, m) of complex readings.

    Parameters
    ----------
    unloaded : (m,) readings of the unloaded sheet. In phase is the component along their phases. The phase that all
        have in common, ½ arg Σ z², divides them into the two polarities.
    """
    if part is ComplexPart.REAL:
        return np.asarray(readings.real, dtype=np.float64)
    if part is ComplexPart.MAGNITUDE:
        return np.asarray(np.abs(readings), dtype=np.float64)
    common_phase = np.exp(0.5j * np.angle(np.sum(unloaded**2)))
    directions = np.exp(1j * np.angle(unloaded))
    directions *= np.where((directions * common_phase.conj()).real < 0, -1.0, 1.0)
    return np.asarray((readings * directions.conj()).real, dtype=np.float64)


def check_same_unit(frames: FrameTable, rest: FrameTable | None = None) -> None:
    """Check that whole frames have one unit, and that of the frames at rest; RecordingError names rows or columns."""
    problems = [
        f"row {row + 1}: its readings are {ratio:.4g} times as large as those of the other rows"
        for row, ratio in find_odd_sizes(frames.readings)
    ]
    if rest is not None and not problems:
        _refuse(rest.path, list(_cell_problems(rest)), "correct the cell, or leave the row out")
        check_same_unit(rest)
        level, rest_level = (np.median(np.abs(table.readings), axis=0) for table in (frames, rest))
        problems = list(_level_problems(frames.columns, level, rest_level, rest.path))
    _refuse(frames.path, problems, "give all readings in one unit")


def find_odd_sizes(frames: Array) -> Iterator[tuple[int, float]]:
    """Yield frames (n, m) in another unit than most: their index, and how many times as large they are."""
    sizes = np.linalg.norm(frames, axis=1)
    usual = float(np.median(sizes))
    ratios = sizes / usual if usual > 0 else np.ones(len(sizes))
    for row in np.flatnonzero((ratios >= _OTHER_UNIT) | (ratios <= 1 / _OTHER_UNIT)).tolist():
        yield row, float(ratios[row])


def find_other_unit(size: float, other: float) -> float | None:
    """Return how many times as large a size is as another if units differ, else None."""
    if not (size > 0 and other > 0):
        return None
    ratio = size / other
    return ratio if not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT else None


def _level_problems(columns: tuple[str, ...], level: Array, rest_level: Array, rest: Path) -> Iterator[str]:
    """Compare the levels (m,) of columns with those at rest, of all and then of each against all."""
    usual, rest_usual = float(np.median(level)), float(np.median(rest_level))
    if ratio := find_other_unit(usual, rest_usual):
        yield f"its readings are {ratio:.4g} times as large as those of {rest}"
        return
    noticeable = rest_level > rest_usual / _OTHER_UNIT
    for k in np.flatnonzero(noticeable).tolist():
        if ratio := find_other_unit(float(level[k]), float(rest_level[k])):
            yield f"column {columns[k]}: its readings are {ratio:.4g} times as large as those of {rest}"


def _cell_problems(rest: FrameTable) -> Iterator[str]:
    """Name readings at rest that alone of their row are in a larger unit; of two rows none is known to be."""
    sizes = np.abs(rest.readings)
    level = np.median(sizes, axis=0)
    if len(sizes) < _FEWEST_ROWS:
        return
    noticeable = level > float(np.median(level)) / _OTHER_UNIT
    odd = (sizes >= _OTHER_UNIT * level) & noticeable
    odd[odd.sum(axis=1) > 1] = False
    for row, column in np.argwhere(odd).tolist():
        ratio = sizes[row, column] / level[column]
        yield f"row {row + 1}, column {rest.columns[column]}: {ratio:.4g} times as large as in the other rows"


def _split_columns(table: NumberTable, pairs: int) -> tuple[tuple[str, ...], Array | None]:
    """Return the names of the readings' columns, and the times."""
    lower_names = [name.lower() for name in table.columns]
    named_times = [
        name
        for name, lower in zip(table.columns, lower_names, strict=True)
        if lower.partition("_")[0].partition("[")[0].strip() in _TIMES
    ]
    columns = tuple(name for name in table.columns if name not in named_times)
    if len(columns) != pairs or len(named_times) > 1:
        besides = f" besides {', '.join(named_times)}" if named_times else ""
        hint = f"; the first is {columns[0]!r}, the last {columns[-1]!r}" if len(columns) > pairs else ""
        raise RecordingError(
            f"{table.path} has {len(columns)} columns{besides}, the pattern has {pairs} rows{hint}",
            remedy="give one row of the pattern for each column of the readings, in the same order; a column of times"
            f" is {TIME_COLUMN}",
        )
    if not named_times:
        return columns, None
    (name,) = named_times
    if name != TIME_COLUMN:
        table.refuse([f"column {name!r}: {TIME_COLUMN} is allowed, times in seconds"], "give times in seconds")
    time_s = table.numbers([name])[:, 0]
    table.refuse(
        [
            f"row {row + 2}, column {name}: {time_s[row + 1]:g} after {time_s[row]:g}; times rise from row to row"
            for row in np.flatnonzero(np.diff(time_s) <= 0).tolist()
        ],
        "put the rows in the order of their times, or leave the column out",
    )
    return columns, time_s


def _refuse(path: Path, problems: list[str], remedy: str) -> None:
    if problems:
        NumberTable(path, (), np.empty((0, 0))).refuse(problems, remedy)
