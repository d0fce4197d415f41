"""The page on using a calibration runs as printed, on a sensor and frames made for it."""

import re
import subprocess
import sys

import numpy as np
import pytest
from pages import HOW_TO, blocks, commands, typed
from streamed import loaded, write_sensor

pytestmark = pytest.mark.rest

_PAGE = HOW_TO / "use-a-calibration.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    write_sensor(folder, 12)
    np.save(folder / "frames.npy", loaded(12))
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
