"""Meshes of sheets that are no discs, and voltages on them against exact solutions."""

from functools import cache

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, reject, strategies as st

from benchmarks.reference_solutions import pin_transfer_impedance
from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.geometry import Polygon, corner_turns, rounding_room
from cbsr_qa.domain.sensor import DrivePattern, ElectrodeKind, PlacedElectrodes, adjacent_pattern, polygon_sensor
from cbsr_qa.eit.forward.elements import FiniteElements
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.mesh import image_mesh, sheet_mesh, smallest_angle_deg

STAR = tuple((r * np.cos(a), r * np.sin(a)) for a, r in zip(np.pi * np.arange(10) / 5, [22, 50] * 5, strict=True))
SHEETS = {
    "rectangle": Polygon(((-60, -40), (60, -40), (60, 40), (-60, 40))),
    "rounded": Polygon(((-60, -40), (60, -40), (60, 40), (-60, 40)), 10.0),
    "elbow": Polygon(((0, 0), (80, 0), (80, 30), (30, 30), (30, 80), (0, 80))),
    "rounded elbow": Polygon(((0, 0), (80, 0), (80, 30), (30, 30), (30, 80), (0, 80)), 5.0),
    "slotted": Polygon(((0, 0), (60, 0), (60, 60), (31, 60), (31, 10), (29, 10), (29, 60), (0, 60))),
    "waist": Polygon(
        (
            *((0, 0), (40, 0), (40, 20), (60, 20), (60, 0), (100, 0)),
            *((100, 60), (60, 60), (60, 25), (40, 25), (40, 60), (0, 60)),
        )
    ),
    "star": Polygon(STAR),
}
OPEN = 1e9  # contact impedance of an electrode that is not there


def around(outline, count, inset=0.0):
    """Places evenly along the edge, or so far inside it."""
    curve = outline.curve
    along = curve.perimeter * (np.arange(count) + 0.5) / count
    ahead = curve.at(along + 1e-3) - curve.at(along - 1e-3)
    inward = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.hypot(*ahead.T)[:, None]
    return tuple(map(tuple, (curve.at(along) + inset * inward).tolist()))


def sensor_on(name, kind, count=16):
    outline = SHEETS[name]
    inset, width = (2.0, 0.65) if kind is ElectrodeKind.PIN else (0.0, 5.0)
    electrodes = PlacedElectrodes(kind, around(outline, count, inset), width)
    return polygon_sensor(name, outline, 4.0, electrodes, adjacent_pattern(count))


@cache
def mesh_on(name, kind, order=1):
    sensor = sensor_on(name, kind)
    return sheet_mesh(sensor, size_mm=(0.06 if order == 1 else 0.1) * sensor.radius_mm, order=order)


MESHED = [(name, ElectrodeKind.ARC) for name in SHEETS]
MESHED += [(name, ElectrodeKind.PIN) for name in ("rectangle", "rounded elbow", "slotted")]


@st.composite
def any_sheets(draw):
    """Sheets seen whole from a place inside, however pointed, with corners round or not and strips somewhere."""
    gaps = draw(st.lists(st.floats(0.2, 1.0), min_size=3, max_size=10))
    angles = 2 * np.pi * np.cumsum(gaps) / sum(gaps)
    radii = np.array(draw(st.lists(st.floats(12.0, 50.0), min_size=len(gaps), max_size=len(gaps))))
    corners = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    rounding = draw(st.sampled_from([0.0, 0.1, 0.8])) * rounding_room(corners)
    try:
        outline = Polygon(tuple(map(tuple, corners.tolist())), rounding)
    except RefusedError:
        reject()
    begin, width = draw(st.floats(0, 1)), draw(st.floats(0.01, 0.1))
    curve = outline.curve
    places = curve.at(curve.perimeter * (begin + np.arange(5) / 5))
    electrodes = PlacedElectrodes(ElectrodeKind.ARC, tuple(map(tuple, places.tolist())), width * curve.perimeter)
    return polygon_sensor("any", outline, 1.0, electrodes, adjacent_pattern(5))


@drawn(8)
@given(any_sheets(), st.floats(0.1, 0.2), st.sampled_from([1, 2]))
def test_any_sheet_is_meshed_without_thin_elements(sensor, size, order):
    sharpest = 180 - np.rad2deg(np.abs(corner_turns(np.array(sensor.outline.corners_mm))).max())
    forward = sheet_mesh(sensor, size_mm=size * sensor.radius_mm, order=order)
    for mesh in (forward, image_mesh(sensor, size_mm=size * sensor.radius_mm)):
        assert smallest_angle_deg(mesh.nodes_mm, mesh.elements).min() > min(12, 0.8 * sharpest)
        assert mesh.areas_mm2.sum() == pytest.approx(sensor.outline.curve.area, rel=0.02)
    assert FiniteElements(forward, 2).weights_mm2.min() > 0  # no arc bends an element inside out


