"""Runs with an unreadable cell are set apart, so that the other runs of a list are read."""

from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from typing import Any, Final, TypeVar

from sqlalchemy import JSON, Connection, Integer, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.chain.check import unreadable
from cbsr_qa.store.chain.run_documents import list_covered
from cbsr_qa.store.damage import FOREIGN_CELL, cell_reader, raw_cell
from cbsr_qa.store.tables.runs import Base, RunRow
from cbsr_qa.store.types import Instant, time_of_id

_T = TypeVar("_T")
_NEVER: Final = datetime.fromtimestamp(0, UTC)
#: Longest text that stands for a cell of another type.
_MAX_TEXT_LENGTH: Final = 64


def read_apart(
    connection: Connection,
    runs: Sequence[str],
    read: Callable[[Sequence[str]], _T],
    instead: Callable[[str, str], _T],
) -> Iterator[_T]:
    """Read a batch of runs; if that fails, halve it until each unreadable run is alone.

    Parameters
    ----------
    read : function that reads a batch of runs.
    instead : function that returns the stand-in for an unreadable run, from its name and its problem.

    Yields
    ------
    What was read of some of the runs, in their order.
    """
    if not runs:
        return
    try:
        content = read(runs)
    except (*FOREIGN_CELL, StoreError) as error:
        if len(runs) == 1:
            yield instead(runs[0], problem_of(connection, runs[0], error))
            return
        middle = len(runs) // 2
        for half in (runs[:middle], runs[middle:]):
            yield from read_apart(connection, half, read, instead)
    else:
        yield content


def problem_of(connection: Connection, run: str, error: Exception) -> str:
    """Return in words why a run cannot be read: the cell that its column cannot hold, or the error."""
    store_error = error if isinstance(error, StoreError) else unreadable(connection, run, error)
    return store_error.reason if run in store_error.reason else f"run {run}: {store_error.reason}"


def readable_values(connection: Connection, run: str) -> dict[str, Any]:
    """Return the row of a run as far as it can be shown; a value of the right type replaces each odd cell."""
    table = Base.metadata.tables[RunRow.__tablename__]
    columns = list_covered(table)
    query = select(*(raw_cell(connection, column) for column in columns)).where(RunRow.run == run)
    cells = connection.execute(query).one()
    return {column.name: _value(connection, column, run, cell) for column, cell in zip(columns, cells, strict=True)}


def _value(connection: Connection, column: Any, run: str, cell: Any) -> Any:
    try:
        return cell_reader(connection, column)(cell)
    except FOREIGN_CELL:
        if isinstance(column.type, Instant):
            return time_of_id(run) or _NEVER
        if isinstance(column.type, JSON):
            return []
        if isinstance(getattr(column.type, "impl", column.type), Integer):
            return None
        return str(cell)[:_MAX_TEXT_LENGTH]
