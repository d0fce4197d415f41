"""Lines of the SMU rig's CSV, a line a reading: read in stretches without gaps, and written from simulated scenes."""

import math
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import ReadingFlag, Recording, RecordingError, RefusedError, RowProblem, Transcript
from cbsr_qa_plugins.recordings import lab_files

TITLES: Final = ("time_pc [s]", "voltage [V]", "i_src [A]", "f [N]", "x [mm]", "y [mm]", "z [mm]")
COLUMNS: Final = len(TITLES)
#: ``i_src`` is read once per this many readings and ``nan`` otherwise: a mark that shows where lines were lost.
CURRENT_EVERY: Final = 16
#: Readings a frame.
FRAME: Final = 256

_SATURATED = re.compile(r"^(?P<value>\S+)\s+MAX VOLTAGE ERROR$")
#: Unix time will reach it in the year 5138; no source of this rig reaches a kilovolt or an ampere.
_MAX_TIME_S: Final = 1e11
MOST_V: Final = 1e3
MOST_A: Final = 1.0


@dataclass(frozen=True, slots=True)
class Reading:
    """One line.

    Parameters
    ----------
    line : 1-based.
    time_s, voltage : as written; a bad line keeps its place in the scan with ``bad`` set.
    saturated : whether the source was at its voltage limit.
    current_A : None if not read.
    others : force [N], x, y, z [mm].
    bad : what is wrong; empty if nothing is.
    copy : whether the line above reads the same.
    """

    line: int
    time_s: float
    voltage: float
    saturated: bool
    current_A: float | None
    others: tuple[float, ...]
    bad: str = ""
    copy: bool = False


@dataclass(frozen=True, slots=True)
class Stretch:
    """Readings that follow each other without a gap.

    Parameters
    ----------
    readings : at least one.
    counted_at : position in the scan (0 to 255) of the first one, by counting from the one before; None where
        nothing stands before: headers were repeated, or it is the first of the file.
    """

    readings: list[Reading]
    counted_at: int | None


def read_stretches(path: Path) -> tuple[list[Stretch], list[RowProblem], tuple[str, ...]]:
    """Read all lines; a file may have been appended to, then its headers repeat, and lines may be lost or doubled.

    Returns
    -------
    The stretches, what is wrong with lines, and what the headers say was simulated.
    """
    sessions: list[list[Reading]] = [[]]
    problems: list[RowProblem] = []
    headers: list[str] = []
    before, bad, number = "", 0, 0
    for line in lab_files.text_lines(path):
        number, text = line.number, line.text
        fields = [field.strip() for field in text.split(",")]
        if not any(fields):
            continue
        if fields[0].startswith(("UTC:", "time_pc")):
            _check_titles(path, fields)
            headers.append(text)
            if sessions[-1]:
                sessions.append([])
            continue
        reading = _reading(number, fields, copy=text == before)
        before, bad = text, bad + 1 if reading.bad else 0
        if reading.bad:
            problems.append(RowProblem(number, reading.bad, True))
        sessions[-1].append(reading)
        if bad == lab_files.MOST_BAD_IN_A_ROW:
            problem = f"{bad} lines in a row are no readings; the rest of the file was not read"
            problems.append(RowProblem(number, problem, False))
            break
    stretches = [stretch for session in sessions if session for stretch in _stretches(session, problems)]
    if not stretches:
        raise RecordingError(
            f"{path.name} holds only headers, not one reading" if number else f"{path.name} is empty",
            remedy="record again, or analyse another file",
        )
    return stretches, problems, lab_files.find_simulation_marks(headers)


def _check_titles(path: Path, fields: list[str]) -> None:
    titles = [field for field in fields if field]
    if not titles[0].startswith("time_pc") or len(titles) >= COLUMNS:
        return
    known_titles = {title.split()[0] for title in titles}
    missing = [title for title in TITLES if title.split()[0] not in known_titles]
    raise RecordingError(
        f"{path.name} has {len(titles)} columns where this format has {COLUMNS}; missing: {', '.join(missing)}",
        remedy="record force and position too; a column that was not measured may hold nan",
    )


def _reading(number: int, fields: list[str], *, copy: bool) -> Reading:
    if len(fields) != COLUMNS:
        return _bad(number, f"{len(fields)} fields where a reading has {COLUMNS}")
    saturated = _SATURATED.match(fields[1])
    texts = [fields[0], saturated["value"] if saturated else fields[1], *fields[2:]]
    values: list[float] = []
    for text in texts:
        try:
            values.append(float(text))
        except ValueError:
            return _bad(number, f"{text[:40]!r} is not a number")
    time_s, voltage, current, *others = values
    if not (abs(time_s) <= _MAX_TIME_S and abs(voltage) <= MOST_V):
        return _bad(number, f"time {time_s} s or voltage {voltage} V is not a possible number")
    if abs(current) > MOST_A:
        return _bad(number, f"current {current} A is not a possible number")
    current_A = None if math.isnan(current) else current
    return Reading(number, time_s, voltage, saturated is not None, current_A, tuple(others), copy=copy)


def _bad(number: int, why: str) -> Reading:
    return Reading(number, float("nan"), 0.0, False, None, (), why)


