"""Recordings of the ERT board, as the lab's two recorder scripts write them (format ``ert-board-csv``)."""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.plugin import FrameBlock, Recording, RecordingError, RowProblem, ScanKind, Transcript, VoltageUnit
from cbsr_qa_plugins.hardware._board_stream import BOARDS
from cbsr_qa_plugins.recordings.ert_board_clock import board_clock, force_samples, frame_times
from cbsr_qa_plugins.recordings.ert_board_rows import (
    Assembly,
    BoardLine,
    CountScale,
    LineKind,
    RowForm,
    assemble,
    complaint,
    count_scale,
    parse_line,
)
from cbsr_qa_plugins.recordings.ert_board_writer import write_ert_board
from cbsr_qa_plugins.recordings.lab_files import (
    MOST_BAD_IN_A_ROW,
    OneDataSet,
    find_simulation_marks,
    number,
    text_lines,
)

_TITLE = re.compile(rb"(?im)^\s*time(_pc)? \[s\],.*data")
_WITH_MASS = re.compile(r"(?i)mass")
#: Lines among which the titles are.
_TOP: Final = 10
#: The file states the drive current in µA; this board drives far less than an ampere.
_MAX_CURRENT_UA: Final = 1e6
#: Numbers of rows, without and with the board's clock.
_WIDTHS: Final = frozenset(pairs + clock for pairs in BOARDS for clock in (0, 1))


