"""Meshes and protocols of pyEIT, as this engine takes them; pyEIT need not be installed.

pyEIT counts nodes and electrodes from 0, as here. Its electrodes are single nodes of the boundary, its triangles may
go either way round, and its length has no unit: 1 is taken for 1 mm. A reading is v[n] − v[m] for each row (n, m).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices, Mask, array_of, real_numbers
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import DrivePattern, Pair
from cbsr_qa.eit.mesh.imported import import_mesh, whole_numbers

_MISSING: Final = object()


@dataclass(frozen=True, slots=True, eq=False)
class PyeitSheet:
    """A mesh of pyEIT.

    Parameters
    ----------
    mesh : e elements, counterclockwise, without electrodes [mm].
    electrode_nodes : (electrodes,) nodes of the boundary, as
        :func:`~cbsr_qa.eit.forward.model.point_model` takes them.
    conductance : (e,) sheet conductance of the elements, pyEIT's ``perm`` [S].
    """

    mesh: Mesh
    electrode_nodes: Indices
    conductance: Array

    def widen_electrodes(self) -> Mesh:
        """Return the mesh with electrodes for the complete electrode model: the edges on either side of each node.

        Raises
        ------
        NumericsError
            If two electrodes are neighbours on the boundary, and would share an edge.
        """
        outline = self.mesh.outline
        edges = tuple(outline[(outline == node).any(axis=1)] for node in self.electrode_nodes)
        all_edges = np.concatenate(edges)
        number = np.repeat(np.arange(len(edges)), [len(electrode_edges) for electrode_edges in edges])
        _, first, count = np.unique(np.sort(all_edges, axis=1), axis=0, return_index=True, return_counts=True)
        if (count > 1).any():
            ends = set(all_edges[first[np.argmax(count > 1)]].tolist())
            both = [int(k) for k, edge in zip(number, all_edges.tolist(), strict=True) if set(edge) == ends]
            raise NumericsError(
                f"electrodes {both[0]} and {both[1]} are neighbours on the mesh's boundary: they would share an edge",
                remedy="use a finer mesh, or point electrodes (cbsr_qa.eit.forward.model.point_model)",
            )
        return Mesh(self.mesh.nodes_mm, self.mesh.elements, edges)


def import_pyeit_mesh(mesh: object) -> PyeitSheet:
    """Check a mesh of pyEIT, and turn its triangles counterclockwise.

    Parameters
    ----------
    mesh : ``PyEITMesh``, or a dict of the same names: ``node`` (n, 2), or (n, 3) with a constant third coordinate;
        ``element`` (e, 3); ``el_pos`` (electrodes,) or (electrodes, 1); ``perm``, a positive number or (e,) of them,
        1 without one. Nodes that belong to no element are left out, and the others are renumbered.

    Raises
    ------
    NumericsError
        If an array is missing or has another shape, a node or element is refused by
        :func:`~cbsr_qa.eit.mesh.imported.import_mesh`, an electrode is no node, not on the boundary or there twice,
        or a conductance is not positive.
    """
    node, element = _entry(mesh, "node"), _entry(mesh, "element")
    if element.ndim == 2 and element.shape[1] == 4:
        raise NumericsError(
            "element has 4 columns: the mesh is made of tetrahedra, and a sheet of triangles",
            remedy="make a mesh in the plane",
        )
    sheet = import_mesh(node, element, fix=True)
    numbers = _entry(mesh, "el_pos")
    nodes = whole_numbers(numbers[:, 0] if numbers.ndim == 2 and numbers.shape[1] == 1 else numbers, "el_pos", ())
    _check_numbers(nodes, len(node), "el_pos: electrode", "node")
    used_nodes = np.unique(element.astype(np.int64))
    on_boundary = np.isin(nodes, used_nodes[np.unique(sheet.outline)])
    if not on_boundary.all():
        number = int(np.argmin(on_boundary))
        raise NumericsError(
            f"el_pos: electrode {number} is node {nodes[number]}, which is not on the mesh's boundary",
            remedy="name nodes of the sheet's edge, or of the rim of a hole in it",
        )
    _, first_electrodes = np.unique(nodes, return_index=True)
    if len(first_electrodes) < len(nodes):
        number = int(np.setdiff1d(np.arange(len(nodes)), first_electrodes)[0])
        raise NumericsError(
            f"el_pos: electrode {number} is node {nodes[number]}, as is an earlier one",
            remedy="give every electrode its own node",
        )
    return PyeitSheet(sheet, np.searchsorted(used_nodes, nodes), _conductance(mesh, len(sheet.elements)))


def _check_numbers(numbers: Indices, count: int, what: str, named: str) -> None:
    """Refuse numbers (k,) beyond those that there are."""
    bad_indices = np.flatnonzero((numbers < 0) | (numbers >= count))
    if bad_indices.size:
        raise NumericsError(
            f"{what} {bad_indices[0]} names {named} {numbers[bad_indices[0]]}; there are {named}s 0 to {count - 1}",
            remedy=f"count {named}s from 0, as pyEIT does",
        )


def _conductance(mesh: object, count: int) -> Array:
    perm = real_numbers(_entry(mesh, "perm", 1.0), "perm")
    if perm.shape not in ((), (1,), (count,)):
        raise NumericsError(
            f"perm has shape {perm.shape}; the mesh has {count} elements", remedy="give one number, or one each"
        )
    conductance = np.broadcast_to(perm, (count,)).copy()
    bad = np.flatnonzero(~(np.isfinite(conductance) & (conductance > 0)))
    if bad.size:
        raise NumericsError(
            f"perm of element {bad[0]} (one of {bad.size} such) is {conductance[bad[0]]:g}",
            remedy="give positive finite numbers",
        )
    return conductance


@dataclass(frozen=True, slots=True, eq=False)
class PyeitProtocol:
    """A protocol of pyEIT, and where its readings stand in a frame.

    Parameters
    ----------
    pattern : drive pairs in their order; distinct measure pairs in the order of their second electrodes.
    drive, measure : (m,) drive and measure pair of each reading.
    kept : mask that selects these readings from a longer row, pyEIT's ``keep_ba``; None if it has none.
    """

    pattern: DrivePattern
    drive: Indices
    measure: Indices
    kept: Mask | None

    @property
    def used(self) -> Mask:
        """Readings that images are made of: measured, at no driven electrode; (drives, measures)."""
        measured = np.zeros(self.pattern.shape, dtype=np.bool_)
        measured[self.drive, self.measure] = True
        return measured & self.pattern.usable()

    def arrange(self, readings: ArrayLike) -> Array:
        """Arrange rows of readings (…, m) as frames (…, drives, measures), NaN where nothing was measured.

        Rows as long as ``kept`` are cut by it first. NumericsError if they have another length.
        """
        values = real_numbers(readings, "readings")
        count = len(self.drive)
        length = values.shape[-1] if values.ndim else 0
        if self.kept is not None and length == len(self.kept) != count:
            values = values[..., self.kept]
        elif length != count:
            longer = "" if self.kept is None or len(self.kept) == count else f", or {len(self.kept)} with unused ones"
            raise NumericsError(
                f"readings of shape {values.shape} do not fit the protocol, which has {count}{longer}",
                remedy="give one row of readings a frame, in the order of meas_mat",
            )
        frames = np.full((*values.shape[:-1], *self.pattern.shape), np.nan)
        frames[..., self.drive, self.measure] = values
        return frames

    def list_readings(self, frames: Array) -> Array:
        """Return frames (…, drives, measures) as rows of readings (…, m) in pyEIT's order."""
        readings: Array = frames[..., self.drive, self.measure]
        return readings


