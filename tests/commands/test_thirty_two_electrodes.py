"""A sensor type of 32 electrodes from its run to streamed forces: the number stands in its file alone."""

import csv
import json

import numpy as np
import pytest
import scipy.io
from command import cbsr_qa, document, refused
from scene_samples import HEAD, load_table
from streamed import messages, streaming

from cbsr_qa.analysis.recording_files import read_recording
from cbsr_qa.config.documents import DocumentKind, open_document

_RECIPE = """
[recipe]
name = "five-places"
calibrate_phases = ["nine locations"]

[[phases]]
name = "nine locations"
sequence = "location-grid"
strains_percent = [20.0]
trials = 1
locations_mm = [[0.0, 0.0], [30.0, 0.0], [-15.0, 15.0], [0.0, -30.0], [-25.0, -10.0]]
hold_s = 60.0
rest_s = 60.0
initial_rest_s = 120.0
unloaded_frames = 16

[reconstruction]
method = "gauss-newton-noser"
noise_figure = 1.0
exponent = 0.25

[metrics.centre-of-mass-error]

[[limits]]
measurement = "centre_of_mass_error"
upper = 10.0
unit = "mm"
"""
#: Places of the recipe by electrode and r/R: electrode 0 lies on +x, a degree of the circle is 32/360 electrodes.
_PLACES = {(0.0, 0.6), (12.0, 0.42), (24.0, 0.6), (17.94, 0.54)}


def write_files(folder):
    """A disc with 32 pins in place of 16, stations of it, and a recipe and a scene that are short."""
    disc = open_document(DocumentKind.SENSOR_TYPE, "disc-100mm").text
    (folder / "disc32.toml").write_text(disc.replace("disc-100mm", "disc32").replace("count = 16", "count = 32"))
    for name in ("simulated", "board-emulated", "bench-emulated"):
        text = open_document(DocumentKind.STATION, name).text
        (folder / f"{name}.toml").write_text(text.replace('"disc-100mm"', '"disc32.toml"'))
    (folder / "five-places.toml").write_text(_RECIPE)
    scene = HEAD.replace('"disc-100mm"', '"disc32.toml"') + load_table(x_mm=20.0, y_mm=5.0)
    effects = '[[effects]]\nname = "time-skew"\n\n[[effects]]\nname = "piezoresistivity"\n'
    (folder / "scene.toml").write_text(scene + effects)


