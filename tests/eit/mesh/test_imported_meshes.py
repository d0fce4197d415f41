"""Meshes made elsewhere: what is wrong with one is said by name, and what is right is used as it is."""

import json
import pickle
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import Delaunay

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.config.merging import canonical_json
from cbsr_qa.domain.errors import ConfigError, NumericsError, RefusedError
from cbsr_qa.domain.geometry.outlines import Polygon
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, PlacedElectrodes
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import polygon_sensor
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.mesh.files import mesh_sensor, read_mesh, write_mesh
from cbsr_qa.eit.mesh.imported import ElectrodeAt, import_mesh
from cbsr_qa.eit.mesh.sheet import image_mesh, sheet_mesh
from cbsr_qa.system.fork_server import obtain_fork_server

#: On the edge of a sheet of 90 mm by 60 mm, counterclockwise.
PLACES = (
    [(x, -30.0) for x in (-30, -10, 10, 30)] + [(45.0, 0.0)] + [(x, 30.0) for x in (30, 10, -10, -30)] + [(-45.0, 0)]
)


@cache
def grid():
    """Nodes and triangles of a rectangle, as any mesh generator might give them."""
    x, y = np.meshgrid(np.arange(-45, 46, 2.5), np.arange(-30, 31, 2.5))
    nodes = np.column_stack([x.ravel(), y.ravel()])
    triangles = Delaunay(nodes).simplices.astype(np.int64)
    corners = nodes[triangles]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    turned = one[:, 0] * other[:, 1] < one[:, 1] * other[:, 0]
    triangles[turned] = triangles[turned][:, ::-1]
    return nodes, triangles


@cache
def made_here(kind):
    """A sensor of ours, and the mesh we make for it."""
    outline = Polygon(((-45, -30), (45, -30), (45, 30), (-45, 30)))
    places = tuple((0.9 * x, 0.9 * y) if kind is ElectrodeKind.PIN else (float(x), float(y)) for x, y in PLACES)
    electrodes = PlacedElectrodes(kind, places, 2.0 if kind is ElectrodeKind.PIN else 6.0)
    sensor = polygon_sensor("ours", outline, 4.0, electrodes, adjacent_pattern(10))
    return sensor, sheet_mesh(sensor, size_mm=3.0)


def same_edges(one, other):
    return np.array_equal(np.unique(np.sort(one, axis=1), axis=0), np.unique(np.sort(other, axis=1), axis=0))


@pytest.mark.parametrize("kind", ElectrodeKind)
def test_electrodes_are_found_by_edges_by_nodes_and_by_place(kind):
    sensor, mesh = made_here(kind)
    width = sensor.electrodes.width_mm
    ways = {
        "edges": list(mesh.electrode_edges),
        "nodes": [np.unique(edges)[::-1] for edges in mesh.electrode_edges],
        "places": [ElectrodeAt(x, y, width) for x, y in sensor.electrodes.places_mm],
    }
    for electrodes in ways.values():
        found = import_mesh(mesh.nodes_mm, mesh.elements, electrodes).electrode_edges
        assert all(same_edges(*pair) for pair in zip(found, mesh.electrode_edges, strict=True))


def test_a_mesh_counted_from_one_in_space_and_clockwise_is_the_same_mesh():
    _, mesh = made_here(ElectrodeKind.ARC)
    idle = np.vstack([mesh.nodes_mm, [[3.0, 4.0]]])
    flat = np.column_stack([idle, np.full(len(idle), 7.0)])
    nodes = [np.unique(edges) + 1 for edges in mesh.electrode_edges]
    found = import_mesh(flat.tolist(), (mesh.elements[:, ::-1] + 1).tolist(), nodes, first=1, fix=True)
    np.testing.assert_array_equal(found.nodes_mm, mesh.nodes_mm)
    assert set(map(frozenset, found.elements.tolist())) == set(map(frozenset, mesh.elements.tolist()))
    assert all(same_edges(*pair) for pair in zip(found.electrode_edges, mesh.electrode_edges, strict=True))


