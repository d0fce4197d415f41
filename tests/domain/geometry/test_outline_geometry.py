"""Outlines of sheets as geometry: exact, independent of how they lie, and refused where no sheet could have them."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from matplotlib.path import Path

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.geometry.curve import circle_curve
from cbsr_qa.domain.geometry.outlines import Disc, Polygon, simplify_outline
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout, PlacedElectrodes, placement_problems

RECTANGLE = ((-60.0, -40.0), (60.0, -40.0), (60.0, 40.0), (-60.0, 40.0))
ELBOW = ((0.0, 0.0), (80.0, 0.0), (80.0, 30.0), (30.0, 30.0), (30.0, 80.0), (0.0, 80.0))


def star(angles, radii):
    """A polygon seen whole from its middle: simple, however concave."""
    return tuple(zip((radii * np.cos(angles)).tolist(), (radii * np.sin(angles)).tolist(), strict=True))


stars = st.lists(st.floats(25.0, 50.0), min_size=5, max_size=14).map(
    lambda radii: star(2 * np.pi * np.arange(len(radii)) / len(radii), np.array(radii))
)


def moved(points, angle=0.7, by=(3.3, -17.1)):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray(points) @ turn.T + by


def as_corners(points):
    return tuple((float(x), float(y)) for x, y in points)


def test_area_perimeter_and_radius_of_rounded_corners_are_exact():
    sharp, rounded = Polygon(RECTANGLE), Polygon(RECTANGLE, 10.0)
    assert sharp.curve.area == pytest.approx(9600, rel=1e-14)
    assert rounded.curve.area == pytest.approx(9600 - (4 - np.pi) * 100, rel=1e-14)
    assert rounded.curve.perimeter == pytest.approx(400 - (8 - 2 * np.pi) * 10, rel=1e-14)
    elbow = Polygon(ELBOW, 5.0)  # five corners lose what one gains
    assert elbow.curve.area == pytest.approx(3900 - 4 * (1 - np.pi / 4) * 25, rel=1e-14)
    assert sharp.radius_mm == pytest.approx(np.sqrt(9600 / np.pi))
    assert circle_curve(5.0).area == pytest.approx(25 * np.pi, rel=1e-14)


@pytest.mark.rest
@given(stars, st.sampled_from([0.0, 1.0]))
def test_clearance_is_the_distance_to_the_densely_drawn_edge(corners, rounding):
    polygon = Polygon(corners, rounding)
    curve = polygon.curve
    drawn = curve.points_at(np.linspace(0, curve.perimeter, 6001))
    points = np.random.default_rng(0).uniform(-60, 60, (60, 2))
    clearance = polygon.clearance_mm(points)
    distance = np.hypot(*(points[:, None] - drawn).transpose(2, 0, 1)).min(axis=1)
    assert np.abs(np.abs(clearance) - distance).max() < curve.perimeter / 6000
    clear = distance > 0.1
    np.testing.assert_array_equal((clearance > 0)[clear], Path(drawn).contains_points(points)[clear])


@pytest.mark.parametrize("rounding", [0.0, 4.0])
def test_places_that_line_up_with_corners_and_chords_are_told_apart_too(rounding):
    polygon = Polygon(ELBOW, rounding)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-2.0, 83.0), np.arange(-2.0, 83.0)))  # on every chord
    clearance = polygon.clearance_mm(np.column_stack([x, y]))
    inside = (x > 0) & (y > 0) & (x < 80) & (y < 80) & ((x < 30) | (y < 30))
    for corner_x, corner_y in ELBOW:
        sign_x, sign_y = (-1 if corner_x else 1), (-1 if corner_y else 1)
        away_x, away_y = (x - corner_x) * sign_x, (y - corner_y) * sign_y
        if (corner_x, corner_y) == (30.0, 30.0):
            away_x, away_y = -away_x, -away_y
        cut = (np.hypot(away_x - rounding, away_y - rounding) > rounding) & (away_x < rounding) & (away_y < rounding)
        near = cut & (away_x >= 0) & (away_y >= 0)
        inside = inside | near if (corner_x, corner_y) == (30.0, 30.0) else inside & ~near
    clear = np.abs(clearance) > 1e-9
    np.testing.assert_array_equal((clearance > 0)[clear], inside[clear])


@pytest.mark.rest
@given(stars, st.floats(0, 1))
def test_a_place_on_the_edge_is_found_again(corners, share):
    curve = Polygon(corners, 1.0).curve
    along = np.array([share * curve.perimeter])
    found, away = curve.nearest(curve.points_at(along))
    assert away[0] < 1e-9
    apart = abs(found[0] - along[0])
    assert min(apart, curve.perimeter - apart) < 1e-6


def test_a_turned_and_moved_sheet_is_the_same_sheet():
    polygon, other = Polygon(ELBOW, 4.0), Polygon(as_corners(moved(ELBOW)), 4.0)
    points = np.random.default_rng(1).uniform(-10, 90, (200, 2))
    np.testing.assert_allclose(polygon.clearance_mm(points), other.clearance_mm(moved(points)), atol=1e-12)
    assert other.radius_mm == pytest.approx(polygon.radius_mm, rel=1e-14)


def test_clockwise_corners_are_turned_and_begin_with_the_first():
    assert Polygon(RECTANGLE[::-1]) == Polygon((RECTANGLE[3], *RECTANGLE[:3]))


def test_the_centre_is_the_origin_where_that_is_well_inside_and_else_the_deepest_place():
    assert Polygon(RECTANGLE).centre_mm == (0.0, 0.0)
    away = Polygon(as_corners(np.array(RECTANGLE) + np.array([200, 0])))
    assert away.centre_mm[1] == pytest.approx(0.0, abs=1e-6)
    assert away.clearance_mm(np.array([away.centre_mm]))[0] == pytest.approx(40.0, abs=1e-6)
    # In the elbow's corner the largest disc touches both outer edges and the inner corner: (30√2)/(1 + √2).
    depth = Polygon(ELBOW).clearance_mm(np.array([Polygon(ELBOW).centre_mm]))[0]
    assert depth == pytest.approx(30 * np.sqrt(2) / (1 + np.sqrt(2)), abs=1e-5)
    assert Disc(50.0).centre_mm == (0.0, 0.0)


def test_corners_that_are_none_are_left_out_for_images():
    middles = [((a[0] + b[0]) / 2, (a[1] + b[1]) / 2) for a, b in zip(ELBOW, (*ELBOW[1:], ELBOW[0]), strict=True)]
    dense = Polygon(tuple(point for pair in zip(ELBOW, middles, strict=True) for point in pair))
    assert simplify_outline(dense, 0.01) == Polygon(ELBOW)
    assert simplify_outline(Polygon(ELBOW, 2.0), 1.0) == Polygon(ELBOW, 2.0)
    assert simplify_outline(Disc(3.0), 1.0) == Disc(3.0)


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        (RECTANGLE[:2], "has 2 corners; at least 3"),
        ((*RECTANGLE, RECTANGLE[0]), "corner 5 of the outline repeats corner 1; the last edge closes"),
        ((RECTANGLE[0], RECTANGLE[0], *RECTANGLE[1:]), "corner 2 of the outline repeats corner 1; leave one out"),
        ((RECTANGLE[0], RECTANGLE[2], RECTANGLE[1], RECTANGLE[3]), "crosses itself"),
        ((*RECTANGLE[:3], (0.0, -40.0), RECTANGLE[3]), "crosses itself"),  # a corner touches an edge
        (((0.0, 0.0), (50.0, 0.0), (100.0, 0.0)), "turns back to 0°"),
        (((0.0, 0.0), (100.0, 0.0), (100.0, 10.0)), "turns back to 5.71°; at least 10° are needed"),
        (
            ((0, 0), (90, 0), (90, 50), (45.1, 50), (45.1, 0.2), (44.9, 0.2), (44.9, 50), (0, 50)),
            "is only 0.2 mm wide",
        ),
        ((*RECTANGLE[:3], (float("nan"), 0.0)), "not a finite number"),
    ],
)
def test_outlines_no_sheet_has_are_refused_by_name(corners, said):
    with pytest.raises(RefusedError) as caught:
        Polygon(tuple(corners))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("radius", "said"),
    [
        (41.0, "the edges leave room for 40 mm at most"),
        (-1.0, "it must be a finite number"),
        (float("inf"), "finite"),
    ],
)
def test_corners_that_cannot_be_rounded_so_are_refused(radius, said):
    with pytest.raises(RefusedError, match=said):
        Polygon(RECTANGLE, radius)


def placed(kind, *changes, width=4.0):
    places = [(-30.0, -40.0), (30.0, -40.0), (60.0, 0.0), (30.0, 40.0), (-30.0, 40.0), (-60.0, 0.0)]
    if kind is ElectrodeKind.PIN:
        places = [(0.9 * x, 0.9 * y) for x, y in places]
    for number, place in changes:
        places[number] = place
    return PlacedElectrodes(kind, tuple(places), width)


@pytest.mark.parametrize("kind", ElectrodeKind)
def test_electrodes_that_fit_are_no_problem(kind):
    assert list(placement_problems(placed(kind), Polygon(RECTANGLE, 10.0))) == []


@pytest.mark.parametrize(
    ("kind", "change", "number", "said"),
    [
        (ElectrodeKind.PIN, (3, (30.0, 43.0)), 3, "lies 3 mm outside the sheet"),
        (ElectrodeKind.PIN, (3, (30.0, 39.0)), 3, "lies 1 mm from the edge; a pin of 4 mm needs 2.2 mm"),
        (ElectrodeKind.PIN, (3, (-27.0, -34.0)), 3, "overlaps electrode 0: their centres are 2 mm apart"),
        (ElectrodeKind.PIN, (3, (-22.9, -36.0)), 3, "is too close to electrode 0: between centres"),
        (ElectrodeKind.ARC, (3, (-25.999, -40.0)), 3, "is too close to electrode 0: between centres are 4.001 mm"),
        (ElectrodeKind.ARC, (3, (30.0, 35.0)), 3, "lies 5 mm from the edge, where"),
        (
            ElectrodeKind.ARC,
            (3, (-32.0, -40.0)),
            3,
            "overlaps electrode 0: their centres are 2 mm apart along the edge",
        ),
    ],
)
def test_electrodes_that_do_not_fit_are_named(kind, change, number, said):
    ((found, what),) = placement_problems(placed(kind, change), Polygon(RECTANGLE))
    assert found == number
    assert said in what


def test_a_strip_overlaps_round_a_corner_and_across_the_first_one():
    outline = Polygon(RECTANGLE)
    crowded = PlacedElectrodes(ElectrodeKind.ARC, ((-59.0, -40.0), (-60.0, -39.0), (0.0, 40.0)), 4.0)
    ((number, what),) = placement_problems(crowded, outline)
    assert (number, "electrode 0" in what) == (1, True)


def test_rings_fit_any_sheet_they_lie_in():
    ring = ElectrodeLayout(8, ElectrodeKind.PIN, 30.0, 2.0, 0.0, True)
    assert list(placement_problems(ring, Polygon(RECTANGLE))) == []
    wide = ElectrodeLayout(8, ElectrodeKind.PIN, 45.0, 2.0, 0.0, True)
    assert [number for number, _ in placement_problems(wide, Polygon(RECTANGLE))] == [2, 6]
    arcs = ElectrodeLayout(8, ElectrodeKind.ARC, 45.0, 2.0, 0.0, True)
    ((number, what),) = placement_problems(arcs, Polygon(RECTANGLE))
    assert number is None
    assert "give the position of each electrode" in what


@given(st.floats(0.2, 10), st.floats(0, 6.28))
def test_the_direction_of_a_place_is_that_of_a_ring_where_electrodes_are_on_one(far, angle):
    ring = ElectrodeLayout(7, ElectrodeKind.PIN, 10.0, 1.0, 25.0, False)
    single = PlacedElectrodes(ElectrodeKind.PIN, as_corners(ring.positions_mm()), 1.0)
    x, y = far * np.cos(angle), far * np.sin(angle)
    apart = abs(ring.electrode_at(x, y) - single.electrode_at(x, y))
    assert min(apart, 7 - apart) < 1e-9
