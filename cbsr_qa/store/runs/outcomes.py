"""Outcomes of runs, without their frames: the latest of one run, the earlier runs of a sensor, their seeds."""

import json
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Final

from sqlalchemy import CTE, Connection, Engine, func, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.changes import EarlierRun, SensorHistory
from cbsr_qa.domain.run.states import EndReason, ResultState
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity, SensorPart
from cbsr_qa.store.chain.links import KEY_OPTION, SigningKey
from cbsr_qa.store.damage import FOREIGN_CELL, name_database
from cbsr_qa.store.engine import open_engine, parse_url, reading, sqlite_file
from cbsr_qa.store.golden import find_golden_runs
from cbsr_qa.store.left_out import find_altered_outside
from cbsr_qa.store.locks import seed_claimed, this_process
from cbsr_qa.store.runs.verdicts import verdict_of
from cbsr_qa.store.tables.runs import PartRow, RunRow, SensorRow
from cbsr_qa.store.types import time_of_id
from cbsr_qa.store.unreadable_runs import problem_of

#: Runs that are looked at where a station waits, in 40 ms.
RECENT_RUNS: Final = 500
#: Names that one query looks for; databases allow some ten thousand.
_NAMES_AT_ONCE: Final = 1000


class NoRunError(StoreError):
    """There is no such run, or no database."""


