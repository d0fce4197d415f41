"""An instrument's own clock, put onto the station's."""

import math
from collections import deque
from typing import Final

#: Arrivals of the last so many seconds tell how the clocks lie: long enough that some of them were not late, short
#: enough that a drift of 100 parts per million makes 6 ms [s].
_WINDOW_S: Final = 60.0
#: A device time that is one of the last so many is an old line again; another that lies back is a restart.
_REMEMBERED: Final = 4
#: Lines that came late together are this close at most to each other in their arrival, and not in their times [s].
_CATCHES_UP_S: Final = 2.0


class DeviceTime:
    """Maps device times onto the station's clock by the lines that came soonest.

    A line arrives after it was sent, never before, by a delay that varies: the least of (arrival − device time) over
    the last minute is the clocks' offset plus the shortest delay (the lower envelope of the arrivals). Being the
    least of recent ones only, it follows drift. A step of the device's clock counts only once the next line goes on
    from it: one digit that was garbled on the line must not move a minute of samples.
    """

    def __init__(self) -> None:
        self._least: deque[tuple[float, float]] = deque()  # (device time, offset): offsets rise from the front on
        self._recent: deque[float] = deque(maxlen=_REMEMBERED)
        self._arrived_s = -math.inf
        self._odd: tuple[float, float] | None = None  # device time and arrival of a step nobody has confirmed
        self._last_s = -math.inf
        #: How often the device's clock began again, or was set.
        self.restarts = 0

    def on_station(self, device_s: float, arrival_s: float) -> float | None:
        """Return when a line was sent on the station's clock; None where it is an old line again, or its time odd.

        Times rise strictly from line to line, and lie no later than the arrival.
        """
        if device_s in self._recent:
            return None
        if self._recent and not _follows((device_s, arrival_s), (self._recent[-1], self._arrived_s)):
            odd, self._odd = self._odd, (device_s, arrival_s)
            if odd is None or not _follows((device_s, arrival_s), odd):
                return None
            self.restarts += 1
            self._least.clear()
        self._odd = None
        self._recent.append(device_s)
        self._arrived_s = arrival_s
        offset = arrival_s - device_s
        while self._least and self._least[-1][1] >= offset:
            self._least.pop()
        self._least.append((device_s, offset))
        while self._least[0][0] < device_s - _WINDOW_S:
            self._least.popleft()
        self._last_s = max(device_s + self._least[0][1], self._last_s + 1e-6)
        return self._last_s


def _follows(line: tuple[float, float], before: tuple[float, float]) -> bool:
    """Whether a device time goes on from another: forwards, by no more than has passed, but for late arrivals."""
    return 0 < line[0] - before[0] <= line[1] - before[1] + _CATCHES_UP_S
