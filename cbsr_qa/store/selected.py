"""Conditions that select runs, and reads that name the first run that cannot be read."""

from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, time
from typing import Final, TypeAlias, TypeVar

from sqlalchemy import ColumnElement, Connection, select
from sqlalchemy.exc import OperationalError

from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.store.chain.check import unreadable
from cbsr_qa.store.damage import FOREIGN_CELL
from cbsr_qa.store.golden import golden_runs
from cbsr_qa.store.tables.runs import PartRow, RunRow

Conditions: TypeAlias = list[ColumnElement[bool]]

_T = TypeVar("_T")
#: Errors of a cell whose value has another type than its column.
_UNREADABLE: Final = (*FOREIGN_CELL, OperationalError)
#: Columns that select runs by name, in the order of :func:`_names`.
_BY_NAME: Final = (RunRow.recipe, RunRow.batch, RunRow.station, RunRow.operator)


def read_naming_runs(connection: Connection, chosen: Conditions, read: Callable[[Connection, Conditions], _T]) -> _T:
    """Call ``read``; if it fails, raise an error that names the first unreadable run."""
    try:
        return read(connection, chosen)
    except _UNREADABLE as error:
        run = _first_unreadable(connection, chosen, read)
        if run is None:  # the database failed, not a run
            raise
        raise unreadable(connection, run, error) from error


def _names(selection: RunSelection) -> Iterator[Sequence[str]]:
    """Return the selected names by column of :data:`_BY_NAME`; empty for any."""
    yield () if selection.recipe is None else (selection.recipe,)
    yield () if selection.batch is None else (selection.batch,)
    yield selection.stations
    yield selection.operators


def _first_unreadable(
    connection: Connection, chosen: Conditions, read: Callable[[Connection, Conditions], object]
) -> str | None:
    """Find the first run that cannot be read, by bisection."""
    runs = list(connection.scalars(select(RunRow.run).where(*chosen).order_by(RunRow.run)))

    def fails(runs_tried: Sequence[str]) -> bool:
        try:
            read(connection, [*chosen, RunRow.run.between(runs_tried[0], runs_tried[-1])])
        except _UNREADABLE:
            return True
        return False

    while len(runs) > 1:
        first_half = runs[: len(runs) // 2]
        runs = first_half if fails(first_half) else runs[len(first_half) :]
    return runs[0] if runs and fails(runs) else None


def conditions(selection: RunSelection) -> Conditions:
    """Return a selection as conditions on rows of ``runs``."""
    chosen: Conditions = [RunRow.serial.in_(selection.serials)] if selection.serials else []
    chosen += [column.in_(names) for column, names in zip(_BY_NAME, _names(selection), strict=True) if names]
    for part in selection.parts:
        of_part = select(PartRow.run).where(PartRow.name == part.name, PartRow.identifier == part.identifier)
        chosen.append(RunRow.run.in_(of_part.where(PartRow.revision == part.revision) if part.revision else of_part))
    if selection.since is not None:
        chosen.append(RunRow.started_at >= datetime.combine(selection.since, time(), UTC))
    if selection.until is not None:
        chosen.append(RunRow.started_at <= datetime.combine(selection.until, time.max, UTC))
    chosen += [RunRow.started_at >= selection.from_moment] if selection.from_moment else []
    chosen += [RunRow.started_at < selection.before_moment] if selection.before_moment else []
    chosen += [RunRow.run > selection.after] if selection.after else []
    chosen += [RunRow.run <= selection.up_to] if selection.up_to else []
    if not selection.checks:
        chosen.append(RunRow.run.not_in(golden_runs()))  # left_out.py adds runs whose checks are not sound
    if selection.latest is not None:
        latest = select(RunRow.run).where(*chosen).order_by(RunRow.run.desc()).limit(selection.latest)
        chosen.append(RunRow.run.in_(latest))
    return chosen
