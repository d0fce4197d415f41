r"""Lines of the ERT board's CSV files, and whole frames out of them.

The lab's script puts its own clock and the load cell in front of whatever line the board printed. The board prints
rows of readings, ``A`` at the start of each frame, and, now and then, a log. Variants that exist:

- with a load cell (``time_pc, mass, payload``) or without (``time, payload``);
- the payload with the board's clock in ms first, or without it, whatever the title says;
- the mass, or the whole serial line, written as a Python bytes literal (``b'0.62'``, ``"b'183927,11022,…\r\n'"``);
- saved again by a spreadsheet, which pads every line with commas to the longest one.
"""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from itertools import groupby, takewhile, zip_longest
from math import gcd
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import RowProblem, ScanKind
from cbsr_qa_plugins.recordings.lab_files import number as as_number

#: A 16-bit converter, printed as signed or unsigned.
LOWEST_COUNT, HIGHEST_COUNT = -(2**15), 2**16 - 1
#: Largest range of counts that is believed, whatever they were multiplied by.
_MAX_COUNT_RANGE: Final = 2**40

_BYTES_LITERAL = re.compile(r"""^b(['"])(.*)\1$""", re.DOTALL)
_INTEGER = re.compile(r"^[+-]?\d{1,18}(\.0*)?$")
#: A frame mark with something behind it: written twice, or joined with the end of a row.
_SPOILT_MARK = re.compile(r"^A[A\d,.+-]+$", re.IGNORECASE)
#: The board counts milliseconds in 32 bits.
LAST_BOARD_MS: Final = 2**32 - 1
#: Latest time of a computer that is believed [s]; Unix time will reach it in the year 5138.
_MAX_COMPUTER_S: Final = 1e11
#: A line with at least this many numbers is a row of readings with something wrong in it, not a log.
_MIN_ROW_NUMBERS: Final = 3
#: A number that recurs so often in a column of rows that are multiplied by a constant is of a stuck channel.
_RECURS: Final = 8


class LineKind(Enum):
    """What a line is."""

    HEADER = auto()  #: ``UTC:``, ``Isrc:`` or the column titles
    MARK = auto()  #: ``A``: a frame starts
    ROW = auto()  #: readings, possibly with the board's clock in front
    LOG = auto()  #: text the board printed, or an empty payload
    GARBLED = auto()  #: readings that cannot all be read
    TORN = auto()  #: the start of a row into which the board printed a log; its rest follows the log
    BLANK = auto()  #: nothing at all


@dataclass(frozen=True, slots=True)
class BoardLine:
    """One line of a file, taken apart.

    Parameters
    ----------
    number : 1-based line of the file.
    computer_s : the computer's clock [s]; None for headers.
    mass_g : the load cell [g], or None.
    numbers : the payload's numbers; empty unless the line is a row.
    said : the payload in words: a header's key, a log line's text, or what is wrong with a garbled row.
    closed : whether a comma follows the last number, as the board prints it; without one the number may be cut.
    """

    number: int
    kind: LineKind
    computer_s: float | None = None
    mass_g: float | None = None
    numbers: tuple[int, ...] = ()
    said: str = ""
    closed: bool = False


def split_fields(text: str) -> tuple[list[str], bool, bool]:
    """Split one line into fields: quotes and bytes literals opened, empty fields at its end dropped.

    Parameters
    ----------
    text : without its line end.

    Returns
    -------
    The fields, whether all after the first came out of one bytes literal (the whole serial line, no mass), and
    whether a comma follows the last field (within its literal, if it came out of one).
    """
    fields = next(csv.reader([text]), []) if '"' in text else text.split(",")
    fields = [field.strip() for field in fields]
    closed = _drop_empty_end(fields)
    whole_line = len(fields) == 2 and bool(_BYTES_LITERAL.match(fields[1]))
    opened: list[str] = []
    for entry in fields:
        literal = _BYTES_LITERAL.match(entry)
        opened += literal.group(2).replace("\\r", "").replace("\\n", "").split(",") if literal else [entry]
    if fields and _BYTES_LITERAL.match(fields[-1]):
        closed = _drop_empty_end(opened)
    return opened, whole_line, closed


def _drop_empty_end(fields: list[str]) -> bool:
    """Drop the empty fields at the end; return whether there were any."""
    count = len(fields)
    while fields and not fields[-1]:
        fields.pop()
    return len(fields) < count


def parse_line(number: int, text: str, *, with_mass: bool) -> BoardLine:
    """Take a line apart.

    Parameters
    ----------
    number : 1-based line of the file.
    with_mass : whether the titles promise a load cell column.
    """
    fields, whole_line, closed = split_fields(text)
    if not fields:
        return BoardLine(number, LineKind.BLANK)
    key = fields[0].lower()
    if key in ("utc:", "isrc:") or key.startswith("time"):
        return BoardLine(number, LineKind.HEADER, said=",".join(fields))
    computer_s = as_number(fields[0])
    if computer_s is None or abs(computer_s) > _MAX_COMPUTER_S:
        return BoardLine(number, LineKind.GARBLED, said=f"it does not start with a time but with {fields[0][:20]!r}")
    with_mass = with_mass and not whole_line
    mass_g = as_number(fields[1]) if with_mass and len(fields) > 1 else None
    payload = fields[2:] if with_mass else fields[1:]
    kind, numbers, log = _classify_payload(payload)
    return BoardLine(number, kind, computer_s, mass_g, numbers, log, closed)