def test_the_same_mesh_has_the_same_voltages_wherever_it_comes_from(tmp_path):
    sensor, mesh = made_here(ElectrodeKind.PIN)
    write_mesh(tmp_path / "own.npz", mesh)
    back = read_mesh(tmp_path / "own.npz")
    for order in (1, 2):  # the second follows the pins' arcs
        one, other = (
            ForwardModel(m, sensor.pattern, np.ones(len(m.elements)), np.full(10, 0.3), order=order).voltages()
            for m in (mesh, back)
        )
        np.testing.assert_array_equal(one, other)


@pytest.mark.rest
@pytest.mark.parametrize("kind", ElectrodeKind)
def test_a_sensor_of_a_mesh_is_imaged_like_the_sensor_the_mesh_was_made_for(kind):
    sensor, mesh = made_here(kind)
    given = mesh_sensor("given", mesh, sensor.pattern, thickness_mm=4.0)
    assert sheet_mesh(given, size_mm=1.0) is mesh
    assert set(np.round(given.outline.corners_mm, 6).ravel().tolist()) == {-45.0, -30.0, 30.0, 45.0}
    assert given.electrodes.kind is kind
    np.testing.assert_allclose(given.electrodes.positions_mm(), sensor.electrodes.positions_mm(), atol=1e-6)
    assert given.electrodes.width_mm == pytest.approx(sensor.electrodes.width_mm, rel=0.02)
    one, other = imaging_problem(sensor), imaging_problem(given)
    np.testing.assert_allclose(one.reference, other.reference, rtol=0.02, atol=2e-3)
    assert other.mesh.areas_mm2.sum() == pytest.approx(5400, rel=1e-6)


def test_two_meshes_are_one_sensor_only_where_everything_is_the_same():
    sensor, mesh = made_here(ElectrodeKind.ARC)
    again = mesh_sensor("given", replace(mesh), sensor.pattern, thickness_mm=4.0)
    assert again == mesh_sensor("given", mesh, sensor.pattern, thickness_mm=4.0)
    assert hash(again) == hash(mesh_sensor("given", mesh, sensor.pattern, thickness_mm=4.0))
    shifted = mesh.nodes_mm.copy()
    shifted[-1] += 1e-6
    assert again != mesh_sensor("given", replace(mesh, nodes_mm=shifted), sensor.pattern, thickness_mm=4.0)


def test_images_leave_out_the_holes_of_a_mesh():
    nodes, triangles = grid()
    hole = (np.abs(nodes[triangles].mean(axis=1) - [20, 0]) < 7.5).all(axis=1)
    mesh = import_mesh(nodes, triangles[~hole], [ElectrodeAt(x, y, 5) for x, y in PLACES], fix=True)
    sensor = mesh_sensor("holed", mesh, adjacent_pattern(10), thickness_mm=4.0)
    image = image_mesh(sensor, size_mm=2.5)
    assert not (np.abs(image.nodes_mm[image.elements] - [20, 0]) < 7.5).all(axis=(1, 2)).any()
    assert 1.0 < image.areas_mm2.sum() / mesh.areas_mm2.sum() < 1.02
    assert len(np.unique(image.elements)) == len(image.nodes_mm)
    assert np.isfinite(imaging_problem(sensor).jacobian).all()


def spoilt(change):
    nodes, triangles = (array.copy() for array in grid())
    return change(nodes, triangles)


