"""Meshes and protocols of pyEIT in ours: the same readings in the same order, and refusals that name the row."""

from types import SimpleNamespace

import numpy as np
import pytest
from disc_meshes import disc_mesh

from benchmarks.reference_solutions import point_transfer_impedance
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.sensor.patterns import adjacent_pattern, list_pairs
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet
from cbsr_qa.eit.forward.model import ForwardModel, point_model
from cbsr_qa.eit.mesh.pyeit import import_pyeit_mesh, import_pyeit_protocol
from cbsr_qa.testing.numerics import convergence_order

_COUNT = 16


def pyeit_mesh(rings, count=_COUNT):
    """A unit disc in the form of pyEIT 1.2.4: three coordinates, triangles either way round, electrodes as a column.

    Its first node belongs to no triangle, as in meshes that were cut.
    """
    disc = disc_mesh(1.0, rings=rings, spokes=6 * count)
    element = 1 + disc.elements.astype(np.int32)
    element[::2] = element[::2, ::-1]
    node = np.vstack([[0.1, 0.2, 0.0], np.column_stack([disc.nodes_mm, np.zeros(len(disc.nodes_mm))])])
    el_pos = len(node) - 6 * count + 6 * np.arange(count)
    return {"node": node, "element": element, "perm": 1.0, "el_pos": el_pos[:, None]}


def pyeit_protocol(count=_COUNT, *, apart=1, rotated=False):
    """Adjacent measurement as ``pyeit.eit.protocol.create`` of 1.2.4 lists it: no reading at a driven electrode."""
    ex_mat = np.array([[k, (k + apart) % count] for k in range(count)])
    meas_mat, keep_ba = [], []
    for source, sink in ex_mat:
        minus = ((source if rotated else 0) + np.arange(count)) % count
        pairs = np.column_stack([(minus + 1) % count, minus])
        keep = ~np.isin(pairs, [source, sink]).any(axis=1)
        keep_ba.append(keep)
        meas_mat.append(pairs[keep])
    return SimpleNamespace(ex_mat=ex_mat, meas_mat=np.array(meas_mat), keep_ba=np.concatenate(keep_ba))


def exact_readings(protocol):
    """Readings of point electrodes without a mesh, each by its own row of the protocol."""
    count = int(protocol.ex_mat.max()) + 1
    impedance = point_transfer_impedance(ConcentricSheet(1.0, 1.0), 2 * np.pi * np.arange(count) / count)
    return np.array(
        [
            impedance[plus, source] - impedance[plus, sink] - impedance[minus, source] + impedance[minus, sink]
            for (source, sink), pairs in zip(protocol.ex_mat, protocol.meas_mat, strict=True)
            for plus, minus in pairs[:, :2]
        ]
    )


def readings_on(mesh, protocol):
    sheet, read = import_pyeit_mesh(mesh), import_pyeit_protocol(protocol, len(mesh["el_pos"]))
    model = point_model(sheet.mesh, sheet.electrode_nodes, read.pattern, sheet.conductance)
    return read.list_readings(model.voltages())


def relative_error(found, exact):
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("protocol", [pyeit_protocol(), pyeit_protocol(apart=3), pyeit_protocol(rotated=True)])
def test_readings_come_in_its_order_with_its_signs(protocol):
    assert relative_error(readings_on(pyeit_mesh(12), protocol), exact_readings(protocol)) < 0.02


def test_readings_converge_to_the_exact_ones_of_points():
    rings = (8, 16, 32)
    exact = exact_readings(pyeit_protocol())
    errors = [relative_error(readings_on(refined_disc(n), pyeit_protocol()), exact) for n in rings]
    assert errors[-1] < 2e-3
    assert convergence_order(errors, [1 / n for n in rings]) > 1.7


def refined_disc(rings):
    """Rings and spokes refined together, unlike those of :func:`pyeit_mesh`."""
    disc = disc_mesh(1.0, rings=rings, spokes=6 * rings)
    first = len(disc.nodes_mm) - 6 * rings
    el_pos = first + 6 * rings // _COUNT * np.arange(_COUNT)
    return {"node": disc.nodes_mm, "element": disc.elements, "el_pos": el_pos}


