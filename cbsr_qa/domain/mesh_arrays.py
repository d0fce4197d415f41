"""A mesh as a handful of arrays by name: what files, databases and configurations hold of it."""

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.mesh import CircleArcs, Mesh

#: All arrays of a mesh.
NAMES = (
    "nodes_mm",
    "elements",
    "electrode_edges",
    "electrode_edge_counts",
    "arc_edges",
    "arc_edge_counts",
    "arc_circles",
)
#: Those that are whole numbers; the others are float64.
INTEGERS = ("elements", "electrode_edges", "electrode_edge_counts", "arc_edges", "arc_edge_counts")


def mesh_arrays(mesh: Mesh) -> dict[str, NDArray[Any]]:
    """Return a mesh as arrays.

    Returns
    -------
    nodes_mm : (n, 2) float64.
    elements : (e, 3) int64.
    electrode_edges, electrode_edge_counts : (k, 2) and (electrodes,) int64, all electrodes' edges one after another.
    arc_edges, arc_edge_counts, arc_circles : (m, 2) and (a,) int64, (a, 3) float64 of centre and radius.
    """
    return {
        "nodes_mm": mesh.nodes_mm,
        "elements": mesh.elements,
        "electrode_edges": _joined([*mesh.electrode_edges]),
        "electrode_edge_counts": np.array([len(edges) for edges in mesh.electrode_edges], dtype=np.int64),
        "arc_edges": _joined([arcs.edges for arcs in mesh.arcs]),
        "arc_edge_counts": np.array([len(arcs.edges) for arcs in mesh.arcs], dtype=np.int64),
        "arc_circles": np.array([(*a.centre_mm, a.radius_mm) for a in mesh.arcs], dtype=np.float64).reshape(-1, 3),
    }


def mesh_of_arrays(arrays: Mapping[str, Any]) -> Mesh:
    """Return the mesh of :func:`mesh_arrays`, from arrays or nested lists; arcs may be left out.

    Raises
    ------
    RefusedError
        If an array is missing, has another shape or other numbers, or the mesh contradicts itself.
    """
    nodes = _array(arrays, "nodes_mm", 2)
    edges = edge_lists(arrays, "electrode")
    arcs: tuple[CircleArcs, ...] = ()
    if "arc_edges" in arrays:
        circles = _array(arrays, "arc_circles", 3)
        parts = edge_lists(arrays, "arc")
        if len(parts) != len(circles):
            raise RefusedError(f"{len(parts)} lists of a mesh's arcs do not fit {len(circles)} circles")
        arcs = tuple(CircleArcs(e, (x, y), r) for e, (x, y, r) in zip(parts, circles.tolist(), strict=True))
    for part in (*edges, *(a.edges for a in arcs)):
        if part.size and not 0 <= part.min() <= part.max() < len(nodes):
            raise RefusedError("an electrode or an arc names a node that is not in the mesh")
    return Mesh(nodes, _array(arrays, "elements", 3), edges, arcs)


def edge_lists(arrays: Mapping[str, Any], what: str) -> tuple[NDArray[np.int64], ...]:
    """Return the edges of each ``"electrode"`` or ``"arc"``, (k, 2) int64.

    Raises
    ------
    RefusedError
        If they are missing, or their counts say something else.
    """
    edges, counts = _array(arrays, f"{what}_edges", 2), _array(arrays, f"{what}_edge_counts", 0)
    if (counts < 0).any() or int(counts.sum()) != len(edges):
        raise RefusedError(f"{what}_edges holds {len(edges)} edges, the counts say {int(counts.sum())}")
    return tuple(np.split(edges, np.cumsum(counts)[:-1])) if len(counts) else ()


def mesh_digest(mesh: Mesh) -> str:
    """SHA-256 of all that a mesh is made of, hexadecimal."""
    sha = hashlib.sha256()
    for name, array in sorted(mesh_arrays(mesh).items()):
        kind = "<i8" if name in INTEGERS else "<f8"
        sha.update(f"{name}{array.shape}\n".encode())
        sha.update(np.ascontiguousarray(array + 0, dtype=kind).tobytes())  # no −0, which not every file keeps
    return sha.hexdigest()


def _joined(parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.zeros((0, 2), dtype=np.int64)


def _array(arrays: Mapping[str, Any], name: str, columns: int) -> NDArray[Any]:
    """Return a checked array of rows of so many numbers; of single numbers for 0."""
    if name not in arrays:
        raise RefusedError(f"the mesh has no {name}")
    try:
        array = np.asarray(arrays[name])
        whole = name in INTEGERS
        if array.size == 0:
            array = np.zeros((0, columns) if columns else 0, dtype=np.int64 if whole else np.float64)
        if array.dtype.kind not in ("iu" if whole else "iuf"):
            raise RefusedError(f"{name} of the mesh does not hold {'whole ' if whole else ''}numbers")
    except ValueError as error:
        raise RefusedError(f"{name} of the mesh has rows of different lengths") from error
    if array.ndim != (2 if columns else 1) or (columns and array.shape[1] != columns):
        raise RefusedError(f"{name} of the mesh has the shape {array.shape} instead of (n, {columns or ''})")
    array = array.astype(np.int64 if whole else np.float64)
    if not np.isfinite(array).all():
        raise RefusedError(f"{name} of the mesh holds a number that is not finite")
    return array
