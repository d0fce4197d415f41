"""Frames of a run in netCDF and for EIDORS: read by others' libraries, they are what was stored."""

import numpy as np
import pytest
import scipy.io
from exported_runs import GRID, five_runs, store_pressed
from stored_runs import SENSOR_TYPE

from cbsr_qa.app.export.export import ExportRequest, export_data
from cbsr_qa.domain.errors import RecordingError, RefusedError
from cbsr_qa.domain.readings.frames import ReadOptions
from cbsr_qa.store.opening import open_store
from cbsr_qa_plugins.recordings.eidors_mat import EidorsMat

xarray = pytest.importorskip("xarray")


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pressed")
    url = f"sqlite:///{folder / 'runs.db'}"
    run, impedance_ohm = store_pressed(url)
    with open_store(url) as store:
        return url, store.runs.load(run), impedance_ohm


@pytest.fixture(scope="module")
def written(pressed, tmp_path_factory):
    """Export the pressed run in a format, and return the file."""
    folder = tmp_path_factory.mktemp("frames")

    def written(suffix):
        result = export_data(ExportRequest(folder / f"out{suffix}", "S-1", force=True), database=pressed[0], tell=str)
        assert (result.result.frames, result.result.loads, result.result.runs) == (6, 1, 1)
        return folder / f"out{suffix}"

    return written


@pytest.fixture
def opened(written):
    with xarray.open_dataset(written(".nc")) as opened:
        yield opened


def test_xarray_opens_the_frames_with_units_and_coordinates(opened, pressed):
    frames = pressed[1].phases[0].frames
    voltage = opened.voltage
    assert voltage.dims == ("time", "drive", "measure")
    assert (voltage.units, opened.time.units, opened.current.units) == ("V", "s", "A")
    assert [name for name, variable in opened.variables.items() if not variable.attrs["long_name"]] == []
    missing = np.isnan(voltage.values)
    assert np.argwhere(missing).tolist() == [[1, 2, 3]]
    assert np.where(missing, 0.0, voltage.values).tobytes() == frames.voltages.tobytes()
    assert opened.flags.values.tobytes() == frames.flags.tobytes()
    assert dict(zip(opened.flags.flag_meanings.split(), opened.flags.flag_masks, strict=True)) == {
        "saturated": 1,
        "compliance": 2,
        "missing": 4,
    }
    assert opened.time.values.tolist() == frames.time_s.tolist()
    assert set(opened.current.values) == {4e-4}


def test_the_pairs_name_their_electrodes_and_these_their_places(opened):
    pattern = SENSOR_TYPE.pattern
    pairs = zip(opened.drive_source.values, opened.drive_sink.values, strict=True)
    assert [tuple(pair) for pair in pairs] == list(pattern.drive)
    pairs = zip(opened.measure_plus.values, opened.measure_minus.values, strict=True)
    assert [tuple(pair) for pair in pairs] == list(pattern.measure)
    assert (opened.usable.values == pattern.usable()).all()
    places = np.column_stack([opened.electrode_x, opened.electrode_y])
    assert (places == SENSOR_TYPE.electrodes.positions_mm()).all()
    assert opened.electrode_x.units == "mm"


def test_each_frame_knows_its_phase_press_place_and_strain(opened):
    assert set(opened.voltage.coords) >= {"phase", "load_stage", "load_label", "load_x", "load_y", "strain"}
    assert set(opened.phase.values) == {GRID}
    meanings = opened.load_stage.flag_meanings.split()
    stages = [meanings[stage] for stage in opened.load_stage.values]
    assert stages == ["none", "press", "hold", "ease", "hold", "rest"]
    assert opened.strain.values.tolist() == pytest.approx([np.nan, np.nan, 0.2, np.nan, 0.1, np.nan], nan_ok=True)
    assert opened.load_x.values.tolist() == pytest.approx([np.nan, *[15.0] * 5], nan_ok=True)
    assert opened.load_label.values.tolist() == ["", *["L0"] * 5]
    held = opened.voltage.where(opened.strain == 0.2, drop=True)
    assert held.time.values.tolist() == [31.5]


def test_the_file_says_which_run_it_is_of(opened, pressed):
    identity = pressed[1].identity
    expected = {
        "run": identity.run,
        "serial": "S-1",
        "recipe": "short",
        "station": "bench-α",
        "sensor_type": "disc-100mm",
        "started_at": "2026-11-21T08:00:00.123456+00:00",
        "verdict": "none",
        "source": "simulated: the sheet",
    }
    assert {name: opened.attrs[name] for name in expected} == expected


