"""Exported recordings of a disc that is pressed, by the forward model."""

from dataclasses import replace

import numpy as np

from cbsr_qa.analysis.recording.imaging import nominal_disc
from cbsr_qa.analysis.recording_files import write_recording
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, SampleBlock, ScanKind, VoltageUnit
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.forward.coverage import disc_coverage
from cbsr_qa.eit.inverse.problem import nominal_model
from cbsr_qa.eit.loads.local import LocalUpdate

DISC: SensorType = nominal_disc(None, 16)


def pressed_frames(x, y, *, contrast, n=80, start=30, end=60, seed=1):
    """Volts of a disc with one press, by the forward model; (n, 16, 16)."""
    model = LocalUpdate(nominal_model(DISC))
    empty = model.model.voltages()
    elements, share = disc_coverage(model.model.mesh, 50 * x, 50 * y, 6.5)
    full = model.voltages(elements, contrast * share)
    loaded = np.zeros(n)
    loaded[start:end] = 1
    noise = np.random.default_rng(seed).normal(0, 1e-4 * np.abs(empty).mean(), (n, 16, 16))
    return empty + loaded[:, None, None] * (full - empty) + noise


def moving_frames(places, *, contrast, seed=1):
    """Volts of a disc with a load that is at another place in each frame; places (n, 2) in radii, (n, 16, 16)."""
    model = LocalUpdate(nominal_model(DISC))
    empty = model.model.voltages()
    frames = []
    for x, y in places:
        elements, share = disc_coverage(model.model.mesh, 50 * x, 50 * y, 6.5)
        frames.append(model.voltages(elements, contrast * share))
    noise = np.random.default_rng(seed).normal(0, 1e-4 * np.abs(empty).mean(), (len(places), 16, 16))
    return np.array(frames) + noise


def exported(tmp_path, frames, *, sensor_type=None, name="run.h5", unit=VoltageUnit.VOLT, current_A=0.001, **said):
    times = 100 + 2.5 * np.arange(len(frames))
    block = FrameBlock(times, frames, np.zeros(frames.shape, np.uint8), unit, current_A)
    force = SampleBlock("force", "N", times, np.where((times > 175) & (times < 250), 4.0, 0.0))
    path = tmp_path / name
    recording = Recording(
        path, "cbsr-recording", "", ScanKind.FULL, block, None, False, False, "computer", (force,),
        sensor_type=sensor_type,
    )  # fmt: skip
    write_recording(path, replace(recording, **said))
    return path
