"""Tables of numbers with a header: CSV, or Parquet; read in a limited child process, refused by file, row and column.

Rows are counted from 1 below the header; the first row of a CSV file is its line 2.
"""

import cmath
import csv
import io
import math
import os
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.system.foreign import UnfitFileError, open_foreign
from cbsr_qa.system.untrusted import largest_content, read_untrusted

#: Largest size of a file: more than that of a table of a hundred thousand presses.
_MAX_FILE_BYTES: Final = 2**29
#: Largest number of columns: the readings in a frame of a sensor of 256 electrodes.
_MAX_COLUMNS: Final = 2**16
#: Largest length of a line: so many columns, and their commas.
_MAX_LINE_LENGTH: Final = 32 * _MAX_COLUMNS
#: Largest number of any column.
_MAX_NUMBER: Final = 1e12
_CORRECT: Final = "correct the table and try again; row 1 is the first below the header"
_TOO_MUCH: Final = "give a table with a row per press and a column per reading"
_REAL: Final = "write real numbers; cbsr-qa analyse reads complex ones with --complex-part"
#: Number of problems of a table that are listed.
_MAX_LISTED_CELLS: Final = 10
_MAX_CELL_LENGTH: Final = 40
#: Rows of a Parquet file that are decoded at once.
_AT_ONCE: Final = 1024
#: Module that reads Parquet.
_PARQUET: Final = "pyarrow.parquet"
#: Row and column of a cell, both from 0.
_Cell = tuple[int, int]
#: Names of columns, numbers, the cells that are none, and imaginary parts if there are any.
_Content = tuple[tuple[str, ...], Array, dict[_Cell, str], Array | None]


@dataclass(frozen=True, slots=True, eq=False)
class NumberTable:
    """A table of numbers.

    Parameters
    ----------
    path : path of the file.
    columns : names of the columns.
    values : (rows, columns) numbers; NaN where a cell is not a finite number.
    odd_cells : content of those cells, as a message shows it: the first ten of each column.
    imaginary : (rows, columns) imaginary parts; None if no cell is a complex number.
    """

    path: Path
    columns: tuple[str, ...]
    values: Array
    odd_cells: Mapping[_Cell, str] = field(default_factory=dict)
    imaginary: Array | None = None

    def numbers(self, names: Sequence[str] | None = None) -> Array:
        """Return some columns, (rows, columns); by default all. RecordingError names cells that are not real numbers.

        A cell like 1.2+0.3j is complex, also with an imaginary part of 0.
        """
        chosen_columns = range(len(self.columns)) if names is None else [self.columns.index(name) for name in names]
        imaginary = np.zeros(0) if self.imaginary is None else self.imaginary[:, chosen_columns]
        complex_cells = np.argwhere(~np.isnan(imaginary)) if imaginary.size else imaginary
        if len(complex_cells):
            row, k = complex_cells[0].tolist()
            cell = f"{self.values[row, chosen_columns[k]]:g}{imaginary[row, k]:+g}j"
            others = f"; and {len(complex_cells) - 1} more" if len(complex_cells) > 1 else ""
            self.refuse(
                [f"row {row + 1}, column {self.columns[chosen_columns[k]]}: {cell}, a complex number{others}"], _REAL
            )
        return self._check_numbers(chosen_columns, self.values[:, chosen_columns])

    def complex_numbers(self, names: Sequence[str]) -> NDArray[np.complex128]:
        """Return some columns, (rows, columns), complex; RecordingError names cells that are not numbers."""
        chosen_columns = [self.columns.index(name) for name in names]
        values = self._check_numbers(chosen_columns, self.values[:, chosen_columns])
        if self.imaginary is None:
            return values.astype(np.complex128)
        return values + 1j * self._check_numbers(chosen_columns, np.nan_to_num(self.imaginary[:, chosen_columns]))

    def _check_numbers(self, chosen_columns: Sequence[int], values: Array) -> Array:
        unusable = np.argwhere(~(np.abs(values) <= _MAX_NUMBER))
        described = []
        for row, k in unusable[:_MAX_LISTED_CELLS].tolist():
            value, column = values[row, k], chosen_columns[k]
            why = (
                f"{value:g}; at most {_MAX_NUMBER:g} is allowed"
                if np.isfinite(value)
                else self.odd_cells[row, column]
            )
            described.append(f"row {row + 1}, column {self.columns[column]}: {why}")
        self.refuse(described, more=len(unusable) - len(described))
        return values

    def refuse(self, problems: Sequence[str], remedy: str = _CORRECT, *, more: int = 0) -> None:
        """Raise RecordingError with the problems of the table, if any, and how many more there are."""
        _refuse(self.path, problems, remedy, more)


