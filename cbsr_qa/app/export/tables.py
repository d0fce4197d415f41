"""Runs and measurements as CSV or Parquet, page by page: memory does not grow with what is selected."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from importlib import import_module
from typing import Any, BinaryIO, Final, Protocol, TypeAlias

from cbsr_qa.app.export.formats import ExportFormat, ExportTable
from cbsr_qa.app.shift.lists import ListRequest, RunEntry, run_pages
from cbsr_qa.app.shift.report import table_cell
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.listed import ALTERED, ListedRun
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.files import csv_text

Rows: TypeAlias = list[tuple[Any, ...]]

#: Runs in memory at a time.
AT_ONCE: Final = 1000

#: Columns of a table and the types of their values, ``tuple`` for several texts. Any value but a key may be absent.
_RUN: Final[dict[str, type]] = {
    "run": str,
    "serial": str,
    "batch": str,
    "sensor_type": str,
    "station": str,
    "recipe": str,
    "operator": str,
    "started_at": datetime,
    "end": str,
    "station_s": float,
    "verdict": str,
    "outcome": str,
    "reason": str,
    "overridden_by": str,
    "overridden_why": str,
    "failed_limits": tuple,
    "failure_codes": tuple,
    "parts": tuple,
    "number": int,
    "of_check": bool,
    "simulated": bool,
    "chain": str,
}
#: Columns of a measurement that tell which run it is of.
_OF_RUN: Final = ("run", "serial", "batch", "station", "recipe", "started_at")
_MEASURED: Final[dict[str, type]] = {
    "analysis": str,
    "number": int,
    "name": str,
    "value": float,
    "unit": str,
    "uncertainty": float,
    "bound": str,
    "phase": str,
    "location": str,
    "trial": int,
    "qualifier": str,
    "load_index": int,
    "strain": float,
    "outcome": str,
    "lower_limit": float,
    "upper_limit": float,
    "marginal": float,
    "how": str,
}
_COLUMNS: Final = {
    ExportTable.RUNS: _RUN,
    ExportTable.MEASUREMENTS: {**{name: _RUN[name] for name in _OF_RUN}, **_MEASURED},
}


class TableWriter(Protocol):
    """Writes rows of a table."""

    def write(self, rows: Rows) -> None: ...


def rows_of(store: Repository, table: ExportTable, runs: Sequence[ListedRun]) -> tuple[Rows, tuple[str, ...]]:
    """Return the rows of some runs, and which of the runs were altered: their rows say so.

    Raise StoreError if a cell of one is damaged; the message names the run.
    """
    if table is ExportTable.RUNS:
        entries = map(RunEntry.from_run, runs)
        rows = [tuple(_as_cell(getattr(entry, name)) for name in _RUN) for entry in entries]
        return rows, tuple(run.run for run in runs if run.altered)
    of_run = {run.run: tuple(getattr(run, name) for name in _OF_RUN) for run in runs}
    measured = store.lists.read_measurements([*of_run])
    cells = zip(*(measured.columns[name] for name in _MEASURED), strict=True)
    rows = [(*of_run[run], *values) for run, values in zip(measured.runs, cells, strict=True)]
    # An altered run has this row in place of its measurements.
    marked = [
        (*of_run[run], *({"outcome": ALTERED, "how": problem}.get(name) for name in _MEASURED))
        for run, problem in measured.altered.items()
    ]
    return rows + marked, tuple(measured.altered)


def _as_cell(value: Any) -> Any:
    return tuple(map(str, value)) if isinstance(value, tuple) else value


def read_whole_table(store: Repository, request: ListRequest, table: ExportTable) -> tuple[Mapping[str, type], Rows]:
    """Return columns with their types, and all rows, of the selected runs. Raises as :func:`rows_of`."""
    rows: Rows = []
    for page in run_pages(store, request, AT_ONCE):
        rows += rows_of(store, table, page.runs)[0]
    return _COLUMNS[table], rows


@contextmanager
def table_writer(file: BinaryIO, kind: ExportFormat, table: ExportTable) -> Iterator[TableWriter]:
    """Write a table to an open file. Raise RefusedError if a library is missing."""
    columns = _COLUMNS[table]
    if kind is ExportFormat.CSV:
        yield _Csv(file, columns)
        return
    parquet = _Parquet(file, columns)
    try:
        yield parquet
    finally:
        parquet.close()


class _Csv:
    """RFC 4180 in UTF-8, text that a spreadsheet would work out escaped, see ``csv_text``."""

    def __init__(self, file: BinaryIO, columns: Iterable[str]) -> None:
        self._file = file
        self._lines([columns])

    def write(self, rows: Rows) -> None:
        self._lines(map(table_cell, row) for row in rows)

    def _lines(self, rows: Iterable[Iterable[str | float | None]]) -> None:
        self._file.write(csv_text(rows, line_end="\r\n").encode())


class _Parquet:
    """One row group a page; texts, times in UTC, and empty cells keep their types."""

    def __init__(self, file: BinaryIO, columns: dict[str, type]) -> None:
        try:
            arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
        except ImportError as error:
            raise RefusedError(
                "Parquet needs pyarrow, which is not installed",
                remedy="pip install 'cbsr-qa[parquet]', or export CSV",
            ) from error
        types = {
            str: arrow.string(),
            float: arrow.float64(),
            int: arrow.int64(),
            bool: arrow.bool_(),
            datetime: arrow.timestamp("us", tz="UTC"),
            tuple: arrow.list_(arrow.string()),
        }
        self._schema = arrow.schema([(name, types[kind]) for name, kind in columns.items()])
        self._table = arrow.table
        self._array = arrow.array
        self._writer = parquet.ParquetWriter(file, self._schema)

    def write(self, rows: Rows) -> None:
        if rows:
            columns = zip(*rows, strict=True)
            arrays = [self._array(c, field.type) for c, field in zip(columns, self._schema, strict=True)]
            self._writer.write_table(self._table(arrays, schema=self._schema))

    def close(self) -> None:
        self._writer.close()
