"""Mesh files: our own ``.npz``, and whatever meshio reads where it is installed."""

import io
import re
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import CbsrError, NumericsError
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.mesh_arrays import edge_lists, mesh_arrays, mesh_of_arrays
from cbsr_qa.files import written_whole
from cbsr_qa.forward.imported import ElectrodeGiven, imported_mesh

#: More than any mesh of a sheet holds; a file that claims more is refused before memory is taken for it.
LARGEST_BYTES: Final = 200_000_000
#: Name of a group of lines in a file that stands for an electrode, and its number.
_ELECTRODE: Final = re.compile(r"electrode[-_ ]?(\d+)", re.IGNORECASE)


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh as ``.npz``: arrays by the names of :func:`cbsr_qa.domain.mesh_arrays.mesh_arrays`.

    Raises
    ------
    NumericsError
        If the file cannot be written.
    """
    try:
        with written_whole(path) as file:
            arrays: dict[str, Any] = mesh_arrays(mesh)
            np.savez_compressed(file, **arrays)
    except OSError as error:
        raise NumericsError(
            f"the mesh cannot be written to {path}: {error.strerror or error}",
            remedy="choose a folder that is there and may be written to",
        ) from error


def read_mesh(path: Path, electrodes: Sequence[ElectrodeGiven] | None = None, *, mend: bool = False) -> Mesh:
    """Read a mesh and check it as :func:`cbsr_qa.forward.imported.imported_mesh` does.

    Parameters
    ----------
    path : ``.npz`` with ``nodes_mm`` and ``elements`` (from 0), or any other format for meshio [mm].
    electrodes : as there; by default what the file says: ``electrode_edges`` and ``electrode_edge_counts`` of an
        ``.npz``, groups of lines called "electrode 0", "electrode 1" and so on of another.
    mend : turn clockwise elements and leave out nodes that no element uses.

    Raises
    ------
    NumericsError
        If there is no such file, it is no mesh, meshio is needed and not installed, or the mesh is refused.
    """
    if not path.is_file():
        raise NumericsError(
            f"there is no mesh file {path}", remedy="check its name, and the folder it is looked for in"
        )
    if path.stat().st_size > LARGEST_BYTES:
        raise NumericsError(
            f"{path} has {path.stat().st_size} bytes; a mesh file has at most {LARGEST_BYTES}",
            remedy="mesh the sheet with larger elements",
        )
    try:
        if path.suffix == ".npz":
            return _checked(_npz(path), electrodes, mend=mend)
        nodes, elements, found = _by_meshio(path)
        return imported_mesh(nodes, elements, found if electrodes is None else electrodes, mend=mend)
    except CbsrError as error:
        raise NumericsError(f"{path.name}: {error.reason}", remedy=error.remedy) from error


def _npz(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise NumericsError(
            "it is damaged, or no .npz file of numbers", remedy="write it again, with write_mesh or numpy.savez"
        ) from error


def _checked(arrays: Mapping[str, NDArray[Any]], electrodes: Sequence[ElectrodeGiven] | None, *, mend: bool) -> Mesh:
    missing = [name for name in ("nodes_mm", "elements") if name not in arrays]
    if missing:
        raise NumericsError(
            f"it holds no {missing[0]}", remedy="write it with write_mesh, or with arrays nodes_mm and elements"
        )
    if electrodes is not None or "electrode_edges" not in arrays:
        return imported_mesh(arrays["nodes_mm"], arrays["elements"], electrodes or (), mend=mend)
    mesh = imported_mesh(arrays["nodes_mm"], arrays["elements"], edge_lists(arrays, "electrode"), mend=mend)
    if len(mesh.nodes_mm) != len(arrays["nodes_mm"]) or "arc_edges" not in arrays:
        return mesh  # arcs do not outlive nodes that are left out
    return mesh_of_arrays({**arrays, **mesh_arrays(mesh), **{k: arrays[k] for k in arrays if k.startswith("arc_")}})


def _by_meshio(path: Path) -> tuple[NDArray[Any], NDArray[Any], list[ElectrodeGiven]]:
    try:
        meshio: Any = import_module("meshio")
    except ImportError as error:
        raise NumericsError(
            f"files of type {path.suffix!r} are read by meshio, which is not installed",
            remedy="install meshio, or write the mesh as .npz with arrays nodes_mm and elements",
        ) from error
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            found = meshio.read(path)
    # meshio raises whatever its readers stumble over; on some formats it prints why and leaves the program.
    except (Exception, SystemExit) as error:
        why = " ".join((said.getvalue() or str(error)).split())
        raise NumericsError(f"meshio cannot read it: {why[:200]}") from error
    triangles = found.cells_dict.get("triangle")
    if triangles is None:
        kinds = ", ".join(sorted(found.cells_dict)) or "nothing"
        raise NumericsError(f"it holds no triangles but {kinds}", remedy="mesh the sheet with triangles")
    return found.points, triangles, _named_lines(found)


def _named_lines(found: Any) -> list[ElectrodeGiven]:
    """Groups of lines that are called electrodes, in the order of their numbers."""
    lines = found.cells_dict.get("line")
    groups: dict[int, NDArray[Any]] = {}
    for name, members in found.cell_sets_dict.items():
        called = _ELECTRODE.fullmatch(str(name))
        if called and lines is not None and "line" in members:
            groups[int(called[1])] = lines[members["line"]]
    physical = found.cell_data_dict.get("gmsh:physical", {}).get("line")
    for name, (tag, dimension) in found.field_data.items():
        called = _ELECTRODE.fullmatch(str(name))
        if called and lines is not None and physical is not None and dimension == 1:
            groups.setdefault(int(called[1]), lines[physical == tag])
    return [groups[number] for number in sorted(groups)]
