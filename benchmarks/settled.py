"""Forces of recorded frames against the load cell, each frame alone and with loads that have not settled flagged.

``python -m benchmarks.settled CALIBRATION RECORDING...`` counts what docs/explanation/force.md states.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_files import read_recording
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.runtime.settling_forces import SettlingForces
from cbsr_qa.domain.readings.frames import Recording

Array = NDArray[np.float64]

#: A force is off beyond so many standard errors and newtons.
_STDERR, _ROOM_N = 3.0, 0.05


def row(calibration: Calibration, recording: Recording) -> str:
    time_s, frames = recording.frames.time_s, recording.frames.voltages
    truth = _cell_N(recording, time_s)
    alone = calibration.force(frames)
    followed, _ = SettlingForces(calibration)(time_s, frames, alone)
    off = [np.abs(each.force_N - truth) > _STDERR * each.stderr_N + _ROOM_N for each in (alone, followed)]
    chosen = ((alone.flags == 0, off[0]), (followed.flags == 0, off[1]), (followed.flags == Flag.UNSETTLED, off[1]))
    cells = (f"{(which & wrong).sum()} of {which.sum()}" for which, wrong in chosen)
    return f"| {recording.path.stem} | {len(frames)} | {' | '.join(cells)} |"


def _cell_N(recording: Recording, time_s: Array) -> Array:
    """Force by the load cell (n,) over each frame."""
    (force,) = (block for block in recording.samples if block.channel == "force")
    half_s = float(np.median(np.diff(time_s))) / 2
    return np.array([force.select_interval(time - half_s, time + half_s).values.mean() for time in time_s.tolist()])


def main() -> None:
    calibration = Calibration.load(sys.argv[1])
    print("| recording | frames | off, frame alone | off, unflagged | off, flagged only as unsettled |")
    print("| --- | --- | --- | --- | --- |")
    for path in sys.argv[2:]:
        print(row(calibration, read_recording(Path(path))))


if __name__ == "__main__":
    main()
