"""Time and force in the ERT board's files: two clocks, and a load cell read on the slower one."""

from dataclasses import dataclass, field
from datetime import datetime
from itertools import pairwise

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import RowProblem, SampleBlock
from cbsr_qa_plugins.recordings.ert_board_rows import Assembly, BoardLine, LineKind, RowForm, Rows

#: Standard gravity [m/s²] turns the load cell's grams into newtons; compression is negative grams on this rig.
NEWTON_PER_GRAM = 9.80665e-3
#: The load cell of this rig ends here [g]; readings this close to it say "at least" [g].
_CELL_LIMIT_G, _CELL_LIMIT_BAND_G = 750.0, 3.0
#: A row older than this beside its mass is worth a note [s].
_NOTEWORTHY_LAG_S = 0.5
#: A step of the board's clock between neighbouring rows longer than this is worth a note [ms].
_NOTEWORTHY_GAP_MS = 1000


@dataclass(slots=True)
class RowClock:
    """Times of the rows.

    Parameters
    ----------
    name : ``"board"`` or ``"computer"``.
    row_s : line number → seconds, never falling.
    lag_s : how much later than on the board's clock the computer's time of an undelayed row is.
    sessions : line number → seconds to add to the computer's time (files opened in append mode restart it).
    """

    name: str
    row_s: dict[int, float]
    lag_s: float = 0.0
    sessions: dict[int, float] = field(default_factory=dict)
    problems: list[RowProblem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def frame_middle_s(self, rows: Rows) -> float:
        """Middle of a frame on this clock [s]."""
        return (self.row_s[rows[0].number] + self.row_s[rows[-1].number]) / 2


def board_clock(lines: list[BoardLine], form: RowForm) -> RowClock:
    """Set up the clock of a file: the board's where rows carry it, the computer's otherwise."""
    rows = [line for line in lines if line.kind is LineKind.ROW]
    offsets = _session_offsets(lines)
    timed = [(line.number, line.computer_s) for line in lines if line.computer_s is not None]
    computer = {number: time_s + offsets[number] for number, time_s in timed}
    # With less than one step per frame, the board's clock cannot separate frames.
    needed_times = max(2.0, len(rows) / form.pairs)
    stands_still = form.has_clock and len(rows) > 1 and len({row.numbers[0] for row in rows}) < needed_times
    if not form.has_clock or stands_still:
        times = np.maximum.accumulate([computer[row.number] for row in rows])
        rising = {row.number: float(time) for row, time in zip(rows, times, strict=True)}
        clock = RowClock("computer", rising, sessions=offsets)
        if stands_still:
            what = f"the board's clock stands still (at {rows[0].numbers[0]} ms here): the computer's clock is used"
            clock.problems.append(RowProblem(rows[0].number, what, False))
            clock.notes.append("the board's clock stands still: times are from the computer's clock")
        if len({clock.row_s[row.number] for row in rows}) < len(rows) / 4:
            _spread_repeated(clock, rows)
        return clock
    clock = RowClock("board", {}, sessions=offsets)
    _follow_board(clock, rows, computer)
    lags = np.array([computer[row.number] - clock.row_s[row.number] for row in rows])
    # A line is read after it was sent: the least delayed row gives the offset of the clocks.
    clock.lag_s = float(lags.min())
    worst = float(lags.max() - lags.min())
    if worst > _NOTEWORTHY_LAG_S:
        clock.notes.append(
            f"the computer read rows up to {worst:.1f} s after the board sent them: the force beside a row is that"
            " much younger than its readings; both are put on the board's clock"
        )
    return clock


def frame_times(assembly: Assembly, clock: RowClock) -> Array:
    """Middles of the frames [s] from the first one's, (frames,) float64."""
    middles = np.array([clock.frame_middle_s(rows) for rows in assembly.frames], dtype=np.float64)
    times: Array = middles - middles[0]
    return times


def force_samples(
    lines: list[BoardLine], clock: RowClock, zero_s: float
) -> tuple[tuple[SampleBlock, ...], list[str]]:
    """Force from the load cell's column, compression positive, on the frames' clock.

    Parameters
    ----------
    zero_s : the first complete frame on the clock [s].

    Returns
    -------
    One block of N, or none if the column is missing or constantly zero (load cell off), and notes.
    """
    force_lines = [line for line in lines if line.mass_g is not None and line.computer_s is not None]
    if not any(line.mass_g for line in force_lines):
        return (), []
    notes = []
    marked = [line for line in force_lines if line.kind is LineKind.MARK]
    if marked and not any(line.mass_g for line in force_lines if line.kind is not LineKind.MARK):
        force_lines = marked
        notes.append("the load cell was written on the frame marks only; the zeros beside the rows are not readings")
    times = np.array(
        [(line.computer_s or 0.0) + clock.sessions[line.number] - clock.lag_s - zero_s for line in force_lines]
    )
    mass_g = np.array([line.mass_g or 0.0 for line in force_lines])
    at_limit = int(np.sum(np.abs(mass_g + _CELL_LIMIT_G) < _CELL_LIMIT_BAND_G))
    if at_limit >= 3:
        notes.append(
            f"the force is flat near {_CELL_LIMIT_G * NEWTON_PER_GRAM:.2f} N for {at_limit} samples:"
            " the load cell's limit"
        )
    order = np.argsort(times, kind="stable")
    return (SampleBlock("force", "N", times[order], -mass_g[order] * NEWTON_PER_GRAM),), notes


def _follow_board(clock: RowClock, rows: list[BoardLine], computer: dict[int, float]) -> None:
    """Add up the board's steps; a step back (the board restarted) takes the computer's step instead."""
    now_s = rows[0].numbers[0] / 1000
    clock.row_s[rows[0].number] = now_s
    for before, row in pairwise(rows):
        step_ms = row.numbers[0] - before.numbers[0]
        if step_ms < 0:
            step_s = max(computer[row.number] - computer[before.number], 0.0)
            what = f"the board's clock steps back by {-step_ms} ms (restarted?); the computer's clock bridges it"
            clock.problems.append(RowProblem(row.number, what, False))
        else:
            step_s = step_ms / 1000
            if step_ms > _NOTEWORTHY_GAP_MS:
                clock.problems.append(RowProblem(row.number, f"the board's clock jumps by {step_ms} ms here", False))
        now_s += step_s
        clock.row_s[row.number] = now_s


def _spread_repeated(clock: RowClock, rows: list[BoardLine]) -> None:
    """A spreadsheet rounds Unix time to whole seconds: rows are spread evenly from the first second to the last.

    Second by second would be worse: the serial buffer delivers rows in bursts.
    """
    times = [clock.row_s[row.number] for row in rows]
    duration_s = times[-1] - times[0] + 1
    clock.row_s = {row.number: times[0] + (k + 0.5) * duration_s / len(rows) for k, row in enumerate(rows)}
    clock.notes.append(
        "times were rounded to whole seconds by a spreadsheet; rows are spread evenly over the recording,"
        f" whose length is known to about 1 s of {duration_s:.0f} s"
    )


def _session_offsets(lines: list[BoardLine]) -> dict[int, float]:
    """Seconds to add to the computer's time so that appended recordings follow each other on one clock."""
    offsets: dict[int, float] = {}
    offset, last_s, first_utc, pending = 0.0, 0.0, None, False
    for line in lines:
        if line.kind is LineKind.HEADER and line.said.startswith("UTC"):
            try:
                utc = datetime.fromisoformat(line.said.split(",")[1].strip())
            except (IndexError, ValueError):
                utc = None
            pending = bool(offsets) and last_s > 0
            if pending and utc is not None and first_utc is not None:
                offset = max((utc - first_utc).total_seconds(), 0.0)
                pending = False
            first_utc = first_utc or utc
        if line.computer_s is not None:
            if pending:
                offset, pending = max(last_s - line.computer_s, 0.0), False
            last_s = line.computer_s + offset
        offsets[line.number] = offset
    return offsets
