"""Meshes with a known outline, for tests that need the exact shape of a blob."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.imaging import Blob, Image
from cbsr_qa.domain.sensor.mesh import Mesh


def disc_mesh(
    radius_mm: float, *, centre_mm: tuple[float, float] = (0.0, 0.0), rings: int = 8, spokes: int = 96
) -> Mesh:
    """A disc of rings of triangles; its outline is a regular polygon with ``spokes`` corners on the circle."""
    angle = 2 * np.pi * np.arange(spokes) / spokes
    radii = radius_mm * np.arange(1, rings + 1) / rings
    around = np.stack([np.outer(radii, np.cos(angle)), np.outer(radii, np.sin(angle))], axis=-1).reshape(-1, 2)
    nodes = np.vstack([[0.0, 0.0], around]) + np.asarray(centre_mm)
    here = np.arange(spokes)
    there = (here + 1) % spokes
    elements = [np.column_stack([np.zeros(spokes, dtype=int), 1 + here, 1 + there])]
    for ring in range(1, rings):
        inner, outer = 1 + (ring - 1) * spokes, 1 + ring * spokes
        elements.append(np.column_stack([inner + here, outer + here, outer + there]))
        elements.append(np.column_stack([inner + here, outer + there, inner + there]))
    return Mesh(nodes, np.vstack(elements).astype(np.int64))


def square_mesh(cells: int, *, size_mm: float = 1.0) -> Mesh:
    """A square from the origin, ``cells`` × ``cells`` squares cut into two triangles: element 2 c and 2 c + 1."""
    axis = size_mm * np.arange(cells + 1) / cells
    nodes = np.stack(np.meshgrid(axis, axis, indexing="xy"), axis=-1).reshape(-1, 2)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)[None, :]).ravel()
    right, up, across = corner + 1, corner + cells + 1, corner + cells + 2
    lower, upper = np.column_stack([corner, right, across]), np.column_stack([corner, across, up])
    return Mesh(nodes, np.stack([lower, upper], axis=1).reshape(-1, 3).astype(np.int64))


def uniform_blob(mesh: Mesh, elements: NDArray[np.int64] | None = None) -> Blob:
    """A blob of value 1 over some or all elements of a mesh."""
    chosen = np.arange(len(mesh.elements)) if elements is None else elements
    return Blob(Image(mesh, np.ones(len(mesh.elements))), np.asarray(chosen, dtype=np.int64))
