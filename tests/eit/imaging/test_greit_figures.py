"""GREIT's figures of merit against images whose values follow from their shape."""

import numpy as np
import pytest
from disc_meshes import disc_mesh
from drawn import drawn
from hypothesis import given, strategies as st
from scipy.integrate import quad

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import PolygonFootprint, RoundFootprint
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.imaging.rasters import Raster, pixel_image
from cbsr_qa.eit.imaging.shape import greit_figures

SHEET = disc_mesh(50.0, rings=50, spokes=240)
#: Where whole rings of elements end.
EDGE = 10.0
TARGET = RoundFootprint(0.0, 0.0, EDGE)


def _rings(*levels: tuple[float, float, float]) -> Image:
    """Values on rings of whole elements, from radius to radius."""
    distance = np.hypot(*SHEET.centroids_mm.T)
    values = np.zeros_like(distance)
    for inner, outer, value in levels:
        values[(distance > inner) & (distance < outer)] = value
    return Image(SHEET, values)


def _bump(mesh: Mesh, x_mm: float, y_mm: float, width_mm: float) -> Image:
    squared = ((mesh.centroids_mm - [x_mm, y_mm]) ** 2).sum(axis=1)
    return Image(mesh, np.exp(-squared / width_mm**2))


def test_a_perfect_image_has_perfect_figures():
    found = greit_figures(_rings((0, EDGE, 0.3)), TARGET, contrast=0.3)
    assert found.amplitude_response == pytest.approx(1.0, rel=2e-4)
    assert found.position_error_mm == pytest.approx(0.0, abs=1e-9)
    assert found.resolution == pytest.approx(EDGE / 50, rel=1e-6)
    assert found.shape_deformation == pytest.approx(0.0, abs=1e-3)
    assert found.ringing == 0.0


def test_ringing_is_the_opposite_sign_outside_over_what_is_inside():
    image = _rings((0, EDGE, 1.0), (12, 14, -0.1), (20, 22, 0.05))
    found = greit_figures(image, TARGET, contrast=1.0)
    assert found.ringing == pytest.approx(0.1 * (14**2 - 12**2) / EDGE**2, rel=1e-3)
    integral = EDGE**2 - 0.1 * (14**2 - 12**2) + 0.05 * (22**2 - 20**2)
    assert found.amplitude_response == pytest.approx(integral / EDGE**2, rel=1e-3)


def test_the_quarter_amplitude_set_holds_a_quarter_and_nothing_lower():
    """0.25 × (3 × 0.1) rounds to more than 0.075."""
    for peak, beside, beyond in ((1.0, 0.26, 0.24), (3 * 0.1, 0.075, 0.0)):
        found = greit_figures(_rings((0, EDGE, peak), (EDGE, 20, beside), (20, 30, beyond)), TARGET)
        assert found.resolution == pytest.approx(20 / 50, rel=1e-6)


def test_an_ellipse_is_deformed_by_what_lies_outside_the_circle_of_its_area():
    squeezed = disc_mesh(20.0, rings=60, spokes=360)
    mesh = Mesh(squeezed.nodes_mm * [1.5, 0.8], squeezed.elements)
    values = np.where(np.hypot(*squeezed.centroids_mm.T) < 10.0, 1.0, 0.0)
    found = greit_figures(Image(mesh, values), TARGET)
    a, b = 15.0, 8.0
    radius_squared = a * b

    def beyond(angle: float) -> float:
        reach = 1 / ((np.cos(angle) / a) ** 2 + (np.sin(angle) / b) ** 2)
        return max(reach - radius_squared, 0.0) / 2

    outside = 4 * quad(beyond, 0, np.pi / 2, limit=200)[0]
    assert found.shape_deformation == pytest.approx(outside / (np.pi * a * b), rel=2e-3)


@pytest.mark.parametrize("seen_mm", [18.0, 20.0, 23.0])
def test_position_errors_are_positive_towards_the_centre(seen_mm):
    found = greit_figures(_bump(SHEET, 0.6 * seen_mm, 0.8 * seen_mm, 6.0), RoundFootprint(12.0, 16.0, 6.5))
    assert found.position_error_mm == pytest.approx(20.0 - seen_mm, abs=0.05)


