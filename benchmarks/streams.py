"""Forces estimated while a head still presses, after seconds of a stream of frames.

``python -m benchmarks.streams`` prints the table of docs/explanation/force.md: the random loads of simulated runs of
the recipe ``nine-locations`` (half a minute a seed), followed by each run's own calibration.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.force import Issued, issued, measured_N
from cbsr_qa.calibration.runtime.tracking import ForceStream

#: Frames after the head is down that the table shows, from 0.
_FRAMES = (1, 2, 3, 5, 7, 13)


class Told(NamedTuple):
    """Estimate of one load at one frame.

    Parameters
    ----------
    frame : of the hold, from 0.
    held_s : since the head was down.
    error_N, stderr_N : of the force it will have, against the load cell; NaN if no load was reported.
    share : of the error, relative.
    """

    frame: int
    held_s: float
    error_N: float
    stderr_N: float
    share: float


def told(run: Issued) -> Iterator[Told]:
    stream, frames = ForceStream(run.calibration), run.recording.frames
    head_mm = run.calibration.issued.indenter.diameter_mm
    in_turn = zip(frames.time_s.tolist(), frames.voltages, strict=True)
    seen = {time_s: stream.update(time_s, frame) for time_s, frame in in_turn}
    for load in run.recording.loads:
        truth, place = measured_N(run.recording, load), np.array([load.load.x_mm, load.load.y_mm])
        held = [time_s for time_s in seen if load.hold_start_s <= time_s < load.release_start_s]
        for frame, time_s in enumerate(held):
            near = [one for one in seen[time_s] if one.force_N > 0 and np.hypot(*(one.place_mm - place)) < head_mm]
            error, stderr = (near[0].force_N - truth, near[0].stderr_N) if near else (np.nan, np.nan)
            yield Told(frame, time_s - load.hold_start_s, error, stderr, error / truth)


def row(all_told: Sequence[Told], frame: int) -> str:
    of_frame = [one for one in all_told if one.frame == frame]
    seen = [one for one in of_frame if np.isfinite(one.error_N)]
    error, stderr, share = (
        np.array([getattr(one, name) for one in seen]) for name in ("error_N", "stderr_N", "share")
    )
    line = (
        f"| {np.mean([one.held_s for one in of_frame]):.1f} s | {len(seen)} of {len(of_frame)}"
        f" | {100 * share.mean():.1f} % | {error.std(ddof=1):.2f} N | {np.sqrt(np.mean((error / stderr) ** 2)):.1f} |"
    )
    return line.replace("-", "−")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.streams", description=__doc__)
    parser.add_argument("--seeds", default="1:4", help="first and one after the last")
    seeds = range(*map(int, parser.parse_args().seeds.split(":")))
    all_told = [one for seed in seeds for one in told(issued(seed))]
    print("| held | loads reported | bias | σ | error over stated, rms |\n| --- | --- | --- | --- | --- |")
    print("\n".join(row(all_told, frame) for frame in _FRAMES))


if __name__ == "__main__":
    main()
