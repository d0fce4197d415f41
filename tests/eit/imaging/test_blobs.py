"""Connected components over shared edges, and which blob counts as sensed."""

import numpy as np
import pytest
from disc_meshes import square_mesh

from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.results import Image
from cbsr_qa.eit.imaging.blobs import find_blobs, nearest_blob

CELLS = 6


def _image(kept: dict[int, float]) -> tuple[Image, np.ndarray]:
    """An image on a square of cells, given the values of whole cells."""
    mesh = square_mesh(CELLS, size_mm=float(CELLS))
    values = np.zeros(len(mesh.elements))
    for cell, value in kept.items():
        values[2 * cell : 2 * cell + 2] = value
    return Image(mesh, values), values != 0


def test_two_regions_apart_are_two_blobs_the_heaviest_first():
    image, keep = _image({0: 1.0, 1: 1.0, 20: 5.0})
    blobs = find_blobs(image, keep)
    assert [blob.elements.tolist() for blob in blobs] == [[40, 41], [0, 1, 2, 3]]
    assert [blob.weight for blob in blobs] == [5.0, 2.0]


def test_elements_that_meet_in_a_corner_are_not_connected():
    image, keep = _image({1: 1.0, CELLS: 1.0})
    assert len(find_blobs(image, keep)) == 2


def test_kept_elements_without_a_positive_value_are_dropped():
    image, keep = _image({0: -1.0, 1: 1.0})
    (blob,) = find_blobs(image, np.ones_like(keep))
    assert blob.elements.tolist() == [2, 3]


def test_equal_weights_come_in_the_order_of_their_elements():
    image, keep = _image({30: 1.0, 4: 1.0, 17: 1.0})
    assert [int(blob.elements[0]) for blob in find_blobs(image, keep)] == [8, 34, 60]


def test_the_nearest_blob_is_the_sensed_one_not_the_heaviest():
    image, keep = _image({0: 9.0, 35: 1.0})
    sensed = nearest_blob(find_blobs(image, keep), 5.0, 5.0)
    assert sensed is not None
    assert sensed.elements.tolist() == [70, 71]


def test_a_mask_of_another_mesh_is_refused():
    image, keep = _image({0: 1.0})
    with pytest.raises(NumericsError, match="does not match"):
        find_blobs(image, keep[:-1])
