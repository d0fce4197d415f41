"""The station of emulated instruments: the real drivers give what the simulation gives directly, within noise."""

import re
import shutil
import subprocess

import pytest
from command import cbsr_qa, document
from one_press import one_press_recipe

pytestmark = pytest.mark.rest

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")

RECIPE = one_press_recipe(
    "applied-force", "centre-of-mass-error", "channel-noise", "contact-resistance", "load-estimate", "reciprocity"
)
#: (measurement, qualifier) → how far apart two runs may be that share sheet and press, but not noise and frame times.
WITHIN = {
    ("contact_resistance", "pair 6-7"): 0.4,  # Ω of 18.1 kΩ; both are means of 16 readings, to 0.06 Ω
    ("interelectrode_resistance", ""): 0.4,
    ("force", ""): 0.1,  # N of 3.6; a surface that is found 0.01 mm elsewhere is 0.05 N
    ("centre_of_mass_error", ""): 1.0,  # mm
    ("channel_snr", "median"): 1.5,  # dB of 58; noise told from 16 frames
    ("reciprocity_error", ""): 1e-4,  # 1, of 2.9e-4
}
#: Whose standard errors say how far.
BY_THEIR_ERRORS = ("estimated_contrast", "estimated_place_error", "drift")


def measured(folder, station):
    (folder / "one-press.toml").write_text(RECIPE)
    files = ["--station", station, "--recipe", "one-press.toml"]
    return document(cbsr_qa(folder, "run", *files, "--serial", "S-1", "--seed", "11", "--json"))


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    return {name: measured(tmp_path_factory.mktemp(name), name) for name in ("simulated", "bench-emulated")}


def figures(run):
    return {(m["name"], m["qualifier"]): (m["value"], m["uncertainty"]) for m in run["measurements"]}


def test_both_runs_measure_the_same_quantities(both):
    direct, driven = map(figures, both.values())
    assert direct.keys() == driven.keys()
    assert [run["end"] for run in both.values()] == ["finished", "finished"]


@pytest.mark.parametrize("what", WITHIN)
def test_what_the_drivers_give_is_what_the_simulation_gives(both, what):
    (direct, _), (driven, _) = (figures(run)[what] for run in both.values())
    assert driven == pytest.approx(direct, abs=WITHIN[what])


@pytest.mark.parametrize("name", BY_THEIR_ERRORS)
def test_estimates_agree_within_their_standard_errors(both, name):
    (direct, error), (driven, also) = (figures(run)[name, ""] for run in both.values())
    assert abs(driven - direct) < 4 * (error**2 + also**2) ** 0.5


def test_everything_on_the_bench_is_said_to_be_simulated(both):
    said = {text.partition(":")[0] for text in both["bench-emulated"]["simulated"]}
    assert said == {"applicator", "frames", "load_cell", "multiplexer", "source_meter", "thermometer"}


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_the_report_of_a_bench_of_six_instruments_prints_on_three_sides(tmp_path):
    cbsr_qa(tmp_path, "station", "check", "bench-emulated", "--ring-ohm", "10000")
    report = tmp_path / measured(tmp_path, "bench-emulated")["report"]
    printed = tmp_path / "report.pdf"
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer", f"--print-to-pdf={printed}"]
    subprocess.run([CHROMIUM, *options, report.as_uri()], check=True, capture_output=True, timeout=120)
    assert len(re.findall(rb"/Type\s*/Page\b", printed.read_bytes())) == 3