def test_phases_of_different_currents_and_other_channels(tmp_path):
    url, _ = five_runs()
    export_data(ExportRequest(tmp_path / "all.nc", "S-0"), database=url, tell=str)
    with xarray.open_dataset(tmp_path / "all.nc") as opened:
        assert opened.phase.values.tolist() == [GRID] * 9 + ["relaxation"] * 2
        assert opened.current.values.tolist() == pytest.approx([4e-4] * 9 + [np.nan] * 2, nan_ok=True)
        assert np.isnan(opened.reading_time.values).all(axis=(1, 2)).tolist() == [False] * 9 + [True] * 2
        assert (opened.force.units, opened.force.dims, opened.force.size) == ("N", ("force_time",), 40)
    with pytest.raises(RefusedError, match="differ in their drive current") as refused:
        export_data(ExportRequest(tmp_path / "all.mat", "S-0"), database=url, tell=str)
    assert "--phase" in refused.value.remedy
    assert not (tmp_path / "all.mat").exists()
    request = ExportRequest(tmp_path / "rest.mat", "S-0", phase="relaxation")
    assert export_data(request, database=url, tell=str).result.frames == 2
    read = scipy.io.loadmat(tmp_path / "rest.mat", simplify_cells=True)
    assert np.isnan(read["cbsr"]["current_A"])
    assert np.abs(read["fmdl"]["stimulation"][0]["stim_pattern"].toarray()).max() == 1.0


def test_eidors_patterns_reproduce_the_readings_from_the_sheets_impedances(written, pressed):
    """meas_pattern · Z · stim_pattern is how EIDORS simulates a frame: it must give ``vv``."""
    read = scipy.io.loadmat(written(".mat"), simplify_cells=True)
    model, vv, impedance_ohm = read["fmdl"], read["vv"], pressed[2]
    assert vv.shape == (256, 6)
    selected = vv[model["meas_select"].ravel().astype(bool)]
    patterns = [(s["meas_pattern"], s["stim_pattern"].toarray().ravel()) for s in model["stimulation"]]
    assert {s["stimulation"] for s in model["stimulation"]} == {"Amp"}
    assert scipy.sparse.issparse(patterns[0][0])
    for frame, ohm in enumerate(impedance_ohm):
        simulated = np.concatenate([meas @ ohm @ stim for meas, stim in patterns])
        measured = ~np.isnan(selected[:, frame])
        assert measured.sum() >= 207
        assert simulated[measured] == pytest.approx(selected[measured, frame], abs=1e-12)


def test_eidors_files_hold_what_was_going_on(written, pressed):
    file = written(".mat")
    beside = scipy.io.loadmat(file, simplify_cells=True)["cbsr"]
    assert (beside["serial"], beside["unit"], beside["current_A"]) == ("S-1", "V", 4e-4)
    assert beside["electrode_positions_mm"] == pytest.approx(SENSOR_TYPE.electrodes.positions_mm())
    assert [beside["load_stages"][stage] for stage in beside["load_stage"]][2] == "hold"
    assert beside["phase"].tolist() == [1] * 6
    assert beside["flags"].shape == (256, 6)
    with pytest.raises(RecordingError, match="vv holds values that are not finite"):  # one frame lacks a reading
        EidorsMat().read(file, ReadOptions())


def test_analyse_reads_eidors_files_without_missing_readings(tmp_path):
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    store_pressed(url, missing=False)
    export_data(ExportRequest(tmp_path / "out.mat", "S-1"), database=url, tell=str)
    usable = SENSOR_TYPE.pattern.usable()
    with open_store(url) as store:
        stored = store.runs.load(store.runs.resolve("S-1")).phases[0].frames.voltages
    assert (
        EidorsMat().read(tmp_path / "out.mat", ReadOptions()).frames.voltages == np.where(usable, stored, 0)
    ).all()


def test_a_channel_that_is_named_like_a_variable_gets_a_name_of_its_own():
    from cbsr_qa.app.export.netcdf import _samples
    from cbsr_qa.domain.readings.frames import SampleBlock

    block = SampleBlock("strain", "1", np.arange(2.0), np.arange(2.0))
    assert [variable.name for variable in _samples(block, {"strain", "strain_time"})] == ["strain__time", "strain_"]
