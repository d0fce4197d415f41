"""Our own export of a run, HDF5 (format ``cbsr-recording``)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_files import FORMAT, SIGNATURE, read_recording, write_recording
from cbsr_qa.calibration.file.hdf5 import BLOCK_BEGINS
from cbsr_qa.plugin import LoadRecord, Recording, RecordingError, RefusedError, Transcript
from cbsr_qa_plugins.recordings.lab_files import OneDataSet, refuse_existing


class CbsrRecording(OneDataSet):
    """Reads what ``cbsr-qa export`` writes, and writes simulated scenes."""

    def recognises(self, path: Path, head: bytes) -> bool:
        """Recognise HDF5's signature; an HDF5 file of another kind is refused when read."""
        return head.startswith((SIGNATURE, BLOCK_BEGINS)) and path.suffix != ".mat"

    def _read(self, path: Path) -> Recording:
        return _from_first_frame(read_recording(path))

    def write(self, path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
        """Write the whole frames of a simulated recording, to the bit.

        Raises
        ------
        RefusedError
            If the file exists, the transcript is of another number of frames, or no frame is whole.
        """
        refuse_existing(path)
        lost: NDArray[np.bool_] = np.any(transcript.lost, axis=1)
        if len(lost) != len(recording.frames) or lost.all():
            raise RefusedError(
                f"of {len(recording.frames)} frames and a transcript of {len(lost)} none is whole",
                remedy="write all frames with the transcript they were taken with, and lose fewer rows",
            )
        counted = replace(recording, path=path, format=FORMAT, frames=recording.frames.select(~lost))
        write_recording(path, replace(counted, frames_dropped=recording.frames_dropped + int(lost.sum())))
        omissions = []
        if lost.any():
            lost_count = int(lost.sum())
            omissions.append(f"{lost_count} of {len(lost)} frames lost rows and are left out; the file says how many")
        if transcript.dumps:
            omissions.append(f"{len(transcript.dumps)} watchdog dumps are not written; their pauses are in the times")
        return tuple(omissions)


def _from_first_frame(recording: Recording) -> Recording:
    """Count times from the first frame instead of the start of the run."""
    frames = recording.frames
    if not len(frames):
        raise RecordingError(f"{recording.path.name} holds no frames", remedy="export another phase of the run")
    zero_s = float(frames.time_s[0])
    reading_time_s = None if frames.reading_time_s is None else frames.reading_time_s - zero_s
    loads: list[LoadRecord] = []
    for load in recording.loads:
        names = ("press_start_s", "hold_start_s", "release_start_s", "release_end_s", "rest_end_s")
        loads.append(replace(load, **{name: getattr(load, name) - zero_s for name in names}))
    return replace(
        recording,
        frames=replace(frames, time_s=frames.time_s - zero_s, reading_time_s=reading_time_s),
        samples=tuple(replace(block, time_s=block.time_s - zero_s) for block in recording.samples),
        loads=tuple(loads),
        clock="none" if recording.clock == "none" else "station",
        notes=(*recording.notes, f"times count from the first frame, which the run's clock puts at {zero_s:.2f} s"),
    )