def _classify_payload(fields: list[str]) -> tuple[LineKind, tuple[int, ...], str]:
    if fields == ["A"]:
        return LineKind.MARK, (), "A"
    if fields and all(_INTEGER.match(field) for field in fields):
        return LineKind.ROW, tuple(int(field.partition(".")[0]) for field in fields), ""
    if _SPOILT_MARK.match(text := ",".join(fields)):
        return LineKind.GARBLED, (), f"a frame mark with something behind it: {text[:40]!r}"
    if sum(bool(_INTEGER.match(field)) for field in fields) < _MIN_ROW_NUMBERS:
        return LineKind.LOG, (), text
    leading = next(index for index, field in enumerate(fields) if not _INTEGER.match(field))
    odd = fields[leading] or "an empty field"
    if leading >= _MIN_ROW_NUMBERS and ("\x1b" in odd or "task_wdt" in odd):
        log = f"a log is printed into a row after {leading} numbers; the rest of the row follows it"
        return LineKind.TORN, (), log
    return LineKind.GARBLED, (), f"{len(fields)} fields with {odd[:40]!r} among the numbers"


@dataclass(frozen=True, slots=True)
class CountScale:
    """How a file writes its counts.

    Parameters
    ----------
    factor : constant that the file's numbers are multiplied by; they are divided by it.
    lowest, highest : least and largest possible count, after division.
    stuck : numbers that are no multiples of it, each with its column, from 0, in which it recurs; they are rounded.
    """

    factor: int = 1
    lowest: int = LOWEST_COUNT
    highest: int = HIGHEST_COUNT
    stuck: frozenset[tuple[int, int]] = frozenset()

    @property
    def note(self) -> str:
        """Say what was done; empty where the file holds counts of 16 bits."""
        if self.factor > 1:
            besides = f" but {', '.join(str(n) for _, n in sorted(self.stuck)[:3])}" if self.stuck else ""
            multiples = f"all readings{besides} are multiples of {self.factor}"
            return f"{multiples}, most rows exceed 16 bits: divided by {self.factor}"
        if self.highest > HIGHEST_COUNT:
            return (
                f"readings exceed 16 bits in most rows and have no common factor: read as they are, to {self.highest}"
            )
        return ""


