"""Area of triangles inside a circle, against exact figures."""

import numpy as np
import pytest
from disc_meshes import disc_mesh
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.polygons import circle_overlap_mm2

PLACE = st.tuples(st.floats(-12, 12), st.floats(-12, 12))


@given(centre=PLACE, radius=st.floats(0.01, 9.0))
def test_the_triangles_of_a_sheet_share_out_the_whole_disc(centre: tuple[float, float], radius: float):
    mesh = disc_mesh(30.0, rings=6, spokes=24)
    overlap = circle_overlap_mm2(mesh.corners_mm, centre, radius)
    assert overlap.sum() == pytest.approx(np.pi * radius**2, rel=1e-11)
    assert (overlap <= mesh.areas_mm2 * (1 + 1e-12)).all()


@pytest.mark.parametrize("off", [0.0, 1e-300, 4e-22, 1e-17, 1e-16, 1e-12])
@pytest.mark.parametrize("direction", [(1.0, 0.0), (-0.6, 0.8), (0.3, -1.0)])
def test_a_corner_all_but_at_the_centre_makes_no_difference(off: float, direction: tuple[float, float]):
    mesh = disc_mesh(30.0, rings=6, spokes=24)
    centre = (off * direction[0], off * direction[1])
    assert circle_overlap_mm2(mesh.corners_mm, centre, 6.5).sum() == pytest.approx(np.pi * 6.5**2, rel=1e-11)


def test_a_half_plane_cuts_a_circular_segment():
    height, radius = 0.3, 1.0
    corners = np.array([[[-100.0, height], [100.0, height], [0.0, 100.0]]])
    segment = radius**2 * np.arccos(height / radius) - height * np.sqrt(radius**2 - height**2)
    assert circle_overlap_mm2(corners, (0.0, 0.0), radius)[0] == pytest.approx(segment, rel=1e-12)


def test_a_triangle_inside_counts_whole_and_one_far_away_not_at_all():
    corners = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [[1e6, 0.0], [1e6 + 1, 0.0], [1e6, 1.0]]])
    np.testing.assert_allclose(circle_overlap_mm2(corners, (0.2, 0.2), 5.0), [0.5, 0.0], rtol=1e-14)


@pytest.mark.parametrize("radius", [0.0, -1.0, float("nan"), float("inf")])
def test_a_radius_that_is_none_is_refused(radius: float):
    with pytest.raises(NumericsError, match="radius"):
        circle_overlap_mm2(np.zeros((1, 3, 2)), (0.0, 0.0), radius)
