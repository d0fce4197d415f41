"""Runs of a fleet with the values of their latest analyses, in a fixed number of queries."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from sqlalchemy import Connection, Engine, Row, select

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import (
    Bound,
    Decision,
    EndReason,
    FleetTable,
    MetricKey,
    Outcome,
    RunLine,
    RunSelection,
    State,
    ValueKind,
)
from cbsr_qa.store.chain import (
    AT_ONCE,
    BETWEEN,
    JOINED,
    RUN_COLUMNS,
    Figures,
    Known,
    check_figures,
    check_run,
    facts,
    figures_query,
    words,
)
from cbsr_qa.store.damage import stored
from cbsr_qa.store.listed import decisions_of
from cbsr_qa.store.results import analysis_outcome
from cbsr_qa.store.selected import Conditions, latest_of, read_selected
from cbsr_qa.store.standing import up_to_date
from cbsr_qa.store.tables import AnalysisRow, LoadRow, MeasurementRow, RunRow, RunStateRow, StationCheckRow
from cbsr_qa.store.types import made_at

_BAD: Final = {str(Outcome.FAIL): State.FAILED, str(Outcome.NOT_MEASURED): State.UNMEASURED}
#: State of a value by its outcome and its bound.
_STATES: Final = {
    (str(outcome), str(bound)): int(
        _BAD.get(outcome, State.PLAIN) | (State.LOWER_BOUND if bound is Bound.LOWER else State.PLAIN)
    )
    for outcome in Outcome
    for bound in Bound
}
_EVERY: Final = RunSelection()


def run_lines(engine: Engine, selection: RunSelection = _EVERY) -> tuple[RunLine, ...]:
    """Return the selected runs in the order they were made in. StoreError as for :func:`fleet_table`."""
    return read_selected(engine, selection, lambda connection, chosen: tuple(_runs(connection, chosen)[0]))


def fleet_table(engine: Engine, selection: RunSelection = _EVERY) -> FleetTable:
    """Return runs with the values of their latest analyses.

    Raises
    ------
    StoreError
        If the database cannot be read, holds an unknown outcome or bound or a cell of the wrong type, or rows of a
        chained run were altered.
    """

    def table(connection: Connection, chosen: Conditions) -> FleetTable:
        runs, places, known = _runs(connection, chosen)
        kinds, (run, kind, value, state) = _values(connection, chosen, places, known)
        return FleetTable(tuple(runs), kinds, run, kind, value, state, _places(connection, runs))

    return read_selected(engine, selection, table)


def _runs(connection: Connection, chosen: Conditions) -> tuple[list[RunLine], dict[str, int], list[Known | None]]:
    """Runs in order, the place of each latest analysis, and the rows read of chained runs.

    States and analyses are joined to their runs here: a database without statistics of its tables may scan every
    analysis for every run.
    """
    ends = latest_of(connection, select(RunStateRow.run, RunStateRow.end).order_by(RunStateRow.number), chosen)
    a = AnalysisRow
    analysed = select(a.run, a.analysis, a.outcome, a.reason, a.software).where(up_to_date()).order_by(a.analysis)
    analyses = latest_of(connection, analysed, chosen)
    decisions = decisions_of(connection, chosen)
    of_checks = set(connection.scalars(select(StationCheckRow.golden_run)))
    query = select(*RUN_COLUMNS, RunRow.chain).where(*chosen).order_by(RunRow.run)
    runs: list[RunLine] = []
    places: dict[str, int] = {}
    known: list[Known | None] = []
    shared: dict[Any, Any] = {}  # tens of thousands of runs name the same few versions
    for row in connection.execute(query.execution_options(yield_per=AT_ONCE)):
        analysis, linked = analyses.get(row.run), None
        if analysis is not None:
            name = analysis.analysis
            linked = (row.run, name, facts(row, name, analysis.outcome, analysis.software))
            places[name] = len(runs)
        decision = None if analysis is None else decisions.get((row.run, analysis.analysis))
        if decision is not None and row.chain is not None:  # few runs have one
            check_run(connection, row.run)
        known.append(linked if row.chain is not None else None)
        runs.append(_run(row, ends.get(row.run), analysis, decision, shared, of_check=row.run in of_checks))
    return runs, places, known


def _run(
    row: Row[*tuple[Any, ...]],
    end: Row[*tuple[Any, ...]] | None,
    analysis: Row[*tuple[Any, ...]] | None,
    decision: Decision | None,
    shared: dict[Any, Any],
    *,
    of_check: bool,
) -> RunLine:
    software = () if analysis is None else tuple((name, version) for name, version in analysis.software)
    simulated = tuple(row.simulated)
    return RunLine(
        run=row.run,
        serial=row.serial,
        batch=shared.setdefault(row.batch, row.batch),
        material=shared.setdefault(row.material, row.material) or "",
        station=shared.setdefault(row.station, row.station),
        recipe=shared.setdefault(row.recipe, row.recipe),
        started_at=row.started_at,
        made_at=made_at(row.run),
        end=EndReason.RUNNING if end is None else stored(EndReason, end.end, "run_states.end", f"run {row.run}"),
        outcome=None if analysis is None else analysis_outcome(analysis),
        software=shared.setdefault(software, software),
        simulated=shared.setdefault(simulated, simulated),
        of_check=of_check,
        operator=shared.setdefault(row.operator, row.operator),
        reason="" if analysis is None else analysis.reason,
        overridden_to=None if decision is None else decision.outcome,
    )


def _values(
    connection: Connection, chosen: Conditions, places: dict[str, int], known: list[Known | None]
) -> tuple[tuple[ValueKind, ...], tuple[Any, ...]]:
    """Kinds, and the columns of :class:`FleetTable`; chained runs are verified."""
    query = figures_query()
    if chosen:
        analysed = select(AnalysisRow.analysis).join(RunRow, RunRow.run == AnalysisRow.run).where(*chosen)
        query = query.where(MeasurementRow.analysis.in_(analysed))
    figures = Figures(connection, query, places)
    kinds: dict[ValueKind, int] = {}
    meant = [_meant(connection, saying, kinds) for saying in figures.sayings]
    if any(known):
        check_figures(connection, chosen, known, figures)
    kind, state = np.array(meant, dtype=np.int32).reshape(-1, 2)[figures.said].T
    return tuple(kinds), (figures.place, kind, figures.value, state.astype(np.uint8))


def _meant(connection: Connection, saying: tuple[Any, ...], kinds: dict[ValueKind, int]) -> tuple[int, int]:
    """Kind and state for joined words and limits; new kinds are added."""
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
    kind = ValueKind(MetricKey(name, phase, qualifier), unit, location, lower, upper)
    return kinds.setdefault(kind, len(kinds)), _STATES[outcome, bound]


def _first(connection: Connection, said: str) -> str:
    m = MeasurementRow
    query = select(m.analysis, m.number).where(words() == said).order_by(m.analysis, m.number).limit(1)
    row = connection.execute(query).one()
    return f"analysis {row.analysis}, measurement {row.number},"


def _places(connection: Connection, runs: Sequence[RunLine]) -> dict[str, tuple[float, float]]:
    """Return the place of each load label, from the first and the last run of each recipe."""
    last = {run.recipe: run.run for run in runs if run.finished}
    first = {run.recipe: run.run for run in reversed(runs) if run.finished}
    ends = {*first.values(), *last.values()}
    query = select(LoadRow.label, LoadRow.x_mm, LoadRow.y_mm).where(LoadRow.run.in_(ends)).distinct()
    found: dict[str, set[tuple[float, float]]] = {}
    for label, x_mm, y_mm in connection.execute(query):
        found.setdefault(label, set()).add((x_mm, y_mm))
    # Random loads are elsewhere in every run: their labels are not places.
    return {label: at.pop() for label, at in found.items() if len(at) == 1}
