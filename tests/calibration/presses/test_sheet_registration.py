"""Registration finds the pose that presses were labelled with, and refuses what does not determine it."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, opposite_pairs, pressed_sheet, round_sensor, some
from tiers import rest_but

from cbsr_qa.calibration.presses.ascent import ascend
from cbsr_qa.calibration.presses.electrode_order import find_electrode_order
from cbsr_qa.calibration.presses.likeness import Likeness
from cbsr_qa.calibration.presses.registration import register_presses
from cbsr_qa.calibration.presses.weak_loads import ModelledSheet
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.eit.estimate.readings import load_model
from cbsr_qa.eit.loads.round_load import RoundLoads


def registered(pressed, *, stated=True, radius_mm=None):
    sheet = ModelledSheet(round_sensor(radius_mm or pressed.sensor.radius_mm))
    return register_presses(sheet, pressed.pairs, pressed.changes, pressed.labels_mm, radius_stated=stated)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize(
    ("pairs", "sign"), [pytest.param(opposite_pairs(), 1, marks=pytest.mark.rest), (adjacent_pairs(), -1)]
)
def test_the_pose_that_presses_were_labelled_with_is_found(mirrored, pairs, sign):
    pressed = pressed_sheet(60, pairs=pairs, mirrored=mirrored, rotation_deg=-140.0, scale=1.04)
    found = registered(replace(pressed, changes=sign * pressed.changes))
    pose = found.registration
    assert (pose.mirrored, found.sign, pose.trusted) == (mirrored, sign, True)
    assert pose.rotation_deg == pytest.approx(-140, abs=1.5)
    assert pose.scale == pytest.approx(1.04, abs=0.02)
    assert pose.shift_mm == pytest.approx((46, -408), abs=1)
    assert pose.signal_share > 0.9
    assert pose.place_share > 0.95
    np.testing.assert_allclose(pose.on_sheet_mm(pressed.labels_mm), pressed.places_mm, atol=2.5)


def test_without_a_stated_radius_it_is_estimated_at_a_scale_of_one():
    pressed = pressed_sheet(60, radius_mm=51.0, rotation_deg=100.0)
    pose = registered(pressed, stated=False, radius_mm=200.0).registration
    assert pose.scale == 1
    assert pose.radius_mm == pytest.approx(51, abs=1.5)
    assert 0 < pose.radius_stderr_mm < 2


def test_places_on_the_sheet_and_labels_are_turned_into_each_other():
    pose = registered(pressed_sheet(12, mirrored=True, scale=0.95)).registration
    places = np.array([[3.0, 4.0], [-20.0, 7.0]])
    np.testing.assert_allclose(pose.on_sheet_mm(pose.to_press_frame_mm(places)), places, atol=1e-9)


def test_places_in_another_unit_are_seen_in_the_scale():
    pressed = pressed_sheet(40, noise=0.1, scale=1e-3, shift_mm=(0.046, -0.408))
    pose = registered(pressed).registration
    assert pose.trusted
    assert pose.scale == pytest.approx(1e-3, rel=0.05)


def test_a_rectifying_front_end_and_spikes_do_not_turn_the_sheet():
    pressed = pressed_sheet(40, rectified=True, mirrored=True, rotation_deg=70.0)
    changes, random = pressed.changes.copy(), np.random.default_rng(0)
    for press in random.choice(40, 4, replace=False):
        changes[press, random.integers(changes.shape[1])] += 100 * np.median(np.abs(changes[press]))
    found = registered(replace(pressed, changes=changes))
    assert "rectify" in found.findings[0]
    assert found.registration.mirrored
    assert found.registration.rotation_deg == pytest.approx(70, abs=3)
    assert found.registration.trusted


@pytest.mark.parametrize("head_mm", rest_but({13.0}, [4.0, 13.0, 18.0]))
def test_nine_presses_on_a_grid_are_not_drawn_to_the_lattice_and_the_scale_has_an_honest_error(head_mm):
    sensor = load_sensor_type("disc-100mm").value
    model, places = load_model(sensor), np.array(NINE_LOCATIONS_MM)
    drive, measure = np.nonzero(model.pattern.usable())
    pairs = np.array(
        [(*model.pattern.drive[d], *model.pattern.measure[m]) for d, m in zip(drive, measure, strict=True)]
    )
    loads = RoundLoads.from_contrast(places, np.full(9, head_mm / 2), np.full(9, 0.3))
    changes = model.readings(loads).change[:, drive, measure]
    pose = register_presses(ModelledSheet(sensor), pairs, changes, places, radius_stated=True).registration
    assert abs(pose.scale - 1) < 2 * pose.scale_stderr < 0.1
    assert abs(pose.rotation_deg) < 0.1
    assert np.hypot(*pose.shift_mm) < 0.05
    assert min(pose.shift_stderr_mm) > 0
    assert pose.rotation_stderr_deg > 0


@pytest.mark.rest
def test_its_standard_errors_are_those_of_presses_drawn_again():
    whole = pressed_sheet(400, noise=1.5, rotation_deg=40.0)
    drawn = [some(whole, np.random.default_rng(seed).choice(400, 12, replace=False)) for seed in range(16)]
    poses = [registered(each).registration for each in drawn]
    scatter = np.std([pose.rotation_deg for pose in poses])
    stated = np.median([pose.rotation_stderr_deg for pose in poses])
    assert 0.5 < stated / scatter < 2


_LINE = np.column_stack([np.linspace(-40, 40, 9), np.linspace(-20, 20, 9)])


@pytest.mark.parametrize(
    ("places", "why"),
    [
        (np.tile([[3.0, 4.0]], (9, 1)), r"one place, \(3, 4\) mm"),
        (np.tile([[3.0, 4.0], [8.0, 9.0], [1.0, 2.0]], (3, 1)), "3 different places"),
        (_LINE, "on one line"),
    ],
)
def test_places_that_do_not_determine_a_pose_are_refused(places, why):
    with pytest.raises(NumericsError, match=why):
        registered(replace(pressed_sheet(9), labels_mm=places))


def test_readings_that_have_nothing_to_do_with_the_places_are_not_trusted():
    pressed = pressed_sheet(30)
    shuffled = registered(replace(pressed, changes=np.random.default_rng(1).permutation(pressed.changes)))
    assert not shuffled.registration.trusted
    assert "explains" in shuffled.registration.why


@pytest.mark.rest
@pytest.mark.parametrize("radius_stated", [True, False])
def test_nine_presses_of_a_real_skin_are_registered_as_two_thousand_are(skins, radius_stated):
    plain = skins("no_pattern")
    whole = registered(plain, stated=radius_stated)
    assert "rectify" in whole.findings[0]
    on_sheet = 40 * np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
    apart = []
    for seed in range(10):
        nine = some(plain, np.random.default_rng(seed).choice(len(plain.labels_mm), 9, replace=False))
        found = registered(nine, stated=radius_stated)
        assert found.registration.trusted
        assert found.registration.mirrored
        places = [
            pose.to_press_frame_mm(on_sheet * pose.radius_mm / 73)
            for pose in (found.registration, whole.registration)
        ]
        apart.append(np.linalg.norm(places[0] - places[1], axis=1).mean())
    assert np.quantile(apart, 0.9) < 9
    assert np.median(apart) < 5


@pytest.mark.rest
def test_a_patterned_skin_is_not_what_the_disc_describes(skins):
    lines = skins("parallel_lines")
    for count in (9, 200):
        rows = np.random.default_rng(count).choice(len(lines.labels_mm), count, replace=False)
        assert not registered(some(lines, rows)).registration.trusted


def ordered(pressed):
    sheet = ModelledSheet(pressed.sensor)
    return find_electrode_order(sheet, pressed.pairs, pressed.changes, pressed.labels_mm, radius_stated=True)


def test_two_exchanged_electrodes_are_named_and_others_are_not():
    wired = np.arange(16)
    wired[[3, 10]] = 10, 3
    order = ordered(pressed_sheet(40, wired=wired, noise=0.1))
    assert len(order.findings) == 1
    assert order.findings[0].startswith("electrodes 3 and 10 seem to be exchanged")
    assert order.registered.registration.signal_share > 0.9
    assert not ordered(pressed_sheet(40, noise=0.1)).findings


@pytest.mark.rest
def test_measuring_electrodes_that_are_numbered_from_elsewhere_are_named():
    pressed = pressed_sheet(40, noise=0.1)
    shifted = pressed.pairs.copy()
    shifted[:, 2:] = (shifted[:, 2:] - 3) % 16
    order = ordered(replace(pressed, pairs=shifted))
    assert "numbered from electrode 3 of the driving ones" in order.findings[0]
    np.testing.assert_array_equal(order.pairs, pressed.pairs)


@pytest.mark.rest
def test_a_pattern_that_leaves_out_what_it_drives_is_numbered_as_it_says(skins):
    """Other numberings explain the plain skin a little better, but would measure at driven electrodes."""
    skin = skins("no_pattern")
    rows = np.random.default_rng(1).permutation(len(skin.labels_mm))[:39]
    assert not ordered(some(skin, rows)).findings


def test_electrodes_numbered_the_other_way_round_are_a_mirrored_sheet():
    order = ordered(pressed_sheet(40, wired=-np.arange(16) % 16))
    assert order.registered.registration.mirrored
    assert not order.findings


# --- its search: Newton's steps ---


def test_slopes_and_bends_of_likelihoods_are_those_of_differences():
    pressed = pressed_sheet(6, noise=0.3)
    likeness = Likeness(ModelledSheet(pressed.sensor), pressed.pairs, pressed.changes)
    places = np.random.default_rng(2).uniform(-1, 1, (40, 6, 2))  # some of them at the rim and beyond the sheet
    _, *slopes, xx, xy, yy = likeness.evaluate(places)
    step = 1e-5
    for slope, bends, along in zip(slopes, [(xx, xy), (xy, yy)], step * np.eye(2), strict=True):
        change = (likeness.evaluate(places + along) - likeness.evaluate(places - along)) / (2 * step)
        np.testing.assert_allclose(slope, change[0], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(bends, change[1:3], rtol=1e-4, atol=1e-3)
    assert np.abs(slopes).max() > 1


def test_an_ascent_ends_at_the_nearest_maximum_and_leaves_saddles():
    def jet(at, which):
        """cos x cos y, stretched for every start: maxima where x and y are both multiples of π with an even sum."""
        scale = stretched[which]
        (x, y), one = at.T * scale, np.ones(len(at))
        value, mixed = np.cos(x) * np.cos(y), np.sin(x) * np.sin(y)
        slope = -np.stack([np.sin(x) * np.cos(y), np.cos(x) * np.sin(y)], axis=-1)
        bend = np.stack([np.stack([-value, mixed], -1), np.stack([mixed, -value * one], -1)], axis=-2)
        return value, slope * scale[:, None], bend * scale[:, None, None] ** 2

    stretched = np.array([1.0, 1.0, 2.0, 1.0])
    starts = np.array([[0.5, -0.7], [2.9, 3.6], [0.3, 0.2], [np.pi / 2 + 0.01, np.pi / 2 + 0.01]])
    at, value = ascend(jet, starts)
    np.testing.assert_allclose(value, 1, atol=1e-12)
    np.testing.assert_allclose(at[:3], [[0, 0], [np.pi, np.pi], [0, 0]], atol=1e-6)
    np.testing.assert_allclose(np.abs(at[3] - np.pi / 2), np.pi / 2, atol=1e-6)