def test_conductance_of_elements_goes_with_them():
    """Twice the conductance halves readings; of one half of the sheet alone it does not."""
    mesh = pyeit_mesh(6)
    plain, doubled = (readings_on({**mesh, "perm": perm}, pyeit_protocol()) for perm in (1, 2.0))
    np.testing.assert_allclose(doubled, plain / 2, rtol=1e-12)
    right = mesh["node"][mesh["element"]].mean(axis=1)[:, 0] > 0
    half = import_pyeit_mesh({**mesh, "perm": 1.0 + right})
    np.testing.assert_array_equal(half.conductance == 2, half.mesh.centroids_mm[:, 0] > 0)


def test_arranged_readings_are_frames_of_the_pattern_with_nothing_where_nothing_was_measured():
    read = import_pyeit_protocol(pyeit_protocol(), _COUNT)
    assert read.pattern.drive == list_pairs("adjacent", _COUNT)
    assert read.pattern.measure == tuple((plus, minus) for minus, plus in list_pairs("adjacent", _COUNT))
    np.testing.assert_array_equal(read.used, adjacent_pattern(_COUNT).usable())
    rows = np.random.default_rng(3).standard_normal((5, 208))
    frames = read.arrange(rows)
    assert frames.shape == (5, 16, 16)
    np.testing.assert_array_equal(np.isfinite(frames), np.broadcast_to(read.used, frames.shape))
    np.testing.assert_array_equal(read.list_readings(frames), rows)


def test_rows_of_every_reading_are_cut_by_keep_ba():
    read = import_pyeit_protocol(pyeit_protocol(), _COUNT)
    every = np.random.default_rng(4).standard_normal((2, 256))
    np.testing.assert_array_equal(read.arrange(every), read.arrange(every[:, read.kept]))


@pytest.mark.parametrize("flat", [False, True])
def test_the_third_column_of_later_versions_is_the_drive(flat):
    two = pyeit_protocol()
    numbered = np.concatenate([two.meas_mat, np.repeat(np.arange(16), 13).reshape(16, 13, 1)], axis=2)
    three = {"ex_mat": two.ex_mat, "meas_mat": numbered.reshape(-1, 3) if flat else numbered}
    one, other = import_pyeit_protocol(two, 16), import_pyeit_protocol(three, 16)
    assert one.pattern == other.pattern
    np.testing.assert_array_equal([one.drive, one.measure], [other.drive, other.measure])
    assert other.kept is None


def test_drives_may_have_different_numbers_of_readings_in_the_flat_form():
    given = {"ex_mat": [[0, 1], [1, 2]], "meas_mat": [[3, 2, 0], [4, 3, 0], [0, 4, 1]]}
    read = import_pyeit_protocol(given, 5)
    assert [
        (read.pattern.drive[d], read.pattern.measure[m]) for d, m in zip(read.drive, read.measure, strict=True)
    ] == [
        ((0, 1), (3, 2)),
        ((0, 1), (4, 3)),
        ((1, 2), (0, 4)),
    ]


def test_electrodes_made_wide_read_nearly_as_points_and_ever_nearer_on_finer_meshes():
    protocol = pyeit_protocol()
    off = []
    for rings, spokes in ((8, 96), (16, 192)):
        disc = disc_mesh(1.0, rings=rings, spokes=spokes)
        el_pos = len(disc.nodes_mm) - spokes + spokes // _COUNT * np.arange(_COUNT)
        sheet = import_pyeit_mesh({"node": disc.nodes_mm, "element": disc.elements, "el_pos": el_pos})
        read = import_pyeit_protocol(protocol, _COUNT)
        wide = sheet.widen_electrodes()
        assert [len(edges) for edges in wide.electrode_edges] == [2] * _COUNT
        model = ForwardModel(wide, read.pattern, sheet.conductance, np.full(_COUNT, 0.01))
        off.append(relative_error(read.list_readings(model.voltages()), exact_readings(protocol)))
    assert off[1] < 0.6 * off[0] < 0.03


def test_neighbours_on_the_boundary_cannot_be_made_wide():
    sheet = import_pyeit_mesh({**pyeit_mesh(4), "el_pos": np.array([300, 301, 310])})
    with pytest.raises(CbsrError, match="electrodes 0 and 1 are neighbours on the mesh's boundary"):
        sheet.widen_electrodes()


