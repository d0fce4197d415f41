"""Per-reading CSV of the rig behind the paper: SMU, command multiplexer, applicator (format ``smu-rig-csv``)."""

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import (
    FrameBlock,
    ReadingFlag,
    Recording,
    RecordingError,
    RowProblem,
    SampleBlock,
    ScanKind,
    Transcript,
    VoltageUnit,
)
from cbsr_qa_plugins.recordings.lab_files import ELECTRODES, OneDataSet
from cbsr_qa_plugins.recordings.smu_rig_rows import CHANNELS, FRAME, Reading, Stretch, read_stretches, write_smu_rig

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
    unframed: list[Reading] = []
    broken: list[Reading] = []
    reached = FRAME  # how far the frame dropped last is known; its end where no further stretch is of it
    for number, stretch in enumerate(stretches):
        expected = scans.late if stretch.counted_at is None else stretch.counted_at
        position = _position(stretch.readings, expected)
        if number == 0:
            scans.late = position
        elif position != expected:
            problem = (
                f"the scan continues with reading {position} of {FRAME} here, as the driven pairs show, not with"
                f" {expected}"
            )
            scans.moved.append(RowProblem(stretch.readings[0].line, problem, False))
        head = stretch.readings[: -position % FRAME]
        if number and (piece := unframed + head):
            if not unframed and position >= reached:  # several gaps in one frame
                scans.dropped.pop()
            else:
                broken = []
            broken += piece
            why = "lines are missing or too many in it" if stretch.counted_at is not None else "headers stand in it"
            scans.dropped.append(_frame_problem(broken, broken[-1].line, why))
        inside = number and 0 < position + len(head) < FRAME and len(head) == len(stretch.readings)
        reached = position + len(head) if inside else FRAME
        unframed = _cut(stretch.readings[len(head) :], scans)
    for before, after in pairwise(scans.frames):
        if (back_s := before[-1].time_s - after[0].time_s) > 0:
            problem = f"time steps back by {back_s:.6g} s from the frame before"
            scans.moved.append(RowProblem(after[0].line, problem, False))
    return scans


def _cut(readings: list[Reading], scans: Scans) -> list[Reading]:
    """Cut readings that begin with a frame; return those behind the last whole one."""
    count = len(readings) // FRAME
    for start in range(0, count * FRAME, FRAME):
        frame = readings[start : start + FRAME]
        bad = [reading.line for reading in frame if reading.bad]
        if bad:
            scans.dropped.append(_frame_problem(frame, bad[0], f"{len(bad)} readings in it are bad"))
        elif backwards := [later for before, later in pairwise(frame) if later.time_s < before.time_s]:
            why = f"time steps back in it {len(backwards)}×, first in line {backwards[0].line}"
            scans.dropped.append(_frame_problem(frame, backwards[0].line, why))
        else:
            scans.frames.append(frame)
    return readings[count * FRAME :]


def _frame_problem(frame: list[Reading], line: int, why: str) -> RowProblem:
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
    level: Array = np.median(np.reshape(values, (count, FRAME)), axis=0)
    explained = np.array([level[(_DRIVEN - position) % FRAME].sum() for position in range(FRAME)])
    best = int(explained.argmax())
    stands_out = explained[best] > _STAND_OUT * len(_DRIVEN) * float(np.median(level))
    half_a_pair = explained[best] / len(_DRIVEN) / 2
    return best if stands_out and explained[best] - explained[expected] > half_a_pair else expected


_DECLARED_ORDER: Final = "the current pair is the inner loop"
#: Largest pause between two sessions of one file that is believed [s]; longer ones only push later frames away.
_SESSION_GAP_S: Final = 1.0

Frames = list[list[Reading]]