def _refuse(path: Path, problems: Sequence[str], remedy: str, more: int = 0) -> None:
    if problems:
        more += max(len(problems) - _MAX_LISTED_CELLS, 0)
        other_problems = f"; and {more} more" if more else ""
        raise RecordingError(f"{path}: {'; '.join(problems[:_MAX_LISTED_CELLS])}{other_problems}", remedy=remedy)


def read_table(path: Path) -> NumberTable:
    """Read a table with a header: Parquet by its suffix, else CSV in UTF-8.

    RecordingError if the file is missing, is not a file, takes more than the limits of
    ``read_untrusted``, has no header, no rows, rows of different lengths, a column twice, or more
    columns than any sensor has readings.
    """
    read = partial(_content, path)
    if _is_parquet(path):
        _parquet_reader(path)
        content = read_untrusted(path, read, refusal=RecordingError, modules=(_PARQUET,))
    else:
        content = read_untrusted(path, read, refusal=RecordingError)
    return NumberTable(path, *content)


def _is_parquet(path: Path) -> bool:
    return path.suffix.lower() in (".parquet", ".pq")


def _content(path: Path) -> _Content:
    try:
        with open_foreign(path, _MAX_FILE_BYTES) as file:
            return _parquet(path, file, _parquet_reader(path)) if _is_parquet(path) else _csv(path, file)
    except UnfitFileError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}", remedy=_TOO_MUCH) from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}", remedy="check its name") from error


def _csv(path: Path, file: BinaryIO) -> _Content:
    try:
        text = io.TextIOWrapper(file, encoding="utf-8-sig", newline="")
        lines = [[cell.strip() for cell in line] for line in csv.reader(_read_short_lines(path, text))]
    except (UnicodeDecodeError, csv.Error) as error:
        remedy = "save the table as CSV in UTF-8"
        raise RecordingError(f"{path} is not CSV in UTF-8: {error}", remedy=remedy) from error
    while lines and not any(lines[-1]):
        del lines[-1]
    lines = [line for line in lines if line not in ([], [""])]
    if not lines:
        raise RecordingError(f"{path} is empty")
    if not any(line[-1] for line in lines):  # a comma at the end of every line
        lines = [line[:-1] for line in lines]
    header, *rows = lines
    _check_header(path, header)
    _check_columns(path, header, len(rows))
    uneven = [
        f"row {number}: {len(row)} cells, the header has {len(header)}"
        + (" (is a comma a decimal point there?)" if len(row) > len(header) else "")
        for number, row in enumerate(rows, 1)
        if len(row) != len(header)
    ]
    _refuse(path, uneven, _CORRECT)
    numbers = _Numbers(len(header))
    for row in rows:
        numbers.add(row)
    return numbers.content(header)


def _read_short_lines(path: Path, text: io.TextIOWrapper) -> Iterator[str]:
    while line := text.readline(_MAX_LINE_LENGTH):
        if len(line) == _MAX_LINE_LENGTH:
            raise RecordingError(
                f"{path} has a line of {_MAX_LINE_LENGTH} characters or more; a table has at most"
                f" {_MAX_COLUMNS} columns",
                remedy=_TOO_MUCH,
            )
        yield line


def _check_header(path: Path, header: Sequence[str]) -> None:
    for name, sign in (("semicolons", ";"), ("tabs", "\t")):
        if sum(cell.count(sign) for cell in header) >= len(header):
            raise RecordingError(
                f"{path} line 1: separated by {name}", remedy="separate by commas, decimals by points"
            )
    if _is_row(header):
        raise RecordingError(
            f"{path} line 1 holds numbers where the header is expected: {', '.join(header[:4])}",
            remedy="name the columns in the first line",
        )


def _is_row(header: Sequence[str]) -> bool:
    """Whether a first line has numbers other than a numbering of columns."""
    try:
        numbers = [float(cell) for cell in header]
    except ValueError:
        return False
    return not any(numbers == [float(k) for k in range(first, first + len(numbers))] for first in (0, 1))


def _parquet_reader(path: Path) -> Any:
    """Import pyarrow; RecordingError if it is not installed."""
    try:
        return import_module(_PARQUET)
    except ImportError as error:
        raise RecordingError(
            f"{path} is Parquet, which needs pyarrow", remedy="pip install 'cbsr-qa[parquet]', or write CSV"
        ) from error