def _stretches(session: list[Reading], problems: list[RowProblem]) -> list[Stretch]:
    """Cut a session where two current readings are not a multiple of 16 lines apart; copies of lines go first."""
    session = _drop_copies(session, problems)
    current_lines = [k for k, reading in enumerate(session) if reading.current_A is not None]
    gaps = [(before, after) for before, after in pairwise(current_lines) if (after - before) % CURRENT_EVERY]
    if len(gaps) > len(current_lines) / 2:  # the current is not read in this rhythm here
        gaps = []
    out: list[Stretch] = []
    start, counted_at = 0, None
    for before, after in gaps:
        count = after - before
        what = f"{count - 1} lines between two readings of the current, not a multiple of {CURRENT_EVERY} less one"
        what += f": {-count % CURRENT_EVERY} lines are missing before this one, or {count % CURRENT_EVERY} too many"
        problems.append(RowProblem(session[after].line, what, False))
        out.append(Stretch(session[start : before + 1], counted_at))
        whole = -(-count // CURRENT_EVERY) * CURRENT_EVERY
        start, counted_at = after, ((counted_at or 0) + before - start + whole) % FRAME
    return [*out, Stretch(session[start:], counted_at)]


def _drop_copies(session: list[Reading], problems: list[RowProblem]) -> list[Reading]:
    current_lines = [k for k, reading in enumerate(session) if reading.current_A is not None]
    dropped: set[int] = set()
    for before, after in pairwise(current_lines):
        copies = {k for k in range(before + 1, after + 1) if session[k].copy}
        if (after - before) % CURRENT_EVERY and (after - before - len(copies)) % CURRENT_EVERY == 0:
            dropped |= copies
    problem = "the line is written twice; the copy is left out"
    problems += [RowProblem(session[k].line, problem, True) for k in sorted(dropped)]
    return [reading for k, reading in enumerate(session) if k not in dropped]


NAME: Final = "smu-rig-csv"
#: Channels in the order of their columns, with their units.
CHANNELS: Final = (("force", "N"), ("x", "mm"), ("y", "mm"), ("z", "mm"))


def write_smu_rig(path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
    """Write a recording, reading by reading, the current pair as the inner loop.

    ``i_src`` stands in the first line that arrives of each 16. Force and place are interpolated at the reading's
    time, keep their first and last value outside the samples, and are ``nan`` where there is no such channel.

    Returns
    -------
    What the file does not say, in words.
    """
    lab_files.refuse_unfit(NAME, path, recording, transcript)
    times_s = lab_files.reading_times(NAME, recording, transcript, "drive")
    _refuse_numbers(recording, transcript)
    zero_s = float(times_s[0, 0, 0])
    current = "nan" if recording.frames.current_A is None else repr(float(recording.frames.current_A))
    with lab_files.new_text_file(path) as file:
        file.write(lab_files.utc_line(recording) + ",".join(TITLES) + "\n")
        for frame, lost in enumerate(transcript.lost):
            if not lost.all():
                file.writelines(_frame_lines(recording, frame, times_s[frame], zero_s, lost, current))
    return tuple(_list_omissions(recording, transcript))


def _frame_lines(
    recording: Recording, frame: int, times_s: Array, zero_s: float, lost: NDArray[np.bool_], current: str
) -> list[str]:
    """Lines of one frame, without those of lost rows."""
    scan_s = times_s.T.ravel()
    columns: list[list[str]] = []
    for channel, unit in CHANNELS:
        block = lab_files.channel(recording, channel, unit)
        values = np.full(len(scan_s), np.nan) if block is None else np.interp(scan_s, block.time_s, block.values)
        columns.append([f"{value:.6g}" for value in values.tolist()])
    volts = recording.frames.voltages[frame].T.ravel().tolist()
    at_limit = (recording.frames.flags[frame].T.ravel() & ReadingFlag.COMPLIANCE.value) > 0
    gone = lost.tolist() * lab_files.ELECTRODES
    read_at = gone.index(False)  # place of the line with the current within each 16
    out = []
    for k, (time_s, volt, limit, others) in enumerate(
        zip((scan_s - zero_s).tolist(), volts, at_limit.tolist(), zip(*columns, strict=True), strict=True)
    ):
        if not gone[k]:
            voltage_text = f"{volt!r} MAX VOLTAGE ERROR" if limit else repr(volt)
            source = current if k % CURRENT_EVERY == read_at else "nan"
            out.append(f"{time_s:.6f},{voltage_text},{source},{','.join(others)}\n")
    return out


def _refuse_numbers(recording: Recording, transcript: Transcript) -> None:
    """Refuse what the format's reader would take for a broken line, or could not find the place in the scan of."""
    current_A = recording.frames.current_A
    largest_V = float(np.abs(recording.frames.voltages).max())
    if largest_V > MOST_V or (current_A is not None and not abs(current_A) <= MOST_A):
        raise RefusedError(
            f"readings reach {largest_V:g} V at {current_A} A; {NAME} holds up to {MOST_V:g} V and {MOST_A:g} A",
            remedy="drive a smaller current, or write cbsr-recording",
        )
    if current_A is None and transcript.lost.any():
        raise RefusedError(
            f"rows are lost, which {NAME} shows by the drive current alone; the recording states none",
            remedy="state the current, or take frame-loss out of the scene",
        )


def _list_omissions(recording: Recording, transcript: Transcript) -> list[str]:
    carried = [name for name, unit in CHANNELS if lab_files.channel(recording, name, unit) is not None]
    omissions = lab_files.list_omissions(recording, transcript, carried, ReadingFlag.SATURATED)
    if transcript.dumps:
        omissions.append(
            f"{len(transcript.dumps)} watchdog dumps are not written: this rig's multiplexer sends none;"
            " the times of readings, if recorded, contain their pauses"
        )
    absent = [name for name, _ in CHANNELS if name not in carried]
    if absent:
        omissions.append(f"columns of nan, since nothing recorded them: {', '.join(absent)}")
    return omissions
