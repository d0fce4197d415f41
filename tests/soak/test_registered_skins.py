"""Poses of a real skin from nine presses: the table of the page on presses holds."""

import re

import numpy as np
import pytest
from pages import HOW_TO
from pressed_sheets import round_sensor, some

from cbsr_qa.calibration.presses.electrode_order import find_electrode_order
from cbsr_qa.calibration.presses.weak_loads import ModelledSheet

_PAGE = (HOW_TO / "calibrate-from-presses.md").read_text(encoding="utf-8")
_DRAWS = 40


def poses(skin, count, seeds, *, stated):
    """Poses from ``count`` presses drawn at random, once for each seed."""
    sheet = ModelledSheet(round_sensor())
    for seed in seeds:
        drawn = some(skin, np.sort(np.random.default_rng(seed).permutation(len(skin.labels_mm))[:count]))
        order = find_electrode_order(sheet, drawn.pairs, drawn.changes, drawn.labels_mm, radius_stated=stated)
        yield order.registered.registration


@pytest.mark.parametrize(("words", "stated"), [("stated", True), ("estimated", False)])
def test_nine_presses_tell_the_pose_as_well_as_the_page_says(skins, words, stated):
    skin = skins("no_pattern")
    (whole,) = poses(skin, 2000, [0], stated=stated)
    nine = list(poses(skin, 9, range(1, 1 + _DRAWS), stated=stated))
    assert all(pose.trusted and pose.mirrored for pose in nine)
    shift = [np.hypot(*np.subtract(pose.shift_mm, whole.shift_mm)) for pose in nine]
    turn = [abs((pose.rotation_deg - whole.rotation_deg + 180) % 360 - 180) for pose in nine]
    row = re.search(rf"^\| {words} \| ([\d.]+) mm \| ([\d.]+) mm \| ([\d.]+)° \| ([\d.]+)° \|", _PAGE, re.M)
    found = [*np.quantile(shift, [0.5, 0.95]), *np.quantile(turn, [0.5, 0.95])]
    assert np.all(np.array(found) < 1.5 * np.array([float(number) for number in row.groups()]))


def test_the_patterned_skin_is_hardly_ever_taken_for_one_as_modelled(skins):
    trusted = [pose.trusted for pose in poses(skins("parallel_lines"), 9, range(_DRAWS), stated=True)]
    assert np.mean(trusted) <= 0.05
