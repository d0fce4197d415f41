"""Noise floor and percentage masks."""

import numpy as np
import pytest

from cbsr_qa.domain import NumericsError
from cbsr_qa.eit.imaging.blobs import floored, noise_floor, percentage_mask


def test_the_floor_is_the_largest_absolute_value_anywhere():
    assert noise_floor(np.array([[0.1, -0.4, 0.0], [0.3, 0.2, -0.1]])) == 0.4


@pytest.mark.parametrize("images", [np.empty((0, 5)), np.zeros(5), np.full((2, 3), np.nan)])
def test_a_floor_of_nothing_is_refused(images):
    with pytest.raises(NumericsError, match="unloaded image"):
        noise_floor(images)


def test_the_floor_is_subtracted_above_and_everything_else_is_zero():
    assert floored(np.array([-5.0, 0.1, 0.2, 0.5]), 0.2) == pytest.approx([0.0, 0.0, 0.0, 0.3])


@pytest.mark.parametrize("floor", [-0.1, float("nan"), float("inf")])
def test_an_impossible_floor_is_refused(floor):
    with pytest.raises(NumericsError, match="noise floor"):
        floored(np.ones(3), floor)


def test_the_mask_keeps_what_reaches_the_fraction_of_the_maximum():
    assert percentage_mask(np.array([1.0, 0.86, 0.84, 0.0, -2.0]), 0.85).tolist() == [True, True, False, False, False]


@pytest.mark.parametrize("peak", [1.0, 3.0, 0.1, 1e-9, 7.7e12])
@pytest.mark.parametrize("fraction", [0.25, 0.5, 0.75, 0.85, 1.0])
def test_ties_are_included_however_the_product_rounds(peak, fraction):
    tied = np.array([peak, peak * fraction, fraction * peak, peak / (1 / fraction)])
    assert percentage_mask(tied, fraction).all()


def test_negative_and_zero_values_never_survive():
    assert not percentage_mask(np.array([-1.0, -0.5, 0.0]), 0.25).any()
    assert not percentage_mask(np.zeros(4), 0.85).any()
    assert not percentage_mask(np.empty(0), 0.85).any()


@pytest.mark.parametrize("fraction", [0.0, -0.1, 1.01, 85.0, float("nan")])
def test_a_fraction_outside_its_range_is_refused(fraction):
    with pytest.raises(NumericsError, match="allowed: above 0, at most 1"):
        percentage_mask(np.ones(3), fraction)


def test_an_image_with_a_hole_in_its_numbers_is_refused():
    with pytest.raises(NumericsError, match="finite"):
        percentage_mask(np.array([1.0, np.nan]), 0.5)
