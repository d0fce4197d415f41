"""Simulated scenes as the script of the rig behind the paper writes them: a line a reading."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.frames import ReadingFlag
from cbsr_qa.domain.recording import Recording
from cbsr_qa.domain.scene import Transcript
from cbsr_qa_plugins.recordings.lab_files import (
    ELECTRODES,
    channel,
    left_out,
    new_text_file,
    reading_times,
    refuse_unfit,
    utc_line,
)
from cbsr_qa_plugins.recordings.smu_rig_rows import CURRENT_EVERY, MOST_A, MOST_V, TITLES

NAME: Final = "smu-rig-csv"
#: Channels in the order of their columns, with their units.
_CHANNELS: Final = (("force", "N"), ("x", "mm"), ("y", "mm"), ("z", "mm"))


def write_smu_rig(path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
    """Write a recording, reading by reading, the current pair as the inner loop.

    ``i_src`` stands in the first line that arrives of each 16. Force and place are interpolated at the reading's
    time, keep their first and last value outside the samples, and are ``nan`` where there is no such channel.

    Returns
    -------
    What the file does not say, in words.

    Raises
    ------
    RefusedError
        If the rig cannot have recorded this; see :func:`~cbsr_qa_plugins.recordings.lab_files.refuse_unfit`.
    """
    refuse_unfit(NAME, path, recording, transcript)
    times_s = reading_times(NAME, recording, transcript, "drive")
    _refuse_numbers(recording, transcript)
    zero_s = float(times_s[0, 0, 0])
    current = "nan" if recording.frames.current_A is None else repr(float(recording.frames.current_A))
    with new_text_file(path) as file:
        file.write(utc_line(recording) + ",".join(TITLES) + "\n")
        for frame, lost in enumerate(transcript.lost):
            if not lost.all():
                file.writelines(_frame_lines(recording, frame, times_s[frame], zero_s, lost, current))
    return tuple(_not_said(recording, transcript))


def _frame_lines(
    recording: Recording,
    frame: int,
    times_s: NDArray[np.float64],
    zero_s: float,
    lost: NDArray[np.bool_],
    current: str,
) -> list[str]:
    """Lines of one frame, without those of lost rows."""
    scan_s = times_s.T.ravel()
    columns = zip(*[_column(recording, *named, scan_s) for named in _CHANNELS], strict=True)
    volts = recording.frames.voltages[frame].T.ravel().tolist()
    at_limit = (recording.frames.flags[frame].T.ravel() & ReadingFlag.COMPLIANCE.value) > 0
    gone = lost.tolist() * ELECTRODES
    read_at = gone.index(False)  # place within each 16 of the line that has the current
    out = []
    for k, (time_s, volt, limit, others) in enumerate(
        zip((scan_s - zero_s).tolist(), volts, at_limit.tolist(), columns, strict=True)
    ):
        if not gone[k]:
            said = f"{volt!r} MAX VOLTAGE ERROR" if limit else repr(volt)
            source = current if k % CURRENT_EVERY == read_at else "nan"
            out.append(f"{time_s:.6f},{said},{source},{','.join(others)}\n")
    return out


def _column(recording: Recording, name: str, unit: str, at_s: NDArray[np.float64]) -> Sequence[str]:
    block = channel(recording, name, unit)
    if block is None:
        return ["nan"] * len(at_s)
    return [f"{value:.6g}" for value in np.interp(at_s, block.time_s, block.values).tolist()]


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


def _not_said(recording: Recording, transcript: Transcript) -> list[str]:
    carried = [name for name, unit in _CHANNELS if channel(recording, name, unit) is not None]
    said = left_out(recording, transcript, carried, ReadingFlag.SATURATED)
    if transcript.dumps:
        said.append(
            f"{len(transcript.dumps)} watchdog dumps are not written: this rig's multiplexer sends none;"
            " their pauses are in the times where readings have times of their own"
        )
    absent = [name for name, _ in _CHANNELS if name not in carried]
    if absent:
        said.append(f"columns of nan, since nothing recorded them: {', '.join(absent)}")
    return said
