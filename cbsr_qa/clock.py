"""Time, real and virtual. No other module sleeps or asks for the time."""

import time
from datetime import UTC, datetime, timedelta
from typing import Protocol


class Clock(Protocol):
    """The station's time."""

    def now(self) -> float:
        """Seconds since the clock was made; never steps back [s]."""
        ...

    def wall(self) -> datetime:
        """Date and time of day with zone, for people; may be set back by anybody."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Let this much of the station's time pass [s]."""
        ...


class RealClock:
    """The computer's monotonic clock."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now(self) -> float:
        """Seconds since this clock was made [s]."""
        return time.monotonic() - self._start

    def wall(self) -> datetime:
        """Date and time of day, UTC."""
        return datetime.now(UTC)

    def sleep(self, duration_s: float) -> None:
        """Wait [s]."""
        if duration_s > 0:
            time.sleep(duration_s)


class VirtualClock:
    """Time that passes only when somebody sleeps: hours of station time cost no waiting.

    Parameters
    ----------
    start : the wall time at second 0; by default now.
    """

    def __init__(self, start: datetime | None = None) -> None:
        self._start = start or datetime.now(UTC)
        self._now = 0.0

    def now(self) -> float:
        """Seconds slept so far [s]."""
        return self._now

    def wall(self) -> datetime:
        """Wall time of the start plus the seconds slept so far."""
        return self._start + timedelta(seconds=self._now)

    def sleep(self, duration_s: float) -> None:
        """Advance at once by this much [s]; a negative duration is ignored."""
        self._now += max(duration_s, 0.0)
