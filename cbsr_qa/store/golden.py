"""Runs of golden sensors that checked a station: lists leave them out if the check is sound.

A row in ``station_checks`` must not hide a failed run. So its station and its time must fit those of the run, and
its rows must match its seal, which is signed if the run is signed. Checks whose seal was removed count for one recipe
only.
"""

from collections.abc import Collection, Sequence
from datetime import timedelta
from typing import Any, Final

from sqlalchemy import Connection, Row, Select, select, type_coerce
from sqlalchemy.types import NullType

from cbsr_qa.store.chain.links import key_id_of
from cbsr_qa.store.seals import check_seals, key_of_seal
from cbsr_qa.store.tables.records import StationCheckRow
from cbsr_qa.store.tables.runs import RunRow
from cbsr_qa.store.types import time_of_id

#: Recipe of a golden sensor's run, in checks that have no seal.
GOLDEN_RECIPE: Final = "golden-check"
#: Longest time from the beginning of a golden sensor's run to its check.
_MAX_CHECK_DURATION: Final = timedelta(days=1)


def golden_runs() -> Select[Any]:
    """Return the query of all runs that checks name as those of their golden sensors, sound or not."""
    golden_run = StationCheckRow.golden_run
    return select(type_coerce(golden_run, NullType())).where(golden_run.is_not(None))


def find_golden_runs(connection: Connection, runs: Collection[str]) -> set[str]:
    """Return those of some runs that a sound check names as the run of its golden sensor."""
    if not runs:
        return set()
    checks = _read_checks(connection, runs)
    doubted = _problems(connection, checks)
    return {row.golden_run for row in checks if row.check_id not in doubted}


def find_doubtful_checks(connection: Connection) -> dict[str, str]:
    """Return the problems of the checks that name a golden run and are not sound, by check."""
    return _problems(connection, _read_checks(connection))


def _read_checks(connection: Connection, runs: Collection[str] | None = None) -> list[Row[Any]]:
    """Return the checks that name some runs (None: any run), with the columns of the run to compare."""
    c, r = StationCheckRow, RunRow
    columns = c.check_id, c.golden_run, c.station, c.seal, r.station.label("tested_at"), r.recipe, r.chain
    plain: list[Any] = [type_coerce(column, NullType()).label(column.key) for column in columns]
    query: Any = select(*plain)
    query = query.outerjoin(r, r.run == c.golden_run).where(c.golden_run.is_not(None)).order_by(c.check_id)
    return [row for row in connection.execute(query) if runs is None or row.golden_run in runs]


def _problems(connection: Connection, named: Sequence[Row[Any]]) -> dict[str, str]:
    problem_by_check = {row.check_id: problem for row in named if (problem := _describe_mismatch(row))}
    seals = {row.check_id: row.seal for row in named if row.check_id not in problem_by_check}
    return problem_by_check | {
        check: problem for check, (_, problem) in check_seals(connection, seals).items() if problem
    }


def _describe_mismatch(row: Row[Any]) -> str:
    """Return in words how a check does not fit the run that it names; empty if it fits."""
    made_at, begun_at = time_of_id(str(row.check_id)), time_of_id(str(row.golden_run))
    beginning = f"station check {row.check_id} names run {row.golden_run} as its golden sensor's, and"
    if row.station != row.tested_at:
        return f"{beginning} it is of station {str(row.station)[:64]!r}, the run of {str(row.tested_at)[:64]!r}"
    if made_at is not None and begun_at is not None and not begun_at <= made_at <= begun_at + _MAX_CHECK_DURATION:
        return f"{beginning} was made at {made_at:%Y-%m-%d %H:%M} UTC, the run at {begun_at:%Y-%m-%d %H:%M}"
    if row.seal is None and row.recipe != GOLDEN_RECIPE:
        return f"{beginning} has no seal, and the run is not one of recipe {GOLDEN_RECIPE}"
    if row.seal is not None and (key := key_id_of(str(row.chain or ""))) and key != key_of_seal(row.seal):
        return f"{beginning} is not signed with the key of the run, {key}"
    return ""
