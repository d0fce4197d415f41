r"""Transcripts: every byte between drivers and instruments, with its time, as a text file that people can read.

The first line names the format, the next ones the station and its instruments with their drivers. Then comes one line
per event, ``TIME ROLE SIGN BYTES``: seconds of the station's clock; ``>`` sent to the instrument, ``<`` received from
it, ``-`` received and thrown away, ``!`` a failure of the link, in words, which begin with ``open: `` if it did not
open. Bytes that are not printable ASCII are written ``\n``, ``\r``, ``\t``, ``\\`` or ``\xNN``. The last line counts
the events and has the SHA-256 of all lines before it, so that a file that was cut off or changed is noticed.
"""

import codecs
import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.system.foreign import read_foreign

_FORMAT: Final = "cbsr-qa transcript 1"
_ANY_FORMAT: Final = re.compile(r"cbsr-qa transcript (?P<version>\d+)")
#: How the words of a link that could not be opened begin.
NOT_OPENED: Final = b"open: "
#: Longest part of an event in a message.
_SHOWN: Final = 60
#: Largest file that is read [bytes].
_LARGEST: Final = 2**30
_SIGNS: Final = (">", "<", "-", "!")
_EVENT: Final = re.compile(r"(?P<time>\d+(\.\d+)?(e-\d+)?) (?P<role>\S+) (?P<sign>\S) ?(?P<data>.*)")
_END: Final = re.compile(r"end (?P<count>\d+) sha256 (?P<digest>[0-9a-f]{64})")
_ESCAPE: Final = re.compile(rb"\\(x[0-9a-f]{2}|.?)", re.DOTALL)
_NAMED: Final = {b"n": b"\n", b"r": b"\r", b"t": b"\t", b"\\": b"\\"}
_RECORD_AGAIN: Final = "record it again: cbsr-qa station record"
_UNCHANGED: Final = f"take the file as it was recorded, or {_RECORD_AGAIN}"


#: What was sent and what was received.
Pair = tuple[bytes | str | None, bytes | str | None]


@dataclass(frozen=True, slots=True)
class Event:
    """One event on the link to an instrument.

    Parameters
    ----------
    time_s : of the station's clock.
    role : instrument's role at the station.
    sign : ``>`` sent, ``<`` received, ``-`` received and thrown away, ``!`` a failure.
    data : the bytes; of a failure its words (UTF-8).
    line : in the file, counted from 1; 0 where it is not from a file.
    """

    time_s: float
    role: str
    sign: str
    data: bytes
    line: int = 0

    def format(self) -> str:
        return f"{self.time_s!r} {self.role} {self.sign} {escape(self.data)}"


