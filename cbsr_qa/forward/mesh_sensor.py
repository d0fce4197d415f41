"""Sensor types whose sheet is a mesh made elsewhere."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.electrodes import ElectrodeKind, PlacedElectrodes
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.outlines import Polygon, thinned_ring
from cbsr_qa.domain.patterns import DrivePattern
from cbsr_qa.domain.polygons import inside_polygon, signed_area
from cbsr_qa.domain.sensor import GivenMesh, Response, SensorType

Indices = NDArray[np.int64]

#: A sheet's outline follows its mesh's edge to this share of the radius.
_OUTLINE: Final = 1e-3


def mesh_sensor(
    name: str,
    mesh: Mesh,
    pattern: DrivePattern,
    *,
    thickness_mm: float,
    response: Response = Response.AUTO,
) -> SensorType:
    """Sensor type on a mesh that carries electrodes: its outline is the mesh's, its forward model's mesh is this one.

    Raises
    ------
    NumericsError
        If the mesh carries no electrodes, or fewer than three.
    RefusedError
        If the pattern is of another number of electrodes, or the outline is none a sheet can have.
    """
    if len(mesh.electrode_edges) < 3:
        raise NumericsError(
            f"the mesh carries {len(mesh.electrode_edges)} electrodes; a sensor has at least 3",
            remedy="give imported_mesh its electrodes",
        )
    ring = outer_ring(mesh)
    # What is furthest from the middle is a corner, where there are any.
    middle = mesh.nodes_mm[ring].mean(axis=0)
    ring = np.roll(ring, -int(np.hypot(*(mesh.nodes_mm[ring] - middle).T).argmax()))
    corners = thinned_ring(mesh.nodes_mm[ring], _OUTLINE * float(np.sqrt(mesh.areas_mm2.sum() / np.pi)))
    polygon = Polygon(tuple((x, y) for x, y in corners.tolist()))
    on_edge = np.zeros(len(mesh.nodes_mm), dtype=np.bool_)
    on_edge[ring] = True
    kind = ElectrodeKind.ARC if all(on_edge[edges].all() for edges in mesh.electrode_edges) else ElectrodeKind.PIN
    middles, lengths = zip(*(_middle(mesh, edges) for edges in mesh.electrode_edges), strict=True)
    width = float(np.mean(lengths)) / (1 if kind is ElectrodeKind.ARC else np.pi)
    electrodes = PlacedElectrodes(kind, tuple(middles), width)
    return SensorType(
        name, polygon.radius_mm, thickness_mm, electrodes, pattern, response, polygon, GivenMesh.of(mesh)
    )


def outer_ring(mesh: Mesh) -> Indices:
    """Nodes of the outer boundary, counterclockwise: of the boundary's closed lines the one that goes round most."""
    return max(_rings(mesh), key=lambda ring: signed_area(mesh.nodes_mm[ring]))


def without_holes(image: Mesh, sheet: Mesh) -> Mesh:
    """Leave out of an image's mesh the elements that lie in a hole of the sheet's, with all their corners."""
    inside = np.zeros(len(image.elements), dtype=np.bool_)
    for ring in _rings(sheet):
        corners = sheet.nodes_mm[ring]
        if signed_area(corners) < 0:
            nodes = inside_polygon(image.nodes_mm, corners)
            inside |= nodes[image.elements].all(axis=1) & inside_polygon(image.centroids_mm, corners)
    used, elements = np.unique(image.elements[~inside], return_inverse=True)
    return Mesh(image.nodes_mm[used], elements.reshape(-1, 3).astype(np.int64))


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


def _middle(mesh: Mesh, edges: Indices) -> tuple[tuple[float, float], float]:
    """Middle of an electrode and its length."""
    ends = mesh.nodes_mm[edges]
    lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    x, y = (lengths @ ends.mean(axis=1) / lengths.sum()).tolist()
    return (x, y), float(lengths.sum())
