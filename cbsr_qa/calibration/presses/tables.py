"""Tables of presses and electrode pairs, refused by file, row and column."""

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.pairs import measures_at_driven
from cbsr_qa.calibration.presses.number_tables import NumberTable, read_table
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.results.press_calibration import SourceFile
from cbsr_qa.system.foreign import open_foreign

_PAIR_COLUMNS: Final = ("source", "sink", "plus", "minus")
_PLACE: Final = ("x_mm", "y_mm")
_OPTIONAL: Final = ("depth_mm", "force_N", "time_s")
#: Columns of a table of presses.
LABELS: Final = (*_PLACE, *_OPTIONAL)
_QUANTITIES: Final = {name.rpartition("_")[0]: name for name in LABELS}
#: Largest share of a pattern's pairs, and of its drives, that measure at driven electrodes by mistake: if more do,
#: that is its kind. A single drive is few, unless there is no other. The same share of pairs stands twice by mistake.
_FEW_AT_DRIVEN: Final = 0.1
#: Most electrodes of a pattern.
_MOST_ELECTRODES: Final = 256


@dataclass(frozen=True, slots=True, eq=False)
class PressTable:
    """Labels of presses.

    Parameters
    ----------
    table : table as it was read.
    place_mm : (n, 2) places of the presses.
    depth_mm, force_N, time_s : (n,) numbers of the columns; None without such a column.
    """

    table: NumberTable
    place_mm: Array
    depth_mm: Array | None
    force_N: Array | None
    time_s: Array | None

    def select(self, rows: Indices) -> "PressTable":
        """Select labels, in the order of ``rows``."""
        depth_mm, force_N, time_s = (
            None if column is None else column[rows] for column in (self.depth_mm, self.force_N, self.time_s)
        )
        return PressTable(self.table, self.place_mm[rows], depth_mm, force_N, time_s)


def read_presses(path: Path) -> PressTable:
    """Read labels of presses: ``x_mm``, ``y_mm``, and if known ``depth_mm``, ``force_N`` and ``time_s``.

    Raises
    ------
    RecordingError
        As for :func:`read_table`; if a column lacks its unit, is unknown or missing, or a cell is not a finite
        number; if all depths, all forces or all times are equal, or a force is not positive.
    """
    table = read_table(path)
    table.refuse(
        list(_header_problems(table.columns)), remedy="name columns with their units: x_mm, y_mm, force_N, …"
    )
    optional_names = [name for name in _OPTIONAL if name in table.columns]
    values = table.numbers([*_PLACE, *optional_names])
    by_name = dict(zip(optional_names, values[:, 2:].T, strict=True))
    for name in _OPTIONAL:
        column = by_name.get(name)
        if column is not None and len(column) > 1 and np.ptp(column) == 0:
            table.refuse(
                [
                    f"column {name}: all {len(column)} rows hold {column[0]:g}, a constant column carries no"
                    " information"
                ],
                remedy=f"leave column {name} out; the place is learned without it",
            )
    force_N = by_name.get("force_N")
    if force_N is not None:
        table.refuse(
            [
                f"row {row + 1}, column force_N: {force_N[row]:g}; a force is positive"
                for row in np.flatnonzero(force_N <= 0)
            ],
            remedy="leave out those presses in both tables, or column force_N; the place is learned without it",
        )
    time_s = by_name.get("time_s")
    return PressTable(table, values[:, :2], by_name.get("depth_mm"), force_N, time_s)


def read_pairs(path: Path, electrodes: int | None) -> Indices:
    """Read electrode pairs (m, 4): ``source``, ``sink``, ``plus``, ``minus``, electrodes from 0.

    Parameters
    ----------
    electrodes : number of electrodes of the sensor; None if unknown.

    Raises
    ------
    RecordingError
        As for :func:`read_table`; if a column is missing, a cell is not an electrode of the sensor or paired with
        itself; or if a few pairs stand twice, or measure at an electrode that they drive, and all others do not.
    """
    table = read_table(path)
    missing_columns = [name for name in _PAIR_COLUMNS if name not in table.columns]
    if missing_columns:
        table.refuse(
            [f"the header is {', '.join(table.columns[:8])}; missing: {', '.join(missing_columns)}"],
            remedy=f"the columns of a pattern are {','.join(_PAIR_COLUMNS)}, electrodes from 0",
        )
    values = table.numbers(_PAIR_COLUMNS)
    count = _MOST_ELECTRODES if electrodes is None else electrodes
    table.refuse(list(pair_problems(values, count)))
    return values.astype(np.int64)