@given(st.floats(0, 2 * np.pi), st.floats(0.1, 10.0), st.floats(0.5, 2.0))
@drawn(20)
def test_turned_scaled_and_amplified(angle, gain, scale):
    mesh = disc_mesh(20.0, rings=10, spokes=48)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    image = Image(mesh, _bump(mesh, 5.0, 3.0, 6.0).values - 0.1)
    moved = Image(Mesh(mesh.nodes_mm @ turn.T, mesh.elements), gain * image.values)
    corners = np.array([[2.0, 0.0], [8.0, 1.0], [6.0, 7.0]])
    one = greit_figures(image, PolygonFootprint(corners), contrast=0.5)
    other = greit_figures(moved, PolygonFootprint(corners @ turn.T), contrast=0.5)
    assert other.amplitude_response == pytest.approx(gain * one.amplitude_response)
    assert other.position_error_mm == pytest.approx(scale * one.position_error_mm, abs=1e-9)
    assert other.resolution == pytest.approx(one.resolution)
    assert other.shape_deformation == pytest.approx(one.shape_deformation, abs=1e-9)
    assert other.ringing == pytest.approx(one.ringing, abs=1e-9)


def test_a_raster_has_the_figures_of_the_mesh_as_its_pixels_shrink():
    """One analytic image both ways: bump with a dip beside it, on a round sheet."""

    def values(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.exp(-((x - 15) ** 2 + (y - 10) ** 2) / 8**2) - 0.2 * np.exp(-((x + 5) ** 2 + y**2) / 12**2)

    target = RoundFootprint(15.0, 10.0, 6.5)
    exact = greit_figures(Image(SHEET, values(*SHEET.centroids_mm.T)), target, contrast=0.4)

    def errors(pixels: int) -> np.ndarray:
        pitch = 100 / pixels
        axis = -50 + pitch * (np.arange(pixels) + 0.5)
        x, y = np.meshgrid(axis, axis)
        image = pixel_image(Raster(values(x, y), pitch, (axis[0], axis[0])), np.hypot(x, y) <= 50)
        found = greit_figures(image, target, contrast=0.4)
        names = ("amplitude_response", "position_error_mm", "resolution", "shape_deformation", "ringing")
        return np.abs([getattr(found, name) - getattr(exact, name) for name in names])

    coarse, fine = errors(32), errors(256)
    assert (coarse < [0.02, 0.6, 0.01, 0.1, 0.02]).all()
    assert (fine < [0.002, 0.07, 0.002, 0.015, 0.002]).all()


def test_pixels_off_the_sheet_do_not_count():
    raster = Raster(np.ones((4, 6)), 2.0, (1.0, 1.0))
    where = np.zeros((4, 6), dtype=bool)
    where[1:3, 2:4] = True
    image = pixel_image(raster, where)
    assert image.mesh.areas_mm2.sum() == pytest.approx(16.0)
    assert image.mesh.centroids_mm.mean(axis=0) == pytest.approx([6.0, 4.0])
    assert pixel_image(raster).mesh.areas_mm2.sum() == pytest.approx(96.0)
    with pytest.raises(NumericsError, match="no pixel"):
        pixel_image(raster, np.zeros((4, 6), dtype=bool))


def test_nothing_positive_has_no_figures():
    assert greit_figures(_rings((0, EDGE, -1.0)), TARGET) is None


def test_two_far_pieces_have_no_ringing_to_speak_of():
    values = np.exp(-(((np.abs(SHEET.centroids_mm) - [30, 0]) ** 2).sum(axis=1)) / 25) - 0.2
    found = greit_figures(Image(SHEET, values), TARGET)
    assert found.ringing is None
    assert found.shape_deformation > 0.9
    assert found.amplitude_response is None


@pytest.mark.parametrize("contrast", [0.0, -0.2])
def test_impossible_contrasts_are_refused(contrast):
    with pytest.raises(NumericsError, match="contrast is"):
        greit_figures(_rings((0, EDGE, 1.0)), TARGET, contrast=contrast)
