"""``import cbsr_qa as qa``: what it loads, what its objects give, and what it refuses."""

import subprocess
import sys

import numpy as np
import pytest
from force_calibration import force_calibration
from stored_lots import judged, measured, store_run
from stored_runs import journalled, short_run

import cbsr_qa as qa
from cbsr_qa.app.export.export import ExportRequest, export_data
from cbsr_qa.interface import tables
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.scenes.run import SceneRunRequest, run_scene

pytest.importorskip("pandas")
xr = pytest.importorskip("xarray")


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Path of a database with one run that was never analysed, and the run."""
    path = tmp_path_factory.mktemp("stored") / "runs.db"
    with open_store(f"sqlite:///{path}") as store:
        run = store.new_id()
        journalled(store, short_run(run))
    return str(path), run


@pytest.fixture(scope="module")
def scene():
    """A scene of four loads."""
    return qa.simulate_scene("faulty-electrode", seed=3)


def test_importing_it_loads_nothing_else():
    code = "import sys, cbsr_qa; print([m for m in sys.modules if m.startswith(('cbsr_qa.', 'numpy', 'scipy'))])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_calibration_is_loaded_without_what_a_robot_lacks():
    code = (
        "import sys, cbsr_qa as qa; qa.load_calibration, qa.ForceStream, qa.Flag, qa.PressureMap, qa.CbsrError;"
        "qa.PressCalibration, qa.Estimator, qa.Touches;"
        "print([m for m in ('pydantic', 'sqlalchemy', 'matplotlib', 'pandas', 'xarray') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_tables_have_the_columns_of_exported_ones(stored):
    database, run = stored
    runs = qa.open_database(database).runs(serial="S-1")
    assert list(runs["run"]) == [run]
    assert str(runs["started_at"].dtype) == "datetime64[us, UTC]"
    assert len(qa.open_database(database).measurements()) == 0
    with pytest.raises(qa.CbsrError, match="S-2"):
        qa.open_database(database).runs(serial="S-2")


@pytest.mark.parametrize("part", ["sheet=LOT7/B", ("sheet=LOT7", "board=B-9")])
def test_runs_are_selected_by_the_parts_of_their_sensors(stored, part):
    database, run = stored
    assert list(qa.open_database(database).runs(part=part)["run"]) == [run]
    with pytest.raises(qa.CbsrError, match="LOT7/C"):
        qa.open_database(database).runs(part="sheet=LOT7/C")
    with pytest.raises(qa.CbsrError, match="LOT8"):
        qa.compare("batch", part="sheet=LOT8", database=database)


def test_measurements_of_a_run_are_of_no_earlier_one(tmp_path):
    random, url = np.random.default_rng(5), f"sqlite:///{tmp_path / 'runs.db'}"
    with open_store(url, durable=False) as store:
        names = [store_run(store, serial, judged(measured(random, np.zeros(3)))) for serial in ("S-1", "S-2")]
    for run in names:
        values = qa.open_database(url).run(run).measurements()
        assert set(values["run"]) == {run}
        assert len(values) == 12


def test_frames_are_the_content_of_the_exported_file(stored, tmp_path):
    database, run = stored
    frames = qa.open_database(database).run("S-1").frames("nine locations")
    to = tmp_path / "frames.nc"
    export_data(ExportRequest(to, run, phase="nine locations"), database=database, tell=lambda words: None)
    with xr.open_dataset(to, engine="h5netcdf") as exported:
        assert set(exported.variables) == set(frames.variables)
        assert set(exported.coords) == set(frames.coords)
        for name, variable in exported.variables.items():
            own = frames[name].values
            assert (own == variable.values).all() or np.allclose(own, variable.values, equal_nan=True), name
            assert frames[name].attrs.get("units") == variable.attrs.get("units")
    assert frames["voltage"].units == "V"


def test_a_run_is_drawn_on_axes(stored):
    database, run = stored
    assert qa.open_database(database).run(run).plot().get_ylabel().split() == ["force", "[N]"]


def test_a_result_in_a_notebook_is_one_element_without_scripts_and_ids(scene):
    page = qa.analyse(scene)._repr_html_()
    assert page.startswith('<div class="cbsr-qa">')
    assert "@scope (.cbsr-qa)" in page
    assert ":scope" in page
    assert not any(forbidden in page for forbidden in ("<script", "<html", "<body", ' id="s', "@page", ":root"))


def test_an_array_is_analysed_as_the_scene_it_is_of(scene):
    frames = scene.frames()
    events = qa.analyse(scene).result.events
    again = qa.analyse(frames, sensor_type="disc-100mm").result.events
    plain = qa.analyse(frames["voltage"].values, time_s=frames["time"].values, sensor_type="disc-100mm")
    assert len(events) == len(again) == 4
    assert [event.x_mm for event in again] == [event.x_mm for event in events]
    assert len(plain.result.events) >= 3  # which readings were saturated is not known there
    assert plain.to_dict()["recording"]["sensor_type"] == "disc-100mm"
    assert "units of the radius" not in repr(plain)
    assert "of the given times" in repr(plain)
    assert "units of the radius" in repr(qa.analyse(frames["voltage"].values))


def test_a_frame_is_imaged_where_it_was_pressed(scene):
    frames = scene.frames()
    loads = frames.isel(time=frames["load_stage"].values == 2)
    images = qa.image(loads.isel(time=[-1]), frames.isel(time=slice(0, 5)))
    x_mm, y_mm = images.mesh.centroids_mm[images.values[0].argmax()]
    truth = scene.result.loads[-1]
    assert np.hypot(x_mm - truth.x_mm, y_mm - truth.y_mm) < 8
    assert len(images.plot().images) == 1
    assert "<svg" in images._repr_html_()
    other = qa.image(loads.isel(time=[-1]), frames.isel(time=slice(0, 5)), reconstruction="truncated-svd")
    assert other.result.reconstruction == "truncated-svd"


def test_frames_of_a_file_in_counts_are_imaged_as_they_are(tmp_path):
    request = SceneRunRequest("faulty-electrode", output=tmp_path / "scene.h5", formats=("ert-board-csv",))
    csv = run_scene(request).files[-1].path
    with pytest.raises(qa.CbsrError, match="no known sensor type"):
        qa.analyse(csv).frames()
    analysis = qa.analyse(csv, sensor_type="disc-100mm")
    frames, event = analysis.frames(), analysis.result.events[-1]
    assert frames["voltage"].attrs["units"] == "count"
    with pytest.raises(qa.CbsrError, match="in count, not in volts"):
        qa.Calibration(force_calibration()).force(frames["voltage"])
    pressed = (frames.time.values > event.end_s - 5) & (frames.time.values < event.end_s)
    images = qa.image(frames.isel(time=pressed), frames.isel(time=slice(0, 5)), reconstruction="truncated-svd")
    x_mm, y_mm = images.mesh.centroids_mm[images.values[-1].argmax()]
    assert np.hypot(x_mm - event.x_mm, y_mm - event.y_mm) < 12


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda: qa.image(np.ones((16, 16)), np.ones((16, 16))), "does not state its sensor type"),
        (lambda: qa.image(np.ones((8, 8)), np.ones((8, 8)), sensor_type="disc-100mm"), "have (8, 8)\ngive"),
        (lambda: qa.image(np.ones((16, 16)), np.ones((16, 16)), sensor_type="disc-100m"), "disc-100m"),
        (lambda: qa.analyse(np.ones((9, 257)), sensor_type="disc-100mm"), "array has frames of (9, 257): drive"),
        (
            lambda: qa.analyse(np.ones((9, 16, 15)), sensor_type="disc-100mm"),
            "of sensor type 'disc-100mm' are (16, 16)",
        ),
        (lambda: qa.analyse(np.ones(256), sensor_type="disc-100mm"), "frames of the shape (256,)"),
        (lambda: qa.analyse(np.ones((9, 16, 16)), time_s=np.arange(8.0)), "8 times for 9 frames"),
        (lambda: qa.analyse(np.ones((9, 257))), "frames of (9, 257): drive pairs, measure pairs; without"),
        (lambda: qa.image("absent.h5", "absent.h5"), "not real numbers"),
        (lambda: qa.analyse("absent.h5"), "absent.h5"),
        (lambda: qa.analyse(np.zeros((4, 16, 16))), "no signal"),
        (lambda: qa.open_database("absent.db"), "absent.db"),
        (lambda: qa.simulate_scene("no-such-scene"), "no-such-scene"),
        (lambda: qa.compare("batches"), "give one of batch, material, station, software, period"),
        (lambda: qa.compare("batch", period="decade"), "give one of day, week, month, year"),
        (lambda: qa.load_calibration("absent.h5"), "absent.h5"),
    ],
)
def test_refusals_are_errors_of_the_package(call, reason, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(qa.CbsrError) as refused:
        call()
    assert reason in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_a_notebook_shows_a_refusal_without_a_traceback():
    with pytest.raises(qa.CbsrError) as refused:
        qa.open_database("absent.db")
    shown = refused.value._render_traceback_()  # called by IPython
    assert "absent.db" in shown[0]
    assert "\n".join(shown).endswith(refused.value.remedy)


def test_a_missing_library_is_named_with_its_remedy():
    with pytest.raises(qa.CbsrError, match=r"pip install 'cbsr-qa\[notebook\]'"):
        tables.notebook_library("no_such_library", "a table")
