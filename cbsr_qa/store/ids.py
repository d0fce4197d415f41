"""Time-ordered identifiers (UUID version 7, RFC 9562): stations merge without collision, rows sort by age."""

import secrets
from collections.abc import Callable
from datetime import UTC, datetime
from threading import Lock
from uuid import UUID

_COUNTER_BITS = 12
#: An identifier has room for later years than a date has.
_YEAR_10000_MS = 253_402_300_800_000


class IdSource:
    """Makes identifiers that rise within one source, whatever the wall clock does.

    The 12 bits after the version count within a millisecond (RFC 9562, 6.2, method 1), starting from a random
    number whose highest bit is 0; a clock that stands or is set back keeps the last millisecond and counts on.

    Parameters
    ----------
    wall : tells the time.
    """

    def __init__(self, wall: Callable[[], datetime]) -> None:
        self._wall = wall
        self._last_ms = -1
        self._counter = 0
        self._lock = Lock()

    def follow(self, latest: str) -> None:
        """Make only identifiers that come after another one from here on: a clock that was set back changes no order.

        Parameters
        ----------
        latest : an identifier; one that is not of this kind is followed by any.
        """
        found = _parts(latest)
        with self._lock:
            if found is not None and found > (self._last_ms, self._counter):
                self._last_ms, self._counter = found

    def new(self) -> str:
        """Return a new identifier as text."""
        now_ms = int(self._wall().timestamp() * 1000)
        with self._lock:
            if now_ms > self._last_ms:
                self._last_ms, self._counter = now_ms, secrets.randbits(_COUNTER_BITS - 1)
            else:
                self._counter += 1
                if self._counter >> _COUNTER_BITS:
                    self._last_ms, self._counter = self._last_ms + 1, secrets.randbits(_COUNTER_BITS - 1)
            millisecond, counter = self._last_ms, self._counter
        return str(UUID(int=millisecond << 80 | 7 << 76 | counter << 64 | 2 << 62 | secrets.randbits(62)))


def made_at(identifier: str) -> datetime | None:
    """Return when an identifier was made, by the clock of whoever made it; None where it does not say."""
    found = _parts(identifier)
    if found is None or found[0] >= _YEAR_10000_MS:
        return None
    return datetime.fromtimestamp(found[0] / 1000, UTC)


def _parts(identifier: str) -> tuple[int, int] | None:
    """Millisecond and counter of an identifier; None where it is not of version 7."""
    try:
        number = UUID(identifier)
    except ValueError:
        return None
    if number.version != 7:
        return None
    return number.int >> 80, (number.int >> 64) & ((1 << _COUNTER_BITS) - 1)
