"""``pip install --no-deps cbsr-qa`` in fresh environments: what the pages on robots and on the engine promise."""

import subprocess

import pytest
import test_engine_page as engine
import test_robot_page as robot
from bare_environments import build_wheel, list_installed, list_required, make_environment
from tank_recordings import write_phantom

pytestmark = pytest.mark.rest


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build_wheel(tmp_path_factory.mktemp("wheel"))


def run_in(folder, wheel, distributions, code):
    """Run a program in a fresh environment, which holds nothing else."""
    python = make_environment(folder / "environment", wheel, *distributions)
    assert list_installed(python) == list_required(*distributions) | {"cbsr-qa"}
    done = subprocess.run([python, "-I", "-c", code], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_robot_applies_a_calibration_and_streams(tmp_path, wheel):
    robot.write_files(tmp_path)
    robot.assert_printed_forces(run_in(tmp_path, wheel, robot.BESIDE, robot.snippets(tmp_path)))


def test_the_engine_images_a_tank_recording(tmp_path, wheel):
    write_phantom(tmp_path / "phantom_16elec_1planeB.mat")
    engine.assert_balls(run_in(tmp_path, wheel, engine.BESIDE, engine.snippets(tmp_path)), 8)
