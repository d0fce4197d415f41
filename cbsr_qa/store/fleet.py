"""Runs of a fleet with the values of their latest analyses, in a fixed number of queries."""

from collections.abc import Sequence
from datetime import UTC, date, datetime, time
from difflib import get_close_matches
from typing import Any, Final

import numpy as np
from sqlalchemy import ColumnElement, Connection, Engine, Row, Select, or_, select

from cbsr_qa.domain import RefusedError, StoreError
from cbsr_qa.domain.results import Bound, EndReason, FleetRun, FleetTable, Kind, MetricKey, Outcome, State
from cbsr_qa.store.chain import (
    AT_ONCE,
    BETWEEN,
    JOINED,
    RUN_COLUMNS,
    Figures,
    Known,
    check_figures,
    facts,
    figures_query,
    words,
)
from cbsr_qa.store.engine import reading, stored
from cbsr_qa.store.results import analysis_outcome
from cbsr_qa.store.tables import AnalysisRow, LoadRow, MeasurementRow, RunRow, RunStateRow, StationCheckRow
from cbsr_qa.store.types import made_at

_BAD: Final = {str(Outcome.FAIL): State.FAILED, str(Outcome.NOT_MEASURED): State.UNMEASURED}
#: State of a value by its outcome and what it says of its quantity.
_STATES: Final = {
    (str(outcome), str(bound)): int(
        _BAD.get(outcome, State.PLAIN) | (State.LOWER_BOUND if bound is Bound.LOWER else State.PLAIN)
    )
    for outcome in Outcome
    for bound in Bound
}


def metric_names(engine: Engine) -> tuple[str, ...]:
    """Return all measurement names in the database, sorted."""
    with reading(engine) as connection:
        names = connection.scalars(select(MeasurementRow.name).distinct().order_by(MeasurementRow.name))
        return tuple(names)


def fleet_table(
    engine: Engine,
    *,
    recipe: str | None = None,
    since: date | None = None,
    until: date | None = None,
    names: Sequence[str] = (),
) -> FleetTable:
    """Return runs with the values of their latest analyses.

    Parameters
    ----------
    recipe : only its runs.
    since, until : first and last day a run began on, UTC.
    names : only values of these metrics, and those outside their limits; none for all.

    Raises
    ------
    RefusedError
        If no run is of the recipe (with the nearest name).
    StoreError
        If the database cannot be read, holds an outcome or a bound that is none, or something that is read of a
        chained run is not what was stored.
    """
    chosen = _chosen(recipe, since, until)
    with reading(engine) as connection:
        runs, places, known = _runs(connection, chosen)
        if recipe is not None and not runs:
            _check_recipe(connection, recipe)
        kinds, columns = _values(connection, chosen, names, places, known)
        run, kind, value, state = columns
        return FleetTable(tuple(runs), kinds, run, kind, value, state, _places(connection, runs))


def _chosen(recipe: str | None, since: date | None, until: date | None) -> list[ColumnElement[bool]]:
    wanted: list[ColumnElement[bool]] = []
    if recipe is not None:
        wanted.append(RunRow.recipe == recipe)
    if since is not None:
        wanted.append(RunRow.started_at >= _midnight(since))
    if until is not None:
        wanted.append(RunRow.started_at <= datetime.combine(until, time.max, UTC))
    return wanted


def _check_recipe(connection: Connection, recipe: str) -> None:
    known = list(connection.scalars(select(RunRow.recipe).distinct().order_by(RunRow.recipe)))
    if known and recipe not in known:
        near = get_close_matches(recipe, known, n=1)
        raise RefusedError(
            f"no stored run uses recipe {recipe[:64]!r}",
            remedy=(f"did you mean {near[0]!r}? " if near else "") + f"recipes: {', '.join(known)}",
        )


def _midnight(day: date) -> datetime:
    return datetime.combine(day, time(), UTC)


def _runs(
    connection: Connection, chosen: list[ColumnElement[bool]]
) -> tuple[list[FleetRun], dict[str, int], list[Known | None]]:
    """Runs in order, the place of each latest analysis, and the rows read of chained runs.

    States and analyses are put to their runs here: a database that has no statistics of its tables yet may join them
    by counting every analysis again for every run.
    """
    ends = _latest_of(connection, select(RunStateRow.run, RunStateRow.end).order_by(RunStateRow.number), chosen)
    a = AnalysisRow
    analysed = select(a.run, a.analysis, a.outcome, a.software).order_by(a.analysis)
    analyses = _latest_of(connection, analysed, chosen)
    of_checks = set(connection.scalars(select(StationCheckRow.golden_run)))
    query = select(*RUN_COLUMNS, RunRow.chain).where(*chosen).order_by(RunRow.run)
    runs: list[FleetRun] = []
    places: dict[str, int] = {}
    known: list[Known | None] = []
    shared: dict[Any, Any] = {}  # tens of thousands of runs name the same few versions
    for row in connection.execute(query.execution_options(yield_per=AT_ONCE)):
        analysis, linked = analyses.get(row.run), None
        if analysis is not None:
            name = analysis.analysis
            linked = (row.run, name, facts(row, name, analysis.outcome, analysis.software))
            places[name] = len(runs)
        known.append(linked if row.chain is not None else None)
        runs.append(_run(row, ends.get(row.run), analysis, shared, of_check=row.run in of_checks))
    return runs, places, known


