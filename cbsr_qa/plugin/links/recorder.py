"""Listens to the links of a process: remembers the last exchange with each instrument, or writes a transcript."""

import hashlib
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from cbsr_qa.domain.errors import AbortedError, CbsrError, InstrumentError, RefusedError
from cbsr_qa.domain.plan.plan import Station
from cbsr_qa.plugin.links.taps import count_begun, find_unhidable, hide, is_timeout, list_secrets
from cbsr_qa.plugin.links.transcript import (
    NO_RING,
    NOT_OPENED,
    STOPPED_BY,
    THE_CHECK,
    Event,
    end_line,
    head_lines,
    quote,
)
from cbsr_qa.system.clock import Clock
from cbsr_qa.system.files import writing

#: Bytes of an answer that are remembered, and those of its end that are shown.
_REMEMBERED: Final = 4096
_SHOWN: Final = 40


class Listener:
    """Remembers the last question to each instrument and what came of it."""

    replays = False
    #: Why answers are over before the check is: those of instruments are not.
    ended = ""

    def __init__(self, station: Station) -> None:
        self._hidden = list_secrets(station)
        self._sent: dict[str, bytes] = {}
        self._received: dict[str, bytes] = {}

    def connect(self, role: str, open_real: Callable[[], Any]) -> Any:
        """Open the real link, and listen to it; a failure to open it is noted."""
        try:
            link = open_real()
        except CbsrError as error:
            words = error.reason
            if isinstance(error, InstrumentError):
                words = words.removeprefix(f"{error.role} at {error.address}: ")
            self.note(role, "!", NOT_OPENED + words.encode())
            raise
        return _HeardLink(link, role, self)

    def note(self, role: str, sign: str, data: bytes) -> None:
        """Note an event: ``>`` and bytes sent, ``<`` and bytes received; others are ignored."""
        if sign == ">":
            self._sent[role], self._received[role] = hide(data, self._hidden), b""
        elif sign == "<":
            self._received[role] = hide(self._received.get(role, b"") + data, self._hidden)[-_REMEMBERED:]

    def describe_last(self, role: str) -> str:
        """Say what was sent last and what came then; empty if neither."""
        received = self._received.get(role, b"")[-_SHOWN:]
        if role not in self._sent:
            return f"received {quote(received)}, unasked" if received else ""
        return f"sent {quote(self._sent[role])}, received {quote(received) if received else 'nothing'}"

    def end_early(self, error: BaseException) -> None:
        """Nothing is kept."""

    def note_no_ring(self) -> None:
        """Nothing is kept."""


class Recorder(Listener):
    """Also writes all that passes through the links to a transcript; end it with :meth:`close`.

    Parameters
    ----------
    path : file to write; it is taken away again if no link was opened, nor tried to be.
    options : of the check, for its replay.

    Raises
    ------
    RefusedError
        If the file exists, or cannot be written; or if a secret is too short to be hidden.
    """

    def __init__(self, path: Path, station: Station, clock: Clock, options: Mapping[str, str] | None = None) -> None:
        super().__init__(station)
        if option := find_unhidable(station):
            raise RefusedError(
                f"{option} is too short or too plain to be hidden in a transcript: other words and numbers hold it",
                remedy="give the instrument one of six or more different characters, or check it without recording",
            )
        self._clock = clock
        self._writing = threading.Lock()
        self._digest = hashlib.sha256()
        self.path = path
        #: Whether a driver opened a link, or tried to.
        self.has_links = False
        #: Why the file is not whole; empty while it is. The instruments are not to blame, and the check continues.
        self.failure = ""
        #: Whether the check ended before it was over.
        self.ended_early = False
        self._count = 0
        #: Sign and pieces of what may be the beginning of a secret, which may come octet by octet.
        self._begun: dict[str, tuple[str, list[bytes]]] = {}
        self._own = {spec.role: list_secrets(station, spec.role) for spec in station.instruments}
        #: Events written of each instrument.
        self.events_by_role = dict.fromkeys((spec.role for spec in station.instruments), 0)
        with writing(path):
            try:
                # Line by line: what was said before a crash is there.
                self._file = path.open("x", encoding="ascii", newline="\n", buffering=1)
            except FileExistsError:
                raise RefusedError(f"{path} exists already", remedy="name another file") from None
        drivers = {spec.role: spec.driver for spec in station.instruments}
        for line in head_lines(station.name, drivers, options or {}):
            self._write_line(line)

    def connect(self, role: str, open_real: Callable[[], Any]) -> Any:
        """As a listener; an address that no link can have is not tried."""
        is_tried = True
        try:
            return super().connect(role, open_real)
        except RefusedError:
            is_tried = False
            raise
        finally:
            self.has_links = self.has_links or is_tried

    def note(self, role: str, sign: str, data: bytes) -> None:
        """Note and write an event; an empty one is ignored."""
        if not data:
            return
        with self._writing:
            super().note(role, sign, data)
            if role in self._begun and self._begun[role][0] != sign:
                self._write_begun(role)
            pieces = [*self._begun.pop(role, (sign, []))[1], hide(data, self._hidden)]
            said = b"".join(pieces)
            shown = hide(said, self._hidden)
            begun = 0 if sign == "!" else count_begun(shown, self._own.get(role, ()))
            if sign != ">" or shown != said:  # what was sent is compared one by one in a replay; the rest is a stream
                pieces = [shown[: len(shown) - begun], shown[len(shown) - begun :]]
            held: list[bytes] = []
            while sum(map(len, held)) < begun:
                held.insert(0, pieces.pop())
            if held:
                self._begun[role] = sign, held
            for piece in filter(None, pieces):
                self._write_event(role, sign, piece)

    def end_early(self, error: BaseException) -> None:
        """Write that the check ends here; once."""
        if self.ended_early:
            return
        cause = error.by if isinstance(error, AbortedError) else str(error) or type(error).__name__
        with self._writing:
            self.ended_early = True
            self._write_event(THE_CHECK, "#", STOPPED_BY + hide(cause.encode(), self._hidden))

    def note_no_ring(self) -> None:
        with self._writing:
            self._write_event(THE_CHECK, "#", NO_RING)

    def close(self) -> None:
        """Write the last line."""
        with self._writing:
            for role in list(self._begun):
                self._write_begun(role)
            self._write_line(end_line(self._count, self._digest.hexdigest()))
            with suppress(OSError):  # what cannot be written is noted already
                self._file.close()
            if not self.has_links:
                self.path.unlink()

    def _write_begun(self, role: str) -> None:
        sign, pieces = self._begun.pop(role)
        for piece in pieces:
            self._write_event(role, sign, piece)

    def _write_event(self, role: str, sign: str, data: bytes) -> None:
        line = Event(self._clock.now(), role, sign, data).format()
        if role in self.events_by_role:
            self.events_by_role[role] += 1
        # Before it is written: a signal breaks in after that.
        self._count += 1
        self._write_line(line)

    def _write_line(self, line: str) -> None:
        self._digest.update(f"{line}\n".encode("ascii"))
        if self.failure:
            return
        try:
            self._file.write(f"{line}\n")
        except OSError as error:
            self.failure = error.strerror or str(error)


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
            closed = not getattr(self._link, "is_open", True)  # what waits in a port that is closed fails, always
            if not closed and not is_timeout(error):
                self._listener.note(self._role, "!", f"{type(error).__name__}: {error}".encode("ascii", "replace"))
            raise
