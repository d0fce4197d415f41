"""The page on using a calibration runs as printed, on a sensor and frames made for it."""

import re
import subprocess
import sys

import numpy as np
import pytest
from pages import HOW_TO, TOP, blocks, commands, typed

pytestmark = pytest.mark.rest

_PAGE = HOW_TO / "use-a-calibration.md"
_MAKE = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import numpy as np
from force_calibration import force_calibration, frames
from stored_runs import SENSOR_TYPE
from cbsr_qa.analysis.recording_files import write_recording
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.domain.readings.frames import FrameBlock, VoltageUnit
from cbsr_qa.domain.readings.frames import Recording, ScanKind
write_calibration(Path("sensor.h5"), force_calibration())
forces = np.repeat([0.0, 3.0], 6)
seen = frames(np.tile((5.0, 7.0), (12, 1)), forces)
np.save("frames.npy", seen)
block = FrameBlock(2.5 * np.arange(12), seen, np.zeros(seen.shape, np.uint8), VoltageUnit.VOLT, 4e-4)
write_recording(Path("press.h5"), Recording(
    Path("press.h5"), "cbsr-recording", "", ScanKind.FULL, block, None, False, False, "station",
    sensor_type=SENSOR_TYPE.name))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    subprocess.run([sys.executable, "-c", _MAKE, str(TOP / "tests" / "samples")], cwd=folder, check=True)
    return folder


def test_its_snippets_run_as_printed(folder):
    code = "\n".join(blocks(_PAGE, "python"))
    code += "\nassert trusted[6:].all() and abs(there.force_N[6:] - 3).max() < 0.3"
    code += "\nassert np.allclose(doubled.force_N[6:], many.force_N[6:], rtol=1e-6)"
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert re.fullmatch(r"-?\d\.\d\d ± \d\.\d\d N at \[.*\] mm", said[0])
    assert any(" loading " in line and line.startswith("1 ") for line in said)


def test_its_commands_run_as_printed(folder):
    assert len(commands(_PAGE)) >= 8
    for command in commands(_PAGE):
        done = typed(folder, command)
        assert done.stdout.strip() or "--output" in command
    assert (folder / "again.h5").read_bytes() == (folder / "sensor.h5").read_bytes()
    forces = np.genfromtxt(folder / "forces.csv", delimiter=",", skip_header=1, usecols=2)
    assert np.abs(forces[6:] - 3).max() < 0.3
