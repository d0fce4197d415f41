"""The page on robots runs as printed beside numpy, scipy and h5py, on a sensor and frames made for it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from bare_environments import PRINT_LOADED, read_loaded, run_beside
from force_calibration import force_calibration, frames
from pages import HOW_TO, blocks
from streamed import loaded, write_sensor

import cbsr_qa as qa
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.domain.errors import CbsrError

PAGE = HOW_TO / "use-in-a-robot.md"
BESIDE = ("numpy", "scipy", "h5py")
ENDING = """
assert trusted[6:].all() and abs(there.force_N[6:] - 3).max() < 0.3
assert np.allclose(doubled.force_N[6:], many.force_N[6:], rtol=1e-6)
assert stress_kPa.shape[0] == len(frames)
"""


def snippets(folder):
    """The page's code, with its files in a folder."""
    code = "\n".join(blocks(PAGE, "python")) + ENDING
    return re.sub(r'"(\w+\.(?:h5|npy))"', lambda name: repr(str(folder / name[1])), code)


def write_files(folder):
    write_sensor(folder, 12)
    np.save(folder / "frames.npy", loaded(12))


def assert_printed_forces(printed):
    said = printed.splitlines()
    assert re.fullmatch(r"-?\d\.\d\d ± \d\.\d\d N at \[.*\] mm", said[0])
    assert any(line.startswith("1 loading ") for line in said)
    assert re.search(r"other\.h5: there is no such file - check its name and folder", printed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def beside(folder):
    """What the page's code prints beside what it needs, and what it had loaded then."""
    done = run_beside(BESIDE, snippets(folder) + PRINT_LOADED)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_its_snippets_need_numpy_scipy_and_h5py_alone(beside):
    assert_printed_forces(beside.partition("loaded ")[0])


def test_a_robot_has_nothing_of_stations_or_plugins(beside):
    assert {name.split(".")[1] for name in read_loaded(beside)} == {"calibration", "domain", "system"}


def test_every_flag_is_on_it():
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"`{flag.name}`" in page for flag in Flag)


def _make_unlike(folder):
    """What the table of errors is about, in its order."""
    whole = (folder / "sensor.h5").read_bytes()
    (folder / "cut.h5").write_bytes(whole[: len(whole) // 2])
    (folder / "text.h5").write_text("no calibration")
    stream = qa.ForceStream(qa.load_calibration(folder / "sensor.h5"))
    stream.update(5.0, frames((1, 1), [2])[0])
    yield lambda: qa.load_calibration(folder / "none.h5")
    yield lambda: qa.load_calibration(folder / "cut.h5")
    yield lambda: qa.load_calibration(folder / "text.h5")
    yield None  # a later schema: tests/calibration/file
    yield lambda: Calibration(replace(force_calibration(), force=None))
    yield lambda: qa.load_calibration(folder / "sensor.h5").force(np.zeros((8, 8)))
    yield lambda: stream.update(2.0, frames((1, 1), [2])[0])


def test_errors_say_what_its_table_says(folder):
    stated = re.findall(r"^\| `([^`]+)` \| .* \|$", PAGE.read_text().partition("## What errors mean")[2], re.M)
    for words, raising in zip(stated, _make_unlike(folder), strict=True):
        if raising is not None:
            with pytest.raises(CbsrError, match=re.escape(words).replace("…", ".*")):
                raising()