class SensorRuns:
    """Runs of one sensor."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def find_altered_elsewhere(self, serial: str) -> dict[str, str]:
        """Return what is wrong with the rows of recent runs of other sensors that were altered, by run.

        One of them may be of this sensor. The latest 500 of them are looked at, as a station waits for it.
        """
        with reading(self._engine) as connection:
            return find_altered_outside(connection, [RunRow.serial != serial], (), latest=RECENT_RUNS)

    def find_altered_lately(self, known: Collection[str]) -> dict[str, str]:
        """Return what is wrong with the rows of those of the latest 500 runs that were altered, by run.

        Parameters
        ----------
        known : runs to skip.
        """
        with reading(self._engine) as connection:
            return find_altered_outside(connection, [], known, latest=RECENT_RUNS)

    def list_seeds(self, serial: str) -> tuple[int | None, ...]:
        """Return the seeds of all runs of a sensor, oldest first; None where a configuration has none."""
        query = select(RunRow.configuration).where(RunRow.serial == serial).order_by(RunRow.run)
        with reading(self._engine) as connection:
            return tuple(map(_seed, connection.scalars(query)))

    @contextmanager
    def claim_seed(self, serial: str, seed: int, operator: str = "") -> Iterator[bool]:
        """Claim a seed for a run of a sensor while entered; yields False if another of its runs has it."""
        with seed_claimed(self._engine, serial, seed, this_process(operator)) as other:
            yield not other and seed not in self.list_seeds(serial)

    def read_history(self, sensor: SensorIdentity, recipe: str, before: str = "") -> SensorHistory:
        """Return the runs of a sensor that began before a run (empty: all), as seen from a run of a recipe.

        They are in the order they began in; an altered run is there with the problem instead of its result.
        """
        run = RunRow
        query = select(run.run, run.recipe).where(run.serial == sensor.serial).order_by(run.run)
        if before:
            query = query.where(run.run < before)
        with reading(self._engine) as connection:
            rows = connection.execute(query).all()
            of_checks = find_golden_runs(connection, {row.run for row in rows})
            runs = tuple(
                _earlier(connection, sensor.serial, row.run, row.recipe, of_check=row.run in of_checks)
                for row in rows
            )
        return SensorHistory(sensor, recipe, runs)

    def find_runs_of_part(self, part: SensorPart) -> list[tuple[str, str]]:
        """Return run and serial number of every run of a sensor with a part of any revision, in their order."""
        query = select(RunRow.run, RunRow.serial).join(PartRow, PartRow.run == RunRow.run)
        query = query.where(PartRow.name == part.name, PartRow.identifier == part.identifier).order_by(RunRow.run)
        with reading(self._engine) as connection:
            return [(run, serial) for run, serial in connection.execute(query)]

    def find_sensors_of_part(self, part: SensorPart) -> dict[str, str]:
        """Return the serial numbers of all sensors that a part was in, each with its latest run with it.

        Parameters
        ----------
        part : an empty name stands for any, an empty revision too.
        """
        latest = func.max(RunRow.run)
        query = select(RunRow.serial, latest).join(PartRow, PartRow.run == RunRow.run).group_by(RunRow.serial)
        names = select(_part_names().c.name)  # a search by name and identifier has an index
        query = query.where(PartRow.name == part.name if part.name else PartRow.name.in_(names))
        query = query.where(PartRow.identifier == part.identifier)
        query = query.where(PartRow.revision == part.revision) if part.revision else query
        with reading(self._engine) as connection:
            return dict(connection.execute(query).all())

    def find_sensors_of_batch(self, batch: str) -> dict[str, str]:
        """Return the serial numbers of all sensors of a batch, each with its latest run in it."""
        of_batch = select(RunRow.serial, RunRow.run).where(RunRow.batch == batch)
        with reading(self._engine) as connection:  # in their order, SQLite would look at the runs of all batches
            rows = connection.execute(of_batch).all()
        return dict(sorted(rows, key=lambda row: row[1]))

    def find_sensors_of_operator(self, operator: str, runs: int) -> dict[str, str]:
        """Return the serial numbers of the sensors of an operator among the latest runs, each with its latest run.

        Parameters
        ----------
        runs : number of runs that are looked at: operators have no index.
        """
        latest = select(RunRow.serial, RunRow.run, RunRow.operator).order_by(RunRow.run.desc()).limit(runs).subquery()
        query = select(latest.c.serial, latest.c.run).where(latest.c.operator == operator).order_by(latest.c.run)
        with reading(self._engine) as connection:
            return dict(connection.execute(query).all())

    def find_runs(self, serials: Sequence[str]) -> list[str]:
        """Return all runs of some sensors, in the order they were made in."""
        query = select(RunRow.run).where(RunRow.serial.in_(serials)).order_by(RunRow.run)
        with reading(self._engine) as connection:
            return list(connection.scalars(query))

    def find_names(self, names: Sequence[str]) -> tuple[set[str], set[SensorPart]]:
        """Return those of some texts that are serial numbers of any stored run, and parts with such identifiers."""
        serials: set[str] = set()
        parts: set[SensorPart] = set()
        any_name = PartRow.name.in_(select(_part_names().c.name))  # a search by name and identifier has an index
        of_parts = select(PartRow.name, PartRow.identifier, PartRow.revision).where(any_name).distinct()
        with reading(self._engine) as connection:
            for start in range(0, len(names), _NAMES_AT_ONCE):
                some = names[start : start + _NAMES_AT_ONCE]
                serials |= set(connection.scalars(select(SensorRow.serial).where(SensorRow.serial.in_(some))))
                rows = connection.execute(of_parts.where(PartRow.identifier.in_(some)))
                parts |= {SensorPart(*cells) for cells in rows}
        return serials, parts

    def read_latest_names(self, runs: int) -> tuple[set[str], set[SensorPart], set[str]]:
        """Return serial numbers and parts of the latest runs, and the names of their batches and operators."""
        latest = select(RunRow.run).order_by(RunRow.run.desc()).limit(runs)
        of_parts = select(PartRow.name, PartRow.identifier, PartRow.revision).where(PartRow.run.in_(latest))
        with reading(self._engine) as connection:
            columns = select(RunRow.serial, RunRow.batch, RunRow.operator).where(RunRow.run.in_(latest))
            rows = connection.execute(columns).all()
            others = {name for row in rows for name in (row.batch, row.operator) if name}
            return (
                {row.serial for row in rows},
                {SensorPart(*cells) for cells in connection.execute(of_parts)},
                others,
            )


def _part_names() -> CTE:
    """Query the names of parts, each by one step in their index: there are few, and rows by the hundred thousand."""
    names = select(func.min(PartRow.name).label("name")).cte("names", recursive=True)
    following = select(func.min(PartRow.name)).where(PartRow.name > names.c.name).scalar_subquery()
    return names.union_all(select(following).select_from(names).where(names.c.name.is_not(None)))


def latest_result(url: str, run: str) -> tuple[ResultState, Outcome | None]:
    """Return what has come of a run, and the outcome of the latest analysis after its last session, or None.

    Raises
    ------
    NoRunError
        If the database or the run does not exist.
    StoreError
        If it cannot be read, or the run was altered.
    """
    parsed = parse_url(url)
    file = sqlite_file(parsed)
    if file is not None and not file.exists():  # SQLite would create an empty one
        raise NoRunError(f"{name_database(parsed)} does not exist")
    engine = open_engine(parsed)
    try:
        with reading(engine.execution_options(**{KEY_OPTION: SigningKey.from_environment()})) as connection:
            verdict = verdict_of(connection, run)
    finally:
        engine.dispose()
    if verdict is None:
        raise NoRunError(f"there is no run {run} in {name_database(parsed)}")
    return verdict.validate().result, verdict.outcome


def _earlier(connection: Connection, serial: str, run: str, recipe: str, *, of_check: bool) -> EarlierRun:
    try:
        verdict = verdict_of(connection, run)
        if verdict is None:
            raise StoreError(f"run {run} is no longer there")
        decision, values = verdict.validate().decision, verdict.values
    except (*FOREIGN_CELL, StoreError) as error:
        changed = problem_of(connection, run, error)
        began = time_of_id(run) or datetime.fromtimestamp(0, UTC)
        sensor = SensorIdentity(serial, "", "")
        return EarlierRun(run, began, sensor, recipe, EndReason.RUNNING, None, "", of_check=of_check, changed=changed)
    return EarlierRun(
        run=run,
        started_at=values["started_at"],
        sensor=SensorIdentity(values["serial"], values["batch"], values["sensor_type"]),
        recipe=values["recipe"],
        end=verdict.end,
        outcome=verdict.outcome,
        reason=verdict.reason,
        overridden=None if decision is None else (decision.outcome, decision.operator),
        of_check=of_check,
        chained=verdict.chain.chained,
    )


def _seed(configuration: str) -> int | None:
    """Seed of a configuration; None for a damaged one, which is refused when the run is read."""
    try:
        seed: int | None = json.loads(configuration).get("seed")
    except (ValueError, TypeError, AttributeError):
        return None
    return seed
