"""Heads of any outline: exact overlaps and distances, the circle as the limit of many corners, what is refused."""

import numpy as np
import pytest
from disc_meshes import disc_mesh, square_mesh, uniform_blob
from drawn import drawn
from hypothesis import assume, given, strategies as st
from scipy.integrate import quad

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import Footprint, PolygonFootprint, RoundFootprint, overlap_mm2
from cbsr_qa.domain.geometry.polygons import inside_polygon
from cbsr_qa.domain.imaging import Blob, Image
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.imaging.contours import contour_regions
from cbsr_qa.eit.imaging.shape import (
    SpatialFigures,
    area_overlap_percent,
    centre_of_mass_error_mm,
    shape_deviation_mm2,
    spatial_figures,
)

#: A corner of 8 × 8 mm with a 5 × 5 mm bite: area 39 mm².
ELL = np.array([[-3.0, -3.0], [5.0, -3.0], [5.0, 0.0], [0.0, 0.0], [0.0, 5.0], [-3.0, 5.0]])


def _regular(corners: int, radius: float = 6.5, turned: float = 0.1) -> PolygonFootprint:
    angle = 2 * np.pi * np.arange(corners) / corners + turned
    return PolygonFootprint(radius * np.column_stack([np.cos(angle), np.sin(angle)]))


@st.composite
def stars(draw: st.DrawFn) -> np.ndarray:
    """Corners around the origin at any distance: simple, and as concave as it comes."""
    count = draw(st.integers(3, 9))
    gaps = np.array(draw(st.lists(st.floats(0.2, 1.0), min_size=count, max_size=count)))
    angle = 2 * np.pi * np.cumsum(gaps) / gaps.sum()
    assume(np.diff(np.append(angle, angle[0] + 2 * np.pi)).max() < np.pi - 0.05)
    radius = np.array(draw(st.lists(st.floats(1.0, 8.0), min_size=count, max_size=count)))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


@given(stars(), st.floats(-6, 6), st.floats(-6, 6))
@drawn(60)
def test_the_triangles_of_a_sheet_share_out_the_whole_polygon(corners, x, y):
    mesh = disc_mesh(20.0, rings=7, spokes=30)
    head = PolygonFootprint(corners + np.array([x, y]))
    overlap = overlap_mm2(head, mesh.corners_mm)
    assert overlap.sum() == pytest.approx(head.area_mm2, rel=1e-11)
    assert (overlap <= mesh.areas_mm2 * (1 + 1e-11)).all()


@given(stars(), stars(), st.floats(-5, 5), st.floats(-5, 5))
@drawn(60)
def test_two_polygons_have_as_much_of_each_other(one, other, x, y):
    first, second = PolygonFootprint(one), PolygonFootprint(other + np.array([x, y]))

    def inside(which: PolygonFootprint, of: PolygonFootprint) -> float:
        corners = which.corners_mm
        return float(of.area_under_edges_mm2(corners, np.roll(corners, -1, axis=0)).sum())

    assert inside(first, second) == pytest.approx(inside(second, first), rel=1e-9, abs=1e-9)
    assert -1e-9 <= inside(first, second) <= min(first.area_mm2, second.area_mm2) + 1e-9


@pytest.mark.parametrize(
    ("corners", "area"),
    [
        (ELL, 39.0),
        (ELL[::-1], 39.0),
        (ELL + np.array([2.5, 2.5]), 12.25),  # what is left of the corner within the square of ±3
        (ELL + np.array([100.0, 0.0]), 0.0),
    ],
)
def test_an_ell_over_a_square(corners, area):
    mesh = square_mesh(7, size_mm=16.0)
    blob = uniform_blob(Mesh(mesh.nodes_mm - 8.0, mesh.elements))
    small = uniform_blob(Mesh(square_mesh(5, size_mm=6.0).nodes_mm - 3.0, square_mesh(5).elements))
    head = PolygonFootprint(corners)
    region = blob if area in (39.0, 0.0) else small
    inside = overlap_mm2(head, region.image.mesh.corners_mm).sum()
    if area == 12.25:
        # [-0.5, 3]² without [2.5, 3]²
        area -= 0.25
    assert inside == pytest.approx(area, rel=1e-13, abs=1e-12)
    percent = 50 * area * (1 / 39 + 1 / region.area_mm2)
    assert area_overlap_percent(region, head) == pytest.approx(percent, rel=1e-12, abs=1e-12)


