"""Labels and pairs as they are given: what is odd about them is named, repeats are averaged, readings found again."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, opposite_pairs, pressed_sheet, round_sensor, some

from cbsr_qa.calibration.place.pairs import DistinctPairs, match_readings
from cbsr_qa.calibration.presses.inputs import check_inside, check_near, find_outline
from cbsr_qa.calibration.presses.learning import learn_presses
from cbsr_qa.calibration.presses.odd_labels import (
    list_ignored_columns,
    list_unused_electrodes,
    name_far_from_labels,
    name_off_sheet,
)
from cbsr_qa.domain.errors import CalibrationError, RecordingError
from cbsr_qa.domain.geometry.outlines import Disc, Polygon
from cbsr_qa.domain.results.press_calibration import SheetRegistration
from cbsr_qa.domain.sensor.sensor_type import polygon_sensor


@pytest.mark.rest
def test_a_press_with_a_wrong_place_is_named_and_one_off_the_sheet():
    pressed = pressed_sheet(40, seed=41, noise=0.05)
    labels, centre = pressed.labels_mm.copy(), np.array([46.0, -408.0])
    labels[5] = centre + (labels[5] - centre) @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    assert 9 < np.linalg.norm(labels[5] - pressed.labels_mm[5]) < 33
    wrong = replace(pressed, labels_mm=labels)
    learned = learn_presses(wrong.labelled())
    (words,) = learned.findings
    assert words.startswith("1 press is far from where the other presses place it, row 6 by ")
    presses = wrong.labelled().presses
    assert not list(name_off_sheet(presses, learned.registration, Disc(73.0)))
    presses.place_mm[7] = centre + np.array([80.5, 3.0])
    (words,) = name_off_sheet(presses, learned.registration, Disc(73.0))
    assert words.startswith("1 press is outside the sheet, which ends 73 mm from its centre: row 8, ")


def test_presses_are_outside_the_outline_of_a_rectangle_not_of_its_disc():
    """A sheet of 120 × 40 mm has the area of a disc of 39 mm: its ends are outside that, and its sides inside."""
    outline = Polygon(((-60, -20), (60, -20), (60, 20), (-60, 20)))
    sheet = round_sensor()
    pose = SheetRegistration(90.0, 0.1, False, 1.0, 0.01, (10.0, 5.0), (0.1, 0.1), outline.radius_mm, 0.0, 1, 1, True)
    assert find_outline(polygon_sensor("strip", outline, 3.0, sheet.electrodes, sheet.pattern), pose) is outline
    assert find_outline(sheet, replace(pose, radius_mm=50.0)) == Disc(50.0)
    presses = pressed_sheet(4).labelled().presses
    on_sheet_mm = np.array([[58.0, 10.0], [-58.0, -15.0], [0.0, 18.0], [3.0, 4.0]])
    ends = replace(presses, place_mm=pose.to_press_frame_mm(on_sheet_mm))
    check_near(ends, outline)
    check_inside(ends, pose, outline)
    assert not list(name_off_sheet(ends, pose, outline))
    on_sheet_mm[2, 1] = 24.0  # four beyond the side
    (words,) = name_off_sheet(replace(presses, place_mm=pose.to_press_frame_mm(on_sheet_mm)), pose, outline)
    assert "row 3, 4.0 mm beyond its edge" in words
    on_sheet_mm[2, 1] = 35.0  # fifteen, and inside the disc
    with pytest.raises(RecordingError, match="1 of 4 presses are outside the sheet, which is a polygon of 4 corners"):
        check_inside(replace(presses, place_mm=pose.to_press_frame_mm(on_sheet_mm)), pose, outline)


def test_presses_at_both_ends_of_a_strip_are_near_it():
    strip = Polygon(((-150, -10), (150, -10), (150, 10), (-150, 10)))
    presses = pressed_sheet(4).labelled().presses
    places = np.array([[-145.0, 0.0], [-145.0, 5.0], [-140.0, 0.0], [145.0, 0.0]])
    check_near(replace(presses, place_mm=places), strip)
    places[3, 0] = 250.0
    with pytest.raises(RecordingError, match="row 4, columns x_mm and y_mm"):
        check_near(replace(presses, place_mm=places), strip)


def test_errors_of_usual_size_accuse_no_press():
    labelled, random = pressed_sheet(40, seed=41, noise=0.05).labelled(), np.random.default_rng(0)
    found_mm = labelled.presses.place_mm + random.standard_normal((40, 2))
    assert not list(name_far_from_labels(labelled.presses, np.arange(40), found_mm))
    found_mm[:3] += 30.0
    (words,) = name_far_from_labels(labelled.presses, np.arange(40), found_mm)
    assert words.startswith("3 presses are far from where the others place them, row ")


def test_columns_that_are_no_labels_are_named():
    presses = pressed_sheet(2).labelled().presses
    table = replace(presses.table, columns=("x_mm", "who", "y_mm", "force_N"))
    assert list(list_ignored_columns(replace(presses, table=table))) == ["presses.csv: ignored columns: 'who'"]
    assert not list(list_ignored_columns(presses))


def test_electrodes_that_no_pair_uses_are_named():
    pairs = np.array([[0, 1, 2, 3], [3, 4, 7, 0]])
    (words,) = list_unused_electrodes(pairs, 12)
    assert words.startswith("no pair uses electrodes 5 to 6, 8 to 11 of the 12")
    assert not list(list_unused_electrodes(np.arange(16).reshape(4, 4), 16))


@pytest.mark.parametrize("count", [20, 60])
def test_presses_in_the_order_of_their_places_are_seen(count):
    sheet = pressed_sheet(count)
    x, y = sheet.places_mm.T
    for order in (np.argsort(x - 2 * y), np.argsort(np.hypot(x, y))):
        assert some(sheet, order).labelled().follow_places()
    by_chance = [some(sheet, np.random.default_rng(seed).permutation(count)).labelled() for seed in range(200)]
    assert sum(each.follow_places() for each in by_chance) <= 2


# --- pairs ---


def test_repeats_are_averaged_in_the_order_in_which_they_come():
    pairs = np.array([[5, 1, 2, 3], [0, 8, 4, 3], [5, 1, 2, 3], [5, 1, 3, 2]])
    distinct = DistinctPairs.from_pairs(pairs)
    np.testing.assert_array_equal(distinct.pairs, pairs[[0, 1, 3]])
    np.testing.assert_array_equal(distinct.repeats, [2, 1, 1])
    np.testing.assert_allclose(np.array([[1.0, 2.0, 3.0, 4.0]]) @ distinct.merging, [[2, 2, 4]])


def test_readings_are_found_in_another_order_and_polarity():
    pairs, random = adjacent_pairs(), np.random.default_rng(0)
    potentials = random.standard_normal((16, 16))
    potentials = potentials + potentials.T

    def read(pairs):
        s, t, p, q = pairs.T
        return potentials[s, p] - potentials[s, q] - potentials[t, p] + potentials[t, q]

    given = pairs[random.permutation(len(pairs))]
    given[::3] = given[::3][:, [0, 1, 3, 2]]
    given[1::3] = given[1::3][:, [1, 0, 3, 2]]
    distinct = DistinctPairs.from_pairs(np.vstack([given, given[:7]]))
    values = read(np.vstack([given, given[:7]])) @ distinct.merging @ match_readings(pairs, distinct.pairs)
    np.testing.assert_allclose(values, read(pairs))


@pytest.mark.parametrize(
    ("used", "said"),
    [(slice(None), r"1 of the 192 readings .* 0,8,2,1"), (slice(96), r"1 of the 96 readings .* 0,8,2,1")],
    ids=["its other polarity is no substitute where both were calibrated", "a pair that was not read"],
)
def test_a_reading_that_is_not_there_is_named(used, said):
    pairs = opposite_pairs()[used]
    with pytest.raises(CalibrationError, match=said):
        match_readings(pairs, DistinctPairs.from_pairs(pairs[1:]).pairs)
