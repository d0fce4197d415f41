"""Repeats are averaged, and readings are found again whatever their order and polarity."""

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, opposite_pairs

from cbsr_qa.calibration.presses.pairs import DistinctPairs, matched_readings
from cbsr_qa.domain import CalibrationError


def test_repeats_are_averaged_in_the_order_in_which_they_come():
    pairs = np.array([[5, 1, 2, 3], [0, 8, 4, 3], [5, 1, 2, 3], [5, 1, 3, 2]])
    distinct = DistinctPairs.of(pairs)
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
    distinct = DistinctPairs.of(np.vstack([given, given[:7]]))
    values = read(np.vstack([given, given[:7]])) @ distinct.merging @ matched_readings(pairs, distinct)
    np.testing.assert_allclose(values, read(pairs))


def test_the_other_polarity_of_a_drive_is_no_substitute_where_both_were_calibrated():
    pairs = opposite_pairs()
    with pytest.raises(CalibrationError, match=r"1 of the 192 readings .* 0,8,2,1"):
        matched_readings(pairs, DistinctPairs.of(pairs[1:]))


def test_a_pair_that_was_not_read_is_named():
    pairs = opposite_pairs()
    with pytest.raises(CalibrationError, match=r"1 of the 96 readings .* 0,8,2,1"):
        matched_readings(pairs[:96], DistinctPairs.of(pairs[1:96]))
