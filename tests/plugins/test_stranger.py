"""A plugin in a distribution of its own joins a run and its report, and the core does not change."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

_HERE = Path(__file__).parent

_STATION = """
[station]
name = "with-thermometer"
clock = "virtual"
sensor_type = "disc-100mm"
material = "cbsr-8wt"

[indenter]
diameter_mm = 13.0

[motion]
press_speed_mm_per_min = 40.0
travel_speed_mm_per_min = 600.0
hover_mm = 25.0

[safety]
force_N = 20.0
strain_percent = 35.0
travel_radius_mm = 42.0
duration_h = 1.0
stale_s = 2.0

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

_LIMIT = """
[[limits]]
measurement = "temperature_span"
unit = "°C"
upper = 0.05
"""


def _short_recipe(shipped: str) -> str:
    """The shipped recipe with its first phase alone, the stranger's metric and a limit on it."""
    head, rest = shipped.split("[[phases]]", 1)
    first = rest.split("[[phases]]", 1)[0]
    tail = rest[rest.index("[reconstruction]") :]
    head = head.replace('"nine locations"', '"noise figure"')
    tail = tail[: tail.index("[[limits]]")].replace("[metrics]\n", "[metrics]\ntemperature-span = {}\n")
    return head + "[[phases]]" + first.replace("trials = 3", "trials = 1") + tail + _LIMIT


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
    assert theirs == [("instrument", "lab-thermometer"), ("metric", "temperature-span")]


def test_it_appears_in_a_run_and_its_report(environment, tmp_path):
    from cbsr_qa.config.documents import DocumentKind, open_document

    shipped = open_document(DocumentKind.RECIPE, "nine-locations").text
    (tmp_path / "station.toml").write_text(_STATION)
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
