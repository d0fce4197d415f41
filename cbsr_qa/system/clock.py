"""Real and virtual clocks. No other module sleeps or reads the time.

Both clocks tell multiples of one tick, a power of two: sums and differences of such times are exact in double
precision for two and a half centuries, so that results from differences of times are the same, bit for bit, at
any time of a run (decision 0019).
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import Final, Protocol

#: Tick: unit of which all times are multiples [s]; 0.95 µs.
TICK_S: Final = 2.0**-20
#: Longest lag of a paced clock that it makes up by not waiting [s].
_CATCH_UP_S: Final = 1.0


def write_local_time(moment: datetime, *, zone: bool = True) -> str:
    """Write a time by this computer's clock, with its zone or without it."""
    return f"{moment.astimezone():%Y-%m-%d %H:%M}" + (f" {name_zones([moment])}" if zone else "")


def name_zones(moments: Iterable[datetime]) -> str:
    """Name the zone of times by this computer's clock, or both in summer and winter."""
    return " and ".join(dict.fromkeys(moment.astimezone().tzname() or "local" for moment in moments)) or "UTC"


def round_to_ticks(duration_s: float) -> float:
    """Return the multiple of a tick nearest to a duration, at least one tick if it is positive [s]."""
    ticks = round(duration_s / TICK_S)
    return TICK_S * (1 if ticks == 0 and duration_s > 0 else ticks)


def on_tick(time_s: float) -> float:
    """Return the first multiple of a tick that is not before a time [s]."""
    return TICK_S * math.ceil(time_s / TICK_S)


class Clock(Protocol):
    """The station's time."""

    def now(self) -> float:
        """Seconds since the clock was made, in whole ticks; never steps back [s]."""
        ...

    def wall(self) -> datetime:
        """Date and time of day with zone, for people; may be set back."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Sleep this much station time, at least a tick if it is positive [s]."""
        ...


class RealClock:
    """The computer's monotonic clock."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now(self) -> float:
        """Whole ticks that have passed since this clock was made [s]."""
        return TICK_S * math.floor((time.monotonic() - self._start) / TICK_S)

    def wall(self) -> datetime:
        """Date and time of day, UTC."""
        return datetime.now(UTC)

    def sleep(self, duration_s: float) -> None:
        """Wait, at least a tick [s]; a negative duration is ignored."""
        if duration_s > 0:
            time.sleep(max(duration_s, TICK_S))


class WallWatch:
    """Notices that the computer's clock was set; the system does not report it."""

    def __init__(self) -> None:
        self._wall, self._since_s = datetime.now(UTC), time.monotonic()

    def clock_change(self) -> timedelta:
        """Return how far date and time were set since this was made; positive: forward.

        A computer that slept looks as if its clock had been set forward.
        """
        elapsed = timedelta(seconds=time.monotonic() - self._since_s)
        return datetime.now(UTC) - self._wall - elapsed


class VirtualClock:
    """Time that advances only by sleeping: hours of station time cost no waiting.

    Parameters
    ----------
    start : wall time at second 0; by default now.
    speed : station seconds per real second, for people who watch: sleeping then waits. Events happen at the same
        station times at any speed. None: as fast as the computer can.
    """

    def __init__(self, start: datetime | None = None, *, speed: float | None = None) -> None:
        self.speed = speed
        self._start = start or datetime.now(UTC)
        self._now = 0.0
        self._due = time.monotonic()

    def now(self) -> float:
        """Seconds slept so far [s]."""
        return self._now

    def wall(self) -> datetime:
        """Wall time of the start plus the seconds slept so far."""
        return self._start + timedelta(seconds=self._now)

    def sleep(self, duration_s: float) -> None:
        """Advance by the nearest number of ticks, at least one [s]; a negative duration is ignored."""
        slept_s = self._advance(duration_s)
        self._keep_pace(slept_s)

    def _advance(self, duration_s: float) -> float:
        slept_s = round_to_ticks(max(duration_s, 0.0))
        self._now += slept_s
        return slept_s

    def _keep_pace(self, slept_s: float) -> None:
        """Wait until this much station time has passed; a slow computer may catch up a little."""
        if self.speed is not None:
            self._due = max(self._due, time.monotonic() - _CATCH_UP_S) + slept_s / self.speed
            time.sleep(max(self._due - time.monotonic(), 0.0))


def passing(clock: Clock, wait: Callable[[float], object], station_s: float) -> None:
    """Wait in real time, at most for so much station time; a virtual clock advances by the time that has passed.

    ``wait``: function that waits at most so many seconds of real time, and returns earlier if its event happens.
    """
    if not isinstance(clock, VirtualClock):
        wait(station_s)
        return
    speed, before_s = clock.speed or 1.0, time.monotonic()
    wait(min(station_s / speed, _CATCH_UP_S / 2))
    clock.sleep((time.monotonic() - before_s) * speed)


#: Function that is called with the name of each stage as it begins.
Listener = Callable[[str], None]


class Stages:
    """Names and times the stages of a computation. ``listener``: function called with the name of a new stage."""

    def __init__(self, listener: Listener = lambda stage: None) -> None:
        self._listener = listener
        self._spent: dict[str, float] = {}

    def announce(self, name: str) -> None:
        """Announce a stage without timing it."""
        self._listener(name)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the body to a stage."""
        self.announce(name)
        start_s = time.perf_counter()
        try:
            yield
        finally:
            self._spent[name] = self._spent.get(name, 0.0) + time.perf_counter() - start_s

    def table(self) -> tuple[tuple[str, float], ...]:
        """Seconds by stage, in the order they first began."""
        return tuple(self._spent.items())
