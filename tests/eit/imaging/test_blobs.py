"""Noise floor and percentage masks; connected components over shared edges, and which blob counts as sensed."""

import numpy as np
import pytest
from disc_meshes import square_mesh
from drawn import drawn
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Blob, Image
from cbsr_qa.eit.imaging.blobs import find_blobs, nearest_blob, noise_floor, percentage_mask, subtract_noise_floor
from cbsr_qa.eit.imaging.shape import area_overlap_percent, centre_of_mass_error_mm, shape_deviation_mm2

CELLS = 6
GRID = square_mesh(CELLS, size_mm=float(CELLS))
NONE = np.zeros(len(GRID.elements))
HEAD = RoundFootprint(2.5, 3.5, 2.0)
values = hnp.arrays(np.float64, len(NONE), elements=st.floats(-5, 5, allow_subnormal=False))
fractions = st.floats(0.01, 1)


def _image(kept: dict[int, float]) -> tuple[Image, np.ndarray]:
    """An image on a square of cells, given the values of whole cells."""
    image = NONE.copy()
    for cell, value in kept.items():
        image[2 * cell : 2 * cell + 2] = value
    return Image(GRID, image), image != 0


# --- masks -------------------------------------------------------------------------------------------------------


def test_the_floor_is_the_largest_absolute_value_anywhere_and_is_subtracted():
    assert noise_floor(np.array([[0.1, -0.4, 0.0], [0.3, 0.2, -0.1]])) == 0.4
    assert subtract_noise_floor(np.array([-5.0, 0.1, 0.2, 0.5]), 0.2) == pytest.approx([0.0, 0.0, 0.0, 0.3])


@pytest.mark.parametrize(
    ("image", "fraction", "kept"),
    [
        ([1.0, 0.86, 0.84, 0.0, -2.0], 0.85, [True, True, False, False, False]),
        ([-1.0, -0.5, 0.0], 0.25, [False] * 3),
        ([0.0] * 4, 0.85, [False] * 4),
        ([], 0.85, []),
    ],
)
def test_the_mask_keeps_what_is_positive_and_reaches_the_fraction_of_the_maximum(image, fraction, kept):
    assert percentage_mask(np.array(image), fraction).tolist() == kept


@pytest.mark.parametrize("peak", [1.0, 3.0, 0.1, 1e-9, 7.7e12])
@pytest.mark.parametrize("fraction", [0.25, 0.5, 0.75, 0.85, 1.0])
def test_ties_are_included_however_the_product_rounds(peak, fraction):
    tied = np.array([peak, peak * fraction, fraction * peak, peak / (1 / fraction)])
    assert percentage_mask(tied, fraction).all()


@given(values, st.floats(0.05, 1), st.floats(0.05, 1))
@drawn(100)
def test_a_stricter_mask_keeps_a_part_of_a_laxer_one(image, one, other):
    strict, lax = (percentage_mask(image, fraction) for fraction in (max(one, other), min(one, other)))
    assert not (strict & ~lax).any()


@pytest.mark.parametrize(
    ("call", "said"),
    [
        *(
            (lambda images=images: noise_floor(images), "unloaded image")
            for images in (np.empty((0, 5)), np.zeros(5))
        ),
        (lambda: noise_floor(np.full((2, 3), np.nan)), "unloaded image"),
        *(
            (lambda floor=floor: subtract_noise_floor(np.ones(3), floor), "noise floor")
            for floor in (-0.1, np.nan, np.inf)
        ),
        *(
            (lambda fraction=fraction: percentage_mask(np.ones(3), fraction), "allowed: above 0, at most 1")
            for fraction in (0.0, -0.1, 1.01, 85.0, np.nan)
        ),
        (lambda: percentage_mask(np.array([1.0, np.nan]), 0.5), "finite"),
        (lambda: find_blobs(Image(GRID, NONE), np.ones(3, dtype=bool)), "does not match"),
    ],
)
def test_what_makes_no_floor_and_no_mask_is_refused(call, said):
    with pytest.raises(NumericsError, match=said):
        call()


# --- blobs -------------------------------------------------------------------------------------------------------


def test_regions_apart_are_blobs_the_heaviest_first_and_then_in_the_order_of_their_elements():
    image, keep = _image({0: 1.0, 1: 1.0, 20: 5.0})
    blobs = find_blobs(image, keep)
    assert [blob.elements.tolist() for blob in blobs] == [[40, 41], [0, 1, 2, 3]]
    assert [blob.weight for blob in blobs] == [5.0, 2.0]
    image, keep = _image({30: 1.0, 4: 1.0, 17: 1.0})
    assert [int(blob.elements[0]) for blob in find_blobs(image, keep)] == [8, 34, 60]


def test_elements_that_meet_in_a_corner_are_not_connected():
    assert len(find_blobs(*_image({1: 1.0, CELLS: 1.0}))) == 2


def test_kept_elements_without_a_positive_value_are_dropped():
    image, keep = _image({0: -1.0, 1: 1.0})
    (blob,) = find_blobs(image, np.ones_like(keep))
    assert blob.elements.tolist() == [2, 3]


def test_the_nearest_blob_is_the_sensed_one_not_the_heaviest():
    sensed = nearest_blob(find_blobs(*_image({0: 9.0, 35: 1.0})), 5.0, 5.0)
    assert sensed.elements.tolist() == [70, 71]
    assert nearest_blob((), 0.0, 0.0) is None


@given(values, fractions, st.floats(0, 2))
@drawn(150)
def test_blobs_part_the_mask(image, fraction, floor):
    cleared = subtract_noise_floor(image, floor)
    keep = percentage_mask(cleared, fraction)
    blobs = find_blobs(Image(GRID, cleared), keep)
    covered = np.sort(np.concatenate([blob.elements for blob in blobs])) if blobs else np.empty(0, dtype=np.int64)
    assert covered.tolist() == np.flatnonzero(keep).tolist()
    assert bool(blobs) == bool((image > floor).any())
    assert [blob.weight for blob in blobs] == sorted((blob.weight for blob in blobs), reverse=True)
    for blob in blobs:
        assert 0 <= area_overlap_percent(blob, HEAD) <= 100 + 1e-9
        assert shape_deviation_mm2(blob, HEAD) >= 0


@given(values, st.floats(1e-3, 1e3))
@drawn(100)
def test_the_unit_of_the_image_does_not_matter(image, factor):
    image = np.maximum(image, 0.0) + 0.1
    one, other = (Blob(Image(GRID, unit * image), np.arange(len(image))) for unit in (1.0, factor))
    assert abs(centre_of_mass_error_mm(one, HEAD) - centre_of_mass_error_mm(other, HEAD)) < 1e-9