class SmuRigCsv(OneDataSet):
    """Reads and writes the rig's CSV: one line per reading, 256 per frame, the current pair as the inner loop.

    Frames are put into canonical order (row = drive pair, column = measure pair). The rig's start-up query was itself
    a step of the multiplexer, so a file may be shifted by one reading: the phase of the scan is found from the large
    driven-pair readings, again after every gap, and reported.
    """

    def recognises(self, path: Path, head: bytes) -> bool:
        return b"voltage [V]" in head and b"i_src [A]" in head

    def _read(self, path: Path) -> Recording:
        stretches, problems, simulated = read_stretches(path)
        scans = frames_of(stretches)
        frames = scans.frames
        problems = sorted((*problems, *scans.dropped, *scans.moved), key=lambda p: p.line)
        if not frames:
            count = sum(len(stretch.readings) for stretch in stretches)
            raise RecordingError(
                f"{path.name} holds no complete frame: {_inventory(problems, count)}; a frame is {FRAME} readings",
                remedy="record for longer, or analyse another file",
                problems=problems,
            )
        times = _reading_times(frames)
        zero_s = float(times[0].mean())
        samples, notes = _samples(frames, times - zero_s)
        return Recording(
            path=path,
            format="smu-rig-csv",
            dataset="",
            scan=ScanKind.FULL,
            frames=_block(frames, times - zero_s),
            clock="computer",
            samples=samples,
            problems=tuple(problems),
            notes=(_order_note(scans.late), *notes),
            frames_dropped=len(scans.dropped),
            simulated=simulated,
        )

    def write(self, path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
        return write_smu_rig(path, recording, transcript)


def _inventory(problems: list[RowProblem], readings: int) -> str:
    bad = [problem for problem in problems if problem.rejected]
    first = f" (the first in line {bad[0].line}: {bad[0].what})" if bad else ""
    if problems and not bad:
        first = f" (but line {problems[0].line}: {problems[0].what})"
    return f"{readings} lines, {len(bad)} of them bad{first}"


def _order_note(late: int) -> str:
    note = f"declared order: {_DECLARED_ORDER}; frames are stored with row = drive pair, column = measure pair"
    if not late:
        return note
    count = "1 reading" if late == 1 else f"{late} readings"
    return f"{note}; the recording starts {count} late and was shifted back"


def _canonical(values: Array) -> Array:
    """From scan order (n, 256), current pair inner, to (n, drive, measure)."""
    return values.reshape(-1, ELECTRODES, ELECTRODES).swapaxes(1, 2)


def _reading_times(frames: Frames) -> Array:
    """Times of the readings (n, 256) [s]; a session that starts its clock again is put behind the one before."""
    times = np.array([[reading.time_s for reading in frame] for frame in frames])
    for k in range(1, len(times)):
        if times[k, 0] < times[k - 1, -1]:
            times[k:] += times[k - 1, -1] - times[k, 0] + _SESSION_GAP_S
    return times


def _block(frames: Frames, times: Array) -> FrameBlock:
    voltages = _canonical(np.array([[reading.voltage for reading in frame] for frame in frames]))
    saturated = _canonical(np.array([[float(reading.saturated) for reading in frame] for frame in frames]))
    flags = np.where(saturated > 0, ReadingFlag.COMPLIANCE.value, 0).astype(np.uint8)
    currents = [abs(reading.current_A) for frame in frames for reading in frame if reading.current_A is not None]
    current_A = float(np.median(currents)) if currents else None
    return FrameBlock(
        times.mean(axis=1), voltages, flags, VoltageUnit.VOLT, current_A, np.ascontiguousarray(_canonical(times))
    )


def _samples(frames: Frames, times: Array) -> tuple[tuple[SampleBlock, ...], list[str]]:
    values = np.array([reading.others for frame in frames for reading in frame])
    flat_s = times.ravel()
    blocks: list[SampleBlock] = []
    notes: list[str] = []
    for (name, unit), column in zip(CHANNELS, values.T, strict=True):
        good = np.isfinite(column)
        if not good.any() or (name == "force" and not column[good].any()):
            continue
        channel_values = column[good]
        if name == "force" and -channel_values.min() > channel_values.max():
            channel_values = -channel_values
            notes.append("the force column is negative in compression; it is turned so that compression is positive")
        blocks.append(SampleBlock(name, unit, flat_s[good], channel_values))
    return tuple(blocks), notes
