"""The page on applying a calibration to recordings runs as printed, on a sensor and a recording made for it."""

import numpy as np
import pytest
from pages import HOW_TO, commands, typed
from streamed import write_sensor

pytestmark = pytest.mark.rest

_PAGE = HOW_TO / "use-a-calibration.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    write_sensor(folder, 12)
    return folder


def test_its_commands_run_as_printed(folder):
    assert len(commands(_PAGE)) >= 8
    for command in commands(_PAGE):
        done = typed(folder, command)
        assert done.stdout.strip() or "--output" in command
    assert (folder / "again.h5").read_bytes() == (folder / "sensor.h5").read_bytes()
    forces = np.genfromtxt(folder / "forces.csv", delimiter=",", skip_header=1, usecols=2)
    assert np.abs(forces[6:] - 3).max() < 0.3
