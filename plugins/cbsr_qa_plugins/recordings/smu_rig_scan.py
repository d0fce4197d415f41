"""Whole frames out of the SMU rig's readings, and where in the scan each stretch of them stands."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RowProblem
from cbsr_qa_plugins.recordings.smu_rig_rows import FRAME, Reading, Stretch

#: Scan positions at which drive and measure pair are the same: the largest readings of a frame.
_DRIVEN: Final = np.arange(16) * 17
#: The driven pairs show the position only if they stand out of the other readings by this factor.
_STAND_OUT: Final = 4.0


@dataclass(slots=True)
class Scans:
    """What was put together.

    Parameters
    ----------
    frames : the whole ones, in time order.
    dropped : those that are not, one problem each. What the beginning and the end of the file cut off is not
        among them: every recording has that.
    moved : where the scan does not go on as counted.
    late : how many readings late the recording starts.
    """

    frames: list[list[Reading]] = field(default_factory=list)
    dropped: list[RowProblem] = field(default_factory=list)
    moved: list[RowProblem] = field(default_factory=list)
    late: int = 0


def frames_of(stretches: list[Stretch]) -> Scans:
    """Cut stretches into frames of 256."""
    scans = Scans()
    left: list[Reading] = []
    broken: list[Reading] = []
    reached = FRAME  # how far the frame dropped last is known; its end where no further stretch is of it
    for number, stretch in enumerate(stretches):
        expected = scans.late if stretch.counted_at is None else stretch.counted_at
        at = _position(stretch.readings, expected)
        if number == 0:
            scans.late = at
        elif at != expected:
            what = (
                f"the scan goes on with reading {at} of {FRAME} here, as the driven pairs show, not with {expected}"
            )
            scans.moved.append(RowProblem(stretch.readings[0].line, what, False))
        head = stretch.readings[: -at % FRAME]
        if number and (piece := left + head):
            if not left and at >= reached:  # several gaps in one frame
                scans.dropped.pop()
            else:
                broken = []
            broken += piece
            why = "lines are missing or too many in it" if stretch.counted_at is not None else "headers stand in it"
            scans.dropped.append(_dropped(broken, broken[-1].line, why))
        inside = number and 0 < at + len(head) < FRAME and len(head) == len(stretch.readings)
        reached = at + len(head) if inside else FRAME
        left = _cut(stretch.readings[len(head) :], scans)
    scans.moved += _steps_back(scans.frames)
    return scans


def _steps_back(frames: list[list[Reading]]) -> Iterator[RowProblem]:
    for before, after in pairwise(frames):
        if (back_s := before[-1].time_s - after[0].time_s) > 0:
            yield RowProblem(after[0].line, f"time steps back by {back_s:.6g} s from the frame before", False)


def _cut(readings: list[Reading], scans: Scans) -> list[Reading]:
    """Cut readings that begin with a frame; return those behind the last whole one."""
    count = len(readings) // FRAME
    for start in range(0, count * FRAME, FRAME):
        frame = readings[start : start + FRAME]
        bad = [reading.line for reading in frame if reading.bad]
        if bad:
            scans.dropped.append(_dropped(frame, bad[0], f"{len(bad)} readings in it are bad"))
        elif backwards := [later for before, later in pairwise(frame) if later.time_s < before.time_s]:
            why = f"time steps back in it {len(backwards)}×, first in line {backwards[0].line}"
            scans.dropped.append(_dropped(frame, backwards[0].line, why))
        else:
            scans.frames.append(frame)
    return readings[count * FRAME :]


def _dropped(frame: list[Reading], line: int, why: str) -> RowProblem:
    return RowProblem(line, f"frame of lines {frame[0].line} to {frame[-1].line} dropped: {why}", False)


def _position(readings: list[Reading], expected: int) -> int:
    """Position in the scan (0 to 255) of the first reading, by the readings across the driven pairs.

    Positions 17 apart share all but one driven pair, which may be the broken one: another position than the
    expected one must explain at least half a driven pair more.
    """
    count = len(readings) // FRAME
    if not count:
        return expected
    values = [0.0 if reading.bad else abs(reading.voltage) for reading in readings[: count * FRAME]]
    level: NDArray[np.float64] = np.median(np.reshape(values, (count, FRAME)), axis=0)
    explained = np.array([level[(_DRIVEN - at) % FRAME].sum() for at in range(FRAME)])
    best = int(explained.argmax())
    stands_out = explained[best] > _STAND_OUT * len(_DRIVEN) * float(np.median(level))
    half_a_pair = explained[best] / len(_DRIVEN) / 2
    return best if stands_out and explained[best] - explained[expected] > half_a_pair else expected