def count_scale(rows: Sequence[tuple[int, ...]]) -> CountScale:
    """Recognise counts that were multiplied by a constant.

    Parameters
    ----------
    rows : readings of each row. Single damaged ones do not matter: only if most rows leave 16 bits is the scale
        in doubt; the factor is that of most rows.
    """
    if not rows or 2 * sum(_fits_sixteen_bits(row) for row in rows) >= len(rows):
        return CountScale()
    # Sixteen or more unrelated numbers have a common divisor by chance once in 65 000 rows.
    factor = max(Counter(gcd(*row) for row in rows).most_common(1)[0][0], 1)
    divided = [tuple(value // factor for value in row) for row in rows]
    if factor > 1 and 2 * sum(_fits_sixteen_bits(row) for row in divided) >= len(rows):
        odd_numbers = Counter((k, n) for row in rows for k, n in enumerate(row) if n % factor)
        stuck = {number for number, times in odd_numbers.items() if times >= _RECURS}
        return CountScale(factor, stuck=frozenset(stuck))
    typical = sorted(max(map(abs, row)) for row in rows)[len(rows) // 2]
    reach: int = 2 ** (typical.bit_length() + 1)
    return CountScale(1, -reach, reach - 1) if reach <= _MAX_COUNT_RANGE else CountScale()


def _fits_sixteen_bits(row: tuple[int, ...]) -> bool:
    return all(LOWEST_COUNT <= value <= HIGHEST_COUNT for value in row)


@dataclass(frozen=True, slots=True)
class RowForm:
    """What a good row of a file holds.

    Parameters
    ----------
    pairs : number of electrode pairs: of readings in a row, and of rows in a frame.
    has_clock : whether the board's clock precedes the readings.
    """

    pairs: int
    has_clock: bool

    @property
    def width(self) -> int:
        """Number of numbers in a good row."""
        return self.pairs + self.has_clock


def complaint(numbers: tuple[int, ...], form: RowForm, scale: CountScale) -> str:
    """Say what is wrong with a row of numbers; empty if nothing is.

    Parameters
    ----------
    numbers : of the row, divided by the scale's factor.
    form : of good rows of this file.
    """
    count, width = len(numbers), form.width
    if count != width:
        shape = "joined lines" if count > width else "cut row"
        shape += " (the board's time is missing, or a reading)" if form.pairs == count < width else ""
        return f"{shape}: {count} numbers where a row has {width}"
    for value in numbers[-form.pairs :]:
        if not scale.lowest <= value <= scale.highest:
            return f"absurd: {value} is not a count of a {scale.highest.bit_length()}-bit converter"
    if form.has_clock and not 0 <= numbers[0] <= LAST_BOARD_MS:
        return f"absurd: the board's clock says {numbers[0]} ms; it counts in 32 bits"
    return ""


Rows = tuple[BoardLine, ...]


@dataclass(frozen=True, slots=True)
class DroppedFrame:
    """A frame that is not whole.

    Parameters
    ----------
    first_line, last_line : of the file.
    rejected_lines : lines of its rows that were rejected.
    why : reason in words.
    """

    first_line: int
    last_line: int
    rejected_lines: tuple[int, ...]
    why: str

    @property
    def span(self) -> str:
        """The frame by its lines."""
        return f"frame of lines {self.first_line} to {self.last_line}"


@dataclass(slots=True)
class Assembly:
    """Frames of a file, and what is left of it.

    Parameters
    ----------
    pairs : number of readings in a row, and of rows in a frame.
    frames : rows of each whole frame, in time order.
    dropped : frames that broke between two marks. The one cut by the start or the end of the file is not among
        them: every recording has those.
    dumps : stretches of log lines, one entry each.
    """

    pairs: int
    frames: list[Rows] = field(default_factory=list)
    dropped: list[DroppedFrame] = field(default_factory=list)
    dumps: list[RowProblem] = field(default_factory=list)

    def counts(self) -> Array:
        """Return the readings, (frames, rows, pairs) float64 [counts]."""
        return np.array([[row.numbers[-self.pairs :] for row in rows] for rows in self.frames], dtype=np.float64)


def assemble(lines: list[BoardLine], scan: ScanKind, pairs: int) -> Assembly:
    """Put frames together.

    Parameters
    ----------
    lines : of the whole file; bad rows are GARBLED.
    scan : FULL: a mark and a row for each pair; DRIVEN_PAIRS: every row is a frame and marks only separate them.
    pairs : readings of a row.
    """
    assembly = Assembly(pairs, dumps=_list_dumps(lines))
    if scan is ScanKind.DRIVEN_PAIRS:
        assembly.frames = [(line,) for line in lines if line.kind is LineKind.ROW]
        return assembly
    # Split at repeated headers: a file opened in append mode holds several recordings behind each other.
    parts = groupby(lines, key=lambda line: line.kind is LineKind.HEADER)
    sessions = [list(session) for is_header, session in parts if not is_header]
    for session, following in zip_longest(sessions, sessions[1:], fillvalue=list[BoardLine]()):
        _assemble_session(session, following, assembly)
    return assembly


def _assemble_session(lines: list[BoardLine], following: list[BoardLine], assembly: Assembly) -> None:
    """Put the frames of a session together; headers and then ``following`` may stand behind it."""
    marks = [index for index, line in enumerate(lines) if line.kind is LineKind.MARK]
    # Where a whole frame's rows stand before the first mark that follows, headers were put between it and its mark.
    before_mark = list(takewhile(lambda line: line.kind is not LineKind.MARK, following))
    frame_follows = sum(line.kind is LineKind.ROW for line in before_mark) == assembly.pairs
    for begin, end in zip_longest(marks, marks[1:]):
        inside = lines[begin + 1 : end]
        rows = tuple(line for line in inside if line.kind is LineKind.ROW)
        bad_lines = tuple(line.number for line in inside if line.kind in (LineKind.GARBLED, LineKind.TORN))
        if len(rows) == assembly.pairs and not bad_lines:
            assembly.frames.append(rows)
        elif bad_lines or (inside and (end is not None or following)) or (end is None and frame_follows):
            why = f"{len(rows)} whole rows where a frame has {assembly.pairs}"
            if end is None and following:
                why += f", then headers, and the recording continues in line {following[0].number}"
            assembly.dropped.append(DroppedFrame(lines[begin].number, lines[begin:end][-1].number, bad_lines, why))


def _list_dumps(lines: list[BoardLine]) -> list[RowProblem]:
    """Describe each stretch of log lines once, at its first line."""
    dumps: list[RowProblem] = []
    rows_before = False
    for logged, group in groupby(lines, key=lambda line: line.kind in (LineKind.LOG, LineKind.TORN)):
        stretch = list(group)
        if logged:
            dumps.append(_describe_dump(stretch, rows_before))
        rows_before = rows_before or any(line.kind is LineKind.ROW for line in stretch)
    return dumps


def _describe_dump(stretch: list[BoardLine], rows_before: bool) -> RowProblem:
    text = " ".join(line.said for line in stretch)
    if "task_wdt" in text or "Backtrace" in text:
        name = "watchdog dump"
    else:
        name = "log of the board" if rows_before else "start-up log of the board"
    lines = f"lines {stretch[0].number} to {stretch[-1].number}, {len(stretch)} lines"
    return RowProblem(stretch[0].number, f"{name} ({lines}): left out, no readings in it", False)
