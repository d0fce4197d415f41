r"""Transcripts: every byte between drivers and instruments, with its time, as a text file that people can read.

The first line names the format, the next ones the station, its instruments with their drivers, and the options of the
check. Then comes one line per event, ``TIME ROLE SIGN BYTES``: seconds of the station's clock; ``>`` sent to the
instrument, ``<`` received from it, ``-`` received and thrown away, ``!`` a failure of the link, in words, which begin
with ``open: `` if it did not open; ``#`` what the check itself did, in words.

Bytes that are not printable ASCII are written ``\n``, ``\r``, ``\t``, ``\\`` or ``\xNN``. The last line counts the
events and has the SHA-256 of all lines before it, so that a file that was cut off or changed is noticed.
"""

import codecs
import hashlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
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
_SIGNS: Final = (">", "<", "-", "!", "#")
#: Role of events of the check itself, and their words.
THE_CHECK: Final = "check"
STOPPED_BY: Final = b"stopped by "
NO_RING: Final = b"the ring is not connected"
#: Options of a check that the head may state.
_OPTIONS: Final = ("ring", "sensor_type", "material")
#: How files begin that are no text of single bytes, and what they are.
_FOREIGN: Final = (
    (b"\x1f\x8b", "is compressed (gzip)"),
    (b"PK\x03\x04", "is compressed (zip)"),
    (b"BZh", "is compressed (bzip2)"),
    (b"\xfd7zXZ", "is compressed (xz)"),
    (b"\x28\xb5\x2f\xfd", "is compressed (zstd)"),
    (b"\xff\xfe", "is UTF-16 text"),
    (b"\xfe\xff", "is UTF-16 text"),
    (b"c\0b\0", "is UTF-16 text"),
    (b"\0c\0b", "is UTF-16 text"),
)
_EVENT: Final = re.compile(r"(?P<time>\d+(\.\d+)?(e-\d+)?) (?P<role>\S+) (?P<sign>\S) ?(?P<data>.*)")
_END: Final = re.compile(r"end (?P<count>\d+) sha256 (?P<digest>[0-9a-f]{64})")
_ESCAPE: Final = re.compile(rb"\\(x[0-9a-f]{2}|.?)", re.DOTALL)
_NAMED: Final = {b"n": b"\n", b"r": b"\r", b"t": b"\t", b"\\": b"\\"}
_RECORD_AGAIN: Final = "record it again: cbsr-qa station record"
_UNCHANGED: Final = f"take the file as it was recorded, or {_RECORD_AGAIN}"


#: What is sent or received in a test of a driver: bytes, text, octets or a number, as in PyMeasure's tests.
Message = bytes | bytearray | str | Sequence[int] | int | float | None
#: What was sent and what was received.
Pair = tuple[Message, Message]


@dataclass(frozen=True, slots=True)
class Event:
    """One event on the link to an instrument.

    Parameters
    ----------
    time_s : of the station's clock.
    role : instrument's role at the station.
    sign : ``>`` sent, ``<`` received, ``-`` received and thrown away, ``!`` a failure, ``#`` of the check itself.
    data : the bytes; of a failure, and of the check, its words (UTF-8).
    line : in the file, or pair of a test, counted from 1; 0 where it is of neither.
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
    options : of the check, as its head states them.
    without_ring : whether somebody said that the ring is not connected.
    early : why it ends before the check did; empty if it does not.
    early_s : time up to which it is known what was said [s].
    counted : what the numbers of events count.
    """

    station: str
    drivers: dict[str, str]
    events: tuple[Event, ...]
    name: str = "the transcript"
    options: Mapping[str, str] = field(default_factory=dict)
    without_ring: bool = False
    early: str = ""
    early_s: float = math.inf
    counted: str = "line"

    @classmethod
    def read(cls, path: Path | str, *, whole: bool = True) -> Self:
        """Read a file; one of a check that was stopped ends at the stop.

        RefusedError if it is no transcript, or was changed, naming the line; also if it was cut off. ``whole``: False
        takes one that was cut off up to there.
        """
        path = Path(path)
        lines, is_complete = _read_lines(path)
        other = _ANY_FORMAT.fullmatch(lines[0]) if lines else None
        if other is not None and lines[0] != _FORMAT:
            raise _error(path, f"is of format {other['version']}; this version reads {_FORMAT[-1]}", _RECORD_AGAIN)
        if other is None:
            raise _error(path, f"does not begin with {_FORMAT!r}", "name a file of cbsr-qa station record")
        end = _END.fullmatch(lines[-1])
        if end is not None:
            lines.pop()
        else:
            _refuse_cut(path, lines, whole=whole)
            lines = lines if is_complete else lines[:-1]
        station, drivers, options, first = _read_head(path, lines)
        events = [_read_event(path, number, lines[number - 1]) for number in range(first, len(lines) + 1)]
        if end is not None and (int(end["count"]) != len(events) or digest(lines) != end["digest"]):
            stated = "another SHA-256 than its lines have"
            if int(end["count"]) != len(events):
                stated = f"{end['count']} events, and there are {len(events)}"
            raise _error(path, f"was changed: its last line states {stated}", _UNCHANGED)
        _check_order(path, drivers, events)
        early, early_s = "", math.inf
        if end is None:
            early = f"the file was cut off after line {len(lines)}; whether it was changed cannot be seen"
            early_s = events[-1].time_s if events else 0.0
        for at, event in enumerate(events):
            if event.sign == "#" and event.data.startswith(STOPPED_BY):
                early = f"the recording was {event.data.decode(errors='replace')} (line {event.line})"
                early_s, events = event.time_s, events[:at]
                break
        said = tuple(event for event in events if event.sign != "#")
        without_ring = any(event.sign == "#" and event.data == NO_RING for event in events)
        return cls(station, drivers, said, str(path), options, without_ring, early, early_s)

    @classmethod
    def from_pairs(cls, role: str, pairs: Iterable[Pair], *, end: bytes = b"") -> Self:
        """Return a transcript of pairs (sent, received), as PyMeasure's tests of drivers state them.

        Parameters
        ----------
        pairs : of what PyMeasure's take; None where nothing was sent, or nothing received.
        end : of every line; PyMeasure's pairs leave it out.

        Raises
        ------
        RefusedError
            If a pair is something else, naming it.
        """
        events = []
        for number, pair in enumerate(pairs, start=1):
            try:
                sent, received = (None if one is None else _convert_message(one) + end for one in pair)
            except (TypeError, ValueError) as error:
                remedy = "allowed: (sent, received), each of them text, bytes, octets, a number or None"
                raise RefusedError(f"pair {number} is {pair!r}: {error}", remedy=remedy) from error
            events += [
                Event(0.0, role, sign, data, number)
                for sign, data in ((">", sent), ("<", received))
                if data is not None
            ]
        return cls("", {}, tuple(events), "the pairs", counted="pair")


