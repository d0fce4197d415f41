"""Claims of a process while it works: a run that it writes, a sensor that it tests, a seed that it takes."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

from sqlalchemy import Engine

from cbsr_qa.store import locks
from cbsr_qa.store.runs.outcomes import SensorRuns


class Claims:
    """Claims of processes that use one database; all end with their process, see :mod:`cbsr_qa.store.locks`."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def hold_run(self, run: str, operator: str = "") -> AbstractContextManager[None]:
        """Hold the right to write a run while entered; StoreError names another process that holds it."""
        return locks.writing_alone(self._engine, run, locks.this_process(operator))

    @contextmanager
    def claim_seed(self, serial: str, seed: int, operator: str = "") -> Iterator[bool]:
        """Claim a seed for a run of a sensor while entered; yields False if another of its runs has it."""
        with locks.seed_claimed(self._engine, serial, seed, locks.this_process(operator)) as other:
            yield not other and seed not in SensorRuns(self._engine).list_seeds(serial)

    def claim_sensor(self, serial: str, recipe: str, operator: str = "") -> AbstractContextManager[str]:
        """Claim a sensor for a run of a recipe while entered; yields who else tests it now, empty for nobody."""
        return locks.sensor_claimed(self._engine, serial, recipe, locks.this_process(operator))

    def name_writer(self, run: str) -> str:
        """Return who writes a run now; empty for nobody."""
        return locks.writer_of(self._engine, run)
