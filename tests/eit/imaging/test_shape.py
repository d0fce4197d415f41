"""E_CoM, A_OL and SD against the exact values of discs, and their convergence to them."""

import numpy as np
import pytest
from disc_meshes import disc_mesh, square_mesh, uniform_blob
from scipy.integrate import quad

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Blob, Image
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.imaging.shape import (
    area_overlap_percent,
    centre_of_mass_error_mm,
    overlap_grade,
    shape_deviation_mm2,
)

R = 6.5
HEAD = RoundFootprint(0.0, 0.0, R)


def _exact_overlap(shift_mm: float) -> float:
    half = shift_mm / 2
    lens = 2 * (R**2 * np.arccos(half / R) - half * np.sqrt(R**2 - half**2))
    return 100 * lens / (np.pi * R**2)


def _exact_deviation(shift_mm: float) -> float:
    def squared(angle: float) -> float:
        return (np.hypot(shift_mm + R * np.cos(angle), R * np.sin(angle)) - R) ** 2

    return quad(squared, 0, np.pi, epsabs=1e-12)[0] / np.pi


@pytest.mark.parametrize(("factor", "overlap"), [(0.7, 74.5), (1.0, 100.0), (1.5, 72.2)])
def test_a_concentric_disc_of_any_size(factor, overlap):
    blob = uniform_blob(disc_mesh(factor * R, rings=12, spokes=720))
    assert centre_of_mass_error_mm(blob, HEAD) == pytest.approx(0.0, abs=1e-12)
    assert area_overlap_percent(blob, HEAD) == pytest.approx(overlap, abs=0.05)
    assert area_overlap_percent(blob, HEAD) == pytest.approx(50 * min(factor, 1) ** 2 * (1 + factor**-2), abs=2e-3)
    assert shape_deviation_mm2(blob, HEAD) == pytest.approx(((factor - 1) * R) ** 2, rel=1e-4, abs=1e-8)


def test_a_shifted_disc():
    blob = uniform_blob(disc_mesh(R, centre_mm=(2.0, 0.0), rings=12, spokes=720))
    assert centre_of_mass_error_mm(blob, HEAD) == pytest.approx(2.0, rel=1e-12)
    assert area_overlap_percent(blob, HEAD) == pytest.approx(80.49, abs=0.005)
    assert area_overlap_percent(blob, HEAD) == pytest.approx(_exact_overlap(2.0), abs=3e-3)
    assert shape_deviation_mm2(blob, HEAD) == pytest.approx(1.99, abs=0.005)
    assert shape_deviation_mm2(blob, HEAD) == pytest.approx(_exact_deviation(2.0), rel=1e-4)


@pytest.mark.parametrize(
    ("mesh", "overlap"),
    [
        (disc_mesh(50.0, rings=30, spokes=360), 50.845),
        (disc_mesh(0.57, centre_mm=(1.0, 1.0), rings=1, spokes=12), 50.367),
    ],
    ids=["the whole sheet", "one speck"],
)
def test_a_blob_far_too_large_or_small_scores_half_and_is_no_ok(mesh, overlap):
    blob = uniform_blob(mesh)
    found = area_overlap_percent(blob, HEAD)
    assert found == pytest.approx(overlap, abs=0.01)
    assert overlap_grade(found, blob.area_mm2 / (np.pi * R**2)) == "likely poor: size"


@pytest.mark.parametrize(
    ("overlap", "ratio", "grade"),
    [
        (0.0, 1.0, "likely poor"),
        (49.999, 1.0, "likely poor"),
        (50.0, 1.0, "ok"),
        (70.0, 1.0, "good"),
        (100.0, 1.0, "good"),
        (100.0 + 1e-12, 1.0, "good"),
        (60.0, 1 / 3, "ok"),
        (60.0, 3.0, "ok"),
        (90.0, 3.001, "likely poor: size"),
        (90.0, 0.333, "likely poor: size"),
    ],
)
def test_bands_include_their_lower_ends_and_count_only_for_a_fair_size(overlap, ratio, grade):
    assert overlap_grade(overlap, ratio) == grade


