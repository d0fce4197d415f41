"""``import cbsr_qa`` beside numpy, scipy and h5py: what a robot has is there, and the rest says what it lacks."""

import pytest
from bare_environments import run_beside

_ROBOT = ("numpy", "scipy", "h5py")


@pytest.fixture(scope="module")
def beside():
    """A program that lists what a robot is offered, and then asks for what it is not."""
    asking = "import cbsr_qa as qa; print(*dir(qa)); assert not hasattr(qa, 'analyse'); print('over'); qa.analyse"
    return run_beside(_ROBOT, asking)


def test_a_robot_is_offered_what_it_can_use(beside):
    offered = beside.stdout.split()
    assert offered[-1:] == ["over"], beside.stderr
    assert {"load_calibration", "Calibration", "ForceStream", "Indenter", "Flag"} <= set(offered)


def test_what_it_has_not_says_what_is_not_installed(beside):
    assert beside.returncode == 1
    last = beside.stderr.splitlines()[-1]
    assert last.startswith(
        "AttributeError: module 'cbsr_qa' has no attribute 'analyse' beside cbsr_qa.interface, which"
    )
    assert last.endswith("install cbsr-qa with what it requires")
