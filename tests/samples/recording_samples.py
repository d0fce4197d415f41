"""A recording with events in it, for the tests of the report."""

from pathlib import Path

import numpy as np
from load_samples import sample_frames
from sensor_samples import SENSOR

from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.readings.frames import Recording, ScanKind
from cbsr_qa.domain.results.findings import ChannelReport, LoadEvent, NoiseReport, RecordingResult
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.mesh.sheet import image_mesh


def sample_recording(events=2):
    """A recording of bumps in units of the radius, with as many events as asked for."""
    mesh = image_mesh(SENSOR, size_mm=6.0)
    mesh = Mesh(mesh.nodes_mm / 50.0, mesh.elements)
    frames = sample_frames(0.0, 100.0, np.random.default_rng(5))
    recording = Recording(
        path=Path("exp<1>.csv"),
        format="ert-board-csv",
        dataset="",
        scan=ScanKind.FULL,
        frames=frames,
        reference=None,
        still=False,
        magnitudes_only=False,
        clock="board",
    )
    found = tuple(
        LoadEvent(
            start_s=20.0 * k + 5,
            peak_s=20.0 * k + 9,
            end_s=20.0 * k + 15,
            x_over_R=0.5 * np.cos(k),
            y_over_R=0.5 * np.sin(k),
            electrode=2.0 * k,
            electrodes=16,
            sign=-1,
            snr=20.0 + k,
            image=Image(mesh, -np.exp(-((mesh.centroids_mm - [0.5 * np.cos(k), 0.5 * np.sin(k)]) ** 2).sum(axis=1))),
        )
        for k in range(events)
    )
    why = "" if events else "nothing stands out of the noise"
    noise = NoiseReport(0.01, "V", 0.0, (), (0.0, 20.0), 8)
    channels = ChannelReport((), (), False, 208, 58.0, 0.01, None, None, False)
    return RecordingResult(recording, 0.4, channels, noise, found, why)
