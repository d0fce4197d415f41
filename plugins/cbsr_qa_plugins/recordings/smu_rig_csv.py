"""Per-reading CSV of the rig behind the paper: SMU, command multiplexer, applicator (format ``smu-rig-csv``)."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RecordingError, RowProblem
from cbsr_qa.domain.frames import FrameBlock, ReadingFlag, SampleBlock, VoltageUnit
from cbsr_qa.domain.recording import ReadOptions, Recording, ScanKind
from cbsr_qa.domain.scene import Transcript
from cbsr_qa_plugins.recordings.smu_rig_rows import FRAME, Reading, read_stretches
from cbsr_qa_plugins.recordings.smu_rig_scan import frames_of
from cbsr_qa_plugins.recordings.smu_rig_writer import write_smu_rig
from cbsr_qa_plugins.recordings.text_lines import refuse_dataset

_PAIRS: Final = 16
_DECLARED_ORDER: Final = "the current pair is the inner loop"
#: Largest pause between two sessions of one file that is believed [s]; longer ones only push later frames away.
_SESSION_GAP_S: Final = 1.0

Frames = list[list[Reading]]


class SmuRigCsv:
    """Reads one line a reading, 256 a frame, the current pair as the inner loop; simulated scenes are written so too.

    Frames are put into canonical order (row = drive pair, column = measure pair). The rig's start-up query was itself
    a step of the multiplexer, so a file may be shifted by one reading: where the scan stands is decided from where
    the large driven-pair readings are, again behind every gap, and said.
    """

    def recognises(self, path: Path, head: bytes) -> bool:
        """Tell by the titles."""
        return b"voltage [V]" in head and b"i_src [A]" in head

    def datasets(self, path: Path) -> tuple[str, ...]:
        """Such a file is one data set."""
        return ()

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read a file.

        Raises
        ------
        RecordingError
            If the file is empty, holds only headers or lacks a column, or no frame of 256 good readings is complete.
        """
        refuse_dataset(path, options)
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
            reference=None,
            still=False,
            magnitudes_only=False,
            clock="computer",
            samples=samples,
            problems=tuple(problems),
            notes=(_order_note(scans.late), *notes),
            frames_dropped=len(scans.dropped),
            simulated=simulated,
        )

    def write(self, path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
        """Write a simulated recording; see :func:`~cbsr_qa_plugins.recordings.smu_rig_writer.write_smu_rig`."""
        return write_smu_rig(path, recording, transcript)


def _inventory(problems: list[RowProblem], readings: int) -> str:
    bad = [problem for problem in problems if problem.rejected]
    first = f" (the first in line {bad[0].line}: {bad[0].what})" if bad else ""
    if problems and not bad:
        first = f" (but line {problems[0].line}: {problems[0].what})"
    return f"{readings} lines, {len(bad)} of them bad{first}"


def _order_note(late: int) -> str:
    said = f"declared order: {_DECLARED_ORDER}; frames are stored with row = drive pair, column = measure pair"
    if not late:
        return said
    count = "1 reading" if late == 1 else f"{late} readings"
    return f"{said}; the recording starts {count} late and was shifted back"


def _canonical(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """From scan order (n, 256), current pair inner, to (n, drive, measure)."""
    return values.reshape(-1, _PAIRS, _PAIRS).swapaxes(1, 2)


def _reading_times(frames: Frames) -> NDArray[np.float64]:
    """Times of the readings (n, 256) [s]; a session that starts its clock again is put behind the one before."""
    times = np.array([[reading.time_s for reading in frame] for frame in frames])
    for k in range(1, len(times)):
        if times[k, 0] < times[k - 1, -1]:
            times[k:] += times[k - 1, -1] - times[k, 0] + _SESSION_GAP_S
    return times


def _block(frames: Frames, times: NDArray[np.float64]) -> FrameBlock:
    voltages = _canonical(np.array([[reading.voltage for reading in frame] for frame in frames]))
    saturated = _canonical(np.array([[float(reading.saturated) for reading in frame] for frame in frames]))
    flags = np.where(saturated > 0, ReadingFlag.COMPLIANCE.value, 0).astype(np.uint8)
    currents = [abs(reading.current_A) for frame in frames for reading in frame if reading.current_A is not None]
    current_A = float(np.median(currents)) if currents else None
    return FrameBlock(
        times.mean(axis=1), voltages, flags, VoltageUnit.VOLT, current_A, np.ascontiguousarray(_canonical(times))
    )


def _samples(frames: Frames, times: NDArray[np.float64]) -> tuple[tuple[SampleBlock, ...], list[str]]:
    values = np.array([reading.others for frame in frames for reading in frame])
    flat_s = times.ravel()
    blocks: list[SampleBlock] = []
    notes: list[str] = []
    for name, unit, column in _columns(values):
        good = np.isfinite(column)
        if not good.any() or (name == "force" and not column[good].any()):
            continue
        kept = column[good]
        if name == "force" and -kept.min() > kept.max():
            kept = -kept
            notes.append("the force column is negative in compression; it is turned so that compression is positive")
        blocks.append(SampleBlock(name, unit, flat_s[good], kept))
    return tuple(blocks), notes


def _columns(values: NDArray[np.float64]) -> Iterator[tuple[str, str, NDArray[np.float64]]]:
    for k, (name, unit) in enumerate((("force", "N"), ("x", "mm"), ("y", "mm"), ("z", "mm"))):
        yield name, unit, values[:, k]
