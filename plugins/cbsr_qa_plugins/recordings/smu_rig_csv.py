"""Per-reading CSV of the rig behind the paper: SMU, command multiplexer, applicator (format ``smu-rig-csv``)."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.frames import FrameBlock, ReadingFlag, SampleBlock, VoltageUnit
from cbsr_qa.domain.recording import ReadOptions, Recording, RowProblem, ScanKind
from cbsr_qa_plugins.recordings.smu_rig_rows import Reading, read_sessions

_PAIRS: Final = 16
_FRAME: Final = _PAIRS**2
_DECLARED_ORDER: Final = "the current pair is the inner loop"
#: Largest pause between two sessions of one file that is believed [s]; longer ones only push later frames away.
_SESSION_GAP_S: Final = 1.0

Frames = list[list[Reading]]


class SmuRigCsv:
    """Reads one line a reading, 256 a frame, scanned with the current pair as the inner loop.

    Frames are put into canonical order (row = drive pair, column = measure pair). The rig's start-up query was itself
    a step of the multiplexer, so a file may be shifted by one reading: the shift is decided from where the large
    driven-pair readings are, and said in the notes.
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
            If the file is empty or holds only headers, or no frame of 256 good readings is complete.
        """
        if options.dataset:
            raise RecordingError(f"{path.name} is one data set; it has none named {options.dataset!r}")
        sessions, problems = read_sessions(path)
        shift = _shift(sessions)
        frames, dropped = _frames(sessions, shift)
        problems += dropped
        if not frames:
            count = sum(len(session) for session in sessions)
            raise RecordingError(
                f"{path.name} holds no complete frame: {count} lines, {len(problems)} of them bad;"
                f" a frame is {_FRAME} readings",
                remedy="record for longer, or analyse another file",
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
            problems=tuple(sorted(problems, key=lambda p: p.line)),
            notes=(_order_note(shift), *notes),
        )


def _order_note(shift: int) -> str:
    said = f"declared order: {_DECLARED_ORDER}; frames are stored with row = drive pair, column = measure pair"
    return said + (f"; the recording starts {shift} reading late and was shifted back" if shift else "")


def _shift(sessions: list[list[Reading]]) -> int:
    """0 or 1: where in the scan the first line is, decided by the readings across the driven pairs, the largest."""
    stream = np.array([abs(r.voltage) for r in max(sessions, key=len) if not r.bad])
    usable = stream[: len(stream) // _FRAME * _FRAME].reshape(-1, _FRAME)
    if not len(usable):
        return 0
    level = np.median(usable, axis=0)
    driven = np.arange(_PAIRS) * (_PAIRS + 1)  # scan positions where drive and measure pair are the same
    here, next_one = level[driven].sum(), level[(driven - 1) % _FRAME].sum()
    return int(next_one > 2 * here)


def _frames(sessions: list[list[Reading]], shift: int) -> tuple[Frames, list[RowProblem]]:
    frames: Frames = []
    problems: list[RowProblem] = []
    for session in sessions:
        aligned = session[(_FRAME - shift) % _FRAME :]
        for start in range(0, len(aligned) - _FRAME + 1, _FRAME):
            frame = aligned[start : start + _FRAME]
            bad = [reading.line for reading in frame if reading.bad]
            if bad:
                span = f"frame of lines {frame[0].line} to {frame[-1].line} dropped"
                problems.append(RowProblem(bad[0], f"{span}: {len(bad)} readings in it are bad or missing", False))
            else:
                frames.append(frame)
    return frames, problems


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