def head_lines(station: str, drivers: Mapping[str, str], options: Mapping[str, str]) -> list[str]:
    """Return the lines before the events."""
    instruments = (f"instrument {role} {driver}" for role, driver in drivers.items())
    stated = (f"{name} {escape(value.encode())}" for name, value in options.items())
    return [_FORMAT, f"station {station}", *instruments, *stated]


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


def _convert_message(message: object) -> bytes:
    """Convert a message to bytes. TypeError or ValueError if it is of another kind."""
    if isinstance(message, bool):
        raise TypeError("a truth value is no message")
    if isinstance(message, str | int | float):
        return str(message).encode()
    if isinstance(message, bytes | bytearray | list | tuple):
        return bytes(message)
    raise TypeError(f"{type(message).__name__} is no message")


def _read_lines(path: Path) -> tuple[list[str], bool]:
    """Return the lines of a text file without empty ones at its end, and whether the last one has its line feed."""
    try:
        content = read_foreign(path, _LARGEST)
        if content.startswith(codecs.BOM_UTF8):
            raise _error(path, "begins with a byte order mark, which an editor added", _UNCHANGED)
        for begin, what in _FOREIGN:
            if content.startswith(begin):
                raise _error(path, what, _UNCHANGED)
        text = content.decode("ascii")
    except OSError as error:
        raise RefusedError(f"{path} cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise _error(path, f"byte {error.start + 1} is not ASCII", "name a transcript") from error
    lines = text.splitlines()
    while lines and not lines[-1]:
        lines.pop()
    return lines, text.endswith("\n")


def _refuse_cut(path: Path, lines: Sequence[str], *, whole: bool) -> None:
    """Refuse a file whose last line is not its end, unless it may have been cut off (RefusedError)."""
    ends = [number for number, line in enumerate(lines, start=1) if _END.fullmatch(line)]
    if ends:
        raise _error(path, f"continues after line {ends[0]}, its end", _UNCHANGED)
    if whole:
        remedy = (
            f"events after line {len(lines)} are lost: station check --replay goes up to there; or {_RECORD_AGAIN}"
        )
        raise _error(path, f"was cut off: line {len(lines)} is not its end", remedy)


def _read_head(path: Path, lines: Sequence[str]) -> tuple[str, dict[str, str], dict[str, str], int]:
    """Return station, drivers by role, options, and the number of the first event's line."""
    station, drivers, options = "", {}, {}
    for number, line in enumerate(lines[1:], start=2):
        kind, *words = line.split(" ")
        if kind == "station" and len(words) == 1:
            station = words[0]
        elif kind == "instrument" and len(words) == 2:
            if words[0] in drivers:
                raise _error(path, f"line {number} names instrument {words[0]!r} a second time", _RECORD_AGAIN)
            drivers[words[0]] = words[1]
        elif kind in _OPTIONS and words:
            options[kind] = _read_option(path, number, line)
        else:
            return station, drivers, options, number
    return station, drivers, options, len(lines) + 1


def _read_option(path: Path, number: int, line: str) -> str:
    try:
        return unescape(line.partition(" ")[2]).decode()
    except ValueError as error:
        raise _error(path, f"line {number} is {line[:_SHOWN]!r}: {error}", _RECORD_AGAIN) from error


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
        if event.sign != "#" and event.role not in drivers:
            reason = f"line {event.line} is of {event.role!r}, which is not among the instruments of its head"
            raise _error(path, reason, _RECORD_AGAIN)
        if event.time_s < latest_s:
            reason = f"line {event.line} is at {event.time_s:g} s, before the line above it ({latest_s:g} s)"
            raise _error(path, reason, _RECORD_AGAIN)
        latest_s = event.time_s


def _error(path: Path, reason: str, remedy: str) -> RefusedError:
    return RefusedError(f"{path}: {reason}", remedy=remedy)