def _parquet(path: Path, file: BinaryIO, parquet: Any) -> _Content:
    size_bytes = os.fstat(file.fileno()).st_size
    try:
        table = parquet.ParquetFile(file, pre_buffer=False)
        metadata, columns = table.metadata, table.schema_arrow.names
        _check_columns(path, columns, metadata.num_rows)
        if metadata.num_rows * len(columns) * 8 > largest_content(size_bytes):
            raise RecordingError(
                f"{path} of {metadata.num_rows} rows and {len(columns)} columns is too large for a file of"
                f" {size_bytes} bytes: numbers that were measured are packed less",
                remedy=_TOO_MUCH,
            )
        numbers = _Numbers(len(columns))
        for batch in table.iter_batches(batch_size=_AT_ONCE, use_threads=False):  # a child starts no threads
            for row in zip(*(column.to_pylist() for column in batch.columns), strict=True):
                numbers.add(row)
    except (OSError, ValueError, NotImplementedError) as error:  # ArrowInvalid is a ValueError
        raise RecordingError(f"{path} cannot be read as Parquet: {error}") from error
    return numbers.content(columns)


def _check_columns(path: Path, columns: Sequence[str], rows: int) -> None:
    if len(columns) > _MAX_COLUMNS:
        raise RecordingError(
            f"{path} has {len(columns)} columns; a table has at most {_MAX_COLUMNS}", remedy=_TOO_MUCH
        )
    twice = sorted(name for name, times in Counter(columns).items() if times > 1)[:_MAX_LISTED_CELLS]
    if twice:
        raise RecordingError(
            f"{path}: the header names {', '.join(map(repr, twice))} more than once", remedy=_CORRECT
        )
    if not rows:
        raise RecordingError(f"{path}: only a header, not one row", remedy=_CORRECT)


class _Numbers:
    """Numbers of a table, added row by row."""

    def __init__(self, columns: int) -> None:
        self._values = array("d")
        self._imaginary: array[float] | None = None
        self._odd_cells: dict[_Cell, str] = {}
        self._shown = [0] * columns  #: number of odd cells of each column
        self._rows = 0

    def add(self, cells: Sequence[object]) -> None:
        values = [_number(cell) for cell in cells]
        if any(map(math.isnan, values)):
            values = self._add_odd(cells, values)
        elif self._imaginary is not None:
            self._imaginary.extend([math.nan] * len(values))
        self._values.extend(values)
        self._rows += 1

    def _add_odd(self, cells: Sequence[object], values: list[float]) -> list[float]:
        """Take cells that are not real numbers; return the real parts of the row."""
        numbers = [_complex(cell) if math.isnan(value) else value for cell, value in zip(cells, values, strict=True)]
        imaginary = [number.imag if isinstance(number, complex) else math.nan for number in numbers]
        if self._imaginary is None and not all(map(math.isnan, imaginary)):
            self._imaginary = array("d", [math.nan] * len(self._values))
        if self._imaginary is not None:
            self._imaginary.extend(imaginary)
        for column, number in enumerate(numbers):
            if not cmath.isnan(number) or self._shown[column] >= _MAX_LISTED_CELLS:
                continue
            self._shown[column] += 1
            cell = cells[column]
            description = "empty" if cell in ("", None) else f"{str(cell)[:_MAX_CELL_LENGTH]!r}, not a finite number"
            self._odd_cells[self._rows, column] = description
        return [number.real for number in numbers]

    def content(self, columns: Sequence[str]) -> _Content:
        shape = self._rows, len(columns)
        values = np.frombuffer(self._values, dtype=np.float64).reshape(shape)
        imaginary = self._imaginary
        parts = None if imaginary is None else np.frombuffer(imaginary, dtype=np.float64).reshape(shape)
        return tuple(columns), values, self._odd_cells, parts


def _number(cell: object) -> float:
    """Return a finite number; NaN otherwise."""
    try:
        value = math.nan if "_" in str(cell) else float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return value if math.isfinite(value) else math.nan


def _complex(cell: object) -> complex | float:
    """Return a finite complex number, written with i or j; NaN otherwise."""
    text = str(cell).replace(" ", "").lower().replace("i)", "j)")
    if "_" in text or not text.strip("()").endswith(("i", "j")):
        return math.nan
    try:
        value = complex(f"{text[:-1]}j" if text.endswith("i") else text)
    except ValueError:
        return math.nan
    return value if cmath.isfinite(value) else math.nan
