import hashlib
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.domain import NumericsError, RefusedError
from cbsr_qa.domain.sensor import Mesh, SensorType
from cbsr_qa.eit.mesh import triangulate
from cbsr_qa.eit.mesh.sheet import image_mesh, sheet_mesh
from cbsr_qa.eit.mesh.triangulate import smallest_angle_deg

CASES = {
    "disc-100mm": ("pin", {}, 3.0),
    "disc-100mm-fine": ("pin", {}, 2.0),
    "disc-150mm": ("pin", {"radius_mm": 75.0}, 4.5),
    "eight-pins-clockwise": ("pin", {"count": 8, "first_angle_deg": 90.0, "counterclockwise": False}, 5.0),
    "arcs": ("arc", {}, 0.08),
    "arcs-clockwise": ("arc", {"first_angle_deg": 33.0, "counterclockwise": False}, 0.06),
    "tank-32": ("arc", {"radius_mm": 140.0, "count": 32, "half_width_rad": 0.03}, 10.0),
}


@pytest.fixture(scope="module", params=CASES, ids=list(CASES))
def case(request: pytest.FixtureRequest, pin_sensor, arc_sensor) -> tuple[SensorType, Mesh]:
    kind, options, size_mm = CASES[request.param]
    sensor = {"pin": pin_sensor, "arc": arc_sensor}[kind](**options)
    return sensor, sheet_mesh(sensor, size_mm=size_mm)


def edges_with_counts(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    pairs = np.sort(np.vstack([mesh.elements[:, [0, 1]], mesh.elements[:, [1, 2]], mesh.elements[:, [2, 0]]]), axis=1)
    return np.unique(pairs, axis=0, return_counts=True)


def test_no_element_is_thin(case):
    _, mesh = case
    angles = smallest_angle_deg(mesh.nodes_mm, mesh.elements)
    assert angles.min() > 20
    assert np.median(angles) > 42


def test_mesh_is_one_sheet_with_a_hole_per_pin(case):
    sensor, mesh = case
    edges, counts = edges_with_counts(mesh)
    assert set(counts) == {1, 2}
    holes = sensor.electrodes.count if sensor.electrodes.kind == "pin" else 0
    assert len(mesh.nodes_mm) - len(edges) + len(mesh.elements) == 1 - holes
    assert len(np.unique(mesh.elements)) == len(mesh.nodes_mm)


def test_area_is_the_sheets_less_the_pins_and_chords(case):
    sensor, mesh = case
    pin_radius = sensor.electrodes.width_mm / 2 if sensor.electrodes.kind == "pin" else 0.0
    exact = np.pi * (sensor.radius_mm**2 - sensor.electrodes.count * pin_radius**2)
    assert mesh.areas_mm2.sum() == pytest.approx(exact, rel=2e-3)


def test_electrodes_are_on_the_boundary_at_their_places(case):
    sensor, mesh = case
    edges, counts = edges_with_counts(mesh)
    boundary = {tuple(edge) for edge in edges[counts == 1]}
    layout = sensor.electrodes
    outline = np.pi * layout.width_mm if layout.kind == "pin" else layout.width_mm
    assert len(mesh.electrode_edges) == layout.count
    for centre, electrode in zip(layout.positions_mm(), mesh.electrode_edges, strict=True):
        assert len(electrode) >= (12 if layout.kind == "pin" else 10)
        assert {tuple(sorted(edge)) for edge in electrode} <= boundary
        along = mesh.nodes_mm[electrode[:, 1]] - mesh.nodes_mm[electrode[:, 0]]
        length = np.hypot(along[:, 0], along[:, 1])
        assert length.sum() == pytest.approx(outline, rel=0.012)
        middle = mesh.nodes_mm[electrode].mean(axis=1)
        assert np.allclose(length @ middle / length.sum(), centre, atol=2e-3 * sensor.radius_mm)


def test_electrodes_are_alike_to_rounding(case):
    sensor, mesh = case
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


@pytest.mark.parametrize("size_mm", [3.0, 4.5])
def test_image_elements_are_near_uniform(pin_sensor, size_mm):
    sensor = pin_sensor(radius_mm=50 * size_mm / 3)
    mesh = image_mesh(sensor, size_mm=size_mm)
    equilateral = np.sqrt(3) / 4 * size_mm**2
    assert 1500 < len(mesh.elements) < 2500
    assert mesh.electrode_edges == ()
    assert np.median(mesh.areas_mm2) == pytest.approx(equilateral, rel=0.05)
    assert mesh.areas_mm2.max() < 2.2 * mesh.areas_mm2.min()
    assert mesh.areas_mm2.sum() == pytest.approx(np.pi * sensor.radius_mm**2, rel=1e-3)
    assert smallest_angle_deg(mesh.nodes_mm, mesh.elements).min() > 30


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
        sheet_mesh(pin_sensor(), size_mm=3.0)
    assert "larger elements" in refused.value.remedy