def import_pyeit_protocol(protocol: object, electrode_count: int) -> PyeitProtocol:
    """Check a protocol of pyEIT.

    Parameters
    ----------
    protocol : ``PyEITProtocol``, or a dict of the same names: ``ex_mat`` (drives, 2) of source and sink; ``meas_mat``
        (drives, k, 2) of plus and minus, or (drives, k, 3) or (m, 3) with the number of the drive in the third column
        (pyEIT after 1.2.4); ``keep_ba``, booleans, if there are any.
    electrode_count : number of electrodes of the mesh.

    Raises
    ------
    NumericsError
        If an array is missing or has another shape, or the third column or ``keep_ba`` contradicts the others.
    RefusedError
        If a pair names an electrode that is not there, or the same one twice.
    """
    drives = whole_numbers(_entry(protocol, "ex_mat"), "ex_mat", (2,))
    measurements = _entry(protocol, "meas_mat")
    if (
        measurements.dtype.kind not in "iuf"
        or measurements.ndim not in (2, 3)
        or measurements.shape[-1] not in (2, 3)
    ):
        raise _shape_error(measurements, len(drives))
    if measurements.ndim == 3:
        if len(measurements) != len(drives):
            raise _shape_error(measurements, len(drives))
        drive = np.repeat(np.arange(len(drives)), measurements.shape[1])
    elif measurements.shape[1] == 3:
        drive = whole_numbers(measurements[:, 2], "meas_mat: drives", ())
        _check_numbers(drive, len(drives), "meas_mat: reading", "drive")
    else:
        raise _shape_error(measurements, len(drives))
    rows = measurements.reshape(-1, measurements.shape[-1])
    if rows.shape[1] == 3 and not np.array_equal(rows[:, 2], drive):
        reading = int(np.argmax(rows[:, 2] != drive))
        raise NumericsError(
            f"meas_mat: reading {reading} is in the block of drive {drive[reading]}, and names drive"
            f" {rows[reading, 2]:g}",
            remedy="give each drive its own block, in the order of ex_mat",
        )
    pairs = whole_numbers(rows[:, :2], "meas_mat", (2,))
    distinct_pairs, measure = np.unique(pairs[:, ::-1], axis=0, return_inverse=True)  # by the second electrode
    pattern = DrivePattern(electrode_count, _as_pairs(drives), _as_pairs(distinct_pairs[:, ::-1]))
    return PyeitProtocol(pattern, drive, measure.reshape(-1), _read_kept_mask(protocol, len(pairs)))


