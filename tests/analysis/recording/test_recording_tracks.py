"""Objects that are followed: whether they move, and how that is said."""

import json
from pathlib import Path

import numpy as np
import pytest
from pressed_files import exported, moving_frames, pressed_frames

from cbsr_qa.analysis.recording.imaged_events import motion_of
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout

LAYOUT = ElectrodeLayout(16, ElectrodeKind.PIN, 1.0, 0.01, 0.0, counterclockwise=True)
CLOCKWISE = ElectrodeLayout(16, ElectrodeKind.PIN, 1.0, 0.01, 0.0, counterclockwise=False)


def track(places):
    return tuple((0.1 * k, float(x), float(y)) for k, (x, y) in enumerate(places))


def ring(begin, turns, n=60, r=0.5):
    angle = 2 * np.pi * (begin / 16 + turns * np.linspace(0, 1, n))
    return r * np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize(
    ("turns", "said"),
    [
        (1.0, "once round, towards higher electrode numbers"),
        (-0.93, "once round, towards lower electrode numbers"),
        (2.5, "2.5 times round, towards higher electrode numbers"),
        (0.4, ", towards higher electrode numbers"),
    ],
)
def test_a_way_round_is_told_with_its_ends_turns_and_sense(turns, said):
    motion = motion_of(track(ring(3.0, turns)), LAYOUT)
    assert motion.turns == pytest.approx(turns)
    assert motion.begins == pytest.approx((3.0, 0.5))
    assert motion.ends == pytest.approx(((3.0 + 16 * turns) % 16, 0.5))
    assert motion.words.startswith("from electrode 3.0, r/R 0.50 to electrode ")
    assert motion.words.endswith(said)


def test_electrodes_numbered_clockwise_turn_the_sense():
    assert motion_of(track(ring(3.0, 1.0)), CLOCKWISE).turns == pytest.approx(-1)


def test_a_way_through_the_centre_is_no_turn():
    motion = motion_of(track(np.linspace((-0.5, -0.01), (0.5, 0.01), 40)), LAYOUT)
    assert motion.words == "from electrode 8.1, r/R 0.50 to electrode 0.1, r/R 0.50, through the centre"


def test_a_way_outwards_has_no_sense():
    assert motion_of(track(np.linspace((0.3, 0.0), (0.7, 0.0), 40)), LAYOUT).words.endswith("r/R 0.70")


@pytest.mark.parametrize("scatter", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("frames", [4, 5, 12, 60])
def test_an_object_that_stays_does_not_move_however_its_place_scatters(scatter, frames):
    random = np.random.default_rng(4)
    for _ in range(50):
        places = [0.4, 0.2] + scatter * random.normal(size=(frames, 2))
        assert motion_of(track(places), LAYOUT) is None


def test_one_frame_and_none_tell_no_motion():
    assert motion_of((), LAYOUT) is None
    assert motion_of(((0.0, 0.1, 0.2),), LAYOUT) is None


@pytest.fixture
def walked(tmp_path, monkeypatch, capsys):
    """An object that goes half round against the empty sheet: words, document and report."""
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    places = ring(0.0, 0.5, n=16)
    held = exported(tmp_path, moving_frames(places, contrast=-0.3), name="held.h5")
    empty = exported(tmp_path, pressed_frames(0, 0, contrast=0.0, n=12, seed=3), name="empty.h5")
    said = []
    for more in ((), ("--json",)):
        assert run_guarded(["analyse", str(held), "--reference", str(empty), *more]) == 0
        said.append(capsys.readouterr().out)
    found = json.loads(said[1])
    return said[0], found, Path(found["report"]).read_text(encoding="utf-8")


@pytest.mark.rest
def test_what_moves_is_said_on_the_terminal_in_the_document_and_in_the_report(walked):
    words, found, html = walked
    (event,) = found["events"]
    motion = event["motion"]
    assert motion["turns"] == pytest.approx(0.5, abs=0.02)
    assert motion["to"] == pytest.approx({"electrode": 8.0, "r_over_R": 0.5}, abs=0.1)
    assert f"moves: {motion['words']}" in " ".join(words.split())
    assert f"E1 moves: {motion['words']}" in html
    assert "Line: the way of what moves" in html
    assert "clearest at electrode" in html
