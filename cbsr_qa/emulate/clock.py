"""The station's clock where instruments are emulated: whoever waits moves the emulated world on."""

import threading
from collections.abc import Callable
from datetime import datetime

from cbsr_qa.clock import VirtualClock


class WatchedClock(VirtualClock):
    """A virtual clock that several threads sleep on, and that tells whoever acts while time passes.

    The runner sleeps in its own thread, emulated instruments in theirs; a free-running instrument (a load cell that
    sends eight samples a second) watches, and sends what fell due before the sleep returns.

    Parameters
    ----------
    start : the wall time at second 0; by default now.
    """

    def __init__(self, start: datetime | None = None) -> None:
        super().__init__(start)
        #: Held while time passes, and by an emulated instrument while it obeys a command.
        self.lock = threading.RLock()
        self._watchers: list[Callable[[float], None]] = []

    def watch(self, watcher: Callable[[float], None]) -> None:
        """Call this with the time whenever it has passed; it must not sleep, and must not block."""
        self._watchers.append(watcher)

    def now(self) -> float:
        """Seconds slept so far, by anybody [s]."""
        with self.lock:
            return super().now()

    def sleep(self, duration_s: float) -> None:
        """Advance at once by this much [s], and tell the watchers."""
        with self.lock:
            super().sleep(duration_s)
            now_s = super().now()
            for watcher in self._watchers:
                watcher(now_s)