def source_file(role: str, path: Path) -> SourceFile:
    """Return name and SHA-256 of a file that was read. RecordingError if it is no longer there."""
    try:
        with open_foreign(path) as file:
            return SourceFile(role, path.name, hashlib.file_digest(file, "sha256").hexdigest())
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error


def _header_problems(columns: Sequence[str]) -> Iterator[str]:
    known_names = []
    for name in columns:
        quantity, *units = re.findall(r"[^\W_]+", name.lower()) or [""]
        allowed_name = _QUANTITIES.get(quantity) if len(units) <= 1 else None
        known_names.append(allowed_name)
        if allowed_name is None or name == allowed_name:
            continue
        if not units:
            problem = "has no unit"
        elif f"{quantity}_{units[0]}" == allowed_name.lower():
            problem = "is spelled differently"
        else:
            problem = "is in a unit that is not known"
        yield f"column {name!r} {problem}: {allowed_name} is allowed"
    yield from (
        f"column {name} is missing; the header is {', '.join(columns[:8])}"
        for name in _PLACE
        if name not in known_names
    )


def pair_problems(values: Array, electrodes: int) -> Iterator[str]:
    """Yield what is wrong with numbers (m, 4) as pairs of so many electrodes; rows count from 1."""
    if values.min() == 1 and values.max() == electrodes:
        yield f"electrodes are numbered from 1 to {electrodes}; they are counted from 0"
        return
    used = np.unique(values)
    beyond = (values >= electrodes).any(axis=1)
    if beyond.mean() > _FEW_AT_DRIVEN and used.size > electrodes and electrodes < _MOST_ELECTRODES:
        yield f"it has {used.size} electrodes, up to {used[-1]:g}; the sensor type has {electrodes}, counted from 0"
        return
    for row, numbers in enumerate(values.tolist(), 1):
        for name, number in zip(_PAIR_COLUMNS, numbers, strict=True):
            if not (number.is_integer() and 0 <= number < electrodes):
                yield f"row {row}, column {name}: {number:g}; electrodes are whole numbers from 0 to {electrodes - 1}"
        source, sink, plus, minus = numbers
        if source == sink:
            yield f"row {row}, column sink: current from electrode {source:g} to itself"
        if plus == minus:
            yield f"row {row}, column minus: voltage between electrode {plus:g} and itself"
    yield from _list_repeat_problems(values)
    yield from _list_driven_problems(values)


def _list_repeat_problems(values: Array) -> Iterator[str]:
    first_rows: dict[tuple[float, ...], int] = {}
    repeated = [
        (row, first)
        for row, pair in enumerate(map(tuple, values.tolist()), 1)
        if (first := first_rows.setdefault(pair, row)) != row
    ]
    if len(repeated) <= max(_FEW_AT_DRIVEN * len(values), 1):
        for row, first in repeated:
            yield f"row {row} repeats row {first}: {','.join(f'{number:g}' for number in values[row - 1])}"


def _list_driven_problems(values: Array) -> Iterator[str]:
    at_driven = np.flatnonzero(measures_at_driven(values.astype(np.int64)))
    drives, odd_drives = (len(np.unique(rows[:, :2], axis=0)) for rows in (values, values[at_driven]))
    is_few = len(at_driven) <= _FEW_AT_DRIVEN * len(values)
    if is_few and odd_drives <= max(_FEW_AT_DRIVEN * drives, 1) and odd_drives < drives:
        for row in at_driven.tolist():
            yield (
                f"row {row + 1}: {','.join(f'{number:g}' for number in values[row])} measures at an electrode that it"
                f" drives, which {len(values) - len(at_driven)} of the {len(values)} pairs do not"
            )
