"""A free-running instrument that sends one number per line, with or without its own time."""

import math
import re
import threading
from array import array
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import InstrumentError, SerialLink
from cbsr_qa.plugin.links.serial_link import describe_partial_line
from cbsr_qa.system.clock import TICK_S, Clock, RealClock

#: Samples are fetched every few seconds; an hour covers any pause between two steps [s].
KEPT_S: Final = 3600.0


class SampleLog:
    """Times and values, written by one thread and read by others. Times must rise."""

    def __init__(self) -> None:
        self._times, self._values = array("d"), array("d")
        self._keeping = threading.Lock()

    @property
    def last_s(self) -> float:
        """Time of the last sample; -inf before the first [s]."""
        with self._keeping:
            return self._times[-1] if self._times else -np.inf

    def append(self, time_s: float, value: float) -> None:
        """Keep a sample, and forget those of more than an hour ago now and then."""
        with self._keeping:
            self._times.append(time_s)
            self._values.append(value)
            old = bisect_right(self._times, time_s - KEPT_S)
            if old > len(self._times) // 2:
                del self._times[:old], self._values[:old]

    def read_since(self, time_s: float) -> tuple[Array, Array]:
        """Return times [s] and values, both (n,), after a time."""
        with self._keeping:
            first = bisect_right(self._times, time_s)
            return np.array(self._times[first:]), np.array(self._values[first:])

    def newest(self, count: int) -> Array:
        """Return the last values, at most so many, (n,)."""
        with self._keeping:
            return np.array(self._values[-count:])


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
        self._odd: tuple[float, float] | None = None  # device time and arrival of an unconfirmed step
        self._last_s = -math.inf
        #: How often the device's clock began again, or was set.
        self.restarts = 0

    def on_station(self, device_s: float, arrival_s: float) -> float | None:
        """Return when a line was sent on the station's clock; None if it is an old line, or its time is implausible.

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
        self._last_s = max(device_s + self._least[0][1], self._last_s + TICK_S)
        return self._last_s


def _follows(line: tuple[float, float], before: tuple[float, float]) -> bool:
    """Whether a device time follows another: forwards, by no more than has passed, except for late arrivals."""
    return 0 < line[0] - before[0] <= line[1] - before[1] + _CATCHES_UP_S


_VALUE: Final = r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*"
_PLAIN: Final = re.compile(rf"^{_VALUE}$")
_TIMED: Final = re.compile(rf"^\s*(\d+)\s*,{_VALUE}$")
_SETTINGS: Final = "its baud rate, and 'time' in its table"
#: So many lines after each other that cannot be read are another instrument, or another baud rate.
_UNREADABLE: Final = 20
#: An instrument that has sent nothing for so many periods, and a second, has fallen silent.
_SILENT_PERIODS: Final = 10
#: A thread that reads looks this often whether it should end, and after a pulled cable whether it is back [s].
_LOOK_S: Final = 0.2
#: After a full buffer of the kernel's there may be more behind it [s, real time].
_MORE_S: Final = 0.01
_FULL: Final = 2048


class LineSampler:
    """Reads lines, puts their times on the station's clock, and keeps the samples.

    On a real clock a thread reads, so that every line is stamped when it comes. On a virtual clock time passes only
    where somebody sleeps, and whoever asks for the samples reads.

    A line that cannot be read is counted and skipped: no value is ever made up for it. ``timed``: whether lines are
    ``<milliseconds>,<value>``; else ``<value>``, stamped at their arrival.
    """

    def __init__(
        self, link: SerialLink, clock: Clock, *, timed: bool, rate_hz: float, convert: Callable[[float], float]
    ) -> None:
        self._link, self._clock, self._timed, self._convert = link, clock, timed, convert
        self._period_s = 1 / rate_hz
        self._device = DeviceTime()
        self._log = SampleLog()
        self._partial = b""
        self._fresh = True  # what came first may be the rest of a line
        self._unread = 0
        self._example = ""
        #: Lines that could not be read.
        self.skipped = 0
        self._began_s = clock.now()
        self._failure: InstrumentError | None = None
        self._keeping = threading.RLock()
        self._over = threading.Event()
        self._thread: threading.Thread | None = None
        if isinstance(clock, RealClock):
            self._thread = threading.Thread(target=self._read, name=f"reads {link.role}", daemon=True)
            self._thread.start()

    @property
    def restarts(self) -> int:
        """Number of restarts of the instrument's clock."""
        return self._device.restarts

    def samples_since(self, time_s: float) -> tuple[Array, Array]:
        """Return times [s] and values, both (n,), of what was sent after a time up to now.

        InstrumentError if the line is down and cannot be opened again, or what comes on it are no such lines.
        """
        if self._thread is None:
            self._drain()
        with self._keeping:
            if self._failure is not None:
                raise self._failure
            if self._unread >= _UNREADABLE:
                raise self._link.error(
                    f"{self._unread} lines after each other could not be read, the last is {self._example!r};"
                    f" {self._line_format()} was expected",
                    f"check its address, {_SETTINGS}",
                )
        return self._log.read_since(time_s)

    def newest(self, count: int) -> Array:
        """Return the last values, at most so many, (n,)."""
        return self._log.newest(count)

    def wait_for_first(self, allowed_s: float) -> None:
        """Wait for a sample. InstrumentError if none arrives in time, quoting what arrived instead."""
        until_s = self._clock.now() + allowed_s
        while not len(self.samples_since(-np.inf)[0]):
            if self._clock.now() >= until_s:
                received, remedy = "nothing", f"check that it is switched on, its address, {_SETTINGS}"
                if self._example:
                    received = repr(self._example)
                elif partial_line := self._partial + self._link.partial_line:
                    received = describe_partial_line(partial_line)
                    remedy = f"check its address, its line end, {_SETTINGS}"
                raise self._link.error(
                    f"{received} was found within {allowed_s:g} s; {self._line_format()} was expected", remedy
                )
            self._clock.sleep(self._period_s)

    def check_alive(self) -> None:
        """Raise InstrumentError if it has fallen silent."""
        times, _ = self.samples_since(self._clock.now() - self._silent_s())
        if not len(times) and self._clock.now() - self._began_s > self._silent_s():
            partial_line = self._partial + self._link.partial_line
            raise self._link.error(
                f"it has sent nothing that can be read for {self._silent_s():.3g} s"
                + (f", but {describe_partial_line(partial_line)}" if partial_line else ""),
                "check its power, its cable and its baud rate",
            )

    def close(self) -> None:
        """End the reading and give the port back."""
        self._over.set()
        self._link.close()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=5 * _LOOK_S)

    # --- reading ---

    def _drain(self) -> None:
        """Read pending input, in the calling thread."""
        with self._keeping:
            try:
                self._mend()
                self._take(data := self._link.read_available())
                while len(data) >= _FULL:
                    with suppress(InstrumentError):
                        self._take(self._link.read(1, _MORE_S))
                    self._take(data := self._link.read_available())
            except InstrumentError as error:
                self._failure = error

    def _read(self) -> None:
        """Read line by line until it is closed, in a thread."""
        while not self._over.is_set():
            try:
                self._mend()
                self._take(self._link.read_line(_LOOK_S) + b"\n")
            except InstrumentError as error:
                if not error.retryable:  # the other only says that nothing came
                    with self._keeping:
                        self._failure = error
                    self._over.wait(_LOOK_S)

    def _mend(self) -> None:
        """Reopen the port after its cable was pulled: a device named by identity may have another port."""
        if self._link.down and not self._over.is_set():
            self._link.reopen()
            with self._keeping:
                self._failure, self._partial, self._fresh = None, b"", True

    def _take(self, data: bytes) -> None:
        now_s = self._clock.now()
        *lines, self._partial = (self._partial + data).split(b"\n")
        with self._keeping:
            samples = [sample for line in lines if (sample := self._parse_line(line)) is not None]
            for number, (device_s, value) in enumerate(samples):
                time_s: float | None
                if device_s is not None:
                    time_s = self._device.on_station(device_s, now_s)
                else:  # lines read together came a period apart, and after those before
                    later_samples = len(samples) - 1 - number
                    earliest_s = max(self._log.last_s, self._began_s) + TICK_S
                    time_s = min(max(now_s - later_samples * self._period_s, earliest_s), max(now_s, earliest_s))
                if time_s is None:
                    self.skipped += 1
                    continue
                self._log.append(time_s, self._convert(value))

    def _parse_line(self, line: bytes) -> tuple[float | None, float] | None:
        """Return (device time [s] or None, number) of a line; None if it is not one."""
        text = line.decode("ascii", "replace").strip()
        match = (_TIMED if self._timed else _PLAIN).match(text)
        if match is None:
            self._example = text[:40] or self._example
            if text and not self._fresh:
                self.skipped += 1
                self._unread += 1
            self._fresh = False
            return None
        # The first line that is read may be the end of a longer one: its digits would be another number.
        whole, self._fresh, self._unread = not self._fresh, False, 0
        if not whole:
            return None
        if self._timed:
            return int(match[1]) / 1e3, float(match[2])
        return None, float(match[1])

    def _silent_s(self) -> float:
        return 1.0 + _SILENT_PERIODS * self._period_s

    def _line_format(self) -> str:
        return "'<milliseconds>,<value>'" if self._timed else "'<value>'"
