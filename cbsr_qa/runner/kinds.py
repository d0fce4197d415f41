"""What the station's time is spent on."""

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum

from cbsr_qa.clock import Clock


class Kind(StrEnum):
    """Kinds of activity, in the order a report lists them."""

    HOME = "home"
    SURFACE = "surface finding"
    TRAVEL = "travel"
    PRESS = "press"
    HOLD = "hold"
    RELEASE = "release"
    REST = "rest"
    FRAMES = "frames"
    PROMPT = "prompt"


class Spent:
    """Seconds by kind of activity."""

    def __init__(self) -> None:
        self._seconds = dict.fromkeys(Kind, 0.0)

    def add(self, kind: Kind, seconds: float) -> None:
        """Add to one kind."""
        self._seconds[kind] += seconds

    @contextmanager
    def on(self, kind: Kind, clock: Clock) -> Iterator[None]:
        """Charge what the clock passes inside to one kind, also where it ends in an error."""
        start_s = clock.now()
        try:
            yield
        finally:
            self.add(kind, clock.now() - start_s)

    def table(self) -> tuple[tuple[str, float], ...]:
        """Return (kind, seconds) of every kind that took time, in report order."""
        return tuple((str(kind), seconds) for kind, seconds in self._seconds.items() if seconds > 0)

    def total_s(self) -> float:
        """Return the sum over all kinds [s]."""
        return sum(self._seconds.values())