def _shape_error(measured: Array, drives: int) -> NumericsError:
    return NumericsError(
        f"meas_mat has shape {measured.shape} and type {measured.dtype}; for {drives} drives it is ({drives}, k, 2)"
        f" or ({drives}, k, 3), or (m, 3) with the drive in the third column",
        remedy="give whole numbers, a row for each reading",
    )


def _read_kept_mask(protocol: object, count: int) -> Mask | None:
    keep = _entry(protocol, "keep_ba", None)
    if keep.dtype == object and keep.ndim == 0:
        return None
    if keep.dtype.kind != "b" or keep.ndim != 1 or (len(keep) != count and int(keep.sum()) != count):
        raise NumericsError(
            f"keep_ba of shape {keep.shape} and type {keep.dtype} does not keep the {count} readings of meas_mat",
            remedy=f"give booleans, {count} of them true, or leave it out",
        )
    is_kept: Mask = keep
    return is_kept


def _as_pairs(rows: Indices) -> tuple[Pair, ...]:
    return tuple((int(first), int(second)) for first, second in rows)


def _entry(given: object, name: str, default: Any = _MISSING) -> Any:
    """Return an array of a dict, or of an object of pyEIT."""
    value = given.get(name, default) if isinstance(given, Mapping) else getattr(given, name, default)
    if value is _MISSING:
        raise NumericsError(
            f"a {type(given).__name__} without {name} is no mesh or protocol of pyEIT",
            remedy="give pyEIT's object, or a dict with its names",
        )
    return array_of(value, name)
