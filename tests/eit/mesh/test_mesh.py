"""Meshes of sheets: they cover them, electrodes are where they were said to be, no element is thin; and refusals."""

import hashlib
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, reject, strategies as st
from tiers import rest_but

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.geometry.curve import corner_turns, rounding_room
from cbsr_qa.domain.geometry.outlines import Polygon
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, PlacedElectrodes
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import SensorType, polygon_sensor
from cbsr_qa.eit.forward.elements import FiniteElements
from cbsr_qa.eit.mesh import triangulate
from cbsr_qa.eit.mesh.sheet import image_mesh, sheet_mesh
from cbsr_qa.eit.mesh.triangulate import smallest_angle_deg

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
DISCS = {
    "disc-100mm": ("pin", {}, 3.0),
    "disc-100mm-fine": ("pin", {}, 2.0),
    "disc-150mm": ("pin", {"radius_mm": 75.0}, 4.5),
    "eight-pins-clockwise": ("pin", {"count": 8, "first_angle_deg": 90.0, "counterclockwise": False}, 5.0),
    "arcs": ("arc", {}, 0.08),
    "arcs-clockwise": ("arc", {"first_angle_deg": 33.0, "counterclockwise": False}, 0.06),
    "tank-32": ("arc", {"radius_mm": 140.0, "count": 32, "half_width_rad": 0.03}, 10.0),
}


def around(outline, count, inset=0.0):
    """Places evenly along the edge, or so far inside it."""
    curve = outline.curve
    along = curve.perimeter * (np.arange(count) + 0.5) / count
    ahead = curve.points_at(along + 1e-3) - curve.points_at(along - 1e-3)
    inward = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.hypot(*ahead.T)[:, None]
    return tuple(map(tuple, (curve.points_at(along) + inset * inward).tolist()))


def sensor_on(name, kind, count=16):
    outline = SHEETS[name]
    inset, width = (2.0, 0.65) if kind is ElectrodeKind.PIN else (0.0, 5.0)
    electrodes = PlacedElectrodes(kind, around(outline, count, inset), width)
    return polygon_sensor(name, outline, 4.0, electrodes, adjacent_pattern(count))


@cache
def mesh_on(name, kind):
    sensor = sensor_on(name, kind)
    return sensor, sheet_mesh(sensor, size_mm=0.06 * sensor.radius_mm)


POLYGONS = {f"{name}, strips": (name, ElectrodeKind.ARC) for name in SHEETS} | {
    f"{name}, pins": (name, ElectrodeKind.PIN) for name in ("rectangle", "rounded elbow", "slotted")
}


@pytest.fixture(scope="module")
def disc_of(pin_sensor, arc_sensor):
    @cache
    def make(name: str) -> tuple[SensorType, Mesh]:
        kind, options, size_mm = DISCS[name]
        sensor = {"pin": pin_sensor, "arc": arc_sensor}[kind](**options)
        return sensor, sheet_mesh(sensor, size_mm=size_mm)

    return make


#: Sharp corners inwards, pins in narrow places, pins and strips of a ring in either direction, and its finest part.
_TELLING = {"star, strips", "slotted, pins", "disc-100mm", "arcs-clockwise", "eight-pins-clockwise"}


