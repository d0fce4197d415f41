"""Readings and labels out of step: every way of it is named, and nothing is where they are in step."""

import numpy as np
import pytest

from cbsr_qa.calibration.presses.row_order import find_row_order, guess_error


def press_sheet(count=90, seed=1, noise=0.05):
    """Readings of 40 channels that depend smoothly on the place, of presses of any force, and their places."""
    random = np.random.default_rng([850, seed])
    places = random.uniform(-45, 45, (count, 2))
    directions, phases = random.normal(0, 1 / 40, (2, 40)), random.uniform(0, 2 * np.pi, 40)
    changes = random.uniform(1, 4, (count, 1)) * np.cos(places @ directions + phases)
    return changes + noise * random.normal(size=changes.shape), places


def test_tables_in_step_are_left_as_they_are():
    for seed in range(5):
        assert find_row_order(*press_sheet(seed=seed)) is None


def test_readings_that_say_nothing_are_not_put_in_another_order():
    """Two hundred orders are tried, and none may win by chance."""
    random = np.random.default_rng(851)
    for _ in range(5):
        assert find_row_order(random.normal(size=(90, 40)), random.uniform(-45, 45, (90, 2))) is None


@pytest.mark.parametrize("shift", [1, -1, 2, -2, 3, -3])
def test_a_shift_is_named_with_the_option_that_undoes_it(shift):
    changes, places = press_sheet()
    found = find_row_order(changes, np.roll(places, shift, axis=0))
    assert f"(give --row-shift {shift})" in found.words
    assert found.gain_mm > 0.6 * guess_error(places)


def test_the_reverse_order_is_named():
    changes, places = press_sheet()
    assert "reverse order" in find_row_order(changes, places[::-1]).words


@pytest.mark.parametrize("lost", [10, 45, 80])
@pytest.mark.parametrize("of_readings", [False, True])
def test_a_lost_row_is_named_within_two_rows(lost, of_readings):
    changes, places = press_sheet()
    tables = (
        [np.delete(changes, lost, axis=0), places[:-1]] if of_readings else [changes[:-1], np.delete(places, lost, 0)]
    )
    words = find_row_order(*tables).words
    assert ("the readings of about row" if of_readings else "the place of about row") in words
    assert abs(int(words.split("about row ")[1].split()[0]) - 1 - lost) <= 2


def test_a_row_lost_among_many_presses_is_found_by_both_ends_of_the_session():
    changes, places = press_sheet(count=900)
    assert (
        "the place of a row from 251 to 650 is missing"
        in find_row_order(changes[:-1], np.delete(places, 400, 0)).words
    )


def test_rows_without_a_press_keep_their_numbers():
    changes, places = press_sheet()
    changes[4:10] = 0.0
    words = find_row_order(changes[:-1], np.delete(places, 50, axis=0)).words
    assert abs(int(words.split("about row ")[1].split()[0]) - 51) <= 2


def test_advice_is_the_whole_shift_of_the_tables():
    """Rows that were shifted too far: the remedy is the shift of the tables as they are, not one more."""
    changes, places = press_sheet()
    shifted = np.roll(places, -1, axis=0)
    assert find_row_order(changes, shifted, row_shift=1).words.count("their readings (leave --row-shift out)") == 1
    assert find_row_order(changes, shifted, row_shift=3).words.count("their readings (give --row-shift 2)") == 1
