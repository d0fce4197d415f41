"""Outcomes of runs, without their frames: the latest of one run, the earlier runs of a sensor, their seeds."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Final

from sqlalchemy import Connection, Engine, select

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
from cbsr_qa.store.tables.runs import PartRow, RunRow
from cbsr_qa.store.types import time_of_id
from cbsr_qa.store.unreadable_runs import problem_of

#: Runs that are looked at where a station waits, in 40 ms.
_RECENT: Final = 500


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
            return find_altered_outside(connection, [RunRow.serial != serial], (), latest=_RECENT)

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
