"""Answers drivers as the instruments of a transcript did."""

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final

from cbsr_qa.domain.errors import InstrumentError, RefusedError
from cbsr_qa.domain.plan.plan import Station
from cbsr_qa.plugin.links.taps import hide, list_secrets, make_timeout
from cbsr_qa.plugin.links.transcript import NOT_OPENED, Event, Transcript, quote
from cbsr_qa.system.clock import Clock, RealClock

_SAME_CHECK: Final = "replay it with the options, the station file and the version it was recorded with"


class Replay:
    """Answers drivers as the instruments of a transcript did; the clock advances to the times of its events.

    What goes on beyond a transcript that ends early raises InstrumentError.

    Parameters
    ----------
    station : station that replays it; RefusedError if the transcript has not its instruments and drivers. None for
        any.
    break_in : called before the first such error, with why the transcript ends; may raise what no driver catches.
    """

    replays = True

    def __init__(
        self,
        transcript: Transcript,
        station: Station | None,
        clock: Clock,
        *,
        break_in: Callable[[str], None] = lambda why: None,
    ) -> None:
        self._transcript, self._clock = transcript, clock
        self._hidden = [] if station is None else list_secrets(station)
        #: By role: a link that is opened again goes on where it was.
        self._links: dict[str, ReplayedLink] = {}
        self._break_in = break_in
        #: Why its answers are over before the check is; empty if they are not.
        self.ended = ""
        if station is None:
            return
        for spec in station.instruments:
            driver = transcript.drivers.get(spec.role)
            if driver != spec.driver:
                recorded = f"with driver {driver}" if driver else "without this instrument"
                raise RefusedError(
                    f"instrument {spec.role!r} of station {station.name!r} has driver {spec.driver};"
                    f" {transcript.name} was recorded {recorded}, at station {transcript.station!r}",
                    remedy="replay it with the station file it was recorded with",
                )

    def connect(self, role: str, open_real: Callable[[], Any]) -> Any:
        """Open a role's link, or open it again. InstrumentError if it did not open then."""
        if role not in self._links:
            self._links[role] = ReplayedLink(self._transcript, role, self._clock, self._hidden, self._end)
        self._links[role].open()
        return self._links[role]

    def describe_last(self, role: str) -> str:
        return ""

    def end_early(self, error: BaseException) -> None:
        """Nothing is kept."""

    def note_no_ring(self) -> None:
        """Nothing is kept."""

    def find_difference(self) -> InstrumentError | None:
        """Return the error of an open instrument that was sent something else than then, or less; None without.

        A driver may have caught it.
        """
        different = [(role, link.differs) for role, link in self._links.items() if link.differs]
        unsent = [event for link in self._links.values() for event in link.list_unsent()]
        for event in sorted(unsent, key=lambda event: event.line):
            counted = f"{self._transcript.counted} {event.line}"
            different.append((event.role, f"{counted} has sent {quote(event.data)}, which is not sent now"))
        if not different:
            return None
        return InstrumentError(
            different[0][0], self._transcript.name, different[0][1], remedy=_name_remedy(self._transcript)
        )

    def _end(self) -> None:
        if not self.ended:
            self.ended = self._transcript.early
            self._break_in(self.ended)


def _name_remedy(transcript: Transcript) -> str:
    """Return what to do where a replay differs: a test's pairs have no station file."""
    return _SAME_CHECK if transcript.counted == "line" else ""


