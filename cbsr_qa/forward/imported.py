"""Meshes made elsewhere: checked, and given their electrodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.numbers import array_of
from cbsr_qa.forward.mesh_checks import (
    Indices,
    Points,
    boundary_edges,
    check_doubled,
    check_hanging,
    check_in_one_piece,
    check_range,
    check_shape,
    check_used,
    plane_points,
    twice_area,
    whole_numbers,
)

_LEAST_COVERED: Final = 0.5  # of an electrode's width must be edges of the mesh


@dataclass(frozen=True, slots=True)
class ElectrodeAt:
    """An electrode by its place: every edge of the boundary whose middle lies within half its width of there.

    Parameters
    ----------
    x_mm, y_mm : middle of a strip, or of the hole that a pin is.
    width_mm : a strip's length or a pin's diameter.
    """

    x_mm: float
    y_mm: float
    width_mm: float


#: One electrode: its nodes in any order (k,), its edges as pairs of nodes (k, 2), or its place.
ElectrodeGiven = ElectrodeAt | ArrayLike


def imported_mesh(
    nodes_mm: ArrayLike,
    elements: ArrayLike,
    electrodes: Sequence[ElectrodeGiven] = (),
    *,
    first: int = 0,
    mend: bool = False,
) -> Mesh:
    """Check a mesh that was made elsewhere, and find its electrodes' edges.

    Parameters
    ----------
    nodes_mm : (n, 2) [mm]; (n, 3) where the third coordinate is the same for all.
    elements : (e, 3) nodes of each triangle.
    electrodes : each by its nodes, its edges or its place; in the order of their numbers. Nodes and edges are counted
        as those of ``elements`` are.
    first : number of the first node, 1 where software counts from one (MATLAB, EIDORS, gmsh).
    mend : turn clockwise elements and leave out nodes that no element uses, instead of refusing them.

    Raises
    ------
    NumericsError
        If arrays have other shapes or name nodes that are not there; two nodes are at one place; a node is used by
        no element; an element is turned or flat; three elements share an edge; a node hangs on an edge; the mesh
        falls into pieces; an electrode is outside the mesh, not on its boundary, has no edges, or shares one.
        Messages count nodes, elements and electrodes from 0.
    """
    points = plane_points(nodes_mm)
    corners = whole_numbers(elements, "elements", (3,)) - first
    check_range(corners, len(points), first, "element")
    given = [one if isinstance(one, ElectrodeAt) else _numbers(one, k, first) for k, one in enumerate(electrodes)]
    check_doubled(points, corners)
    if mend:
        points, corners, given = _mended(points, corners, given)
    check_used(points, corners)
    check_shape(points, corners)
    mesh = Mesh(points, corners)
    boundary = boundary_edges(mesh)
    check_in_one_piece(mesh)
    check_hanging(mesh, boundary)
    edges = [_edges_of(one, number, mesh, boundary) for number, one in enumerate(given)]
    _check_shared(edges)
    return Mesh(points, corners, tuple(edges))


def _numbers(given: ArrayLike, number: int, first: int) -> Indices:
    """Nodes (k,) or edges (k, 2) of an electrode, counted from 0."""
    array = array_of(given, f"nodes of electrode {number}")
    if not array.size:
        raise NumericsError(
            f"electrode {number} has no nodes or edges", remedy="give it some, or leave it and its pairs out"
        )
    return whole_numbers(array, f"electrode {number}:", (2,) if array.ndim == 2 else ()) - first


def _mended(
    points: Points, corners: Indices, given: list[ElectrodeAt | Indices]
) -> tuple[Points, Indices, list[ElectrodeAt | Indices]]:
    turned = twice_area(points, corners) < 0
    corners = corners.copy()
    corners[turned] = corners[turned][:, ::-1]
    used = np.unique(corners)
    new = np.full(len(points), -1, dtype=np.int64)
    new[used] = np.arange(len(used))
    kept: list[ElectrodeAt | Indices] = []
    for number, one in enumerate(given):
        if not isinstance(one, ElectrodeAt):
            check_range(one, len(points), 0, f"electrode {number}: entry")
            if (new[one] < 0).any():
                raise NumericsError(
                    f"electrode {number} names a node that belongs to no element", remedy="name nodes of the sheet"
                )
        kept.append(one if isinstance(one, ElectrodeAt) else new[one])
    return points[used], new[corners], kept


def _edges_of(given: ElectrodeAt | Indices, number: int, mesh: Mesh, boundary: Indices) -> Indices:
    if isinstance(given, ElectrodeAt):
        return _edges_at(given, number, mesh, boundary)
    check_range(given, len(mesh.nodes_mm), 0, f"electrode {number}: entry")
    if given.ndim == 1:
        return _edges_between(given, number, boundary)
    keys = _keys(boundary, mesh)
    inside = np.flatnonzero(~np.isin(_keys(given, mesh), keys))
    if inside.size:
        first, second = given[inside[0]]
        raise NumericsError(
            f"electrode {number}: nodes {first} and {second} are no edge of the mesh's boundary",
            remedy="an electrode is on the sheet's edge, or on the rim of a hole in it",
        )
    return given


def _edges_between(nodes: Indices, number: int, boundary: Indices) -> Indices:
    edges: Indices = boundary[np.isin(boundary, nodes).all(axis=1)]
    lonely = np.setdiff1d(nodes, edges)
    if lonely.size:
        where = "is not on the mesh's boundary" if not np.isin(lonely[0], boundary) else "has no other beside it"
        raise NumericsError(
            f"electrode {number}: node {lonely[0]} {where}; an electrode's nodes are joined by edges of the boundary",
            remedy="name all its nodes; for an electrode that is a single point use"
            " cbsr_qa.forward.model.point_model",
        )
    return edges


def _edges_at(place: ElectrodeAt, number: int, mesh: Mesh, boundary: Indices) -> Indices:
    here, ends = np.array([place.x_mm, place.y_mm]), mesh.nodes_mm[boundary]
    to_middle = np.hypot(*(ends.mean(axis=1) - here).T)
    chosen: Indices = boundary[to_middle <= place.width_mm / 2 * (1 + 1e-9)]
    covered = float(np.hypot(*(mesh.nodes_mm[chosen[:, 1]] - mesh.nodes_mm[chosen[:, 0]]).T).sum())
    if covered >= _LEAST_COVERED * place.width_mm:
        return chosen
    where = f"electrode {number} at ({place.x_mm:g}, {place.y_mm:g}) mm"
    along = ends[:, 1] - ends[:, 0]
    share = np.clip(((here - ends[:, 0]) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    away = float(np.hypot(*(here - ends[:, 0] - share[:, None] * along).T).min())
    if away > place.width_mm:
        raise NumericsError(
            f"{where} is not on the mesh's boundary, which is {away:.4g} mm away",
            remedy="move it to the sheet's edge or to a hole, or check the mesh's unit of length (millimetres)",
        )
    raise NumericsError(
        f"{where} covers {covered:.4g} mm of the mesh's boundary; it is {place.width_mm:g} mm wide",
        remedy="use smaller elements there, with nodes at the electrode's ends",
    )


def _check_shared(electrodes: list[Indices]) -> None:
    owner: dict[tuple[int, int], int] = {}
    for number, edges in enumerate(electrodes):
        for first, second in np.sort(edges, axis=1).tolist():
            other = owner.setdefault((first, second), number)
            if other != number:
                raise NumericsError(
                    f"electrodes {other} and {number} share the edge between nodes {first} and {second}",
                    remedy="electrodes may not overlap",
                )


def _keys(edges: Indices, mesh: Mesh) -> Indices:
    keys: Indices = np.sort(edges, axis=1) @ np.array([len(mesh.nodes_mm), 1])
    return keys
