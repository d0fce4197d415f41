"""Runs of a fleet with the values of their latest analyses, in a fixed number of queries."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from sqlalchemy import Connection, Engine, func, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Bound, Outcome
from cbsr_qa.domain.results.fleet import (
    ADAPTIVE,
    FIXED,
    UNCALIBRATED,
    CalibrationWay,
    FleetTable,
    KnownNames,
    MetricKey,
    RunLine,
    RunSelection,
    State,
    ValueKind,
)
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.store.chain.fleet import Figures, Known, check_figures, figures_query
from cbsr_qa.store.chain.many_runs import RUNS_AT_ONCE
from cbsr_qa.store.chain.run_documents import BETWEEN, JOINED, facts, words
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.engine import reading
from cbsr_qa.store.golden import find_golden_runs, golden_runs
from cbsr_qa.store.left_out import with_left_out
from cbsr_qa.store.runs.verdicts import StoredVerdict, read_verdicts, reset_seed
from cbsr_qa.store.selected import Conditions, conditions, read_naming_runs
from cbsr_qa.store.tables.results import AnalysisRow, CalibrationRow, MeasurementRow
from cbsr_qa.store.tables.runs import DecisionRow, LoadRow, PartRow, RunRow
from cbsr_qa.store.types import time_of_id
from cbsr_qa.system.json_text import parse_json

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


class Fleet:
    """Runs of a fleet."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def read_lines(self, selection: RunSelection = _EVERY) -> tuple[RunLine, ...]:
        """Return the selected runs in the order they were made in; those that were altered are marked.

        Raises
        ------
        StoreError
            If the database cannot be read.
        """
        with reading(self._engine) as connection:
            return tuple(line for line, _ in _lines(connection, _select_runs(connection, selection)))

    def read_known_names(self) -> KnownNames:
        """Return the names of all stored runs, whether they were altered or not: no chain is read for them.

        Raises
        ------
        StoreError
            If the database cannot be read.
        """
        of_parts = select(PartRow.name, PartRow.identifier, PartRow.revision).distinct()
        without_index = select(RunRow.recipe, RunRow.operator).distinct()
        with reading(self._engine) as connection:
            batches, serials, stations = (
                frozenset(connection.scalars(select(column).distinct()))
                for column in (RunRow.batch, RunRow.serial, RunRow.station)
            )
            rows = connection.execute(without_index).all()
            parts = frozenset(SensorPart(*cells) for cells in connection.execute(of_parts))
        recipes, operators = frozenset(row.recipe for row in rows), frozenset(row.operator for row in rows)
        return KnownNames(recipes, batches, serials, stations, operators, parts)

    def load_table(self, selection: RunSelection = _EVERY) -> FleetTable:
        """Return runs with the values of their latest analyses.

        Raises
        ------
        StoreError
            If the database cannot be read, holds an unknown outcome or bound or a cell of the wrong type, or rows of
            a chained run were altered.
        """

        def table(connection: Connection, chosen: Conditions) -> FleetTable:
            runs: list[RunLine] = []
            places: dict[str, int] = {}
            link_contents: list[Known | None] = []
            for line, verdict in _lines(connection, _select_runs(connection, selection, chosen)):
                verdict.validate()
                if verdict.analysis:
                    places[verdict.analysis] = len(runs)
                known: Known | None = None
                if verdict.analysis and verdict.chain.chained:  # what the link of its values covers beside them
                    link_facts = facts(line, verdict.analysis, str(verdict.outcome), verdict.software)
                    known = Known(line.run, verdict.analysis, link_facts)
                link_contents.append(known)
                runs.append(line)
            kinds, (run, kind, value, state) = _values(connection, chosen, places, link_contents)
            return FleetTable(tuple(runs), kinds, run, kind, value, state, _places(connection, runs))

        with reading(self._engine) as connection:
            return read_naming_runs(connection, conditions(selection), table)

    def read_ways(self, runs: Sequence[str]) -> dict[str, tuple[CalibrationWay, str]]:
        """Return how the calibration of each run was made, by its configuration and decisions.

        Returns
        -------
        The way by run, and the latest calibration that the run issued; empty without one.

        Raises
        ------
        StoreError
            If the database cannot be read, or the configuration of a run.
        """
        ways: dict[str, tuple[CalibrationWay, str]] = {}
        of_content: dict[str, CalibrationWay] = {}  # runs of one recipe differ by their seeds
        with reading(self._engine) as connection:
            for first in range(0, len(runs), RUNS_AT_ONCE):
                some = runs[first : first + RUNS_AT_ONCE]
                decided = set(connection.scalars(select(DecisionRow.run).where(DecisionRow.run.in_(some)).distinct()))
                issued = select(CalibrationRow.run, func.max(CalibrationRow.calibration))
                issued = issued.where(CalibrationRow.run.in_(some)).group_by(CalibrationRow.run)
                calibrations = {row[0]: row[1] for row in connection.execute(issued)}
                configurations = select(RunRow.run, RunRow.configuration).where(RunRow.run.in_(some))
                for run, configuration in connection.execute(configurations):
                    content = reset_seed(configuration)
                    if content not in of_content:
                        of_content[content] = _read_way(run, configuration)
                    way = of_content[content]
                    way = replace(way, places=ADAPTIVE) if way.places == FIXED and run in decided else way
                    ways[run] = way, calibrations.get(run, "")
        return ways


