"""Connected components over shared edges, and which blob counts as sensed."""

import numpy as np
import pytest
from disc_meshes import disc_mesh, square_mesh

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


def test_a_ring_is_one_blob():
    mesh = disc_mesh(6.0, rings=6, spokes=48)
    keep = np.hypot(*mesh.centroids_mm.T) > 3.0
    (blob,) = find_blobs(Image(mesh, np.ones(len(keep))), keep)
    assert blob.elements.tolist() == np.flatnonzero(keep).tolist()


def test_one_element_is_a_blob():
    image, keep = _image({3: 2.0})
    keep[7] = False
    (blob,) = find_blobs(image, keep)
    assert blob.elements.tolist() == [6]
    assert blob.area_mm2 == 0.5
    assert blob.centre_mm() == pytest.approx(image.mesh.centroids_mm[6])


def test_nothing_kept_is_no_blob():
    image, keep = _image({})
    assert find_blobs(image, keep) == ()
    assert nearest_blob((), 0.0, 0.0) is None


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


def test_the_mesh_knows_its_edges_and_neighbours():
    mesh = disc_mesh(5.0, rings=4, spokes=12)
    nodes, edges, elements = len(mesh.nodes_mm), len(mesh.edges), len(mesh.elements)
    assert nodes - edges + elements == 1  # Euler's formula for a disc
    assert len(mesh.neighbours) == edges - 12  # every edge but the outline's is shared by two
    for element in (0, 17, elements - 1):
        corners = mesh.elements[element]
        for j in range(3):
            assert set(mesh.edges[mesh.element_edges[element, j]]) == {corners[j], corners[(j + 1) % 3]}
    for one, other in mesh.neighbours:
        assert len(set(mesh.elements[one]) & set(mesh.elements[other])) == 2