def test_overlap_and_deviation_converge_with_the_square_of_the_outline():
    def errors(spokes: int) -> tuple[float, float]:
        blob = uniform_blob(disc_mesh(R, centre_mm=(2.0, 0.0), rings=4, spokes=spokes))
        overlap = area_overlap_percent(blob, HEAD) - _exact_overlap(2.0)
        return abs(overlap), abs(shape_deviation_mm2(blob, HEAD) - _exact_deviation(2.0))

    for coarse, fine in zip(errors(48), errors(96), strict=True):
        assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


def test_exact_clipping_does_not_jump_with_the_mesh_as_counting_centroids_does():
    meshes = [square_mesh(cells, size_mm=40.0) for cells in range(20, 30)]

    def spread(mode: str) -> float:
        found = [area_overlap_percent(uniform_blob(mesh), RoundFootprint(20.0, 20.0, R), mode) for mesh in meshes]
        return float(np.ptp(found))

    assert spread("exact") < 1e-10
    assert spread("centroid") > 0.5


@pytest.mark.parametrize(
    ("corners", "radius"),
    [([(-3.0, 1.0), (5.0, -2.0), (2.0, 7.0)], 2.5), ([(-4.0, 0.0), (4.0, 0.0), (0.0, 4.0)], 3.0)],
    ids=["around the centre", "an edge through the centre"],
)
def test_deviation_along_straight_edges_is_the_integral(corners, radius):
    mesh = Mesh(np.array(corners), np.array([[0, 1, 2]]))
    total, length = 0.0, 0.0
    for start, end in zip(mesh.nodes_mm, np.roll(mesh.nodes_mm, -1, axis=0), strict=True):
        size = float(np.hypot(*(end - start)))
        along = lambda t, a=start, b=end: (np.hypot(*(a + t * (b - a))) - radius) ** 2  # noqa: E731
        total += size * quad(along, 0, 1, epsabs=1e-12, points=[0.5])[0]
        length += size
    found = shape_deviation_mm2(uniform_blob(mesh), RoundFootprint(0.0, 0.0, radius))
    assert found == pytest.approx(total / length, rel=1e-12)


def test_a_hole_has_a_perimeter_of_its_own():
    mesh = disc_mesh(6.0, rings=6, spokes=48)
    distance = np.hypot(*mesh.centroids_mm.T)
    ring = np.flatnonzero(distance > 3.0)
    edges = uniform_blob(mesh, ring).rim
    radii = np.hypot(*mesh.nodes_mm[np.unique(edges)].T)
    assert len(edges) == 96
    assert sorted(set(np.round(radii, 9))) == [3.0, 6.0]


def test_the_centre_of_mass_does_not_depend_on_how_the_blob_is_meshed():
    one, other = square_mesh(4, size_mm=8.0), square_mesh(8, size_mm=8.0)

    def blob(mesh: Mesh) -> Blob:
        values = np.where(mesh.centroids_mm[:, 0] < 4.0, 1.0, 3.0)
        return Blob(Image(mesh, values), np.arange(len(values)))

    assert blob(one).centre_mm() == pytest.approx([5.0, 4.0])
    assert blob(other).centre_mm() == pytest.approx([5.0, 4.0])


def test_unknown_modes_are_refused_with_what_is_allowed():
    blob = uniform_blob(square_mesh(2))
    with pytest.raises(NumericsError, match="'exact' or 'centroid'"):
        area_overlap_percent(blob, HEAD, "pixels")
    with pytest.raises(NumericsError, match="'length' or 'nodes'"):
        shape_deviation_mm2(blob, HEAD, "area")


@pytest.mark.parametrize("corners", [100, 10_000])
def test_a_rim_close_to_the_indenters_keeps_its_digits(corners):
    """A polygon inscribed in the circle: sides t off the middle lie r − √(t² + r² cos²(π/n)) inside it.

    With s the sagitta, the mean square is 8/15 s² to order s/r; in closed form alone it was off by a quarter at
    10 000 sides.
    """
    half = np.pi / corners
    angle = 2 * half * np.arange(corners)
    rim = 6.5 * np.column_stack([np.cos(angle), np.sin(angle)])
    integral = RoundFootprint(0.0, 0.0, 6.5).integrate_distance2_mm3(rim, np.roll(rim, -1, axis=0)).sum()
    sagitta = 2 * 6.5 * np.sin(half / 2) ** 2
    perimeter = corners * 2 * 6.5 * np.sin(half)
    assert integral / perimeter == pytest.approx(8 / 15 * sagitta**2, rel=3 * half**2 + 1e-7)
