"""The page on the engine alone: its snippets beside numpy, scipy and scikit-image, and its tables."""

import shutil

import numpy as np
import pytest
from bare_environments import PRINT_LOADED, read_loaded, run_beside
from pages import HOW_TO, assert_same_figures, blocks, marked_tables
from tank_recordings import BALLS_MM, write_phantom

PAGE = HOW_TO / "use-the-eit-engine.md"
BESIDE = ("numpy", "scipy", "scikit-image")
#: What its snippets leave, printed after what they print.
ENDING = """
assert isinstance(tank, SensorType) and len(regions) == 2 and water.voltages().shape == with_ball.shape == (16, 16)
assert v0.shape == (208,) and np.isfinite(frames).sum() == 208
"""


def snippets(folder):
    """The page's code, with the recording in a folder."""
    code = "\n".join(blocks(PAGE, "python")) + ENDING
    return code.replace('"phantom_16elec_1planeB.mat"', repr(str(folder / "phantom_16elec_1planeB.mat")))


def read_places_mm(printed):
    """Places [mm] that the page's first snippet prints."""
    return np.array([[float(word) for word in line[1 : line.index(")")].split(",")] for line in printed.splitlines()])


def assert_balls(printed, within_mm):
    """Both balls are where a flat model sees them; this prior moves them inwards by 7 mm."""
    places = read_places_mm(printed)
    assert len(places) == 2
    for ball in BALLS_MM:
        assert np.hypot(*(places - np.array(ball)).T).min() < within_mm, printed


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """The page's code beside what it needs, on a phantom made for it: what it printed, and what it had loaded."""
    folder = tmp_path_factory.mktemp("engine")
    write_phantom(folder / "phantom_16elec_1planeB.mat")
    done = run_beside(BESIDE, snippets(folder) + PRINT_LOADED)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_its_snippets_need_numpy_scipy_and_scikit_image_alone(beside):
    assert_balls(beside.partition("loaded ")[0], 8)


@pytest.mark.rest
@pytest.mark.shared
def test_its_snippets_find_the_balls_of_the_real_recording(shared, tmp_path):
    shutil.copy(shared / "data" / "tank" / "phantom_16elec_1planeB.mat", tmp_path)
    done = run_beside(BESIDE, snippets(tmp_path))
    assert done.returncode == 0, done.stderr
    assert_balls(done.stdout, 10)


def test_the_engine_has_nothing_of_plugins_runs_or_results(beside):
    loaded = read_loaded(beside)
    assert {name.split(".")[1] for name in loaded} == {"domain", "eit"}
    assert not [name for name in loaded if name.startswith(("cbsr_qa.domain.plan", "cbsr_qa.domain.run"))]
    assert not [name for name in loaded if name.startswith("cbsr_qa.domain.results")]


@pytest.mark.rest
def test_without_scikit_image_only_rasters_are_missing(tmp_path):
    write_phantom(tmp_path / "phantom_16elec_1planeB.mat")
    done = run_beside(("numpy", "scipy"), snippets(tmp_path))
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "ModuleNotFoundError: skimage is not on this computer"
    assert_balls(done.stdout, 8)  # the snippet before had imaged


@pytest.mark.rest
@pytest.mark.shared
def test_its_tables_are_what_the_benchmark_finds(shared):
    pytest.importorskip("pyeit", reason="pyEIT is an extra")
    from benchmarks.engine import forward_rows, tank_rows

    stated = marked_tables(PAGE.read_text(encoding="utf-8"))
    for name, rows in (("forward", forward_rows(timed=False)), ("tank", tank_rows(timed=False))):
        found = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
        assert len(found) == len(stated[name])
        for cells, row in zip(found, stated[name], strict=True):
            *measured, _ = zip(row.values(), cells, strict=True)  # the last is a time
            for one, other in measured:
                assert_same_figures(one, other, (name, cells[0]))
