"""Runs that a selection misses although they may belong to it: altered ones, and those hidden as golden runs.

A selection reads columns of runs that anybody who can write the database can change. So the rows of the runs that it
leaves out are compared with their links too: one that does not match is listed whatever the selection says.
"""

from collections.abc import Collection
from dataclasses import replace
from datetime import UTC, datetime, time, timedelta
from functools import partial
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, select, type_coerce
from sqlalchemy.types import NullType

from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.store.chain.many_runs import RUNS_AT_ONCE, find_altered, read_rows
from cbsr_qa.store.golden import find_golden_runs, golden_runs
from cbsr_qa.store.selected import Conditions, conditions
from cbsr_qa.store.tables.runs import PartRow, RunRow
from cbsr_qa.store.types import first_id
from cbsr_qa.store.unreadable_runs import read_apart

#: Longest time by which an identifier may be older than the start of its run. It may be younger by any time:
#: identifiers go on from the latest one where a clock was set back.
_MAX_IDENTIFIER_LEAD: Final = timedelta(hours=1)
_ANY: Final = RunSelection()


def with_left_out(
    connection: Connection, selection: RunSelection, selected: Collection[str], latest: int | None = None
) -> list[str]:
    """Return the selected runs and those that the selection must not leave out, in the order of their names.

    Parameters
    ----------
    selected : runs that the columns select.
    latest : number of the latest runs to look at; None for all.
    """
    bounds = _limit_names(selection, selected)
    hidden = _find_hidden(connection, selection, bounds)
    # A selection by the names of runs alone depends on no column that could have been altered.
    by_name_only = replace(selection, checks=True, after="", up_to="", latest=None) == _ANY
    altered = {} if by_name_only else find_altered_outside(connection, bounds, {*selected, *hidden}, latest)
    return sorted({*selected, *hidden, *altered})


def find_altered_outside(
    connection: Connection, within: Conditions, known: Collection[str], latest: int | None = None
) -> dict[str, str]:
    """Return the problems of the rows of ``runs`` and ``run_parts`` that do not match their links, by run.

    Parameters
    ----------
    within : conditions on the runs to look at.
    known : runs to skip.
    latest : number of the latest runs to look at; None for all.
    """
    name: Any = type_coerce(RunRow.run, NullType())
    query = select(name).where(*within).order_by(RunRow.run.desc()).limit(latest)
    runs = sorted(set(connection.scalars(query)).difference(known))
    problem_by_run: dict[str, str] = {}
    for start in range(0, len(runs), RUNS_AT_ONCE):
        batch = runs[start : start + RUNS_AT_ONCE]
        for altered in read_apart(connection, batch, partial(_find_altered, connection), lambda run, why: {run: why}):
            problem_by_run |= altered
    return problem_by_run


def _find_altered(connection: Connection, runs: Collection[str]) -> dict[str, str]:
    rows, parts = (read_rows(connection, table, sorted(runs)) for table in (RunRow, PartRow))
    return find_altered(connection, dict(zip(rows.runs, rows.columns["chain"], strict=True)), [rows, parts])


def _limit_names(selection: RunSelection, selected: Collection[str]) -> Conditions:
    """Return the conditions on names of runs that may belong to a selection."""
    bounds: list[ColumnElement[bool]] = []
    if selection.after:
        bounds.append(RunRow.run > selection.after)
    if selection.up_to:
        bounds.append(RunRow.run <= selection.up_to)
    if selection.latest is not None and len(selected) >= selection.latest:
        bounds.append(RunRow.run > min(selected))
    earliest_starts = [] if selection.since is None else [datetime.combine(selection.since, time(), UTC)]
    if selection.from_moment is not None:
        earliest_starts.append(selection.from_moment)
    if earliest_starts:
        bounds.append(RunRow.run >= first_id(max(earliest_starts) - _MAX_IDENTIFIER_LEAD))
    return bounds


def _find_hidden(connection: Connection, selection: RunSelection, within: Conditions) -> set[str]:
    """Return the runs left out as runs of golden sensors although every check that names them is doubtful."""
    if selection.checks:
        return set()
    conditions_with_checks = conditions(replace(selection, checks=True, latest=None))
    named_runs = set(
        connection.scalars(select(RunRow.run).where(*conditions_with_checks, *within, RunRow.run.in_(golden_runs())))
    )
    return named_runs - find_golden_runs(connection, named_runs)
