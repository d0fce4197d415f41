"""A sheet beside its place: found by its loads, and no harm to its force."""

from dataclasses import replace

import numpy as np
import pytest
from force_samples import setting, somewhere
from simulated_runs import simulated_run
from test_verification import observed

from cbsr_qa.analysis.run.force import run_force
from cbsr_qa.calibration.force.sheet_pose import AS_PLACED, SheetPose, sheet_pose_of
from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.force.templates import make_even_model
from cbsr_qa.config.loader import load_scene_plan
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa_plugins.sections.force import _sheet_pose_words


def pressed(shift_mm, rotation_deg, *, count=12, noise=0.25, seed=1):
    """Nominal places and matches of loads on a sheet that lies so, by the exact model."""
    random = np.random.default_rng(seed)
    nominal = somewhere(random, count, 33.0)
    on_sheet = SheetPose(shift_mm, rotation_deg, moved=True).places_mm(nominal)
    rows = setting().rows(on_sheet, np.full(count, 0.12))
    finder = TemplateFilter(make_even_model(setting().bank, setting().readings.merging))
    found = finder.search(rows + np.sqrt(noise) * random.standard_normal(rows.shape))
    return nominal, found, np.full(count, noise), on_sheet


@pytest.mark.parametrize(("shift_mm", "rotation_deg"), [((1.0, -0.5), 2.0), ((0.0, 0.0), -3.0), ((-2.0, 1.5), 0.0)])
def test_shift_and_rotation_are_found(shift_mm, rotation_deg):
    nominal, found, noise, on_sheet = pressed(shift_mm, rotation_deg)
    pose = sheet_pose_of(nominal, found, noise)
    assert pose.moved
    assert abs(pose.rotation_deg - rotation_deg) < 4 * pose.rotation_stderr_deg
    assert np.abs(np.array(pose.shift_mm) - shift_mm).max() < 4 * pose.shift_stderr_mm
    assert np.hypot(*(pose.places_mm(nominal) - on_sheet).T).max() < 0.3


def test_a_sheet_in_its_place_is_left_there():
    moved = [sheet_pose_of(*pressed((0.0, 0.0), 0.0, seed=seed)[:3]).moved for seed in range(20)]
    assert sum(moved) == 0
    nominal = np.array([[1.0, 2.0]])
    assert AS_PLACED.places_mm(nominal) is nominal


def test_one_load_that_is_found_elsewhere_does_not_move_the_sheet():
    nominal, found, noise, _ = pressed((0.0, 0.0), 0.0, count=9)
    place = found.place_mm.copy()
    place[3] += (25.0, -10.0)
    assert not sheet_pose_of(nominal, replace(found, place_mm=place), noise).moved


def test_too_few_places_say_nothing():
    nominal, found, noise, _ = pressed((3.0, 0.0), 5.0, count=2)
    assert sheet_pose_of(nominal, found, noise) == AS_PLACED
    again = np.repeat(nominal[:1], 2, axis=0)
    assert sheet_pose_of(again, found, noise) == AS_PLACED


@pytest.mark.rest
def test_a_misplaced_sheet_is_calibrated_where_it_lies():
    tables = dict(load_scene_plan("base").document.data)
    beside = {"name": "misplaced-sheet", "x_mm": 1.0, "y_mm": -0.5, "rotation_deg": 2.0}
    scene = {**tables, "effects": [beside, *tables["effects"]]}
    run, _ = observed(simulated_run(NINE_LOCATIONS_MM, scene=scene, seed=6), "grid")
    found = run_force(run)
    assert found.sheet_pose.moved
    assert abs(abs(found.sheet_pose.rotation_deg) - 2.0) < 0.5
    assert np.hypot(*found.sheet_pose.shift_mm) == pytest.approx(np.hypot(1.0, 0.5), abs=0.3)
    assert found.learned.model.place_scatter_mm < 0.3


def test_the_report_says_how_the_sheet_lay():
    said = _sheet_pose_words(SheetPose((1.04, -0.5), -2.0, 0.05, 0.1, moved=True))
    assert "(+1.0, −0.5) ± 0.1 mm from the sheet's" in said
    assert "rotated by −2.0 ± 0.1°" in said


def test_places_that_are_pressed_again_stay_equal_to_the_last_bit():
    random = np.random.default_rng(3)
    for count in (1, 3, 9, 13, 64):
        places = random.uniform(-40, 40, (count, 2))
        moved = SheetPose((0.3, -1.1), 3.7, moved=True).places_mm(np.vstack([places, places[::-1], places]))
        one_by_one = [SheetPose((0.3, -1.1), 3.7, moved=True).places_mm(place[None])[0] for place in places]
        for again in (moved[:count], moved[count : 2 * count][::-1], moved[2 * count :], np.array(one_by_one)):
            assert again.tobytes() == moved[:count].tobytes()
