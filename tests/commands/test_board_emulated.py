"""The station with an emulated ERT board: counts of a stream become images, places and forces."""

import pytest
from command import cbsr_qa, document
from test_bench_emulated import RECIPE

pytestmark = pytest.mark.rest

#: Relaxed force of 20 % strain: E ε A of the shipped material and head [N].
RELAXED_N = 132.5e-3 * 0.2 * 132.73


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("board")
    (folder / "one-press.toml").write_text(RECIPE)
    files = ["--station", "board-emulated", "--recipe", "one-press.toml"]
    return document(cbsr_qa(folder, "run", *files, "--serial", "S-1", "--seed", "11", "--json"))


def test_a_recipe_runs_to_its_end(run):
    assert run["end"] == "finished"
    said = {text.partition(":")[0]: text for text in run["simulated"]}
    assert set(said) == {"applicator", "frames", "load_cell", "thermometer"}
    assert "ERT board, binary stream of 0.236 s a frame" in said["frames"]


def test_what_rests_on_changes_of_counts_is_measured(run):
    found = {m["name"]: m["value"] for m in run["measurements"] if m["value"] is not None}
    assert found["force"] == pytest.approx(RELAXED_N, abs=0.2)
    assert found["centre_of_mass_error"] < 1.0
    assert found["estimated_place_error"] < 1.0
    assert found["reciprocity_error"] < 2e-3


def test_ohms_are_not_made_of_counts(run):
    """Nobody stated the scale: what would need it has no value, and says why."""
    ohms = [m for m in run["measurements"] if m["name"] in ("contact_resistance", "interelectrode_resistance")]
    assert ohms
    assert {m["value"] for m in ohms} == {None}
