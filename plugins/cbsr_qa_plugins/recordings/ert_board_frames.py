"""Whole frames out of the ERT board's lines."""

from dataclasses import dataclass, field
from itertools import takewhile, zip_longest

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RowProblem
from cbsr_qa.domain.recording import ScanKind
from cbsr_qa_plugins.recordings.ert_board_rows import PAIRS, Line, LineKind

Rows = tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class DroppedFrame:
    """A frame that is not whole.

    Parameters
    ----------
    first_line, last_line : of the file.
    rejected_lines : rows of it that were rejected.
    why : in words.
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
    """What was put together.

    Parameters
    ----------
    frames : rows of each whole frame, in time order.
    dropped : frames that broke between two marks. The one cut by the start or the end of the file is not among
        them: every recording has those.
    dumps : stretches of log lines, one entry each.
    """

    frames: list[Rows] = field(default_factory=list)
    dropped: list[DroppedFrame] = field(default_factory=list)
    dumps: list[RowProblem] = field(default_factory=list)

    def counts(self) -> NDArray[np.float64]:
        """Return the readings, (frames, rows, 16) float64 [counts]."""
        return np.array([[row.numbers[-PAIRS:] for row in rows] for rows in self.frames], dtype=np.float64)


def assemble(lines: list[Line], scan: ScanKind) -> Assembly:
    """Put frames together.

    Parameters
    ----------
    lines : of the whole file; bad rows are GARBLED.
    scan : FULL: a mark and 16 rows; DRIVEN_PAIRS: every row is a frame and marks only separate them.
    """
    assembly = Assembly(dumps=_dumps(lines))
    if scan is ScanKind.DRIVEN_PAIRS:
        assembly.frames = [(line,) for line in lines if line.kind is LineKind.ROW]
        return assembly
    sessions = _sessions(lines)
    nothing: list[Line] = []
    for session, following in zip_longest(sessions, sessions[1:], fillvalue=nothing):
        _assemble_session(session, following, assembly)
    return assembly


def _sessions(lines: list[Line]) -> list[list[Line]]:
    """Split at repeated headers: a file opened in append mode holds several recordings behind each other."""
    stretches: list[list[Line]] = [[]]
    for line in lines:
        if line.kind is LineKind.HEADER:
            if stretches[-1]:
                stretches.append([])
        else:
            stretches[-1].append(line)
    return [stretch for stretch in stretches if stretch]


def _assemble_session(lines: list[Line], following: list[Line], assembly: Assembly) -> None:
    """Put the frames of a session together; headers and then ``following`` may stand behind it."""
    marks = [k for k, line in enumerate(lines) if line.kind is LineKind.MARK]
    for begin, end in zip_longest(marks, marks[1:]):
        inside = lines[begin + 1 : end]
        rows = tuple(line for line in inside if line.kind is LineKind.ROW)
        bad = tuple(line.number for line in inside if line.kind in (LineKind.GARBLED, LineKind.TORN))
        if len(rows) == PAIRS and not bad:
            assembly.frames.append(rows)
        elif bad or (inside and (end is not None or following)) or (end is None and _begins_with_a_frame(following)):
            why = f"{len(rows)} whole rows where a frame has {PAIRS}"
            if end is None and following:
                why += f", then headers, and the recording goes on in line {following[0].number}"
            assembly.dropped.append(DroppedFrame(lines[begin].number, lines[begin:end][-1].number, bad, why))


def _begins_with_a_frame(lines: list[Line]) -> bool:
    """Whether a whole frame's rows stand before the first mark: then headers were put between it and its mark."""
    before = list(takewhile(lambda line: line.kind is not LineKind.MARK, lines))
    return sum(line.kind is LineKind.ROW for line in before) == PAIRS


def _dumps(lines: list[Line]) -> list[RowProblem]:
    """Name each stretch of log lines once, by its first line."""
    found: list[RowProblem] = []
    stretch: list[Line] = []
    rows_before = False
    for line in [*lines, None]:
        if line is not None and line.kind in (LineKind.LOG, LineKind.TORN):
            stretch.append(line)
            continue
        if stretch:
            found.append(_dump(stretch, rows_before))
            stretch = []
        rows_before = rows_before or (line is not None and line.kind is LineKind.ROW)
    return found


def _dump(stretch: list[Line], rows_before: bool) -> RowProblem:
    text = " ".join(line.said for line in stretch)
    if "task_wdt" in text or "Backtrace" in text:
        what = "watchdog dump"
    else:
        what = "log of the board" if rows_before else "start-up log of the board"
    lines = f"lines {stretch[0].number} to {stretch[-1].number}, {len(stretch)} lines"
    return RowProblem(stretch[0].number, f"{what} ({lines}): left out, no readings in it", False)
