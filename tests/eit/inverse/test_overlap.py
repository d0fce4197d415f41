import numpy as np
import pytest

from cbsr_qa.domain.sensor import Mesh
from cbsr_qa.eit.inverse.overlap import overlap_fractions, overlap_pieces
from cbsr_qa.eit.mesh import image_mesh, sheet_mesh


@pytest.fixture(scope="module")
def meshes(pin_sensor) -> tuple[Mesh, Mesh]:
    sensor = pin_sensor()
    return sheet_mesh(sensor, size_mm=4.0), image_mesh(sensor, size_mm=5.0)


def test_a_mesh_lies_in_itself(meshes):
    _, coarse = meshes
    share = overlap_fractions(coarse, coarse)
    assert np.allclose(share.diagonal(), 1, atol=1e-12)
    assert abs(share.sum() - len(coarse.elements)) < 1e-9


def test_nothing_is_lost_and_area_arrives_where_it_lies(meshes):
    fine, coarse = meshes
    share = overlap_fractions(fine, coarse)
    assert np.allclose(np.asarray(share.sum(axis=1)).ravel(), 1, atol=1e-12)
    arrived = share.T @ fine.areas_mm2
    inner = np.hypot(*coarse.centroids_mm.T) < 40  # away from pins and from the two polygons' edges
    assert np.allclose(arrived[inner], coarse.areas_mm2[inner], rtol=1e-9)


def test_pieces_lie_where_they_should(meshes):
    """First moments of the pieces of every inner element add up to its own, on either mesh."""
    fine, coarse = meshes
    pieces = overlap_pieces(fine, coarse)
    moments = pieces.areas_mm2[:, None] * pieces.centroids_mm
    for mesh, owner in ((fine, pieces.fine), (coarse, pieces.coarse)):
        inner = np.hypot(*mesh.centroids_mm.T) < 40
        for axis in range(2):
            found = np.bincount(owner, moments[:, axis], minlength=len(mesh.elements))
            expected = mesh.areas_mm2 * mesh.centroids_mm[:, axis]
            assert np.abs(found - expected)[inner].max() < 1e-8 * np.abs(expected).max()
