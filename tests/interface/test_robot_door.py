"""``import cbsr_qa`` beside numpy, scipy and h5py: what a robot has is there, and the rest says what it lacks."""

from bare_environments import run_beside

_ROBOT = ("numpy", "scipy", "h5py")


def test_a_robot_is_offered_what_it_can_use():
    done = run_beside(_ROBOT, "import cbsr_qa as qa; print(*dir(qa)); assert not hasattr(qa, 'analyse')")
    assert done.returncode == 0, done.stderr
    assert {"load_calibration", "Calibration", "ForceStream", "Indenter", "Flag"} <= set(done.stdout.split())


def test_what_it_has_not_says_what_is_not_installed():
    done = run_beside(_ROBOT, "import cbsr_qa as qa; qa.analyse")
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith(
        "AttributeError: module 'cbsr_qa' has no attribute 'analyse' beside cbsr_qa.interface, which"
    )
    assert last.endswith("install cbsr-qa with what it requires")