MISTAKES = {
    "counted from one": (lambda n, t: (n, t + 1), "names nodes", "say first=1"),
    "not a number": (lambda n, t: (np.where(n == n[3], np.nan, n), t), "has a non-finite position", ""),
    "in space": (lambda n, t: (np.column_stack([n, n[:, 0]]), t), "not at least three places (x, y) in a plane", ""),
    "squares": (lambda n, t: (n, np.hstack([t, t[:, :1]])), "rows of three nodes are needed", ""),
    "fractions": (lambda n, t: (n, t + 0.5), "rows of three nodes are needed, by number", ""),
    "idle node": (
        lambda n, t: (np.vstack([n, [[1.0, 1.1]]]), t),
        "node 925 (one of 1 such) belongs to no",
        "fix=True",
    ),
    "doubled node": (
        lambda n, t: (np.vstack([n, n[t[:1, 0]]]), np.vstack([[[len(n), *t[0, 1:]]], t[1:]])),
        "are at the same place",
        "merge them",
    ),
    "turned": (lambda n, t: (n, np.vstack([t[:1, ::-1], t[1:]])), "element 0 (one of 1 such) is turned", "fix=True"),
    "flat": (
        lambda n, t: (n, np.vstack([[[0, 1, 2]], t])),
        "element 0 (one of 1 such) is flat",
        "mesh the sheet again",
    ),
    "twice": (lambda n, t: (n, np.vstack([t, t[:1]])), "3 elements share the edge", "leave out elements"),
    "two pieces": (
        lambda n, t: (np.vstack([n, n + 200.0]), np.vstack([t, t + len(n)])),
        "falls into 2 pieces that share no edge",
        "share their nodes",
    ),
    "complex": (lambda n, t: (n + 1j, t), "nodes are of type complex128, not real numbers", ""),
    "words": (lambda n, t: (n.astype(str), t), "not real numbers", ""),
    "ragged nodes": (lambda _, t: ([[0.0, 1.0], [2.0]], t), "rows of different lengths", ""),
    "huge": (lambda n, t: (n * 1e150, t), "from its origin; allowed are 1e-09 to 1e", ""),
    "tiny": (lambda n, t: (n * 1e-150, t), "from its origin; allowed are 1e-09 to 1e", ""),
    "ragged elements": (lambda n, _: (n, [[0, 1, 2], [1, 2]]), "elements are rows", ""),
    "infinite elements": (lambda n, _: (n, [[0, 1, np.inf]]), "elements of shape", ""),
    "complex elements": (lambda n, _: (n, [[0, 1, 2j]]), "elements of shape", ""),
    "elements in words": (lambda n, _: (n, [["0", "1", "2"]]), "elements of shape", ""),
    "touching in a node": (
        lambda n, t: (np.vstack([n, [[50, 30], [45, 40]]]), np.vstack([t, [[len(n) - 1, len(n), len(n) + 1]]])),
        "falls into 2 pieces",
        "one piece",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mesh_that_is_none_is_refused_by_name_with_the_remedy(mistake):
    change, reason, remedy = MISTAKES[mistake]
    with pytest.raises(NumericsError) as caught:
        import_mesh(*spoilt(change))
    assert reason in caught.value.reason
    assert remedy in caught.value.remedy


def test_a_node_that_hangs_on_an_edge_is_refused():
    nodes = [[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [0, -2], [2, -2]]
    elements = [[0, 1, 2], [0, 2, 3], [5, 4, 0], [5, 6, 4], [6, 1, 4], [2, 1, 6]]
    with pytest.raises(NumericsError, match=r"node 4 lies on the edge between nodes 0 and 1 without dividing it"):
        import_mesh([*nodes[:6], [3, -2]], elements)


ELECTRODE_MISTAKES = {
    "no nodes": ([[]], "electrode 0 has no nodes or edges", "leave it and its pairs out"),
    "one node": ([[0, 1], [36]], "electrode 1: node 36 has no other beside it", "point_model"),
    "inside": ([[500]], "node 500 is not on the mesh's boundary", "all its nodes"),
    "apart": ([[[0, 5]]], "nodes 0 and 5 are no edge of the mesh's boundary", "rim of a hole"),
    "edge inside": ([[[0, 38]]], "are no edge of the mesh's boundary", "sheet's edge"),
    "not there": ([[0, 5000]], "names nodes 5000", "first=1"),
    "ragged": ([[[0, 1], [1]]], "are rows of different lengths", ""),
    "shared": ([[0, 1], [[1, 0]]], "electrodes 0 and 1 share the edge between nodes 0 and 1", "may not overlap"),
    "elsewhere": ([ElectrodeAt(50, -40, 5)], "electrode 0 at (50, -40) mm is not on the mesh's boundary", "unit of"),
    "in the middle": ([ElectrodeAt(0, 0, 5)], "which is 30 mm away", "move it"),
    "too small": ([ElectrodeAt(-10, -30, 1.0)], "covers 0 mm of the mesh's boundary", "smaller elements"),
}


@pytest.mark.parametrize("mistake", ELECTRODE_MISTAKES)
def test_an_electrode_that_is_none_is_refused_by_name_with_the_remedy(mistake):
    electrodes, reason, remedy = ELECTRODE_MISTAKES[mistake]
    with pytest.raises(NumericsError) as caught:
        import_mesh(*grid(), electrodes)
    assert reason in caught.value.reason
    assert remedy in caught.value.remedy


def test_a_sensor_needs_a_mesh_with_electrodes():
    with pytest.raises(NumericsError, match="carries 0 electrodes"):
        mesh_sensor("bare", import_mesh(*grid()), adjacent_pattern(10), thickness_mm=1.0)


@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"PK\x03\x04rest"])
def test_a_damaged_file_is_refused(tmp_path, content):
    path = tmp_path / "mesh.npz"
    path.write_bytes(content)
    with pytest.raises(NumericsError, match=r"mesh\.npz: it is damaged"):
        read_mesh(path)


def test_a_file_is_never_executed_and_must_hold_the_arrays(tmp_path):
    np.savez(tmp_path / "objects.npz", nodes_mm=np.array([print], dtype=object), elements=np.zeros((1, 3)))
    with pytest.raises(NumericsError, match=r"not an \.npz file of numbers"):
        read_mesh(tmp_path / "objects.npz")
    np.savez(tmp_path / "other.npz", points=np.zeros((3, 2)))
    with pytest.raises(NumericsError, match="has no array nodes_mm") as caught:
        read_mesh(tmp_path / "other.npz")
    assert "write_mesh" in caught.value.remedy
    with pytest.raises(NumericsError, match="there is no mesh file") as caught:
        read_mesh(tmp_path / "absent.npz")
    assert "folder" in caught.value.remedy


@pytest.mark.parametrize(
    ("place", "said"),
    [(np.nan, "mesh node 1 .* finite"), (-np.inf, "finite"), (1e150, "up to 1e"), (1j, "complex128")],
)
def test_a_mesh_has_its_nodes_at_places(place, said):
    nodes = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], place * np.ones(2)])[[0, 3, 1, 2]]
    with pytest.raises(RefusedError, match=said) as caught:
        Mesh(nodes, np.array([[0, 2, 3]]))
    assert caught.value.remedy