@pytest.fixture
def folder(tmp_path):
    write_files(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def tested(tmp_path_factory):
    """A folder with a run of such a sensor, its calibration, and its frames in each format."""
    folder = tmp_path_factory.mktemp("thirty-two")
    write_files(folder)
    words = ("--station", "simulated.toml", "--recipe", "five-places.toml", "--serial", "S-32", "--json")
    run = document(cbsr_qa(folder, "run", *words))
    assert run["outcome"] == "pass"
    (folder / "sensor.h5").write_bytes((folder / run["calibration"]).read_bytes())
    for file in ("frames.h5", "frames.mat", "frames.nc"):
        cbsr_qa(folder, "export", "S-32", "--to", file)
    return folder


# --- before a run --------------------------------------------------------------------------------------------


def test_a_multiplexer_of_16_channels_refuses_a_dry_run_and_the_run(folder):
    for more in (["--dry-run"], []):
        words = ["--station", "bench-emulated.toml", "--recipe", "five-places.toml", "--serial", "S-32", *more]
        error = refused(folder, "run", *words)
        assert "(esp32-multiplexer) connects 16 electrodes; sensor type 'disc32' has 32" in error
        assert not (folder / "var" / "cbsr-qa.db").exists() or more


def test_a_board_stream_passes_the_dry_run(folder):
    words = ("--station", "board-emulated.toml", "--recipe", "five-places.toml", "--serial", "S-32", "--dry-run")
    assert "The station allows this run" in cbsr_qa(folder, "run", *words).stdout


# --- recordings ----------------------------------------------------------------------------------------------


def assert_press(folder, file):
    """The press of the scene is found where it is."""
    found = document(cbsr_qa(folder, "analyse", file, "--sensor-type", "disc32.toml", "--json"))
    (event,) = found["events"]
    assert event["electrode"] == pytest.approx(np.degrees(np.arctan2(5, 20)) * 32 / 360, abs=0.1)
    assert event["r_over_R"] == pytest.approx(np.hypot(20, 5) / 50, abs=0.06)


@pytest.mark.rest
def test_a_scene_is_written_read_and_analysed_in_every_format_that_holds_32(folder):
    cbsr_qa(folder, "scene", "run", "scene.toml", "--output", "scene.h5", "--format", "ert-board-csv")
    for file in ("scene.h5", "scene.ert-board-csv.csv"):
        assert_press(folder, file)


def test_a_rig_of_16_channels_has_no_such_recording(folder):
    words = ("scene", "run", "scene.toml", "--output", "scene.h5", "--format", "smu-rig-csv")
    error = refused(folder, *words)
    assert "smu-rig-csv holds the adjacent pattern of 16 electrodes; this one drives 32 pairs of 32" in error


# --- a run, and what comes of it -----------------------------------------------------------------------------


@pytest.mark.rest
def test_exported_frames_hold_32_by_32_readings_and_are_analysed(tested):
    frames = read_recording(tested / "frames.h5").frames.voltages
    assert frames.shape[1:] == (32, 32)
    vectors = scipy.io.loadmat(tested / "frames.mat")["vv"]
    np.testing.assert_allclose(vectors.T.reshape(frames.shape), frames)
    assert (tested / "frames.nc").stat().st_size > frames.nbytes / 4
    for file in ("frames.h5", "frames.mat"):
        found = document(cbsr_qa(tested, "analyse", file, "--sensor-type", "disc32.toml", "--json"))
        seen = {(event["electrode"], event["r_over_R"]) for event in found["events"]}
        assert len(seen) == 5
        for electrode, out in _PLACES:
            assert any(
                abs((one - electrode + 16) % 32 - 16) < 0.3 and abs(other - out) < 0.08 for one, other in seen
            ), (file, electrode, seen)


@pytest.mark.rest
def test_the_calibration_goes_through_every_format_without_loss(tested):
    assert json.loads(cbsr_qa(tested, "calibration", "show", "sensor.h5", "--json").stdout)
    cbsr_qa(tested, "calibration", "export", "sensor.h5", "--output", "sensor.json")
    cbsr_qa(tested, "calibration", "export", "sensor.json", "--output", "again.h5")
    assert (tested / "again.h5").read_bytes() == (tested / "sensor.h5").read_bytes()
    cbsr_qa(tested, "calibration", "export", "sensor.h5", "--firmware", "--output", "firmware.json")
    firmware = json.loads((tested / "firmware.json").read_text())
    assert firmware["loss"]["places_lost"] == 0


@pytest.mark.rest
def test_frames_become_forces_applied_and_streamed(tested):
    cbsr_qa(tested, "calibration", "apply", "sensor.h5", "frames.h5", "--output", "forces.csv")
    with (tested / "forces.csv").open() as file:
        rows = list(csv.DictReader(file))
    applied = np.array([float(row["force_N"]) for row in rows])
    settled = np.array([row["flags"] == "" and float(row["force_N"]) > 0 for row in rows])
    assert settled.sum() >= 10
    assert np.abs(applied[settled] - 3.5).max() < 0.5
    station = (tested / "simulated.toml").read_text().replace('"virtual"', '"virtual"\nclock_speed = 100.0')
    played = station.partition("[instruments")[0] + (
        '[instruments.bench]\ndriver = "replayed-recording"\n'
        'provides = ["frame_source", "force_applicator", "force"]\n'
        f'file = "{tested / "frames.h5"}"\n'
    )
    (tested / "played.toml").write_text(played)
    with streaming(tested, "sensor.h5", "--station", "played.toml") as process:
        out, error = process.communicate(timeout=120)
    assert process.returncode == 0, error
    streamed = [message["force_N"] for message in messages(out) if message["type"] == "frame"]
    assert len(streamed) == len(applied)
    np.testing.assert_allclose(streamed, applied, rtol=1e-9)


@pytest.mark.rest
def test_a_run_with_a_board_of_32_pairs_ends(folder):
    recipe = _RECIPE.replace(", [-15.0, 15.0], [0.0, -30.0], [-25.0, -10.0]", "").replace("60.0", "5.0")
    (folder / "five-places.toml").write_text(recipe)
    words = ("--station", "board-emulated.toml", "--recipe", "five-places.toml", "--serial", "S-32", "--json")
    run = document(cbsr_qa(folder, "run", *words))
    assert (run["end"], run["reconstruction"]["readings"]) == ("finished", 32 * 29)
