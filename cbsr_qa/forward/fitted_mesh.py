"""A mesh whose edges follow a circle inside it, so that every element lies on one side of a round load's outline.

Loads that come and go are better served by cutting elements (:mod:`cbsr_qa.forward.coverage`); this is for reference
solutions, which then converge as fast as without a load.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.mesh import CircleArcs, Mesh

Array = NDArray[np.float64]

_CLOSE: Final = 0.6  # nodes nearer to the circle than this share of the local edge length make way for its own
_DENSE: Final = 4000  # points the local edge length is looked up at


def fitted_mesh(mesh: Mesh, centre_mm: tuple[float, float], radius_mm: float) -> tuple[Mesh, NDArray[np.bool_]]:
    """Put a circle into a mesh.

    Parameters
    ----------
    mesh : convex but for round holes that are electrodes' rims.
    centre_mm, radius_mm : of a circle inside the sheet that touches no hole.

    Returns
    -------
    A mesh of about the same edge lengths with the circle among its arcs, and which elements are inside, (e,) bool.

    Raises
    ------
    RefusedError
        If the circle comes so close to an edge of the sheet that it cannot be followed.
    """
    ring = _ring(mesh, np.asarray(centre_mm), radius_mm)
    fixed = np.unique(mesh.outline)
    size = _size_at(mesh, mesh.nodes_mm)
    far = np.abs(np.hypot(*(mesh.nodes_mm - centre_mm).T) - radius_mm) > _CLOSE * size
    kept = far | np.isin(np.arange(len(far)), fixed)
    renumbered = np.cumsum(kept) - 1
    nodes = np.vstack([mesh.nodes_mm[kept], ring])
    following = int(kept.sum()) + np.arange(len(ring))
    circle = np.column_stack([following, np.roll(following, -1)])
    edges = tuple(renumbered[e] for e in mesh.electrode_edges)
    elements = _triangles(nodes, edges)
    arcs = [CircleArcs(renumbered[a.edges], a.centre_mm, a.radius_mm) for a in mesh.arcs]
    fitted = Mesh(nodes, elements, edges, (*arcs, CircleArcs(circle, centre_mm, radius_mm)))
    known = fitted.edges @ np.array([len(nodes), 1])
    if not np.isin(np.sort(circle, axis=1) @ np.array([len(nodes), 1]), known).all():
        raise RefusedError(
            f"a circle of radius {radius_mm:g} mm about {centre_mm} cannot be followed by this mesh",
            remedy="keep it clear of edge and electrodes, or use smaller elements",
        )
    return fitted, np.hypot(*(fitted.centroids_mm - centre_mm).T) < radius_mm


def _size_at(mesh: Mesh, points: Array) -> Array:
    """Edge length of an equilateral triangle as large as the element at each point."""
    nearest = cKDTree(mesh.centroids_mm).query(points)[1]
    size: Array = np.sqrt(mesh.areas_mm2[nearest] * 4 / np.sqrt(3))
    return size


def _ring(mesh: Mesh, centre: Array, radius: float) -> Array:
    """Nodes round the circle, as dense as the mesh is there."""
    turn = 2 * np.pi * np.arange(_DENSE + 1) / _DENSE
    circle = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    density = 1 / _size_at(mesh, circle)
    total = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)]) * radius * turn[1]
    count = max(int(np.ceil(total[-1])), 12)
    angle = np.interp(np.arange(count) / count * total[-1], total, turn)
    ring: Array = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return ring


def _triangles(nodes: Array, rims: tuple[NDArray[np.int64], ...]) -> NDArray[np.int64]:
    elements = Delaunay(nodes).simplices.astype(np.int64)
    hole = np.full(len(nodes), -1)
    for number, rim in enumerate(rims):
        hole[rim.ravel()] = number
    own = hole[elements]
    elements = elements[~((own[:, 0] >= 0) & (own == own[:, :1]).all(axis=1))]
    a, b, c = (nodes[elements[:, k]] for k in range(3))
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    elements[twice < 0] = elements[twice < 0][:, ::-1]
    longest = ((b - a) ** 2).sum(axis=1)
    solid: NDArray[np.int64] = elements[np.abs(twice) > 1e-9 * longest]
    return solid