def test_the_centre_of_an_ell_is_that_of_its_area():
    # Two rectangles: 8 × 3 about (1, −1.5), 3 × 5 about (−1.5, 2.5).
    centre = (24 * np.array([1.0, -1.5]) + 15 * np.array([-1.5, 2.5])) / 39
    head = PolygonFootprint(ELL)
    assert head.centre_mm == pytest.approx(centre)
    assert centre_of_mass_error_mm(uniform_blob(disc_mesh(2.0, centre_mm=tuple(centre))), head) < 1e-12


def test_deviation_along_edges_is_the_integral_of_the_squared_distance():
    head = PolygonFootprint(ELL)
    start = np.array([[-6.0, 1.0], [4.0, -6.0], [2.0, 2.0], [-1.0, -1.0]])
    end = np.array([[6.0, 2.0], [1.0, 7.0], [3.5, 3.5], [0.5, 4.0]])

    def along(s: float, k: int) -> float:
        return float(head.distance_mm((start[k] + s * (end[k] - start[k]))[None])[0]) ** 2

    length = np.hypot(*(end - start).T)
    exact = [
        quad(along, 0, 1, args=(k,), epsabs=1e-12, limit=400, points=[0.2, 0.5])[0] * length[k] for k in range(4)
    ]
    assert head.integrate_distance2_mm3(start, end) == pytest.approx(exact, abs=2e-7)


def test_the_nearest_of_an_ells_sides_may_be_the_inner_ones():
    head = PolygonFootprint(ELL)
    points = np.array([[1.0, 2.0], [0.0, 0.0], [6.0, 1.0], [-1.5, -1.0]])
    assert head.distance_mm(points) == pytest.approx([1.0, 0.0, np.hypot(1, 1), 1.5])
    assert head.contains(points[[0, 3]]).tolist() == [False, True]


@given(stars(), st.floats(-9, 9), st.floats(-9, 9))
@drawn(60)
def test_a_place_is_inside_where_the_outline_goes_around_it(corners, x, y):
    head = PolygonFootprint(corners)
    point = np.array([[x, y]])
    assume(head.distance_mm(point)[0] > 1e-6)
    around = head.corners_mm - point
    turn = np.arctan2(
        around[:, 0] * np.roll(around[:, 1], -1) - around[:, 1] * np.roll(around[:, 0], -1),
        (around * np.roll(around, -1, axis=0)).sum(axis=1),
    ).sum()
    assert bool(inside_polygon(point, head.corners_mm)[0]) == (abs(turn) > 3.0)


def test_a_polygon_of_many_corners_becomes_the_disc_with_the_square_of_their_number():
    places = [(2.0, 0.7), (-4.0, 1.0), (0.3, 5.0), (1.0, -2.0)]
    blobs = [uniform_blob(disc_mesh(5.0, centre_mm=place, rings=2, spokes=60)) for place in places]

    def measured(head: Footprint) -> np.ndarray:
        return np.array([(f.overlap_percent, f.deviation_mm2) for f in spatial_figures(blobs, head)])

    exact = measured(RoundFootprint(0.0, 0.0, 6.5))

    def errors(corners: int) -> np.ndarray:
        return np.sqrt(((measured(_regular(corners)) - exact) ** 2).mean(axis=0))

    for coarse, fine in zip(errors(40), errors(160), strict=True):
        assert np.log2(coarse / fine) / 2 == pytest.approx(2.0, abs=0.1)


def test_a_disc_of_the_same_area_measures_what_the_disc_does():
    """The sanity values of the paper's metrics, with the disc as a polygon of 720 corners."""
    head = _regular(720, 6.5 * np.sqrt(2 * np.pi / 720 / np.sin(2 * np.pi / 720)))
    for factor, overlap in ((0.7, 74.5), (1.5, 72.2)):
        blob = uniform_blob(disc_mesh(factor * 6.5, rings=4, spokes=720))
        assert area_overlap_percent(blob, head) == pytest.approx(overlap, abs=0.05)
    (shifted,) = spatial_figures([uniform_blob(disc_mesh(6.5, centre_mm=(2.0, 0.0), rings=4, spokes=360))], head)
    assert shifted.error_mm == pytest.approx(2.0, rel=1e-9)
    assert shifted.overlap_percent == pytest.approx(80.49, abs=0.01)
    assert shifted.deviation_mm2 == pytest.approx(1.99, abs=0.005)


