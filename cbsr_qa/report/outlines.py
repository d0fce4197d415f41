"""Outlines of blobs and pictures of images, ready to be drawn."""

from collections import defaultdict

import numpy as np
from matplotlib.path import Path
from matplotlib.tri import Triangulation
from numpy.typing import NDArray
from scipy.spatial import KDTree

from cbsr_qa.domain.mesh import Mesh


def outline(mesh: Mesh, elements: NDArray[np.int64]) -> list[NDArray[np.float64]]:
    """Trace the outline of some elements: every edge that belongs to exactly one of them, holes included.

    Parameters
    ----------
    mesh : counterclockwise elements.
    elements : (k,) int64.

    Returns
    -------
    Closed rings, each (n, 2) [mm] with the first point repeated; outer rings counterclockwise, holes clockwise.
    """
    corners = mesh.elements[elements]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    count = len(mesh.nodes_mm)
    forward, backward = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    rim = edges[~np.isin(forward, backward)]
    following: dict[int, list[int]] = defaultdict(list)
    for start, end in rim.tolist():
        following[start].append(end)
    rings = []
    while following:
        rings.append(mesh.nodes_mm[_ring(following)])
    return rings


def _ring(following: dict[int, list[int]]) -> list[int]:
    """Walk one ring and take its edges out; a node where rings touch is left by whichever edge is still there."""
    start = next(iter(following))
    ring = [start]
    while True:
        ends = following[ring[-1]]
        ring.append(ends.pop())
        if not ends:
            del following[ring[-2]]
        if ring[-1] == start:
            return ring


def outline_path(
    mesh: Mesh, elements: NDArray[np.int64], shift_mm: tuple[float, float] = (0.0, 0.0), scale: float = 1.0
) -> Path:
    """Return the outline as one compound path, moved and scaled."""
    rings = [ring * scale + np.asarray(shift_mm) for ring in outline(mesh, elements)]
    return Path.make_compound_path(*(Path(ring, closed=True) for ring in rings))


class Raster:
    """Which element lies under each pixel of a square picture of the sheet: made once per mesh, used per image.

    A picture of elements is a tenth of the bytes of their polygons, and an image costs one look-up.

    Parameters
    ----------
    mesh : of the images.
    radius_mm : half the picture's width.
    pixels : along each side.
    """

    def __init__(self, mesh: Mesh, radius_mm: float, pixels: int) -> None:
        step = 2 * radius_mm / pixels
        centres = -radius_mm + step * (np.arange(pixels) + 0.5)
        x, y = np.meshgrid(centres, centres)
        triangles = Triangulation(mesh.nodes_mm[:, 0], mesh.nodes_mm[:, 1], mesh.elements)
        found = np.asarray(triangles.get_trifinder()(x, y), dtype=np.int64)
        # Round sheets are polygons in a mesh: pixels of the thin rim between them take the nearest element.
        rim = (found < 0) & (x**2 + y**2 <= radius_mm**2)
        if rim.any():
            found[rim] = KDTree(mesh.centroids_mm).query(np.column_stack([x[rim], y[rim]]))[1]
        self.elements = found
        self.extent = (-radius_mm, radius_mm, -radius_mm, radius_mm)

    def picture(self, values: NDArray[np.float64]) -> np.ma.MaskedArray[tuple[int, int], np.dtype[np.float64]]:
        """Return (pixels, pixels) values, bottom row first; masked outside the sheet."""
        outside = self.elements < 0
        return np.ma.MaskedArray(values[np.where(outside, 0, self.elements)], mask=outside)