@dataclass(frozen=True, slots=True)
class Transcript:
    """All events of a session.

    Parameters
    ----------
    station : name of the station.
    drivers : driver of each role.
    events : in order of time.
    name : of the file, for messages.
    """

    station: str
    drivers: dict[str, str]
    events: tuple[Event, ...]
    name: str = "the transcript"

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file. RefusedError if it is no transcript, was cut off, or was changed, naming the line."""
        try:
            content = read_foreign(path, _LARGEST)
            if content.startswith(codecs.BOM_UTF8):
                raise _error(path, "begins with a byte order mark, which an editor added", _UNCHANGED)
            text = content.decode("ascii")
        except OSError as error:
            raise RefusedError(f"{path} cannot be read: {error.strerror or error}") from error
        except UnicodeDecodeError as error:
            raise _error(path, f"byte {error.start + 1} is not ASCII", "name a transcript") from error
        lines = text.splitlines()
        other = _ANY_FORMAT.fullmatch(lines[0]) if lines else None
        if other is not None and lines[0] != _FORMAT:
            raise _error(path, f"is of format {other['version']}; this version reads {_FORMAT[-1]}", _RECORD_AGAIN)
        if other is None:
            raise _error(path, f"does not begin with {_FORMAT!r}", "name a file of cbsr-qa station record")
        end = _END.fullmatch(lines[-1])
        if end is None:
            ends = [number for number, line in enumerate(lines, start=1) if _END.fullmatch(line)]
            if ends:
                raise _error(path, f"continues after line {ends[0]}, its end", _UNCHANGED)
            remedy = f"events after line {len(lines)} are lost; {_RECORD_AGAIN}"
            raise _error(path, f"was cut off: line {len(lines)} is not its end", remedy)
        station, drivers, first = _read_head(path, lines)
        events = tuple(_read_event(path, number, lines[number - 1]) for number in range(first, len(lines)))
        if int(end["count"]) != len(events) or digest(lines[:-1]) != end["digest"]:
            stated = "another SHA-256 than its lines have"
            if int(end["count"]) != len(events):
                stated = f"{end['count']} events, and there are {len(events)}"
            raise _error(path, f"was changed: its last line states {stated}", _UNCHANGED)
        _check_order(path, drivers, events)
        return cls(station, drivers, events, str(path))

    @classmethod
    def from_pairs(cls, role: str, pairs: Iterable[Pair], *, end: bytes = b"") -> Self:
        """Return a transcript of pairs (sent, received), as PyMeasure's tests of drivers state them.

        Parameters
        ----------
        pairs : bytes or text; None where nothing was sent, or nothing received.
        end : of every line; PyMeasure's pairs leave it out.
        """
        events = [
            Event(0.0, role, sign, (data.encode("ascii") if isinstance(data, str) else data) + end)
            for pair in pairs
            for sign, data in zip("><", pair, strict=True)
            if data is not None
        ]
        return cls("", {}, tuple(events))


def head_lines(station: str, drivers: dict[str, str]) -> list[str]:
    """Return the lines before the events."""
    return [_FORMAT, f"station {station}", *(f"instrument {role} {driver}" for role, driver in drivers.items())]


def end_line(count: int, sha256: str) -> str:
    """Return the last line, which counts the events and states the digest of all lines before it."""
    return f"end {count} sha256 {sha256}"


def digest(lines: Sequence[str]) -> str:
    """SHA-256 of lines, each with its line feed."""
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode("ascii")).hexdigest()


def escape(data: bytes) -> str:
    r"""Return bytes as printable ASCII; a space at the end is ``\x20``."""
    names = {value[0]: f"\\{key.decode()}" for key, value in _NAMED.items()}
    text = "".join(names.get(byte) or (chr(byte) if 32 <= byte < 127 else f"\\x{byte:02x}") for byte in data)
    return f"{text[:-1]}\\x20" if text.endswith(" ") else text


def unescape(text: str) -> bytes:
    """Return the bytes that :func:`escape` wrote. ValueError for another escape."""

    def replace(match: re.Match[bytes]) -> bytes:
        name = match[1]
        if name[:1] == b"x" and len(name) == 3:
            return bytes.fromhex(name[1:].decode())
        if name not in _NAMED:
            raise ValueError(f"\\{name.decode('ascii', 'replace')} is no escape")
        return _NAMED[name]

    return _ESCAPE.sub(replace, text.encode("ascii"))


def quote(data: bytes) -> str:
    """Return bytes for a message: escaped, in quotation marks, cut where they are long."""
    return f"'{escape(data)[:_SHOWN]}'"


def _read_head(path: Path, lines: Sequence[str]) -> tuple[str, dict[str, str], int]:
    """Return station, drivers by role, and the number of the first event's line."""
    station, drivers = "", {}
    for number, line in enumerate(lines[1:-1], start=2):
        kind, *words = line.split(" ")
        if kind == "station" and len(words) == 1:
            station = words[0]
        elif kind == "instrument" and len(words) == 2:
            if words[0] in drivers:
                raise _error(path, f"line {number} names instrument {words[0]!r} a second time", _RECORD_AGAIN)
            drivers[words[0]] = words[1]
        else:
            return station, drivers, number
    return station, drivers, len(lines)


def _read_event(path: Path, number: int, line: str) -> Event:
    event = _EVENT.fullmatch(line)
    try:
        if event is None or event["sign"] not in _SIGNS:
            raise ValueError("it is not TIME ROLE SIGN BYTES")
        return Event(float(event["time"]), event["role"], event["sign"], unescape(event["data"]), number)
    except ValueError as error:
        raise _error(path, f"line {number} is {line[:60]!r}: {error}", _RECORD_AGAIN) from error


def _check_order(path: Path, drivers: Mapping[str, str], events: Sequence[Event]) -> None:
    """Refuse an event before the one above it, or of an instrument that the head does not name (RefusedError)."""
    latest_s = 0.0
    for event in events:
        if event.role not in drivers:
            reason = f"line {event.line} is of {event.role!r}, which is not among the instruments of its head"
            raise _error(path, reason, _RECORD_AGAIN)
        if event.time_s < latest_s:
            reason = f"line {event.line} is at {event.time_s:g} s, before the line above it ({latest_s:g} s)"
            raise _error(path, reason, _RECORD_AGAIN)
        latest_s = event.time_s


def _error(path: Path, reason: str, remedy: str) -> RefusedError:
    return RefusedError(f"{path}: {reason}", remedy=remedy)