@pytest.mark.rest
@given(st.booleans(), stars(), st.floats(0, 2 * np.pi), st.floats(0.2, 5.0), st.floats(-50, 50), st.floats(-50, 50))
@drawn(60)
def test_turned_moved_and_scaled_everything_measures_the_same(contour, corners, angle, scale, x, y):
    mesh = disc_mesh(12.0, rings=5, spokes=24, centre_mm=(0.4, -0.3))
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    values = 0.85 ** ((mesh.centroids_mm**2).sum(axis=1) / 36)

    def scored(place, head: Footprint) -> SpatialFigures:
        image = Image(Mesh(place(mesh.nodes_mm), mesh.elements), values)
        region = contour_regions(image, 0.6)[0] if contour else Blob(image, np.flatnonzero(values > 0.6))
        (figures,) = spatial_figures([region], head)
        return figures

    def moved(points: np.ndarray) -> np.ndarray:
        return points @ turn.T + np.array([x, y])

    for head, other in (
        (PolygonFootprint(corners), PolygonFootprint(moved(corners))),
        (RoundFootprint(1.0, 2.0, 5.0), RoundFootprint(*moved(np.array([[1.0, 2.0]]))[0], 5.0 * scale)),
    ):
        one, two = scored(np.asarray, head), scored(moved, other)
        assert two.error_mm == pytest.approx(scale * one.error_mm, rel=1e-6, abs=1e-7)
        assert two.overlap_percent == pytest.approx(one.overlap_percent, abs=1e-6)
        assert two.deviation_mm2 == pytest.approx(scale**2 * one.deviation_mm2, rel=1e-6, abs=1e-7)
        assert two.area_ratio == pytest.approx(one.area_ratio, rel=1e-9)


def test_paper_counting_works_for_any_head():
    mesh = square_mesh(160, size_mm=16.0)
    blob = uniform_blob(Mesh(mesh.nodes_mm - 8.0, mesh.elements))
    head = PolygonFootprint(ELL)
    assert area_overlap_percent(blob, head, "centroid") == pytest.approx(area_overlap_percent(blob, head), rel=5e-3)
    corner = uniform_blob(Mesh(np.array([[5.0, 0.0], [7.0, 0.0], [7.0, 3.0]]), np.array([[0, 1, 2]])))
    assert shape_deviation_mm2(corner, head, "nodes") == pytest.approx((0 + 4 + 13) / 3)


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        ([[0, 0], [1, 0]], "three"),
        ([[0, 0], [1, 0], [np.nan, 1]], "finite"),
        ([[0, 0], [1, 0], [1, 0], [0, 1]], "corner 2 of the outline is repeated"),
        ([[0, 0], [1, 1], [1, 0], [0, 1]], "sides 1 and 3"),
        ([[0, 0], [2, 0], [1, 0], [1, 1]], "sides 1 and 2"),
        ([[0, 0], [4, 0], [4, 4], [2, 0], [0, 4]], "sides 1 and 3"),
        ([[0, 0], [1, 0], [2, 0]], "meet"),
    ],
    ids=["two", "nan", "repeated", "bow tie", "turned back", "touching", "flat"],
)
def test_what_is_no_polygon_is_refused_by_name(corners, said):
    with pytest.raises(NumericsError, match=said):
        PolygonFootprint(np.array(corners, dtype=float))


@pytest.mark.parametrize("radius", [0.0, -1.0, float("nan"), float("inf")])
def test_a_radius_that_is_none_is_refused(radius):
    with pytest.raises(NumericsError, match="radius"):
        RoundFootprint(0.0, 0.0, radius)


def test_an_indenter_knows_its_true_area_and_reach():
    square = Indenter.with_outline([(-5, -5), (5, -5), (5, 5), (-5, 5)])
    assert square.area_mm2 == pytest.approx(100.0)
    assert square.reach_mm == pytest.approx(np.sqrt(50))
    assert square.footprint_at(10.0, 0.0).centre_mm == pytest.approx((10.0, 0.0))
    assert square.footprint_at(10.0, 0.0).area_mm2 == pytest.approx(100.0)
    round_head = Indenter(13.0)
    assert (round_head.area_mm2, round_head.reach_mm) == (pytest.approx(132.73, abs=0.01), 6.5)
    assert round_head.footprint_at(1.0, 2.0) == RoundFootprint(1.0, 2.0, 6.5)
