"""Readings of the SMU rig's CSV: one line each, 256 a frame."""

import math
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.recording import RowProblem

COLUMNS: Final = 7  # time, voltage, i_src, force, x, y, z
#: ``i_src`` is read once per this many readings and ``nan`` otherwise: a mark that shows where lines were lost.
CURRENT_EVERY: Final = 16

_SATURATED = re.compile(r"^(?P<value>\S+)\s+MAX VOLTAGE ERROR$")


@dataclass(frozen=True, slots=True)
class Reading:
    """One line.

    Parameters
    ----------
    line : 1-based.
    time_s, voltage : as written; a bad line keeps its place in the scan with ``bad`` set.
    saturated : whether the source was at its voltage limit.
    current_A : None where it was not read.
    others : force [N], x, y, z [mm].
    bad : what is wrong; empty if nothing is.
    """

    line: int
    time_s: float
    voltage: float
    saturated: bool
    current_A: float | None
    others: tuple[float, ...]
    bad: str = ""


def read_sessions(path: Path) -> tuple[list[list[Reading]], list[RowProblem]]:
    """Read all lines; a file may have been appended to, then its headers repeat and each part is a session."""
    sessions: list[list[Reading]] = [[]]
    problems: list[RowProblem] = []
    lines = path.read_bytes().decode("utf-8-sig", errors="replace").splitlines()
    for number, text in enumerate(lines, 1):
        fields = [field.strip() for field in text.split(",")]
        if not any(fields):
            continue
        if fields[0].startswith(("UTC:", "time_pc")):
            if sessions[-1]:
                sessions.append([])
            continue
        reading = _reading(number, fields)
        if reading.bad:
            problems.append(RowProblem(number, reading.bad, True))
        sessions[-1].append(reading)
    filled = [_with_lost_lines(session, problems) for session in sessions if session]
    if not filled:
        raise RecordingError(
            f"{path.name} holds only headers, not one reading" if lines else f"{path.name} is empty",
            remedy="record again, or analyse another file",
        )
    return filled, problems


def _reading(number: int, fields: list[str]) -> Reading:
    if len(fields) != COLUMNS:
        return _bad(number, f"{len(fields)} fields where a reading has {COLUMNS}")
    saturated = _SATURATED.match(fields[1])
    texts = [fields[0], saturated["value"] if saturated else fields[1], *fields[2:]]
    try:
        time_s, voltage, current, *others = (float(text) for text in texts)
    except ValueError:
        wrong = next(text for text in texts if not _is_number(text))
        return _bad(number, f"{wrong[:40]!r} is not a number")
    if not (abs(time_s) < float("inf") and abs(voltage) < float("inf")):
        return _bad(number, f"time {time_s} or voltage {voltage} is not a finite number")
    return Reading(
        number, time_s, voltage, saturated is not None, None if math.isnan(current) else current, tuple(others)
    )


def _bad(number: int, why: str) -> Reading:
    return Reading(number, float("nan"), 0.0, False, None, (), why)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _with_lost_lines(session: list[Reading], problems: list[RowProblem]) -> list[Reading]:
    """Put placeholders where lines were lost: there two current readings are not a multiple of 16 lines apart."""
    at = [k for k, reading in enumerate(session) if reading.current_A is not None]
    inserted: dict[int, int] = {}
    for before, after in pairwise(at):
        if lost := -(after - before) % CURRENT_EVERY:
            inserted[after] = lost
            problems.append(RowProblem(session[after].line, f"{lost} lines are missing before this one", False))
    if not inserted or len(inserted) > len(at) / 2:
        return session
    out: list[Reading] = []
    for k, reading in enumerate(session):
        out += [_bad(reading.line, "a line is missing")] * inserted.get(k, 0)
        out.append(reading)
    return out
