"""A strip is characterised by the commands of the manual, and its material file is taken by a sensor's run."""

import pytest
from command import cbsr_qa, document, refused
from pages import HOW_TO, commands, typed, write_files

from cbsr_qa.config.loader import load_material

pytestmark = pytest.mark.rest

_PAGE = HOW_TO / "characterise-a-material.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder in which the page was followed."""
    folder = tmp_path_factory.mktemp("characterised")
    assert len(write_files(_PAGE, folder)) == 1
    for command in commands(_PAGE):
        assert typed(folder, command).stdout.strip(), command
    return folder


def _material(folder):
    (path,) = (folder / "var" / "materials").glob("B41-*.toml")
    return path


def test_the_page_runs_as_printed(folder):
    assert len(commands(_PAGE)) == 3
    material = load_material(_material(folder)).value
    assert material.name == "B41"
    assert material.against_strain.slope.value == pytest.approx(0.6, rel=0.05)
    assert material.against_strain.covariance < 0
    assert material.modulus_kPa.value == pytest.approx(132.5, rel=0.02)


def test_the_report_and_the_material_come_again_from_the_store(folder):
    before = _material(folder).read_bytes()
    _material(folder).unlink()
    (report,) = (folder / "var" / "reports").glob("STRIP-41-*.html")
    report.unlink()
    cbsr_qa(folder, "report", "STRIP-41")
    assert _material(folder).read_bytes() == before
    assert "Characterisation of the material" in report.read_text()


def test_a_document_says_what_there_is_and_why_not(folder):
    recipe = (folder / "quick-look.toml").read_text()
    (folder / "one-strain.toml").write_text(
        recipe.replace("[10.0, 20.0, 30.0]", "[20.0]").replace("cycles = 2", "cycles = 1")
    )
    run = ("run", "--station", "simulated-strip", "--recipe", "./one-strain.toml", "--serial", "S-2", "--json")
    done = cbsr_qa(folder, *run, check=False)
    said = document(done)
    assert done.returncode == 3
    assert said["outcome"] == "not measured"
    assert said["material"] is None
    assert "slope and intercept need two" in said["material_why"]
    assert said["calibration_why"] == "a material strip gets no calibration"
    assert {"settling_time", "conductance_change"} <= {m["name"] for m in said["measurements"]}
    assert not list((folder / "var" / "materials").glob("S-2*"))


def test_a_recipe_for_strips_is_refused_on_a_sensor_before_anything_moves(folder):
    said = refused(folder, "run", "--station", "simulated", "--recipe", "characterisation", "--serial", "S-3")
    assert "sensor type 'disc-100mm' is not a strip" in said
    said = refused(folder, "run", "--station", "simulated-strip", "--recipe", "nine-locations", "--serial", "S-3")
    assert "0 independent readings" in said