class ErtBoardCsv(OneDataSet):
    """Reads every variant of the ERT board's CSV files, and writes simulated scenes as one of them.

    Values are converter counts whatever the titles say (they promise mV, the firmware's conversion is commented out).
    Row i of a frame is drive pair i, column j measure pair j; the board scans a row after the other. Frames are
    (n, 16, 16), or (n, 1, 16) where the board ran in calibration mode; of a board of 32 pairs, as its rows say, 32.
    """

    def recognises(self, path: Path, head: bytes) -> bool:
        """Recognise the titles, or the ``UTC:`` line of a file cut right after it."""
        if b"voltage [V]" in head:
            return False
        text = head.removeprefix(b"\xef\xbb\xbf").lstrip().replace(b"\r", b"\n")
        return bool(_TITLE.search(text)) or (text.startswith(b"UTC:") and b"[s]" not in head)

    def _read(self, path: Path) -> Recording:
        lines, given_up = _lines(path)
        _refuse_without_rows(path, lines)
        form = _row_form(lines)
        rows = [line.numbers for line in lines if line.kind is LineKind.ROW and len(line.numbers) == form.width]
        scale = count_scale([numbers[-form.pairs :] for numbers in rows])
        lines, problems = _replace_bad_rows(lines, form, scale)
        problems += given_up
        scan = _scan_kind(lines)
        assembly = assemble(lines, scan, form.pairs)
        if not assembly.frames:
            kinds = Counter(line.kind for line in lines)
            inventory = (
                f"{kinds[LineKind.ROW]} good rows, {len(problems)} rejected, {kinds[LineKind.MARK]} frame marks"
            )
            if problems:
                inventory += f" ({'; '.join(f'line {problem.line}: {problem.what}' for problem in problems[:3])})"
            frame = f"a mark and {form.pairs} rows" if scan is ScanKind.FULL else "one row"
            raise RecordingError(
                f"{path.name} holds no complete frame: {inventory}; a frame is {frame}",
                remedy="record for longer, or analyse another file",
                problems=sorted(_with_frames(problems, assembly), key=lambda p: p.line),
            )
        recording = _recording(path, lines, form, scan, assembly, problems)
        return replace(recording, notes=(*recording.notes, scale.note)) if scale.note else recording

    def write(self, path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
        return write_ert_board(path, recording, transcript)


def _lines(path: Path) -> tuple[list[BoardLine], list[RowProblem]]:
    """Take the lines apart; give up, and say so, where thousands in a row hold no reading."""
    lines: list[BoardLine] = []
    bad = 0
    for line in _parse_file(path):
        lines.append(line)
        good = line.kind is LineKind.MARK or (line.kind is LineKind.ROW and len(line.numbers) in _WIDTHS)
        bad = 0 if good else bad + 1
        if bad == MOST_BAD_IN_A_ROW:
            problem = f"{bad} lines in a row hold no row of readings; the rest of the file was not read"
            return lines, [RowProblem(line.number, problem, False)]
    return lines, []


def _parse_file(path: Path) -> Iterator[BoardLine]:
    raw = text_lines(path)
    top = list(islice(raw, _TOP))
    title = next((line.text for line in top if line.text.lower().lstrip().startswith("time")), "")
    with_mass = bool(_WITH_MASS.search(title)) if title else True
    for text in chain(top, raw):
        line = parse_line(text.number, text.text, with_mass=with_mass)
        if text.too_long:
            problem = f"a line of more than {len(text.text)} characters"
            line = BoardLine(text.number, LineKind.GARBLED, line.computer_s, said=problem)
        elif line.kind is LineKind.ROW and not text.ended and not line.closed:
            line = replace(line, kind=LineKind.GARBLED, said="cut row: the file ends in the middle of it")
        if line.kind is not LineKind.BLANK:
            yield line


def _refuse_without_rows(path: Path, lines: list[BoardLine]) -> None:
    if not lines:
        raise RecordingError(f"{path.name} is empty", remedy="record again, or analyse another file")
    kinds = Counter(line.kind for line in lines)
    if kinds[LineKind.ROW] == kinds[LineKind.GARBLED] == 0:
        contents = f"{kinds[LineKind.HEADER]} header lines"
        contents += f" and {kinds[LineKind.LOG]} log lines" if kinds[LineKind.LOG] else ""
        raise RecordingError(
            f"{path.name} holds only headers ({contents}), not one row of readings",
            remedy="the board sent nothing: check its cable and power, then record again",
        )


def _row_form(lines: list[BoardLine]) -> RowForm:
    """Find what good rows hold: what most of them do.

    Two rows of a small board that were joined are as long as one of a large board. The titles always promise the
    board's clock, and are wrong.
    """
    widths = Counter(len(line.numbers) for line in lines if line.kind is LineKind.ROW)
    pairs = max(BOARDS, key=lambda board: widths[board] + widths[board + 1])
    return RowForm(pairs, widths[pairs + 1] >= widths[pairs] and widths[pairs + 1] > 0)


def _replace_bad_rows(
    lines: list[BoardLine], form: RowForm, scale: CountScale
) -> tuple[list[BoardLine], list[RowProblem]]:
    """Replace bad rows by garbled ones that describe the fault."""
    judged: list[BoardLine] = []
    # The board prints a comma behind each number; a spreadsheet that saved the file again took the last one away.
    closed = [line.closed for line in lines if line.kind is LineKind.ROW and len(line.numbers) == form.width]
    commas = sum(closed) > len(closed) / 2
    for line in (_scale_row(line, form, scale) for line in lines):
        problem = complaint(line.numbers, form, scale) if line.kind is LineKind.ROW else ""
        if line.kind is LineKind.ROW and commas and not line.closed:
            problem = problem or "cut row: no comma behind the last number, which may be cut too"
        judged.append(replace(line, kind=LineKind.GARBLED, said=problem) if problem else line)
    if form.has_clock:
        judged = _clock_outliers(judged)
    faulty = [line for line in judged if line.kind in (LineKind.GARBLED, LineKind.TORN)]
    return judged, [RowProblem(line.number, line.said, line.kind is LineKind.GARBLED) for line in faulty]


def _scale_row(line: BoardLine, form: RowForm, scale: CountScale) -> BoardLine:
    if scale.factor == 1 or line.kind is not LineKind.ROW or len(line.numbers) != form.width:
        return line
    clock, readings = line.numbers[: -form.pairs], line.numbers[-form.pairs :]
    if any(n % scale.factor and (k, n) not in scale.stuck for k, n in enumerate(readings)):
        problem = f"impossible: a reading is not a multiple of {scale.factor}, as all others are"
        return replace(line, kind=LineKind.GARBLED, said=problem)
    return replace(line, numbers=(*clock, *(round(value / scale.factor) for value in readings)))


def _clock_outliers(lines: list[BoardLine]) -> list[BoardLine]:
    """A row whose board time does not lie between its neighbours', which agree, is not a row of this board."""
    rows = [k for k, line in enumerate(lines) if line.kind is LineKind.ROW]
    out = list(lines)
    for before, here, after in zip(rows, rows[1:], rows[2:], strict=False):
        first, own, last = (lines[k].numbers[0] for k in (before, here, after))
        if first <= last and not first <= own <= last and out[before].kind is LineKind.ROW:
            problem = f"absurd: the board's clock says {own} ms between rows at {first} and {last} ms"
            out[here] = replace(lines[here], kind=LineKind.GARBLED, said=problem)
    return out


def _scan_kind(lines: list[BoardLine]) -> ScanKind:
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


def _recording(
    path: Path, lines: list[BoardLine], form: RowForm, scan: ScanKind, assembly: Assembly, problems: list[RowProblem]
) -> Recording:
    clock = board_clock(lines, form)
    counts = assembly.counts()
    # A driven pair's own voltage cannot be negative: a one-row scan of negative counts is wrapped at 2¹⁵.
    is_wrapped = scan is ScanKind.DRIVEN_PAIRS and np.mean(counts < 0) > 0.5
    if is_wrapped:
        counts = np.where(counts < 0, counts + 2**16, counts)
    current_A, current_note = _current(lines)
    flags = np.zeros(counts.shape, dtype=np.uint8)
    block = FrameBlock(frame_times(assembly, clock), counts, flags, VoltageUnit.COUNT, current_A)
    samples, force_notes = force_samples(lines, clock, clock.frame_middle_s(assembly.frames[0]))
    notes = [*clock.notes, *force_notes, *current_note]
    if is_wrapped:
        notes.append("counts are unsigned but were printed as signed 16-bit numbers; they are read as unsigned")
    return Recording(
        path=path,
        format="ert-board-csv",
        dataset="",
        scan=scan,
        frames=block,
        clock=clock.name,
        samples=samples,
        problems=tuple(sorted((*_with_frames(problems, assembly), *clock.problems), key=lambda p: p.line)),
        notes=tuple(notes),
        frames_dropped=len(assembly.dropped),
        simulated=find_simulation_marks(line.said for line in lines if line.kind is LineKind.HEADER),
    )


def _with_frames(problems: list[RowProblem], assembly: Assembly) -> list[RowProblem]:
    """Say beside each rejected row which frame it cost; frames that broke without one are problems of their own."""
    cost = {line: dropped.span for dropped in assembly.dropped for line in dropped.rejected_lines}
    with_frames = [replace(p, what=f"{p.what}; {cost[p.line]} dropped") if p.line in cost else p for p in problems]
    for dropped in assembly.dropped:
        if not dropped.rejected_lines:
            with_frames.append(RowProblem(dropped.first_line, f"{dropped.span} dropped: {dropped.why}", False))
    return with_frames + list(assembly.dumps)


def _current(lines: list[BoardLine]) -> tuple[float | None, list[str]]:
    """Drive current [A] from ``Isrc:`` in µA; it was typed in by hand and may be text such as ``100plus``."""
    stated = [line.said for line in lines if line.kind is LineKind.HEADER and line.said.lower().startswith("isrc")]
    texts = {text.partition(",")[2].partition(",")[0].strip() for text in stated}
    if not any(texts):
        return None, []
    if len(texts) > 1:
        return None, [f"the file states different drive currents ({', '.join(sorted(texts))} µA): none is used"]
    (text,) = texts
    current_uA = number(text) or 0.0
    if not 0 < current_uA <= _MAX_CURRENT_UA:
        return None, [f"Isrc is {text[:20]!r}, which is no current in µA: the current is not stated"]
    return current_uA * 1e-6, []
