"""Mesh files: our own ``.npz`` and, if meshio is installed, its formats; sensor types made from them."""

import io
import os
import re
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import CbsrError, NumericsError
from cbsr_qa.domain.geometry.outlines import Polygon, thin_ring
from cbsr_qa.domain.geometry.polygons import inside_polygon, shoelace_area
from cbsr_qa.domain.numbers import Indices
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, PlacedElectrodes
from cbsr_qa.domain.sensor.mesh import Mesh, edge_lists, mesh_arrays, mesh_of_arrays
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import GivenMesh, Response, SensorType
from cbsr_qa.eit.mesh.imported import ElectrodeGiven, import_mesh
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.foreign import open_foreign
from cbsr_qa.system.untrusted import largest_content, read_untrusted

#: Largest size of a mesh file; files that claim more are refused before memory is allocated.
LARGEST_BYTES: Final = 200_000_000
#: Name of a group of lines that represents an electrode, with its number.
_ELECTRODE: Final = re.compile(r"electrode[-_ ]?(\d+)", re.IGNORECASE)


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh as ``.npz``: arrays by the names of :func:`cbsr_qa.domain.sensor.mesh.mesh_arrays`.

    NumericsError if the file cannot be written.
    """
    remedy = "choose an existing, writable folder"
    with writing(path, refusal=NumericsError, remedy=remedy), write_atomically(path) as file:
        arrays: dict[str, Any] = mesh_arrays(mesh)
        np.savez_compressed(file, **arrays)


def read_mesh(path: Path, electrodes: Sequence[ElectrodeGiven] | None = None, *, fix: bool = False) -> Mesh:
    """Read a mesh and check it as :func:`cbsr_qa.eit.mesh.imported.import_mesh` does.

    Parameters
    ----------
    path : ``.npz`` with ``nodes_mm`` and ``elements`` (from 0), or any other format for meshio [mm].
    electrodes : electrodes, described as there; by default ``electrode_edges`` and ``electrode_edge_counts`` of an
        ``.npz``, groups of lines called "electrode 0", "electrode 1" and so on of another.
    fix : reverse clockwise elements and leave out unused nodes.

    Raises
    ------
    NumericsError
        If the file is missing or not a mesh, takes more than the limits of
        :func:`~cbsr_qa.system.untrusted.read_untrusted`, meshio is needed and not installed, or the mesh is refused.
    """
    reader = partial(_read, path, electrodes, fix=fix)
    if path.suffix == ".npz":
        return read_untrusted(path, reader, refusal=NumericsError)
    _meshio(path.suffix)
    # numpy.fromfile duplicates the file that meshio has open
    return read_untrusted(path, reader, refusal=NumericsError, open_files=2, modules=("meshio",))


def _read(path: Path, electrodes: Sequence[ElectrodeGiven] | None, *, fix: bool) -> Mesh:
    try:
        with open_foreign(path, LARGEST_BYTES) as stream:
            if path.suffix == ".npz":
                return _check_arrays(_npz(stream), electrodes, fix=fix)
        nodes, elements, named = _read_with_meshio(path, _meshio(path.suffix))
        return import_mesh(nodes, elements, named if electrodes is None else electrodes, fix=fix)
    except FileNotFoundError as error:
        raise NumericsError(f"there is no mesh file {path}", remedy="check its name and folder") from error
    except OSError as error:
        raise NumericsError(
            f"{path} cannot be read: {error.strerror or error}", remedy="give the file of a mesh"
        ) from error
    except CbsrError as error:
        raise NumericsError(f"{path.name}: {error.reason}", remedy=error.remedy) from error


def _npz(stream: BinaryIO) -> dict[str, NDArray[Any]]:
    remedy = "write it again, with write_mesh or numpy.savez"
    most_bytes = largest_content(os.fstat(stream.fileno()).st_size)
    try:
        with zipfile.ZipFile(stream) as archive:
            unpacked_bytes = sum(member.file_size for member in archive.infolist())
        if unpacked_bytes > most_bytes:
            raise NumericsError(
                f"it unpacks to {unpacked_bytes} bytes; at most {most_bytes} are allowed for its size", remedy=remedy
            )
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError, zipfile.BadZipFile) as error:
        raise NumericsError("it is damaged, or not an .npz file of numbers", remedy=remedy) from error


def _check_arrays(
    arrays: Mapping[str, NDArray[Any]], electrodes: Sequence[ElectrodeGiven] | None, *, fix: bool
) -> Mesh:
    missing_arrays = [name for name in ("nodes_mm", "elements") if name not in arrays]
    if missing_arrays:
        raise NumericsError(
            f"it has no array {missing_arrays[0]}",
            remedy="write it with write_mesh, or with arrays nodes_mm and elements",
        )
    if electrodes is not None or "electrode_edges" not in arrays:
        return import_mesh(arrays["nodes_mm"], arrays["elements"], electrodes or (), fix=fix)
    mesh = import_mesh(arrays["nodes_mm"], arrays["elements"], edge_lists(arrays, "electrode"), fix=fix)
    if len(mesh.nodes_mm) != len(arrays["nodes_mm"]) or "arc_edges" not in arrays:
        return mesh  # arcs are dropped with left-out nodes
    return mesh_of_arrays({**arrays, **mesh_arrays(mesh), **{k: arrays[k] for k in arrays if k.startswith("arc_")}})


def _meshio(suffix: str) -> Any:
    """Import meshio; NumericsError if it is not installed."""
    try:
        return import_module("meshio")
    except ImportError as error:
        raise NumericsError(
            f"files of type {suffix!r} are read by meshio, which is not installed",
            remedy="install meshio, or write the mesh as .npz with arrays nodes_mm and elements",
        ) from error


def _read_with_meshio(path: Path, meshio: Any) -> tuple[NDArray[Any], NDArray[Any], list[ElectrodeGiven]]:
    printed = io.StringIO()
    try:
        with redirect_stdout(printed), redirect_stderr(printed):
            content = meshio.read(path)
    # meshio raises various exceptions; for some formats it prints the reason and exits.
    except (Exception, SystemExit) as error:
        why = " ".join((printed.getvalue() or str(error)).split())
        raise NumericsError(f"meshio cannot read it: {why[:200]}") from error
    triangles = content.cells_dict.get("triangle")
    if triangles is None:
        kinds = ", ".join(sorted(content.cells_dict)) or "nothing"
        raise NumericsError(f"it holds {kinds} and no triangles", remedy="mesh the sheet with triangles")
    return content.points, triangles, _find_electrode_lines(content)


def _find_electrode_lines(content: Any) -> list[ElectrodeGiven]:
    """Groups of lines named as electrodes, in the order of their numbers."""
    lines = content.cells_dict.get("line")
    groups: dict[int, NDArray[Any]] = {}
    for name, members in content.cell_sets_dict.items():
        called = _ELECTRODE.fullmatch(str(name))
        if called and lines is not None and "line" in members:
            groups[int(called[1])] = lines[members["line"]]
    physical = content.cell_data_dict.get("gmsh:physical", {}).get("line")
    for name, (tag, dimension) in content.field_data.items():
        called = _ELECTRODE.fullmatch(str(name))
        if called and lines is not None and physical is not None and dimension == 1:
            groups.setdefault(int(called[1]), lines[physical == tag])
    return [groups[number] for number in sorted(groups)]


#: A sheet's outline follows its mesh's edge within this share of the radius.
_OUTLINE: Final = 1e-3


def mesh_sensor(
    name: str,
    mesh: Mesh,
    pattern: DrivePattern,
    *,
    thickness_mm: float,
    response: Response = Response.AUTO,
) -> SensorType:
    """Sensor type on a mesh that carries electrodes: with the mesh's outline, and this mesh in its forward model.

    Raises
    ------
    NumericsError
        If the mesh carries no electrodes, or fewer than three.
    RefusedError
        If the pattern has another number of electrodes, or the outline is not allowed for a sheet.
    """
    if len(mesh.electrode_edges) < 3:
        raise NumericsError(
            f"the mesh carries {len(mesh.electrode_edges)} electrodes; a sensor has at least 3",
            remedy="give import_mesh its electrodes",
        )
    ring = outer_ring(mesh)
    # The furthest node from the middle is a corner, if there are corners.
    middle = mesh.nodes_mm[ring].mean(axis=0)
    ring = np.roll(ring, -int(np.hypot(*(mesh.nodes_mm[ring] - middle).T).argmax()))
    corners = thin_ring(mesh.nodes_mm[ring], _OUTLINE * float(np.sqrt(mesh.areas_mm2.sum() / np.pi)))
    polygon = Polygon(tuple((x, y) for x, y in corners.tolist()))
    on_edge = np.zeros(len(mesh.nodes_mm), dtype=np.bool_)
    on_edge[ring] = True
    kind = ElectrodeKind.ARC if all(on_edge[edges].all() for edges in mesh.electrode_edges) else ElectrodeKind.PIN
    middles, lengths = [], []
    for edges in mesh.electrode_edges:
        ends = mesh.nodes_mm[edges]
        edge_lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
        x, y = (edge_lengths @ ends.mean(axis=1) / edge_lengths.sum()).tolist()
        middles.append((x, y))
        lengths.append(float(edge_lengths.sum()))
    width = float(np.mean(lengths)) / (1 if kind is ElectrodeKind.ARC else np.pi)
    electrodes = PlacedElectrodes(kind, tuple(middles), width)
    return SensorType(
        name, polygon.radius_mm, thickness_mm, electrodes, pattern, response, polygon, GivenMesh.from_mesh(mesh)
    )


def outer_ring(mesh: Mesh) -> Indices:
    """Nodes of the outer boundary, counterclockwise: the closed line of the largest area."""
    return max(_rings(mesh), key=lambda ring: shoelace_area(mesh.nodes_mm[ring]))


def leave_out_holes(image: Mesh, sheet: Mesh) -> Mesh:
    """Leave out elements of an image's mesh that lie in a hole of the sheet's, with all their corners."""
    is_inside = np.zeros(len(image.elements), dtype=np.bool_)
    for ring in _rings(sheet):
        corners = sheet.nodes_mm[ring]
        if shoelace_area(corners) < 0:
            nodes = inside_polygon(image.nodes_mm, corners)
            is_inside |= nodes[image.elements].all(axis=1) & inside_polygon(image.centroids_mm, corners)
    used_nodes, elements = np.unique(image.elements[~is_inside], return_inverse=True)
    return Mesh(image.nodes_mm[used_nodes], elements.reshape(-1, 3).astype(np.int64))


def _rings(mesh: Mesh) -> list[Indices]:
    """Closed lines of the boundary, with the sheet to their left."""
    counts = np.bincount(mesh.element_edges.ravel(), minlength=len(mesh.edges))
    element, side = np.nonzero(counts[mesh.element_edges] == 1)
    start, end = mesh.elements[element, side], mesh.elements[element, (side + 1) % 3]
    following: dict[int, list[int]] = {}
    for a, b in zip(start.tolist(), end.tolist(), strict=True):
        following.setdefault(a, []).append(b)
    rings = []
    while following:
        ring = [next(iter(following))]
        while ring[-1] in following:
            ends = following[ring[-1]]
            ring.append(ends.pop())
            if not ends:
                del following[ring[-2]]
        rings.append(np.array(ring[:-1], dtype=np.int64))
    return rings
