"""Frames into force: how fast, and how good, beside what one would do with an image."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import Row, ratio_row
from benchmarks.timing import compare, fastest, shown
from cbsr_qa.analysis.recording_files import read_recording
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.readings.frames import Recording
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.eit.imaging.blobs import find_blobs, percentage_mask

TITLE = "Force from a calibration file"

Array = NDArray[np.float64]

_BATCH = 20_000
_STEADY_S = 10.0


@dataclass(frozen=True)
class Issued:
    """A calibration as a simulated run issued it, and the run's held-out loads."""

    calibration: Calibration
    recording: Recording


def rows() -> Iterator[Row]:
    """Speed in batches and one by one, then errors on loads that were not calibrated with."""
    here = issued()
    frames = here.recording.frames.voltages
    batch = np.resize(frames, (_BATCH, *frames.shape[1:]))
    few = frames[: min(len(frames), 400)]
    loaded = here.calibration.force(frames).detectability.argmax()
    one = frames[loaded]
    rate = _BATCH / fastest(lambda: here.calibration.force(batch), 5)
    yield Row(
        "frames in a batch of 20 000, place estimated", "≥ 20 000 frames/s", f"{rate:,.0f} frames/s", "", rate >= 2e4
    )
    single_s = fastest(lambda: here.calibration.force(one), 400)
    yield Row("one frame, place estimated", "≤ 0.5 ms", shown(single_s), "", single_s <= 5e-4)
    yield ratio_row(
        compare(
            f"{len(few)} frames into force",
            ("templates", lambda: here.calibration.force(few)),
            ("image, mask, blob, Eq 7", lambda: _by_images(here.calibration, few)),
            repeats=5,
        ),
        1.0,
    )
    yield from _errors(here)


def notes() -> str:
    return (
        "\nThe calibration is the one that `cbsr-qa run --station simulated --recipe nine-locations` issues."
        " The loads are the run's ten random ones, at other places and forces than those of the calibration."
        " The method it is compared with reconstructs an image with the matrix of the file, keeps what exceeds"
        " 85 % of its maximum, takes the mean of the region with the largest integral and solves the paper's"
        " Eq 7 with the mean of the file's nine ρ̄₀. The load cell gives the truth.\n"
    )


def _errors(here: Issued) -> Iterator[Row]:
    loads = here.recording.loads
    steady = [_steady(here.recording, load) for load in loads]
    truth = np.array([measured_N(here.recording, load) for load in loads])
    places = np.array([(load.load.x_mm, load.load.y_mm) for load in loads])
    known = here.calibration.force(np.array(steady), place_mm=places).force_N
    found = here.calibration.force(np.array(steady)).force_N
    other = _by_images(here.calibration, np.array(steady))
    for what, error in (("place known", known - truth), ("place estimated", found - truth)):
        yield Row(
            f"rms error of {len(loads)} held-out loads, {what}",
            "",
            f"{np.sqrt(np.mean(error**2)):.2f} N",
            f"by images: {np.sqrt(np.nanmean((other - truth) ** 2)):.2f} N",
        )


def _by_images(calibration: Calibration, frames: Array) -> Array:
    """The image's way: NaN where an image has no blob."""
    issued = calibration.issued
    used, line = issued.reconstruction.problem.used, issued.against_stress
    changes = (frames - issued.reference)[:, used] / issued.scale
    images = changes @ issued.reconstruction.matrix.T
    base = np.mean([place.value for place in issued.baseline if place.value is not None])
    force = np.full(len(frames), np.nan)
    mesh = issued.reconstruction.problem.mesh
    for n, values in enumerate(images):
        blobs = find_blobs(Image(mesh, values), percentage_mask(values, issued.mask))
        if blobs:
            areas = mesh.areas_mm2[blobs[0].elements]
            mean = values[blobs[0].elements] @ areas / areas.sum()
            force[n] = (mean / base - line.intercept.value) / line.slope.value
    return force * issued.indenter.area_mm2 / 1e3


def _steady(recording: Recording, load: LoadRecord) -> Array:
    held: Array = recording.frames.select_interval(load.release_start_s - _STEADY_S, load.release_start_s).voltages
    return held.mean(axis=0)


def measured_N(recording: Recording, load: LoadRecord) -> float:
    """Force by the load cell over the last ten seconds of a hold."""
    (force,) = (block for block in recording.samples if block.channel == "force")
    return float(force.select_interval(load.release_start_s - _STEADY_S, load.release_start_s).values.mean())


@lru_cache(maxsize=1)
def issued(seed: int | None = None) -> Issued:
    """Run the recipe ``nine-locations`` on the simulated station; by default with the seed of the serial number."""
    seeded = [] if seed is None else ["--seed", str(seed)]
    program = str(Path(sys.executable).with_name("cbsr-qa"))
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"CBSR_QA_VAR": str(Path(folder) / "var")}
        recorded = str(Path(folder) / "random.h5")
        for command in (
            ["run", "--station", "simulated", "--recipe", "nine-locations", "--serial", "BENCH-1", *seeded],
            ["export", "BENCH-1", "--to", recorded, "--phase", "random loads"],
        ):
            subprocess.run([program, *command], check=True, env=environment, capture_output=True)
        (file,) = (Path(folder) / "var" / "calibrations").glob("*.h5")
        return Issued(Calibration.load(file), read_recording(Path(recorded)))
