"""Outlines of regions and heads, and pictures of images, ready to be drawn."""

from collections import defaultdict

import numpy as np
from matplotlib.path import Path
from matplotlib.tri import Triangulation
from numpy.typing import NDArray
from scipy.spatial import KDTree

from cbsr_qa.domain.footprints import Footprint
from cbsr_qa.domain.image import Region
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.outlines import SheetOutline

Point = tuple[float, float]


def rings(region: Region) -> list[NDArray[np.float64]]:
    """Trace the perimeter of a region, holes included.

    Returns
    -------
    Closed rings, each (n, 2) [mm] with the first point repeated; outer rings counterclockwise, holes clockwise.
    """
    starts, ends = region.rim_mm()
    following: dict[Point, list[Point]] = defaultdict(list)
    for start, end in zip(map(tuple, starts.tolist()), map(tuple, ends.tolist()), strict=True):
        following[start].append(end)
    found = []
    while following:
        found.append(np.array(_ring(following)))
    return found


def _ring(following: dict[Point, list[Point]]) -> list[Point]:
    """Walk one ring and take its edges out; a point where rings touch is left by whichever edge is still there."""
    start = next(iter(following))
    ring = [start]
    while True:
        ends = following[ring[-1]]
        ring.append(ends.pop())
        if not ends:
            del following[ring[-2]]
        if ring[-1] == start or ring[-1] not in following:
            return ring


def region_path(region: Region, shift_mm: tuple[float, float] = (0.0, 0.0)) -> Path:
    """Return the outline as one compound path, moved."""
    return Path.make_compound_path(*(Path(ring + np.asarray(shift_mm), closed=True) for ring in rings(region)))


def head_path(head: Footprint, shift_mm: tuple[float, float] = (0.0, 0.0)) -> Path:
    """Return a head's outline as a path, moved."""
    corners = head.drawn_mm()
    return Path(np.vstack([corners, corners[:1]]) + np.asarray(shift_mm), closed=True)


class Raster:
    """Which element lies under each pixel of a picture of the sheet: made once per mesh, used per image.

    A picture of elements is a tenth of the bytes of their polygons, and an image costs one look-up.

    Parameters
    ----------
    mesh : of the images.
    sheet : its outline, in the mesh's unit; the picture ends where it does.
    pixels : along the longer side; they are square.
    """

    def __init__(self, mesh: Mesh, sheet: SheetOutline, pixels: int) -> None:
        low_x, high_x, low_y, high_y = sheet.extent_mm
        step = max(high_x - low_x, high_y - low_y) / pixels
        columns, rows = (int(np.ceil(side / step - 1e-9)) for side in (high_x - low_x, high_y - low_y))
        x, y = np.meshgrid(low_x + step * (np.arange(columns) + 0.5), low_y + step * (np.arange(rows) + 0.5))
        triangles = Triangulation(mesh.nodes_mm[:, 0], mesh.nodes_mm[:, 1], mesh.elements)
        found = np.asarray(triangles.get_trifinder()(x, y), dtype=np.int64)
        # Round edges are polygons in a mesh: pixels of the thin rim between them take the nearest element.
        rim = found < 0
        rim[rim] = sheet.clearance_mm(np.column_stack([x[rim], y[rim]])) >= 0
        if rim.any():
            found[rim] = KDTree(mesh.centroids_mm).query(np.column_stack([x[rim], y[rim]]))[1]
        self.elements = found
        self.extent = (low_x, low_x + step * columns, low_y, low_y + step * rows)

    def picture(self, values: NDArray[np.float64]) -> np.ma.MaskedArray[tuple[int, int], np.dtype[np.float64]]:
        """Return (rows, columns) values, bottom row first; masked outside the sheet."""
        outside = self.elements < 0
        return np.ma.MaskedArray(values[np.where(outside, 0, self.elements)], mask=outside)
