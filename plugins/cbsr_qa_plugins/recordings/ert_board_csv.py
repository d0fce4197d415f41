"""Recordings of the ERT board, as the lab's two recorder scripts write them (format ``ert-board-csv``)."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.frames import FrameBlock, VoltageUnit
from cbsr_qa.domain.recording import ReadOptions, Recording, RowProblem, ScanKind
from cbsr_qa_plugins.recordings.ert_board_clock import board_clock, force_samples, frame_times
from cbsr_qa_plugins.recordings.ert_board_frames import Assembly, assemble
from cbsr_qa_plugins.recordings.ert_board_rows import PAIRS, Line, LineKind, complaint, parse_line

_TITLE = re.compile(rb"(?im)^\s*time(_pc)? \[s\],.*data")
_WITH_MASS = re.compile(r"(?i)mass")


class ErtBoardCsv:
    """Reads every variant of the ERT board's CSV files.

    Values are converter counts whatever the titles say (they promise mV, the firmware's conversion is commented out).
    Row i of a frame is drive pair i, column j measure pair j; the board scans a row after the other.
    """

    def recognises(self, path: Path, head: bytes) -> bool:
        """Tell by the titles, or by the ``UTC:`` line of a file that is cut right after it."""
        if b"voltage [V]" in head:
            return False
        text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
        return bool(_TITLE.search(head)) or (text.startswith(b"UTC:") and b"[s]" not in head)

    def datasets(self, path: Path) -> tuple[str, ...]:
        """Such a file is one data set."""
        return ()

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read a file.

        Returns
        -------
        Recording with (n, 16, 16) frames, or (n, 1, 16) where the board ran in calibration mode.

        Raises
        ------
        RecordingError
            If the file is empty, holds only headers, or no frame is complete.
        """
        if options.dataset:
            raise RecordingError(f"{path.name} is one data set; it has none named {options.dataset!r}")
        lines = _lines(path)
        _refuse_without_rows(path, lines)
        width = _row_width(lines)
        lines, problems = _judged(lines, width)
        scan = _scan_kind(lines)
        assembly = assemble(lines, scan)
        if not assembly.frames:
            raise RecordingError(
                f"{path.name} holds no complete frame: {_inventory(lines, problems)}; {_needed(scan)}",
                remedy="record for longer, or analyse another file",
            )
        return _recording(path, lines, width, scan, assembly, problems)


def _lines(path: Path) -> list[Line]:
    text = path.read_bytes().decode("utf-8-sig", errors="replace").replace("\x00", "")
    raw = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    title = next((line for line in raw[:10] if line.lower().lstrip().startswith("time")), "")
    with_mass = bool(_WITH_MASS.search(title)) if title else True
    parsed = (parse_line(number, line, with_mass=with_mass) for number, line in enumerate(raw, 1))
    return [line for line in parsed if line.kind is not LineKind.BLANK]


def _refuse_without_rows(path: Path, lines: list[Line]) -> None:
    if not lines:
        raise RecordingError(f"{path.name} is empty", remedy="record again, or analyse another file")
    kinds = Counter(line.kind for line in lines)
    if kinds[LineKind.ROW] == kinds[LineKind.GARBLED] == 0:
        said = f"{kinds[LineKind.HEADER]} header lines"
        said += f" and {kinds[LineKind.LOG]} log lines" if kinds[LineKind.LOG] else ""
        raise RecordingError(
            f"{path.name} holds only headers ({said}), not one row of readings",
            remedy="the board sent nothing: check its cable and power, then record again",
        )


def _row_width(lines: list[Line]) -> int:
    """Numbers of a good row: 17 where the board's clock is in front; the titles say so always, and are wrong."""
    widths = Counter(len(line.numbers) for line in lines if line.kind is LineKind.ROW)
    return PAIRS + 1 if widths[PAIRS + 1] >= widths[PAIRS] and widths[PAIRS + 1] else PAIRS


def _judged(lines: list[Line], width: int) -> tuple[list[Line], list[RowProblem]]:
    """Turn bad rows into garbled ones and say what is wrong with each."""
    judged: list[Line] = []
    for line in lines:
        what = complaint(line.numbers, width) if line.kind is LineKind.ROW else ""
        judged.append(replace(line, kind=LineKind.GARBLED, said=what) if what else line)
    if width > PAIRS:
        judged = _clock_outliers(judged)
    problems = [
        RowProblem(line.number, line.said, line.kind is LineKind.GARBLED)
        for line in judged
        if line.kind in (LineKind.GARBLED, LineKind.TORN)
    ]
    return judged, problems


def _clock_outliers(lines: list[Line]) -> list[Line]:
    """A row whose board time does not lie between its neighbours', which agree, is not a row of this board."""
    rows = [k for k, line in enumerate(lines) if line.kind is LineKind.ROW]
    out = list(lines)
    for before, here, after in zip(rows, rows[1:], rows[2:], strict=False):
        first, own, last = (lines[k].numbers[0] for k in (before, here, after))
        if first <= last and not first <= own <= last and out[before].kind is LineKind.ROW:
            said = f"absurd: the board's clock says {own} ms between rows at {first} and {last} ms"
            out[here] = replace(lines[here], kind=LineKind.GARBLED, said=said)
    return out


def _scan_kind(lines: list[Line]) -> ScanKind:
    """One row a mark is the board's calibration mode. What the log says about the mode is not reliable."""
    counts: list[int] = []
    for line in lines:
        if line.kind is LineKind.MARK:
            counts.append(0)
        elif line.kind in (LineKind.ROW, LineKind.GARBLED) and counts:
            counts[-1] += 1
    whole = counts[:-1] or counts
    ones = sum(count <= 1 for count in whole)
    return ScanKind.DRIVEN_PAIRS if len(counts) > 1 and 2 * ones > len(whole) else ScanKind.FULL


def _inventory(lines: list[Line], problems: list[RowProblem]) -> str:
    kinds = Counter(line.kind for line in lines)
    said = f"{kinds[LineKind.ROW]} good rows, {len(problems)} rejected, {kinds[LineKind.MARK]} frame marks"
    worst = "; ".join(f"line {problem.line}: {problem.what}" for problem in problems[:3])
    return f"{said} ({worst})" if worst else said


def _needed(scan: ScanKind) -> str:
    return f"a frame is a mark and {PAIRS} rows" if scan is ScanKind.FULL else "a frame is one row"


def _recording(
    path: Path, lines: list[Line], width: int, scan: ScanKind, assembly: Assembly, problems: list[RowProblem]
) -> Recording:
    clock = board_clock(lines, width)
    counts, unwrapped = _unsigned(assembly.counts(), scan)
    block = FrameBlock(
        frame_times(assembly, clock),
        counts,
        np.zeros(counts.shape, dtype=np.uint8),
        VoltageUnit.COUNT,
        _current(lines, scan),
    )
    samples, force_notes = force_samples(lines, clock, clock.at(assembly.frames[0]))
    notes = [*clock.notes, *force_notes, *assembly.notes]
    if unwrapped:
        notes.append("counts are unsigned but were printed as signed 16-bit numbers; they are read as unsigned")
    return Recording(
        path=path,
        format="ert-board-csv",
        dataset="",
        scan=scan,
        frames=block,
        reference=None,
        still=False,
        magnitudes_only=False,
        clock=clock.name,
        samples=samples,
        problems=tuple(sorted((*_with_frames(problems, assembly), *clock.problems), key=lambda p: p.line)),
        notes=tuple(notes),
    )


def _with_frames(problems: list[RowProblem], assembly: Assembly) -> list[RowProblem]:
    """Say beside each rejected row which frame it cost; frames that broke without one are problems of their own."""
    cost = {line: dropped.span for dropped in assembly.dropped for line in dropped.rejected_lines}
    said = [replace(p, what=f"{p.what}; {cost[p.line]} dropped") if p.line in cost else p for p in problems]
    for dropped in assembly.dropped:
        if not dropped.rejected_lines:
            said.append(RowProblem(dropped.first_line, f"{dropped.span} dropped: {dropped.why}", False))
    return said + list(assembly.dumps)


def _unsigned(counts: np.ndarray, scan: ScanKind) -> tuple[np.ndarray, bool]:
    """A driven pair's own voltage cannot be negative: a one-row scan of negative counts is wrapped at 2¹⁵."""
    if scan is ScanKind.DRIVEN_PAIRS and np.mean(counts < 0) > 0.5:
        return np.where(counts < 0, counts + 2**16, counts), True
    return counts, False


def _current(lines: list[Line], scan: ScanKind) -> float | None:
    """Drive current [A] from ``Isrc:`` in µA; it was typed in by hand and may be text such as ``100plus``."""
    stated = next((line.said for line in lines if line.kind is LineKind.HEADER and line.said.startswith("Isrc")), "")
    try:
        return float(stated.split(",")[1]) * 1e-6
    except (IndexError, ValueError):
        return None