def boundary_of(mesh):
    counts = np.bincount(mesh.element_edges.ravel(), minlength=len(mesh.edges))
    assert counts.max() == 2
    return mesh.edges[counts == 1]


@pytest.mark.parametrize(("name", "kind"), MESHED)
def test_elements_cover_exactly_the_sheet_and_electrodes_are_where_they_were_said_to_be(name, kind):
    mesh, sensor, outline = mesh_on(name, kind), sensor_on(name, kind), SHEETS[name]
    assert smallest_angle_deg(mesh.nodes_mm, mesh.elements).min() > 20
    pins = 16 if kind is ElectrodeKind.PIN else 0
    straight = outline.corner_radius_mm == 0
    exact = outline.curve.area - pins * np.pi * 0.325**2
    assert mesh.areas_mm2.sum() == pytest.approx(exact, rel=1e-10 if straight and not pins else 1e-3)
    assert len(mesh.nodes_mm) - len(mesh.edges) + len(mesh.elements) == 1 - pins  # Euler: one piece, pins as holes
    boundary = boundary_of(mesh)
    edge = mesh.nodes_mm[boundary].mean(axis=1)
    off = np.abs(outline.clearance_mm(edge))
    assert (off < 0.1).sum() + pins * 8 <= len(edge)
    if not pins:
        assert off.max() < (1e-9 if straight else 0.2)
    boundary = {tuple(edge) for edge in boundary.tolist()}
    for place, edges in zip(sensor.electrodes.positions_mm(), mesh.electrode_edges, strict=True):
        assert {tuple(sorted(edge)) for edge in edges.tolist()} <= boundary
        ends = mesh.nodes_mm[edges]
        lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
        width = np.pi * 0.65 if kind is ElectrodeKind.PIN else 5.0
        assert lengths.sum() == pytest.approx(width, rel=0.02)
        along, away = sensor.outline.curve.nearest(ends.reshape(-1, 2))
        if kind is ElectrodeKind.ARC:
            assert away.max() < 1e-8
            begin = sensor.outline.curve.nearest(place[None])[0] - 2.5
            after = (along - begin + 1e-6) % sensor.outline.curve.perimeter
            assert after.max() < 5.0 + 1e-5
        else:
            assert np.abs(np.hypot(*(ends.reshape(-1, 2) - place).T) - 0.325).max() < 1e-8


@pytest.mark.parametrize("name", SHEETS)
def test_image_elements_are_near_uniform(name):
    sensor = sensor_on(name, ElectrodeKind.ARC)
    size_mm = 0.06 * sensor.radius_mm
    mesh = image_mesh(sensor, size_mm=size_mm)
    assert mesh.electrode_edges == ()
    assert smallest_angle_deg(mesh.nodes_mm, mesh.elements).min() > 25
    assert np.median(mesh.areas_mm2) == pytest.approx(np.sqrt(3) / 4 * size_mm**2, rel=0.1)
    assert mesh.areas_mm2.sum() == pytest.approx(sensor.outline.curve.area, rel=1e-3)
    assert sensor.outline.clearance_mm(mesh.centroids_mm).min() > 0


@pytest.mark.rest
@pytest.mark.parametrize("name", ["rectangle", "rounded elbow"])
@pytest.mark.parametrize("kind", ElectrodeKind)
def test_a_turned_and_moved_sheet_has_the_same_mesh_turned_and_moved(name, kind):
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])

    def moved(points):
        return tuple(map(tuple, (np.asarray(points) @ turn.T + [3.3, -17.1]).tolist()))

    sensor, outline = sensor_on(name, kind), SHEETS[name]
    places = PlacedElectrodes(kind, moved(sensor.electrodes.places_mm), sensor.electrodes.width_mm)
    other = polygon_sensor(
        name, Polygon(moved(outline.corners_mm), outline.corner_radius_mm), 4.0, places, sensor.pattern
    )
    mesh = mesh_on(name, kind)
    again = sheet_mesh(other, size_mm=0.06 * sensor.radius_mm)
    np.testing.assert_array_equal(again.elements, mesh.elements)
    assert np.abs(again.nodes_mm - moved(mesh.nodes_mm)).max() < 1e-9 * sensor.radius_mm