@pytest.mark.rest
def test_pyeit_itself_solves_the_same_on_its_own_mesh():
    pytest.importorskip("pyeit", reason="pyEIT is an extra")
    from benchmarks.peers import peer

    other = peer(0.1)
    sheet, read = import_pyeit_mesh(other.mesh), import_pyeit_protocol(other.protocol, 16)
    model = point_model(sheet.mesh, sheet.electrode_nodes, read.pattern, sheet.conductance)
    np.testing.assert_allclose(read.list_readings(model.voltages()), other.readings(), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(other.protocol.meas_mat, pyeit_protocol().meas_mat)
    np.testing.assert_array_equal(other.protocol.keep_ba, pyeit_protocol().keep_ba)


_INNER = 5


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"node": None}, "node"),
        ({"node": np.zeros((4, 4))}, r"nodes of shape \(4, 4\)"),
        ({"element": np.zeros((5, 4), dtype=int)}, "element has 4 columns: the mesh is made of tetrahedra"),
        ({"element": np.full((2, 3), 10**6)}, "element 0 names nodes"),
        ({"element": np.ones((2, 3)) / 2}, "elements of shape"),
        ({"el_pos": np.full((16, 2), 3)}, r"el_pos of shape \(16, 2\)"),
        ({"el_pos": [10**6, 400, 401]}, r"el_pos: electrode 0 names node 1000000; there are nodes 0 to"),
        ({"el_pos": [-1, 400, 401]}, "el_pos: electrode 0 names node -1"),
        (
            {"el_pos": [300, _INNER, 301]},
            rf"el_pos: electrode 1 is node {_INNER}, which is not on the mesh's boundary",
        ),
        ({"el_pos": [300, 0, 301]}, "el_pos: electrode 1 is node 0, which is not on the mesh's boundary"),
        ({"el_pos": [300, 301, 300]}, "el_pos: electrode 2 is node 300, as is an earlier one"),
        ({"perm": np.ones(7)}, r"perm has shape \(7,\); the mesh has"),
        ({"perm": 0.0}, "perm of element 0 .* is 0"),
        ({"perm": np.nan}, "perm of element 0 .* is nan"),
        ({"perm": 1 + 1j}, "perm are of type complex128"),
    ],
)
def test_what_is_no_mesh_of_a_sheet_is_refused(changed, said):
    given = {**pyeit_mesh(4), **changed}
    with pytest.raises(CbsrError, match=said):
        import_pyeit_mesh({name: value for name, value in given.items() if value is not None})


_EX, _MEAS = pyeit_protocol().ex_mat, pyeit_protocol().meas_mat


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"meas_mat": None}, "without meas_mat is no mesh or protocol of pyEIT"),
        ({"ex_mat": np.arange(16)}, r"ex_mat of shape \(16,\)"),
        ({"ex_mat": _EX + 1}, r"pair 15 \(15, 16\) of the drive pattern names electrode 16; allowed: 0 to 15"),
        ({"ex_mat": _EX * [1, 0] + _EX[:, :1] * [0, 1]}, "pairs electrode 0 with itself"),
        ({"meas_mat": _MEAS[:15]}, r"meas_mat has shape \(15, 13, 2\) .*; for 16 drives it is \(16, k, 2\)"),
        ({"meas_mat": _MEAS.reshape(-1, 2)}, r"meas_mat has shape \(208, 2\)"),
        ({"meas_mat": _MEAS.astype(str)}, "meas_mat has shape"),
        ({"meas_mat": _MEAS + 3}, "of the measure pattern names electrode"),
        ({"meas_mat": [[3, 2, 16]], "keep_ba": None}, "meas_mat: reading 0 names drive 16; there are drives 0 to 15"),
        (
            {"meas_mat": np.zeros((16, 1, 3)), "keep_ba": None},
            "reading 1 is in the block of drive 1, and names drive 0",
        ),
        ({"keep_ba": np.ones(256, dtype=bool)}, r"keep_ba of shape \(256,\) .* does not keep the 208 readings"),
        ({"keep_ba": np.ones(208)}, "keep_ba of shape .* type float64"),
    ],
)
def test_what_is_no_protocol_is_refused(changed, said):
    given = {**vars(pyeit_protocol()), **changed}
    with pytest.raises(CbsrError, match=said):
        import_pyeit_protocol({name: value for name, value in given.items() if value is not None}, 16)


@pytest.mark.parametrize("readings", [np.zeros(207), np.zeros((3, 16, 16)), 1.0])
def test_readings_of_another_length_do_not_fit(readings):
    with pytest.raises(CbsrError, match="do not fit the protocol, which has 208, or 256 with unused ones"):
        import_pyeit_protocol(pyeit_protocol(), 16).arrange(readings)