@pytest.mark.parametrize("name", rest_but(_TELLING, [*POLYGONS, *DISCS]))
def test_elements_cover_the_sheet_and_electrodes_are_where_they_were_said_to_be(disc_of, name):
    sensor, mesh = mesh_on(*POLYGONS[name]) if name in POLYGONS else disc_of(name)
    angles = smallest_angle_deg(mesh.nodes_mm, mesh.elements)
    assert angles.min() > 20
    assert np.median(angles) > 42
    outline, layout, size = sensor.outline, sensor.electrodes, sensor.radius_mm
    pins = layout.count if layout.kind is ElectrodeKind.PIN else 0
    width = np.pi * layout.width_mm if pins else layout.width_mm
    straight = name in POLYGONS and outline.corner_radius_mm == 0
    exact = outline.curve.area - pins * np.pi * (layout.width_mm / 2) ** 2
    chords, near, far = (1e-3, 0.1, 0.2) if name in POLYGONS else (2e-3, 2e-3 * size, 4e-3 * size)
    assert mesh.areas_mm2.sum() == pytest.approx(exact, rel=1e-10 if straight and not pins else chords)
    assert len(mesh.nodes_mm) - len(mesh.edges) + len(mesh.elements) == 1 - pins  # Euler: one piece, pins as holes
    assert len(np.unique(mesh.elements)) == len(mesh.nodes_mm)
    counts = np.bincount(mesh.element_edges.ravel(), minlength=len(mesh.edges))
    assert set(counts) == {1, 2}
    boundary = mesh.edges[counts == 1]
    off = np.abs(outline.clearance_mm(mesh.nodes_mm[boundary].mean(axis=1)))
    assert (off < near).sum() + pins * 8 <= len(boundary)
    assert pins or off.max() < (1e-9 if straight else far)
    boundary = {tuple(edge) for edge in boundary.tolist()}
    for place, edges in zip(layout.positions_mm(), mesh.electrode_edges, strict=True):
        assert len(edges) >= (12 if pins else 10)
        assert {tuple(sorted(edge)) for edge in edges.tolist()} <= boundary
        ends = mesh.nodes_mm[edges]
        assert np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum() == pytest.approx(width, rel=0.012)
        if pins:
            assert np.abs(np.hypot(*(ends.reshape(-1, 2) - place).T) - layout.width_mm / 2).max() < 1e-8
            continue
        along, away = outline.curve.nearest(ends.reshape(-1, 2))
        assert away.max() < 1e-8
        begin = outline.curve.nearest(place[None])[0] - width / 2
        assert ((along - begin + 1e-6) % outline.curve.perimeter).max() < width + 1e-5


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
    places = curve.points_at(curve.perimeter * (begin + np.arange(5) / 5))
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


@pytest.mark.parametrize("name", rest_but({"waist", "disc-100mm"}, [*SHEETS, "disc-100mm", "disc-150mm"]))
def test_image_elements_are_near_uniform(disc_of, name):
    sensor = sensor_on(name, ElectrodeKind.ARC) if name in SHEETS else disc_of(name)[0]
    size_mm = 0.06 * sensor.radius_mm
    mesh = image_mesh(sensor, size_mm=size_mm)
    assert mesh.electrode_edges == ()
    assert smallest_angle_deg(mesh.nodes_mm, mesh.elements).min() > (25 if name in SHEETS else 30)
    assert np.median(mesh.areas_mm2) == pytest.approx(
        np.sqrt(3) / 4 * size_mm**2, rel=0.1 if name in SHEETS else 0.05
    )
    assert mesh.areas_mm2.sum() == pytest.approx(sensor.outline.curve.area, rel=1e-3)
    assert sensor.outline.clearance_mm(mesh.centroids_mm).min() > 0
    if name in DISCS:
        assert 1500 < len(mesh.elements) < 2500
        assert mesh.areas_mm2.max() < 2.2 * mesh.areas_mm2.min()


@pytest.mark.parametrize("name", rest_but(_TELLING & set(DISCS), DISCS))
def test_electrodes_of_a_ring_are_alike_to_rounding(disc_of, name):
    sensor, mesh = disc_of(name)
    layout = sensor.electrodes
    first = mesh.nodes_mm[mesh.electrode_edges[0]].reshape(-1, 2) @ np.array([1, 1j])
    for k, electrode in enumerate(mesh.electrode_edges):
        turned = mesh.nodes_mm[electrode].reshape(-1, 2) @ np.array([1, 1j]) * np.exp(-1j * k * layout.step_rad)
        assert np.abs(turned - first).max() < 1e-12 * sensor.radius_mm


def test_arc_elements_are_finest_at_the_ends(arc_sensor):
    mesh = sheet_mesh(arc_sensor(), size_mm=0.06)
    electrode = mesh.nodes_mm[mesh.electrode_edges[0]]
    length = np.hypot(*(electrode[:, 1] - electrode[:, 0]).T)
    assert max(length[0], length[-1]) < 0.5 * length.max()
    assert np.allclose(length, length[::-1], rtol=1e-6)


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
    _, mesh = mesh_on(name, kind)
    again = sheet_mesh(other, size_mm=0.06 * sensor.radius_mm)
    np.testing.assert_array_equal(again.elements, mesh.elements)
    assert np.abs(again.nodes_mm - moved(mesh.nodes_mm)).max() < 1e-9 * sensor.radius_mm


def test_round_corners_are_arcs_that_elements_of_second_order_follow():
    _, mesh = mesh_on("rounded", ElectrodeKind.ARC)
    assert len(mesh.arcs) == 4
    exact = SHEETS["rounded"].curve.area
    assert mesh.areas_mm2.sum() < exact - 0.5
    assert FiniteElements(mesh, 2).weights_mm2.sum() == pytest.approx(exact, rel=1e-6)