def strip_model(outline, places, width, size_mm, contacts, order=1, conductance=0.3):
    """Two strips in use; the third closes the layout and is not there."""
    electrodes = PlacedElectrodes(ElectrodeKind.ARC, places, width)
    sensor = polygon_sensor("strips", outline, 1.0, electrodes, DrivePattern(3, ((0, 1),), ((0, 1),)))
    mesh = sheet_mesh(sensor, size_mm=size_mm, order=order)
    gamma = np.full(len(mesh.elements), conductance)
    return ForwardModel(mesh, sensor.pattern, gamma, np.array([contacts, contacts, OPEN]), order=order)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_rectangle_between_whole_ends_has_its_resistance_of_length_over_width(order, angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners, ends = ([(0, 0), (60, 0), (60, 20), (0, 20)], [(0, 10), (60, 10), (30, 0)])
    outline = Polygon(tuple(map(tuple, (np.array(corners) @ turn.T).tolist())))
    places = tuple(map(tuple, (np.array(ends) @ turn.T).tolist()))
    model = strip_model(outline, places, 20.0, 3.0, 5.0, order)
    assert model.voltages()[0, 0] == pytest.approx(60 / (0.3 * 20) + 2 * 5.0 / 20, rel=3e-8)


def bend_error(size_mm, order):
    """Of a right-angled bend: its corner counts as 1 − (2/π) ln 2 squares (conformal map; Hall 1967)."""
    width, arm = 10.0, 60.0
    outline = Polygon(((0, 0), (70, 0), (70, 10), (10, 10), (10, 70), (0, 70)))
    places = ((width + arm, width / 2), (width / 2, width + arm), (0.0, 30.0))
    model = strip_model(outline, places, width, size_mm, 0.1, order, conductance=1.0)
    exact = 2 * arm / width + 1 - 2 / np.pi * np.log(2)
    return (model.voltages()[0, 0] - 2 * 0.1 / width) / exact - 1


@pytest.mark.rest
def test_a_bend_converges_to_the_conformal_maps_resistance():
    errors = np.abs([bend_error(size, 1) for size in (3.0, 1.5, 0.75)])
    assert (np.log2(errors[:-1] / errors[1:]) > 1.1).all()  # 4/3 where nothing is refined at the corner
    assert errors[-1] < 3e-4


def test_elements_of_second_order_are_graded_at_the_bend():
    errors = np.abs([bend_error(size, 2) for size in (3.0, 1.5)])
    assert errors[0] < 2e-5
    assert np.log2(errors[0] / errors[1]) > 2


def test_pins_placed_one_by_one_on_a_disc_have_the_exact_voltages(pin_sensor):
    from dataclasses import replace

    sensor = pin_sensor()
    places = tuple(map(tuple, sensor.electrodes.positions_mm().tolist()))
    single = replace(sensor, electrodes=PlacedElectrodes(ElectrodeKind.PIN, places, 0.65))
    exact = pin_transfer_impedance(50.0, 1.0, sensor.electrodes, 0.2)
    mesh = sheet_mesh(single, size_mm=6.0, order=2)
    model = ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), np.full(16, 0.2), order=2)
    assert np.linalg.norm(model.transfer_impedance - exact) < 1e-3 * np.linalg.norm(exact)
    assert len(mesh.arcs) == 4 + 16  # the disc's edge in quarters, and every pin


def test_round_corners_are_arcs_that_elements_of_second_order_follow():
    mesh = mesh_on("rounded", ElectrodeKind.ARC)
    assert len(mesh.arcs) == 4
    model = ForwardModel(mesh, adjacent_pattern(16), np.ones(len(mesh.elements)), np.full(16, 0.5), order=2)
    exact = SHEETS["rounded"].curve.area
    assert mesh.areas_mm2.sum() < exact - 0.5
    assert model.elements.weights_mm2.sum() == pytest.approx(exact, rel=1e-6)


def test_narrow_places_have_elements_across_them():
    mesh = mesh_on("waist", ElectrodeKind.ARC)
    neck = (mesh.centroids_mm[:, 0] > 42) & (mesh.centroids_mm[:, 0] < 58)
    assert np.sqrt(mesh.areas_mm2[neck].max() * 4 / np.sqrt(3)) < 5 / 2  # 5 mm wide


def test_an_electrode_that_does_not_fit_is_refused_by_the_mesher_too():
    sensor = sensor_on("rectangle", ElectrodeKind.PIN)
    places = ((70.0, 0.0), *sensor.electrodes.places_mm[1:])
    outside = polygon_sensor(
        "bad", SHEETS["rectangle"], 4.0, PlacedElectrodes(ElectrodeKind.PIN, places, 0.65), sensor.pattern
    )
    with pytest.raises(RefusedError, match=r"sensor type 'bad': electrode 0 lies 10 mm outside the sheet"):
        sheet_mesh(outside, size_mm=3.0)
    with pytest.raises(RefusedError, match="quarter of the radius"):
        sheet_mesh(sensor, size_mm=30.0)
