import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.domain.sensor import Mesh
from cbsr_qa.eit.forward import disc_coverage
from cbsr_qa.eit.inverse.overlap import overlap_fractions, overlap_pieces
from cbsr_qa.eit.mesh import image_mesh, sheet_mesh


@pytest.fixture(scope="module")
def meshes(pin_sensor) -> tuple[Mesh, Mesh]:
    sensor = pin_sensor()
    return sheet_mesh(sensor, size_mm=4.0), image_mesh(sensor, size_mm=5.0)


def square(size: float, split: bool) -> Mesh:
    nodes = np.array([[0.0, 0.0], [size, 0.0], [size, size], [0.0, size]])
    corners = [[0, 1, 2], [0, 2, 3]] if split else [[0, 1, 3], [1, 2, 3]]
    return Mesh(nodes, np.array(corners))


def test_two_ways_of_halving_a_square_share_quarters():
    share = overlap_fractions(square(2.0, True), square(2.0, False)).toarray()
    assert np.allclose(share, 0.5)


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


def test_moments_are_kept(meshes):
    """Centres of the pieces add up to the fine mesh's: checks where the pieces are, not only how large."""
    fine, coarse = meshes
    share = overlap_fractions(fine, coarse)
    apart = share.tocoo()
    offset = np.hypot(*(fine.centroids_mm[apart.row] - coarse.centroids_mm[apart.col]).T)
    assert offset.max() < 8.0
    mean = share @ coarse.centroids_mm - fine.centroids_mm
    assert np.abs(mean.mean(axis=0)).max() < 0.05


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


@given(away=st.floats(0, 35), angle=st.floats(0, 2 * np.pi), radius=st.floats(0.5, 12))
@drawn(40)
def test_a_disc_inside_covers_its_own_area(meshes, away, angle, radius):
    x, y = away * np.cos(angle), away * np.sin(angle)
    elements, fraction = disc_coverage(meshes[1], x, y, radius)
    assert ((fraction > 0) & (fraction <= 1)).all()
    assert fraction @ meshes[1].areas_mm2[elements] == pytest.approx(np.pi * radius**2, rel=1e-10)


def test_a_disc_over_the_edge_covers_what_is_there(meshes):
    everything, fraction = disc_coverage(meshes[1], 3.0, 0.0, 200.0)
    assert len(everything) == len(meshes[1].elements)
    assert np.allclose(fraction, 1)
    assert disc_coverage(meshes[1], 80.0, 0.0, 5.0)[0].size == 0
