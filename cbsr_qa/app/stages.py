"""Stages of a computation: told to whoever waits, and timed for the report."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Told the name of each stage as it begins.
Listener = Callable[[str], None]


class Stages:
    """Names and times what the computer is busy with.

    Parameters
    ----------
    listener : told each stage's name as it begins.
    """

    def __init__(self, listener: Listener = lambda stage: None) -> None:
        self._listener = listener
        self._spent: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time inside towards a stage."""
        self._listener(name)
        before = time.perf_counter()
        try:
            yield
        finally:
            self._spent[name] = self._spent.get(name, 0.0) + time.perf_counter() - before

    def table(self) -> tuple[tuple[str, float], ...]:
        """Seconds by stage, in the order they first began."""
        return tuple(self._spent.items())

    def total_s(self) -> float:
        """Seconds of all stages [s]."""
        return sum(self._spent.values())
