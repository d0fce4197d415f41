"""The order of presses on a usual sheet: greedy, by the variance that a normal distribution leaves."""

import numpy as np
import pytest

from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.calibration.sheet.usual_sheet import USUAL_SCATTER, choose_presses, order_presses

RADIUS_MM = 50.0
TARGETS_MM = np.random.default_rng(1).uniform(-30, 30, (20, 2))
CANDIDATES_MM = np.random.default_rng(2).uniform(-35, 35, (12, 2))
NONE_MM = np.empty((0, 2))


def variance_left(pressed_mm):
    """Mean variance at the targets after some presses, by the whole normal distribution of each kernel."""
    every, count = np.vstack([pressed_mm, TARGETS_MM]), len(pressed_mm)
    left = []
    for smooth in (True, False):
        prior = 0.04 * compute_covariance(every, every, 0.4 * RADIUS_MM, smooth) + 4.0
        seen = prior[:count, :count] + USUAL_SCATTER**2 * np.eye(count)
        left.append(
            np.diag(prior[count:, count:] - prior[count:, :count] @ np.linalg.solve(seen, prior[:count, count:]))
        )
    return float(np.mean(left))


@pytest.mark.parametrize("before", [0, 3])
def test_each_press_leaves_the_variance_of_all_presses_so_far(before):
    pressed_mm = np.random.default_rng(3).uniform(-30, 30, (before, 2))
    order, left = order_presses(CANDIDATES_MM, TARGETS_MM, 5, pressed_mm=pressed_mm, radius_mm=RADIUS_MM)
    for count in range(1, 6):
        expected = variance_left(np.vstack([pressed_mm, CANDIDATES_MM[order[:count]]]))
        assert left[count - 1] == pytest.approx(expected, rel=1e-6)


def test_the_first_press_is_the_best_of_all():
    (first, *_), left = order_presses(CANDIDATES_MM, TARGETS_MM, 3, pressed_mm=NONE_MM, radius_mm=RADIUS_MM)
    each = [variance_left(place[None]) for place in CANDIDATES_MM]
    assert first == int(np.argmin(each))
    assert left[0] == pytest.approx(min(each), rel=1e-6)


def test_no_place_is_pressed_twice_and_all_can_be():
    order, left = order_presses(CANDIDATES_MM, TARGETS_MM, 12, pressed_mm=NONE_MM, radius_mm=RADIUS_MM)
    assert sorted(order) == list(range(12))
    assert (np.diff(left) < 0).all()


def test_presses_that_come_first_are_pressed_first_and_the_others_where_they_help_most():
    every = np.vstack([CANDIDATES_MM, TARGETS_MM])
    lengths_mm, scatter = (15.0, 25.0), np.array([1e-4, 4e-4])
    prior = np.array([0.04 * compute_covariance(every, every, length, True) for length in lengths_mm])
    weights = np.array([0.8, 0.2])
    targets = np.arange(12, 32)
    presses = list(choose_presses(prior, weights, scatter, np.arange(12), targets, pressed=[3], first=[7, 1]))
    order = [number for number, _ in presses]
    assert order[:2] == [7, 1]
    assert sorted(order) == list(range(12))

    def leave(numbers, member):
        seen = prior[member][np.ix_(numbers, numbers)] + scatter[member] * np.eye(len(numbers))
        between = prior[member][np.ix_(targets, numbers)]
        return prior[member][np.ix_(targets, targets)] - between @ np.linalg.solve(seen, between.T)

    for member in range(2):
        np.testing.assert_allclose(presses[2][1][member], leave([3, *order[:3]], member), atol=1e-12)
    left = [weights @ [np.trace(leave([3, 7, 1, number], member)) for member in range(2)] for number in range(12)]
    assert order[2] == min(set(range(12)) - {7, 1}, key=lambda number: left[number])