def _read_way(run: str, configuration: str) -> CalibrationWay:
    """Return how a run calibrates, from its configuration; StoreError if that cannot be read."""
    try:
        content = parse_json(configuration)
        recipe = content["recipe"]
        if not recipe.get("recipe", {}).get("calibrate_phases"):
            return CalibrationWay(UNCALIBRATED)
        return CalibrationWay(FIXED, content.get("batch_model", {}).get("digest", ""))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise StoreError(
            f"the configuration of run {run} cannot be read", remedy="restore the database from a copy"
        ) from error


def _select_runs(connection: Connection, selection: RunSelection, chosen: Conditions | None = None) -> list[str]:
    query = select(RunRow.run).where(*(conditions(selection) if chosen is None else chosen)).order_by(RunRow.run)
    return with_left_out(connection, selection, list(connection.scalars(query)))


def _lines(connection: Connection, names: Sequence[str]) -> Iterator[tuple[RunLine, StoredVerdict]]:
    of_checks = find_golden_runs(connection, set(connection.scalars(golden_runs())).intersection(names))
    shared: dict[Any, Any] = {}  # tens of thousands of runs name the same few versions
    for verdict in read_verdicts(connection, names):
        yield _line(verdict, shared, of_check=verdict.run in of_checks), verdict


def _line(verdict: StoredVerdict, shared: dict[Any, Any], *, of_check: bool) -> RunLine:
    row = verdict.values
    # The value of an altered run may be anything.
    simulated = () if verdict.altered else tuple(map(str, row["simulated"]))
    material_table = None if verdict.altered else row["setting"].get("material")
    material = str(material_table.get("name", "")) if isinstance(material_table, dict) else ""
    return RunLine(
        run=row["run"],
        serial=row["serial"],
        batch=shared.setdefault(row["batch"], row["batch"]),
        material=shared.setdefault(material, material),
        station=shared.setdefault(row["station"], row["station"]),
        recipe=shared.setdefault(row["recipe"], row["recipe"]),
        started_at=row["started_at"],
        made_at=time_of_id(row["run"]),
        end=verdict.end,
        outcome=verdict.outcome,
        software=shared.setdefault(verdict.software, verdict.software),
        simulated=shared.setdefault(simulated, simulated),
        of_check=of_check,
        operator=shared.setdefault(row["operator"], row["operator"]),
        reason=verdict.reason,
        overridden_to=None if verdict.decision is None else verdict.decision.outcome,
        altered=verdict.altered,
        parts=shared.setdefault(verdict.parts, verdict.parts),
    )


def _values(
    connection: Connection, chosen: Conditions, places: dict[str, int], known: list[Known | None]
) -> tuple[tuple[ValueKind, ...], tuple[Any, ...]]:
    """Return the kinds, and the columns of :class:`FleetTable`; chained runs are verified."""
    query = figures_query()
    if chosen:
        analysed = select(AnalysisRow.analysis).join(RunRow, RunRow.run == AnalysisRow.run).where(*chosen)
        query = query.where(MeasurementRow.analysis.in_(analysed))
    figures = Figures(connection, query, places)
    kinds: dict[ValueKind, int] = {}
    kinds_and_states = [_interpret(connection, description, kinds) for description in figures.descriptions]
    if any(known):
        check_figures(connection, chosen, known, figures)
    kind, state = np.array(kinds_and_states, dtype=np.int32).reshape(-1, 2)[figures.description_index].T
    return tuple(kinds), (figures.place, kind, figures.value, state.astype(np.uint8))


def _interpret(connection: Connection, description: tuple[Any, ...], kinds: dict[ValueKind, int]) -> tuple[int, int]:
    """Return kind and state for joined words and limits; new kinds are added to ``kinds``."""
    joined, lower, upper = description
    parts = joined.split(BETWEEN)
    if len(parts) != len(JOINED):
        raise StoreError(
            f"the database is damaged: {_name_first(connection, joined)} has {joined[:64]!r} with the control"
            " character U+001F in it",
            remedy="restore the database from a copy; the row is left unchanged",
        )
    name, phase, qualifier, unit, location, outcome, bound = parts
    if (outcome, bound) not in _STATES:
        row = _name_first(connection, joined)
        read_word(Outcome, outcome, "measurements.outcome", row)
        read_word(Bound, bound, "measurements.bound", row)
    kind = ValueKind(MetricKey(name, phase, qualifier), unit, location, lower, upper)
    return kinds.setdefault(kind, len(kinds)), _STATES[outcome, bound]


def _name_first(connection: Connection, joined: str) -> str:
    m = MeasurementRow
    query = select(m.analysis, m.number).where(words() == joined).order_by(m.analysis, m.number).limit(1)
    row = connection.execute(query).one()
    return f"analysis {row.analysis}, measurement {row.number},"


def _places(connection: Connection, runs: Sequence[RunLine]) -> dict[str, tuple[float, float]]:
    """Return the place of each load label, from the first and the last run of each recipe."""
    last_run_by_recipe = {run.recipe: run.run for run in runs if run.finished}
    first_run_by_recipe = {run.recipe: run.run for run in reversed(runs) if run.finished}
    ends = {*first_run_by_recipe.values(), *last_run_by_recipe.values()}
    query = select(LoadRow.label, LoadRow.x_mm, LoadRow.y_mm).where(LoadRow.run.in_(ends)).distinct()
    places_by_label: dict[str, set[tuple[float, float]]] = {}
    for label, x_mm, y_mm in connection.execute(query):
        places_by_label.setdefault(label, set()).add((x_mm, y_mm))
    # Random loads are in another place in every run: their labels do not name places.
    return {label: places.pop() for label, places in places_by_label.items() if len(places) == 1}
