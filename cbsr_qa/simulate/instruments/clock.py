"""Clock of a station with emulated instruments: waiting advances the emulated world.

What emulated instruments can be told to do wrong.
"""

import threading
from collections import deque
from collections.abc import Callable
from datetime import datetime
from enum import StrEnum
from typing import Final

from cbsr_qa.system import VirtualClock


class WatchedClock(VirtualClock):
    """A virtual clock for several threads, which notifies its watchers as time passes.

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
        """Add a watcher, called with the time after each advance; it must not sleep or block."""
        self._watchers.append(watcher)

    def now(self) -> float:
        """Total time slept by all threads [s]."""
        with self.lock:
            return super().now()

    def sleep(self, duration_s: float) -> None:
        """Advance by this much [s], and notify the watchers."""
        with self.lock:
            super().sleep(duration_s)
            now_s = super().now()
            for watcher in self._watchers:
                watcher(now_s)


class Fault(StrEnum):
    """One fault, triggered by the next command after it was armed."""

    DROP = "drop"  #: the link hangs up and stays down
    SILENCE = "silence"  #: commands are taken, and nothing is ever answered again
    GARBLE = "garble"  #: one byte of the reply is another one
    DELAY = "delay"  #: the reply comes after the driver has given up waiting for it
    STALE = "stale"  #: the reply before comes once more, ahead of the right one
    RESET = "reset"  #: the instrument restarts and has forgotten everything
    COMPLIANCE = "compliance"  #: the source is at its voltage limit from now on
    RESEND = "resend"  #: the line is asked for once more
    BUSY = "busy"  #: it says it is busy for a while before it answers
    OVERLOAD = "overload"  #: the force reads far above any ceiling from now on


#: Faults of the link itself; the others are the instrument's, see ``Served.misbehave``.
OF_THE_LINK: Final = frozenset({Fault.DROP, Fault.SILENCE, Fault.GARBLE, Fault.DELAY, Fault.STALE})


class ArmedFaults:
    """Armed faults; armed in one thread, triggered in another."""

    def __init__(self) -> None:
        self._waiting: deque[Fault] = deque()
        self._lock = threading.Lock()

    def arm(self, fault: Fault) -> None:
        """Arm a fault for the next command; several faults hit one command each."""
        with self._lock:
            self._waiting.append(fault)

    @property
    def waiting(self) -> int:
        """Number of faults armed and not yet triggered."""
        with self._lock:
            return len(self._waiting)

    def met(self) -> Fault | None:
        """Take the fault that hits the current command."""
        with self._lock:
            return self._waiting.popleft() if self._waiting else None
