"""A plugin in a distribution of its own joins a run and its report, and the core does not change."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import FEW_SECTIONS
from station_files import station_file

from cbsr_qa.analysis.recording_files import read_recording

pytestmark = pytest.mark.rest

_HERE = Path(__file__).parent

_INSTRUMENTS = """
[instruments.bench]
driver = "simulated-bench"
provides = ["frame_source", "force_applicator", "force"]
scene = "base"

[instruments.room]
driver = "lab-thermometer"
provides = ["temperature"]
calibration_due = 2027-03-01
start_C = 21.0
rise_C_per_h = 1.5
"""

_SCENE = """
[scene]
name = "draught"
current_mA = 0.4
frame_period_s = 1.0
sheet_mesh_size_mm = 8.0

[sensor]
sensor_type = "disc-100mm"
material = "cbsr-8wt"

[recording]
seed = 3
duration_s = 6.0
"""

_DRAUGHT = """
[[effects]]
name = "room-draught"
cooler_K = {cooler_K}
resists_per_K = 0.01
from_s = 2.0
to_s = 4.0
"""

_LIMIT = """
[[limits]]
measurement = "temperature_span"
unit = "°C"
upper = 0.05
"""


def _short_recipe(shipped: str) -> str:
    """The shipped recipe with its first phase alone, the stranger's metric and a limit on it; no figures."""
    head, rest = shipped.split("[[phases]]", 1)
    first = rest.split("[[phases]]", 1)[0]
    tail = rest[rest.index("[reconstruction]") :]
    head = head.replace('"nine locations"', '"noise figure"')
    tail = tail[: tail.index("[[limits]]")].replace("[metrics]\n", "[metrics]\ntemperature-span = {}\n")
    return head + "[[phases]]" + first.replace("trials = 3", "trials = 1") + tail + FEW_SECTIONS + _LIMIT


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Environment in which the stranger is installed beside us."""
    site = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    source = tmp_path_factory.mktemp("source") / "lab_thermometer"
    # A copy: building leaves files beside the source.
    subprocess.run(["cp", "-r", str(_HERE / "lab_thermometer"), str(source)], check=True)
    subprocess.run([*pip, "--target", str(site), str(source)], check=True)
    return {**os.environ, "PYTHONPATH": str(site)}


def _cbsr_qa(environment, folder, *arguments):
    command = [str(Path(sys.executable).with_name("cbsr-qa")), *arguments]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


def test_it_is_listed_with_its_distribution(environment, tmp_path):
    done = _cbsr_qa(environment, tmp_path, "plugins", "list", "--json")
    listed = json.loads(done.stdout)["plugins"]
    theirs = [(row["kind"], row["name"]) for row in listed if row["from"] == "lab-thermometer"]
    assert theirs == [("effect", "room-draught"), ("instrument", "lab-thermometer"), ("metric", "temperature-span")]


def test_it_appears_in_a_run_and_its_report(environment, tmp_path):
    from cbsr_qa.config.documents import DocumentKind, open_document

    shipped = open_document(DocumentKind.RECIPE, "nine-locations").text
    (tmp_path / "station.toml").write_text(
        station_file("with-thermometer", _INSTRUMENTS, travel_radius_mm=42.0, duration_h=1.0)
    )
    (tmp_path / "recipe.toml").write_text(_short_recipe(shipped))
    files = ["--station", "station.toml", "--recipe", "recipe.toml", "--serial", "T-1", "--seed", "5"]
    done = _cbsr_qa(environment, tmp_path, "run", *files, "--json")
    document = json.loads(done.stdout)

    assert document["end"] == "finished", done.stderr
    (span,) = [m for m in document["measurements"] if m["name"] == "temperature_span"]
    # Sampled every second of the run at 1.5 K an hour.
    expected = 1.5 * document["station_s"] / 3600
    assert span["value"] == pytest.approx(expected, abs=1.5 * 3 / 3600)
    assert (span["unit"], span["upper"]) == ("°C", 0.05)
    assert span["outcome"] == ("pass" if span["value"] <= 0.05 else "fail")

    report = (tmp_path / document["report"]).read_text()
    for text in ("temperature span", "Lab thermometer T-1", "T1-0042", "2027-03-01", "2.3.4"):
        assert text in report, text


def test_its_effect_joins_a_scene(environment, tmp_path):
    """Scene files take it with its parameters, `explain` lists it, recordings hold it and say whose it is."""
    (tmp_path / "plain.toml").write_text(_SCENE)
    (tmp_path / "draught.toml").write_text(_SCENE + _DRAUGHT.format(cooler_K=5.0))
    for scene in ("plain", "draught"):
        done = _cbsr_qa(environment, tmp_path, "scene", "run", f"{scene}.toml", "--output", f"{scene}.h5")
        assert done.returncode == 0, done.stderr
    plain, cooled = (read_recording(tmp_path / f"{scene}.h5") for scene in ("plain", "draught"))
    ratio = cooled.frames.voltages / plain.frames.voltages
    expected = np.where((plain.frames.time_s > 2) & (plain.frames.time_s < 4), 1.05, 1.0)
    np.testing.assert_allclose(ratio, np.broadcast_to(expected[:, None, None], ratio.shape), rtol=1e-12)
    assert "lab-thermometer 2.3.4" in cooled.simulated[0]
    assert "lab-thermometer" not in plain.simulated[0]

    done = _cbsr_qa(environment, tmp_path, "scene", "explain", "draught.toml", "--json")
    (entry,) = [effect for effect in json.loads(done.stdout)["effects"] if effect["name"] == "room-draught"]
    assert (entry["on"], entry["needs"], entry["perturbs"]) == (True, [], "impedance")
    assert entry["cost_ms_per_frame"] >= 0


def test_its_effect_refuses_by_name(environment, tmp_path):
    (tmp_path / "draught.toml").write_text(_SCENE + _DRAUGHT.format(cooler_K=-5.0))
    done = _cbsr_qa(environment, tmp_path, "scene", "run", "draught.toml")
    assert done.returncode == 2
    assert "effects[1].cooler_K is -5.0" in done.stderr
    assert not (tmp_path / "var").exists()