def _latest_of(
    connection: Connection, query: Select[*tuple[Any, ...]], chosen: list[ColumnElement[bool]]
) -> dict[str, Row[*tuple[Any, ...]]]:
    """The last row of each run, of rows in their order."""
    if chosen:
        query = query.where(query.selected_columns.run.in_(select(RunRow.run).where(*chosen)))
    return {row.run: row for row in connection.execute(query.execution_options(yield_per=AT_ONCE))}


def _run(
    row: Row[*tuple[Any, ...]],
    end: Row[*tuple[Any, ...]] | None,
    analysis: Row[*tuple[Any, ...]] | None,
    shared: dict[Any, Any],
    *,
    of_check: bool,
) -> FleetRun:
    software = () if analysis is None else tuple((name, version) for name, version in analysis.software)
    ended = None if end is None else stored(EndReason, end.end, "run_states.end", f"run {row.run}")
    simulated = tuple(row.simulated)
    return FleetRun(
        run=row.run,
        serial=row.serial,
        batch=shared.setdefault(row.batch, row.batch),
        material=shared.setdefault(row.material, row.material) or "",
        station=shared.setdefault(row.station, row.station),
        recipe=shared.setdefault(row.recipe, row.recipe),
        started_at=row.started_at,
        made_at=made_at(row.run),
        finished=ended is EndReason.FINISHED,
        outcome=None if analysis is None else analysis_outcome(analysis),
        software=shared.setdefault(software, software),
        simulated=shared.setdefault(simulated, simulated),
        of_check=of_check,
    )


def _measured(chosen: list[ColumnElement[bool]], names: Sequence[str]) -> Select[*tuple[Any, ...]]:
    """Query measurements with their texts joined: a fleet has a million values, and each column takes time."""
    m, query = MeasurementRow, figures_query()
    if chosen:
        analysed = select(AnalysisRow.analysis).join(RunRow, RunRow.run == AnalysisRow.run).where(*chosen)
        query = query.where(m.analysis.in_(analysed))
    if names:
        query = query.where(or_(m.name.in_(names), m.outcome.in_(list(_BAD))))
    return query


def _values(
    connection: Connection,
    chosen: list[ColumnElement[bool]],
    names: Sequence[str],
    places: dict[str, int],
    known: list[Known | None],
) -> tuple[tuple[Kind, ...], tuple[Any, ...]]:
    """Kinds, and the columns of :class:`FleetTable`; chained runs are verified."""
    # A digest is over all measurements of an analysis.
    chained = any(known)
    figures = Figures(connection, _measured(chosen, () if chained else names), places)
    kinds: dict[Kind, int] = {}
    meant = [_meant(connection, saying, kinds, names) for saying in figures.sayings]
    if chained:
        check_figures(connection, chosen, known, figures)
    kind, state = np.array(meant, dtype=np.int32).reshape(-1, 2)[figures.said].T
    asked = kind >= 0
    columns = figures.place[asked], kind[asked], figures.value[asked], state[asked].astype(np.uint8)
    return tuple(kinds), columns


def _meant(
    connection: Connection, saying: tuple[Any, ...], kinds: dict[Kind, int], names: Sequence[str]
) -> tuple[int, int]:
    """Kind and state for joined words and limits; new kinds are added.

    The kind is −1 where its metric was not asked for, and it is within its limits.
    """
    said, lower, upper = saying
    parts = said.split(BETWEEN)
    if len(parts) != len(JOINED):
        raise StoreError(
            f"the database is damaged: {_first(connection, said)} has {said[:64]!r} with the control character"
            " U+001F in it",
            remedy="restore the database from a copy; the row is left unchanged",
        )
    name, phase, qualifier, unit, location, outcome, bound = parts
    if (outcome, bound) not in _STATES:
        row = _first(connection, said)
        stored(Outcome, outcome, "measurements.outcome", row)
        stored(Bound, bound, "measurements.bound", row)
    state = _STATES[outcome, bound]
    if names and name not in names and outcome not in _BAD:
        return -1, state
    kind = Kind(MetricKey(name, phase, qualifier), unit, location, lower, upper)
    return kinds.setdefault(kind, len(kinds)), state


def _first(connection: Connection, said: str) -> str:
    """Name the first row with these words."""
    m = MeasurementRow
    query = select(m.analysis, m.number).where(words() == said).order_by(m.analysis, m.number).limit(1)
    row = connection.execute(query).one()
    return f"analysis {row.analysis}, measurement {row.number},"


def _places(connection: Connection, runs: Sequence[FleetRun]) -> dict[str, tuple[float, float]]:
    """Place of each load label, from the first and the last run of each recipe."""
    last = {run.recipe: run.run for run in runs if run.finished}
    first = {run.recipe: run.run for run in reversed(runs) if run.finished}
    ends = {*first.values(), *last.values()}
    query = select(LoadRow.label, LoadRow.x_mm, LoadRow.y_mm).where(LoadRow.run.in_(ends)).distinct()
    found: dict[str, set[tuple[float, float]]] = {}
    for label, x_mm, y_mm in connection.execute(query):
        found.setdefault(label, set()).add((x_mm, y_mm))
    # Random loads are pressed somewhere else in every run: their labels are no places.
    return {label: at.pop() for label, at in found.items() if len(at) == 1}