def test_narrow_places_have_elements_across_them():
    _, mesh = mesh_on("waist", ElectrodeKind.ARC)
    neck = (mesh.centroids_mm[:, 0] > 42) & (mesh.centroids_mm[:, 0] < 58)
    assert np.sqrt(mesh.areas_mm2[neck].max() * 4 / np.sqrt(3)) < 5 / 2  # 5 mm wide


@pytest.mark.rest
def test_mesh_size_sets_the_edge_length_away_from_electrodes(pin_sensor):
    for size_mm in (2.0, 3.0, 4.0):
        mesh = sheet_mesh(pin_sensor(), size_mm=size_mm)
        inner = np.hypot(*mesh.centroids_mm.T) < 30
        assert np.sqrt(mesh.areas_mm2[inner].mean() * 4 / np.sqrt(3)) == pytest.approx(size_mm, rel=0.15)


DIGEST = """
import hashlib
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.mesh.sheet import sheet_mesh
layout = ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 0.0, True)
mesh = sheet_mesh(SensorType("pins", 50.0, 4.0, layout, adjacent_pattern(16), Response.AUTO), size_mm=3.0)
print(hashlib.sha256(mesh.nodes_mm.tobytes() + mesh.elements.tobytes()).hexdigest())
"""


@pytest.mark.rest
def test_same_mesh_in_another_process_on_other_threads(pin_sensor):
    mesh = sheet_mesh(pin_sensor(), size_mm=3.0)
    here = hashlib.sha256(mesh.nodes_mm.tobytes() + mesh.elements.tobytes()).hexdigest()
    environment = {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "PYTHONHASHSEED": "7"}
    there = subprocess.run(
        [sys.executable, "-c", DIGEST], env=environment, capture_output=True, text=True, check=True
    )
    assert there.stdout.strip() == here


@pytest.mark.parametrize("size_mm", [0.0, -1.0, float("nan"), 12.6])
def test_size_out_of_range_is_refused(pin_sensor, size_mm):
    with pytest.raises(RefusedError, match="quarter of the radius"):
        sheet_mesh(pin_sensor(), size_mm=size_mm)
    with pytest.raises(RefusedError, match="quarter of the radius"):
        image_mesh(pin_sensor(), size_mm=size_mm)


def test_electrodes_that_do_not_fit_the_sheet_are_refused(pin_sensor, arc_sensor):
    with pytest.raises(RefusedError, match="do not lie inside the sheet"):
        sheet_mesh(replace(pin_sensor(), radius_mm=48.2), size_mm=3.0)
    with pytest.raises(RefusedError, match="arcs lie on the sheet's edge"):
        sheet_mesh(replace(arc_sensor(), radius_mm=1.1), size_mm=0.08)


@pytest.mark.rest
@pytest.mark.parametrize(("width_mm", "ring_mm"), [(4.0, 47.8), (0.05, 48.0), (15.42, 41.51)])
def test_electrodes_with_the_least_room_and_width_are_meshed_with_few_elements(pin_sensor, width_mm, ring_mm):
    sensor = pin_sensor()
    layout = replace(sensor.electrodes, width_mm=width_mm, ring_radius_mm=ring_mm * (1 - 1e-9))
    for order in (1, 2):
        mesh = sheet_mesh(replace(sensor, electrodes=layout), size_mm=5.0, order=order)
        assert len(mesh.elements) < 20_000
        assert len(mesh.electrode_edges) == 16


@pytest.mark.parametrize(
    ("width_mm", "reason"),
    [(3.9999, "clear of its edge"), (1e-9, "must be at least 0.05 mm"), (18.5, "at most 17.8")],
)
def test_electrodes_too_small_or_without_room_are_refused_before_they_are_meshed(pin_sensor, width_mm, reason):
    sensor = pin_sensor()
    with pytest.raises(RefusedError, match=reason) as refused:
        sheet_mesh(replace(sensor, electrodes=replace(sensor.electrodes, width_mm=width_mm)), size_mm=5.0)
    assert refused.value.remedy


def test_refinement_ends_with_a_refusal_where_it_takes_too_many_points(pin_sensor, monkeypatch):
    monkeypatch.setattr(triangulate, "MOST_POINTS", 1000)
    with pytest.raises(NumericsError, match=r"more than 1000 points \(\d+ of them on the outline") as refused:
        sheet_mesh(pin_sensor(), size_mm=2.87)  # no other test has this mesh, which a worker would have kept
    assert "larger elements" in refused.value.remedy


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
