"""What becomes of a run on a station whose scene has every effect, electrodes that open included."""

import pytest
from command import cbsr_qa, document, short_recipe

from cbsr_qa.config.documents import DocumentKind, open_document

pytestmark = pytest.mark.rest


def ended(folder, station):
    """How a run ends that takes frames from 1015 to 1110 s: electrode 12 opens at 1053 s."""
    shipped = open_document(DocumentKind.STATION, station).text
    assert 'scene = "base"' in shipped
    (folder / "station.toml").write_text(shipped.replace('scene = "base"', 'scene = "everything"'))
    times = {"rest_s = 240.0": "rest_s = 1000.0", "frames = 30": "frames = 40"}
    recipe = short_recipe(folder, metrics=["centre-of-mass-error"], **times)
    command = ("run", "--station", "station.toml", "--recipe", recipe, "--serial", "S-1", "--json")
    return document(cbsr_qa(folder, *command, check=False))


@pytest.mark.parametrize("station", ["simulated", pytest.param("bench-emulated", marks=pytest.mark.rest)])
def test_a_contact_that_bounces_does_not_stop_a_run(tmp_path, station):
    run = ended(tmp_path, station)
    assert run["end"] == "finished", run["reason"]


def test_a_board_whose_converter_is_too_small_for_the_scene_stops_with_the_rule(tmp_path):
    """What readings on driven electrodes leave in the next ones is beyond its range."""
    run = ended(tmp_path, "board-emulated")
    assert run["end"] == "broken"
    assert "rule 'compliance'" in run["reason"]
    assert "the end of the meter's range" in run["reason"]