#: Stands in for meshio.
MESHIO = """
import pickle, sys
from pathlib import Path
from types import SimpleNamespace

def read(path):
    if path.name == "odd.msh":
        sys.stdout.write("Error: no such thing")
        raise SystemExit(1)
    return SimpleNamespace(**pickle.loads(Path({!r}).read_bytes()))
"""


def test_other_formats_need_meshio_and_take_their_electrodes_from_named_lines(tmp_path, monkeypatch):
    path, odd = tmp_path / "sheet.msh", tmp_path / "odd.msh"
    for each in (path, odd):
        each.write_text("$MeshFormat\n")
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(NumericsError, match="read by meshio, which is not installed"):
        read_mesh(path)

    nodes, triangles = grid()
    lines = np.array([[0, 1], [1, 2], [34, 35], [35, 36]])
    found = {  # as meshio returns a gmsh file with physical groups
        "points": np.column_stack([nodes, np.zeros(len(nodes))]),
        "cells_dict": {"triangle": triangles, "line": lines},
        "cell_sets_dict": {},
        "cell_data_dict": {"gmsh:physical": {"line": np.array([9, 9, 8, 8]), "triangle": np.ones(len(triangles))}},
        "field_data": {"Electrode 1": np.array([9, 1]), "electrode 0": np.array([8, 1]), "sheet": np.array([1, 2])},
    }
    (tmp_path / "found").write_bytes(pickle.dumps(found))
    (tmp_path / "meshio.py").write_text(MESHIO.format(str(tmp_path / "found")))
    obtain_fork_server()  # does not find what stands in for meshio: later tests may need the real one
    monkeypatch.delitem(sys.modules, "meshio")
    monkeypatch.syspath_prepend(tmp_path)
    mesh = read_mesh(path)
    assert [edges.tolist() for edges in mesh.electrode_edges] == [[[34, 35], [35, 36]], [[0, 1], [1, 2]]]
    with pytest.raises(NumericsError, match=r"odd\.msh: meshio cannot read it: Error: no such thing"):
        read_mesh(odd)
    monkeypatch.delitem(sys.modules, "meshio")


