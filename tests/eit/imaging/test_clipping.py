"""Triangle ∩ circle, against shapes whose overlap is known in closed form."""

import numpy as np
import pytest
from disc_meshes import disc_mesh, square_mesh

from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.geometry import RoundFootprint, overlap_mm2
from cbsr_qa.domain.sensor import Mesh


def _area(mesh: Mesh, centre: tuple[float, float], radius: float) -> float:
    return float(overlap_mm2(RoundFootprint(*centre, radius), mesh.corners_mm).sum())


def _triangle(*corners: tuple[float, float]) -> Mesh:
    return Mesh(np.array(corners), np.array([[0, 1, 2]]))


def _segment(radius: float, distance: float) -> float:
    """Area of the circle's part beyond a line at a distance from its centre."""
    return radius**2 * np.arccos(distance / radius) - distance * np.sqrt(radius**2 - distance**2)


def test_a_circle_inside_one_triangle_is_its_whole_area():
    assert _area(_triangle((-20, -10), (20, -10), (0, 20)), (0.5, 0.3), 3.0) == pytest.approx(9 * np.pi, rel=1e-14)


def test_a_triangle_inside_the_circle_keeps_its_whole_area():
    assert _area(_triangle((0, 0), (2, 0), (0, 2)), (0.5, 0.5), 50.0) == pytest.approx(2.0, rel=1e-14)


def test_a_triangle_elsewhere_has_nothing_in_common():
    assert _area(_triangle((100, 0), (102, 0), (100, 2)), (0.0, 0.0), 6.5) == 0.0


def test_an_edge_that_touches_the_circle_cuts_nothing_off():
    assert _area(_triangle((-30, -2), (30, -2), (0, 60)), (0.0, 0.0), 2.0) == pytest.approx(4 * np.pi, rel=1e-9)


@pytest.mark.parametrize("distance", [0.0, 0.4, 1.7, 1.999999])
def test_a_half_plane_cuts_off_a_circular_segment(distance):
    above = _triangle((-500, distance), (500, distance), (0, 900))
    assert _area(above, (0.0, 0.0), 2.0) == pytest.approx(_segment(2.0, distance), rel=1e-9, abs=1e-12)


def test_corner_on_the_centre_gives_the_sector():
    wedge = _triangle((0, 0), (40, 0), (40, 40))
    assert _area(wedge, (0.0, 0.0), 3.0) == pytest.approx(9 * np.pi / 8, rel=1e-14)


def test_two_overlapping_discs_give_the_lens():
    radius, shift = 6.5, 4.0
    lens = 2 * _segment(radius, shift / 2)
    coarse, fine = (
        abs(_area(disc_mesh(radius, centre_mm=(shift, 0.0), spokes=n), (0.0, 0.0), radius) - lens) for n in (60, 120)
    )
    assert fine < 2e-3 * lens
    # The polygon, not the clipping, is the error: it falls with the square of the number of corners.
    assert coarse / fine == pytest.approx(4.0, rel=0.05)


def test_the_pieces_of_a_square_add_up_to_the_quarter_disc():
    assert _area(square_mesh(37, size_mm=10.0), (0.0, 0.0), 7.3) == pytest.approx(np.pi * 7.3**2 / 4, rel=1e-13)


@pytest.mark.parametrize("radius", [0.0, -1.0, float("nan"), float("inf")])
def test_a_radius_that_is_none_is_refused(radius):
    with pytest.raises(NumericsError, match="radius"):
        _area(square_mesh(2), (0.0, 0.0), radius)