class ReplayedLink:
    """A serial port or VISA resource that answers as one role of a transcript.

    What is sent must be what was sent then, in its order: the first that differs is an InstrumentError that names the
    line, and the link is of no use from there. An answer that did not come then does not come now.

    Parameters
    ----------
    clock : advances to the time of each event.
    hidden : secrets, which a transcript does not have.
    end : called before the error of what goes on beyond a transcript that ends early.
    """

    def __init__(
        self,
        transcript: Transcript,
        role: str,
        clock: Clock,
        hidden: Sequence[bytes] = (),
        end: Callable[[], None] = lambda: None,
    ) -> None:
        self._role, self._name, self._clock, self._hidden = role, transcript.name, clock, hidden
        self._transcript, self._end = transcript, end
        #: What was sent now and not then, in words; empty if nothing.
        self.differs = ""
        self._events = deque(event for event in transcript.events if event.role == role)
        asked_roles = [event.role for event in transcript.events if event.sign == ">"]
        #: Whether the instrument was the last one to be sent something: what it did not answer, it may have later.
        self._is_last = asked_roles[-1:] == [role]
        self._received = bytearray()
        self._lock = threading.RLock()
        self._real = RealClock()
        #: Whether something was sent of which nothing has come yet.
        self._asked = False
        #: How long was waited at a time of the clock, which stands still meanwhile [s].
        self._waited_at_s, self._waited_s = 0.0, 0.0
        self.port = f"{role} of {transcript.name}"
        self.is_open = True
        self.timeout: float | None = None
        self.read_termination: str | None = None

    @property
    def in_waiting(self) -> int:
        with self._lock:
            self._take_received(by_s=self._clock.now())
            self._refuse_later(0.0)
            return len(self._received)

    def list_unsent(self) -> list[Event]:
        """Return what was sent then and has not been sent yet."""
        with self._lock:
            return [event for event in self._events if event.sign == ">"]

    def write(self, data: bytes) -> int:
        """Take what is sent. InstrumentError if something else was sent then, or nothing more."""
        with self._lock:
            sent = hide(data, self._hidden)
            while self._events and self._events[0].sign in "<-":
                self._take_next()
            if not self._events:
                if self._transcript.early and not self.differs:
                    self._refuse_beyond()
                self.differs = self.differs or f"{self._name} ends before {quote(sent)} is sent"
            elif not self.differs:
                event = self._take_next()
                self._asked = True
                if event.data != sent:
                    counted = f"{self._transcript.counted} {event.line}"
                    self.differs = f"{counted} has sent {quote(event.data)}, now {quote(sent)} is sent"
            self._refuse_what_differs()
            return len(data)

    def write_raw(self, data: bytes) -> int:
        return self.write(data)

    def read(self, size: int) -> bytes:
        """Return up to so many bytes, after waiting for them as long as the timeout allows.

        The first ones after something was sent answer it, and come at once however late they came. Others come by
        themselves: they are waited for in real time, as drivers count it, so that none is read too early.
        """
        with self._lock:
            self._refuse_what_differs()
            self._take_received(by_s=self._clock.now())
            while len(self._received) < size and self.timeout and self._events and self._events[0].sign in "<!":
                if not self._asked and not self._wait_for_next(self.timeout):
                    break
                self._take_next()
            if len(self._received) < size and self.timeout and not self._events:
                self._refuse_later(self.timeout)
            return self._take(size)

    def read_raw(self) -> bytes:
        """Return the next answer as it was read then. VisaIOError (timeout) if none was."""
        with self._lock:
            self._refuse_what_differs()
            if not self._received and self._events and self._events[0].sign in "<!":
                self._take_next()
            if not self._received:
                if not self._events and self._is_last:
                    self._refuse_beyond()
                raise make_timeout()
            return self._take(len(self._received))

    def read_bytes(self, count: int) -> bytes:
        """Return exactly so many bytes. VisaIOError (timeout) if they were not read then."""
        with self._lock:
            self._refuse_what_differs()
            while len(self._received) < count and self._events and self._events[0].sign in "<!":
                self._take_next()
            if len(self._received) < count:
                if not self._events and self._is_last:
                    self._refuse_beyond()
                raise make_timeout()
            return self._take(count)

    def reset_input_buffer(self) -> None:
        with self._lock:
            if self._events and self._events[0].sign == "-":
                self._take_next()
            self._received.clear()

    def open(self) -> None:
        """Open it, also again. InstrumentError if it did not open then."""
        with self._lock:
            self.is_open = True
            self._received.clear()
            if self._events and self._events[0].sign == "!" and self._events[0].data.startswith(NOT_OPENED):
                words = self._events.popleft().data.removeprefix(NOT_OPENED).decode(errors="replace")
                raise InstrumentError(self._role, self._name, words)

    def close(self) -> None:
        self.is_open = False

    def _refuse_what_differs(self) -> None:
        if self.differs:
            raise InstrumentError(self._role, self._name, self.differs, remedy=_name_remedy(self._transcript))

    def _refuse_later(self, timeout_s: float) -> None:
        """Refuse to say that nothing came, after a wait, where the transcript ends before that.

        What it has is given out first.
        """
        if self._events or self._received or not self._transcript.early:
            return
        waited_s = self._wait(timeout_s, math.inf)
        if self._clock.now() + waited_s > self._transcript.early_s:
            self._refuse_beyond()

    def _refuse_beyond(self) -> None:
        """Refuse what goes on beyond a transcript that ends early (InstrumentError, or what ``end`` raises)."""
        if self._transcript.early:
            self._end()
            raise InstrumentError(self._role, self._name, self._transcript.early)

    def _take_received(self, *, by_s: float) -> None:
        while self._events and self._events[0].sign in "<!" and self._events[0].time_s <= by_s:
            self._take_next()

    def _wait_for_next(self, timeout_s: float) -> bool:
        """Wait in real time for the next event; return whether it came within the timeout."""
        later_s = self._events[0].time_s - self._clock.now()
        return self._wait(timeout_s, later_s) >= later_s

    def _wait(self, timeout_s: float, longest_s: float) -> float:
        """Wait in real time, while the clock stands; return how long that was together, at most ``longest_s``."""
        now_s = self._clock.now()
        if now_s != self._waited_at_s:
            self._waited_at_s, self._waited_s = now_s, 0.0
        waited_s = max(min(timeout_s, longest_s - self._waited_s), 0.0)
        self._real.sleep(waited_s)
        self._waited_s += waited_s
        return self._waited_s

    def _take_next(self) -> Event:
        """Take the next event at its time. OSError if it is a failure of the link."""
        event = self._events.popleft()
        if (later_s := event.time_s - self._clock.now()) > 0:
            self._clock.sleep(later_s)
        self._asked = False
        if event.sign == "!":
            raise OSError(event.data.decode(errors="replace"))
        if event.sign == "<":
            self._received += event.data
        return event

    def _take(self, size: int) -> bytes:
        data = bytes(self._received[:size])
        del self._received[:size]
        return data