def test_what_meshio_writes_is_read(tmp_path):
    meshio = pytest.importorskip("meshio")
    nodes, triangles = grid()
    meshio.write(
        tmp_path / "sheet.vtk", meshio.Mesh(np.column_stack([nodes, 0 * nodes[:, 0]]), [("triangle", triangles)])
    )
    mesh = read_mesh(tmp_path / "sheet.vtk", [ElectrodeAt(x, y, 5) for x, y in PLACES])
    np.testing.assert_array_equal(mesh.elements, triangles)


SENSOR = '[sensor_type]\nname = "own"\nmesh = "{}"\nthickness_mm = 4.0\n{}\n'


def test_a_sensor_type_file_takes_its_mesh_in_by_content(tmp_path):
    _, mesh = made_here(ElectrodeKind.ARC)
    write_mesh(tmp_path / "own.npz", mesh)
    (tmp_path / "own.toml").write_text(SENSOR.format("own.npz", '[pattern]\ndrive = "opposite"'))
    loaded = load_sensor_type(tmp_path / "own.toml")
    assert loaded.value.pattern.shape == (5, 10)
    assert loaded.value.mesh is not None
    np.testing.assert_array_equal(loaded.value.mesh.mesh.nodes_mm, mesh.nodes_mm)
    # Without its files, as a stored run is resumed.
    stored = json.loads(canonical_json(loaded.document.data))
    assert load_sensor_type(stored).value == loaded.value


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("radius_mm = 50.0", "sensor_type.radius_mm does not apply where mesh is given"),
        ('[electrodes]\nkind = "pin"', "electrodes does not apply where mesh is given: the mesh carries them"),
        ("[pattern]\ndrive = [[0, 10]]", "pattern.drive[1] names electrode 10; allowed: 0 to 9"),
    ],
)
def test_what_contradicts_the_mesh_is_refused(tmp_path, more, said):
    write_mesh(tmp_path / "own.npz", made_here(ElectrodeKind.ARC)[1])
    (tmp_path / "own.toml").write_text(SENSOR.format("own.npz", more))
    with pytest.raises(ConfigError) as caught:
        load_sensor_type(tmp_path / "own.toml")
    assert said in str(caught.value)


def test_a_mesh_file_that_cannot_be_used_is_named_with_its_line(tmp_path):
    (tmp_path / "own.toml").write_text(SENSOR.format("absent.npz", ""))
    with pytest.raises(
        ConfigError, match=r"own\.toml: line 3: sensor_type\.mesh: there is no mesh file .*absent\.npz"
    ):
        load_sensor_type(tmp_path / "own.toml")
    write_mesh(tmp_path / "bare.npz", import_mesh(*grid()))
    (tmp_path / "own.toml").write_text(SENSOR.format("bare.npz", ""))
    with pytest.raises(ConfigError, match=r"line 3: sensor_type\.mesh carries fewer than 3 electrodes"):
        load_sensor_type(tmp_path / "own.toml")
