"""Conditions that select runs, and reads that name the first run that cannot be read."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, time
from functools import partial
from typing import Final, TypeAlias, TypeVar

from sqlalchemy import ColumnElement, Connection, Engine, select
from sqlalchemy.exc import OperationalError

from cbsr_qa.domain.results import RunSelection
from cbsr_qa.store.chain import check_run, unreadable
from cbsr_qa.store.engine import reading
from cbsr_qa.store.tables import RunRow, StationCheckRow

Conditions: TypeAlias = list[ColumnElement[bool]]

_T = TypeVar("_T")
#: Raised by a cell whose value has another type than its column.
_UNREADABLE: Final = (AttributeError, KeyError, TypeError, ValueError, OperationalError)
#: Columns that select runs by name, as :func:`_names` gives them.
_BY_NAME: Final = (RunRow.recipe, RunRow.batch, RunRow.station, RunRow.operator)


def read_selected(engine: Engine, selection: RunSelection, read: Callable[[Connection, Conditions], _T]) -> _T:
    """Read the selected runs; if that fails, name the first run that cannot be read."""
    with reading(engine) as connection:
        chosen = conditions(selection)
        if chosen and selection.latest is None:  # the latest are selected through each run's end: by indices alone
            naming_runs(connection, [], partial(_check_left_out, selection))
        return naming_runs(connection, chosen, read)


def naming_runs(connection: Connection, chosen: Conditions, read: Callable[[Connection, Conditions], _T]) -> _T:
    """Read; if that fails, name the first run that cannot be read."""
    try:
        return read(connection, chosen)
    except _UNREADABLE as error:
        run = _first_unreadable(connection, chosen, read)
        if run is None:  # the database failed, not a run
            raise
        raise unreadable(connection, run, error) from error


def _check_left_out(selection: RunSelection, connection: Connection, chosen: Conditions) -> None:
    """Raise for a run that only a damaged cell excludes from a selection: a name, or when it began.

    A name is checked only if no other run shares it, as damage leaves it: checking every run takes 0.3 ms each.
    """
    columns = RunRow.run, RunRow.serial, RunRow.started_at, *_BY_NAME
    runs = connection.execute(select(*columns).where(*chosen)).all()
    for column, wanted in zip(_BY_NAME, _names(selection), strict=True):
        counts = Counter(getattr(run, column.key) for run in runs) if wanted else Counter[str]()
        unique = {name for name, count in counts.items() if count == 1}.difference(wanted)
        for run in runs:
            if getattr(run, column.key) in unique:
                check_run(connection, run.run, ("runs",))


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

    def fails(some: Sequence[str]) -> bool:
        try:
            read(connection, [*chosen, RunRow.run.between(some[0], some[-1])])
        except _UNREADABLE:
            return True
        return False

    while len(runs) > 1:
        half = runs[: len(runs) // 2]
        runs = half if fails(half) else runs[len(half) :]
    return runs[0] if runs and fails(runs) else None


def conditions(selection: RunSelection) -> Conditions:
    """Return what a selection means for rows of ``runs``."""
    chosen: Conditions = [RunRow.serial.in_(selection.serials)] if selection.serials else []
    chosen += [column.in_(names) for column, names in zip(_BY_NAME, _names(selection), strict=True) if names]
    if selection.since is not None:
        chosen.append(RunRow.started_at >= datetime.combine(selection.since, time(), UTC))
    if selection.until is not None:
        chosen.append(RunRow.started_at <= datetime.combine(selection.until, time.max, UTC))
    chosen += [RunRow.started_at >= selection.from_moment] if selection.from_moment else []
    chosen += [RunRow.started_at < selection.before_moment] if selection.before_moment else []
    chosen += [RunRow.run > selection.after] if selection.after else []
    chosen += [RunRow.run <= selection.up_to] if selection.up_to else []
    if not selection.checks:
        of_checks = select(StationCheckRow.golden_run).where(StationCheckRow.golden_run.is_not(None))
        chosen.append(RunRow.run.not_in(of_checks))
    if selection.latest is not None:
        latest = select(RunRow.run).where(*chosen).order_by(RunRow.run.desc()).limit(selection.latest)
        chosen.append(RunRow.run.in_(latest))
    return chosen
