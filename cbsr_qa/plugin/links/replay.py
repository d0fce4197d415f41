"""Answers drivers as the instruments of a transcript did."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.plan import Station
from cbsr_qa.plugin.links.taps import SHOWN, hide, list_secrets, make_timeout
from cbsr_qa.plugin.links.transcript import Event, Transcript, escape
from cbsr_qa.system.clock import Clock


class Replay:
    """Answers drivers as the instruments of a transcript did; the clock advances to the times of its events.

    Parameters
    ----------
    station : station that replays it; RefusedError if the transcript has not its instruments and drivers. None for
        any.
    """

    replays = True

    def __init__(self, transcript: Transcript, station: Station | None, clock: Clock) -> None:
        self._transcript, self._clock = transcript, clock
        self._hidden = [] if station is None else list_secrets(station)
        if station is None:
            return
        for spec in station.instruments:
            driver = transcript.drivers.get(spec.role)
            if driver != spec.driver:
                recorded = f"with driver {driver}" if driver else "without it"
                raise RefusedError(
                    f"{transcript.name} was recorded {recorded}; instrument {spec.role!r} of station"
                    f" {station.name!r} has {spec.driver}",
                    remedy="replay it at the station it was recorded at",
                )

    def connect(self, role: str, open_real: Callable[[], Any]) -> Any:
        return ReplayedLink(self._transcript, role, self._clock, self._hidden)

    def describe_last(self, role: str) -> str:
        return ""


class ReplayedLink:
    """A serial port or VISA resource that answers as one role of a transcript.

    What is sent must be what was sent then, in its order: the first that differs is an OSError that names the line.
    An answer that did not come then does not come now.

    Parameters
    ----------
    clock : advances to the time of each event.
    hidden : secrets, which a transcript does not have.
    """

    def __init__(self, transcript: Transcript, role: str, clock: Clock, hidden: Sequence[bytes] = ()) -> None:
        self._name, self._clock, self._hidden = transcript.name, clock, hidden
        self._events = deque(event for event in transcript.events if event.role == role)
        self._received = bytearray()
        self._lock = threading.RLock()
        self.port = f"{role} of {transcript.name}"
        self.is_open = True
        self.timeout: float | None = None
        self.read_termination: str | None = None

    @property
    def in_waiting(self) -> int:
        with self._lock:
            self._take_received(by_s=self._clock.now())
            return len(self._received)

    def write(self, data: bytes) -> int:
        """Take what is sent. OSError if something else was sent then, or nothing more."""
        with self._lock:
            sent = hide(data, self._hidden)
            while self._events and self._events[0].sign in "<-":
                self._take_next()
            if not self._events:
                raise OSError(f"{self._name} ends before {escape(sent)[:SHOWN]!r} is sent")
            event = self._take_next()
            if event.sign == ">" and event.data != sent:
                raise OSError(
                    f"line {event.line} of {self._name} sent {escape(event.data)[:SHOWN]!r}, now"
                    f" {escape(sent)[:SHOWN]!r} is sent"
                )
            return len(data)

    def write_raw(self, data: bytes) -> int:
        return self.write(data)

    def read(self, size: int) -> bytes:
        """Return up to so many bytes; those that came later are waited for if there is a timeout."""
        with self._lock:
            self._take_received(by_s=self._clock.now())
            while len(self._received) < size and self.timeout and self._events and self._events[0].sign in "<!":
                self._take_next()
            return self._take(size)

    def read_raw(self) -> bytes:
        """Return the next answer as it was read then. VisaIOError (timeout) if none was."""
        with self._lock:
            if not self._received and self._events and self._events[0].sign in "<!":
                self._take_next()
            if not self._received:
                raise make_timeout()
            return self._take(len(self._received))

    def read_bytes(self, count: int) -> bytes:
        """Return exactly so many bytes. VisaIOError (timeout) if they were not read then."""
        with self._lock:
            while len(self._received) < count and self._events and self._events[0].sign in "<!":
                self._take_next()
            if len(self._received) < count:
                raise make_timeout()
            return self._take(count)

    def reset_input_buffer(self) -> None:
        with self._lock:
            if self._events and self._events[0].sign == "-":
                self._take_next()
            self._received.clear()

    def close(self) -> None:
        self.is_open = False

    def _take_received(self, *, by_s: float) -> None:
        while self._events and self._events[0].sign in "<!" and self._events[0].time_s <= by_s:
            self._take_next()

    def _take_next(self) -> Event:
        """Take the next event at its time. OSError if it is a failure of the link."""
        event = self._events.popleft()
        if (later_s := event.time_s - self._clock.now()) > 0:
            self._clock.sleep(later_s)
        if event.sign == "!":
            raise OSError(event.data.decode())
        if event.sign == "<":
            self._received += event.data
        return event

    def _take(self, size: int) -> bytes:
        data = bytes(self._received[:size])
        del self._received[:size]
        return data
