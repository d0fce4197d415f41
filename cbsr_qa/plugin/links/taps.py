"""What listens to the links of a process, or answers in place of the instruments: a recorder, and a replay.

There is none unless a command puts one there for the time of its work.
"""

import hashlib
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Protocol

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.plan import Station
from cbsr_qa.plugin.links.transcript import Event, Transcript, end_line, escape, head_lines
from cbsr_qa.system.clock import Clock
from cbsr_qa.system.files import writing

#: Options of instruments whose values are not written.
_SECRET: Final = ("password", "passphrase", "secret", "token")
_HIDDEN: Final = b"***"
#: Longest part of a line in a message.
_SHOWN: Final = 60
#: Bytes of an answer that are remembered.
_REMEMBERED: Final = 4096


class Tap(Protocol):
    """What stands between drivers and the system's ports and VISA resources."""

    #: Whether it answers in place of instruments, so that nothing real is opened.
    replays: bool

    def connect(self, role: str, open_real: Callable[[], Any]) -> Any:
        """Return a port or resource for a role; ``open_real`` opens the real one."""
        ...

    def describe_last(self, role: str) -> str:
        """Say what was sent last to an instrument, and what came then; empty if nothing was sent."""
        ...


_taps: list[Tap] = []


def current_tap() -> Tap | None:
    """Return the tap of this process, if any."""
    return _taps[-1] if _taps else None


def is_replaying() -> bool:
    """Whether instruments are replayed, so that none is opened or emulated."""
    tap = current_tap()
    return tap is not None and tap.replays


@contextmanager
def use_tap(tap: Tap | None) -> Iterator[None]:
    """Have all links that are opened meanwhile go through a tap; None changes nothing."""
    if tap is None:
        yield
        return
    _taps.append(tap)
    try:
        yield
    finally:
        _taps.remove(tap)


class Listener:
    """Remembers the last question to each instrument and what came of it."""

    replays = False

    def __init__(self, station: Station) -> None:
        self._hidden = _list_secrets(station)
        self._sent: dict[str, bytes] = {}
        self._received: dict[str, bytes] = {}

    def connect(self, role: str, open_real: Callable[[], Any]) -> Any:
        return _HeardLink(open_real(), role, self)

    def note(self, role: str, sign: str, data: bytes) -> None:
        """Take note of an event; without bytes there is none."""
        if sign == ">":
            self._sent[role], self._received[role] = hide(data, self._hidden), b""
        elif sign == "<":
            self._received[role] = (self._received.get(role, b"") + hide(data, self._hidden))[-_REMEMBERED:]

    def describe_last(self, role: str) -> str:
        """Say what was sent last and what came then; empty if nothing was sent."""
        if role not in self._sent:
            return ""
        received = escape(self._received[role])[-_SHOWN:]
        return f"sent {escape(self._sent[role])[:_SHOWN]!r}, received {repr(received) if received else 'nothing'}"


class Recorder(Listener):
    """Also writes all that passes through the links to a transcript; end it with :meth:`close`.

    Raises
    ------
    RefusedError
        If the file exists, or cannot be written.
    """

    def __init__(self, path: Path, station: Station, clock: Clock) -> None:
        super().__init__(station)
        self._clock = clock
        self._writing = threading.Lock()
        self._digest = hashlib.sha256()
        self._events = 0
        with writing(path):
            try:
                self._file = path.open("x", encoding="ascii", newline="\n")
            except FileExistsError:
                raise RefusedError(f"{path} exists already", remedy="name another file") from None
        for line in head_lines(station.name, {spec.role: spec.driver for spec in station.instruments}):
            self._write_line(line)

    def note(self, role: str, sign: str, data: bytes) -> None:
        """Write an event too."""
        if not data:
            return
        with self._writing:
            super().note(role, sign, data)
            self._write_line(Event(self._clock.now(), role, sign, hide(data, self._hidden)).format())
            self._events += 1

    def close(self) -> None:
        """Write the last line."""
        with self._writing:
            self._write_line(end_line(self._events, self._digest.hexdigest()))
            self._file.close()

    def _write_line(self, line: str) -> None:
        self._digest.update(f"{line}\n".encode("ascii"))
        self._file.write(f"{line}\n")


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
        self._hidden = [] if station is None else _list_secrets(station)
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


class _HeardLink:
    """A serial port or VISA resource whose bytes a listener takes note of."""

    def __init__(self, link: Any, role: str, listener: Listener) -> None:
        self.__dict__.update(_link=link, _role=role, _listener=listener)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._link, name, value)

    def write(self, data: bytes) -> int | None:
        with self._noting_failures():
            sent: int | None = self._link.write(data)
        self._listener.note(self._role, ">", data[:sent])
        return sent

    def write_raw(self, data: bytes) -> Any:
        with self._noting_failures():
            sent = self._link.write_raw(data)
        self._listener.note(self._role, ">", data)
        return sent

    def read(self, size: int) -> bytes:
        return self._note_received(lambda: self._link.read(size))

    def read_raw(self) -> bytes:
        return self._note_received(self._link.read_raw)

    def read_bytes(self, count: int) -> bytes:
        return self._note_received(lambda: self._link.read_bytes(count))

    def reset_input_buffer(self) -> None:
        with self._noting_failures():
            dropped = bytes(self._link.read(self._link.in_waiting)) if self._link.in_waiting else b""
            self._link.reset_input_buffer()
        self._listener.note(self._role, "-", dropped)

    def _note_received(self, receive: Callable[[], bytes]) -> bytes:
        with self._noting_failures():
            data = bytes(receive())
        self._listener.note(self._role, "<", data)
        return data

    @contextmanager
    def _noting_failures(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            if not _is_timeout(error):
                self._listener.note(self._role, "!", f"{type(error).__name__}: {error}".encode("ascii", "replace"))
            raise


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
                raise OSError(f"{self._name} ends before {escape(sent)[:_SHOWN]!r} is sent")
            event = self._take_next()
            if event.sign == ">" and event.data != sent:
                raise OSError(
                    f"line {event.line} of {self._name} sent {escape(event.data)[:_SHOWN]!r}, now"
                    f" {escape(sent)[:_SHOWN]!r} is sent"
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
                raise _timeout()
            return self._take(len(self._received))

    def read_bytes(self, count: int) -> bytes:
        """Return exactly so many bytes. VisaIOError (timeout) if they were not read then."""
        with self._lock:
            while len(self._received) < count and self._events and self._events[0].sign in "<!":
                self._take_next()
            if len(self._received) < count:
                raise _timeout()
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


def _is_timeout(error: Exception) -> bool:
    return bool(getattr(error, "error_code", None) == _timeout().error_code)


def _timeout() -> Any:
    """Return the error of a VISA resource that did not answer in time."""
    from pyvisa.constants import StatusCode  # a station without such a resource does not load it
    from pyvisa.errors import VisaIOError

    return VisaIOError(StatusCode.error_timeout)


def hide(data: bytes, secrets: Sequence[bytes]) -> bytes:
    """Return bytes with every secret replaced by stars."""
    for secret in secrets:
        data = data.replace(secret, _HIDDEN)
    return data


def _list_secrets(station: Station) -> list[bytes]:
    """Values of the instruments' options that are named like secrets, the longest first."""
    options: list[Mapping[str, Any]] = [spec.options for spec in station.instruments]
    found = {
        str(value).encode()
        for table in options
        for key, value in table.items()
        if value and any(word in key.lower() for word in _SECRET)
    }
    return sorted(found, key=lambda secret: (-len(secret), secret))
