"""Drawing of the sheet, its electrodes and objects on it."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle, Polygon as Patch
from matplotlib.path import Path
from matplotlib.tri import Triangulation
from scipy.spatial import KDTree

from cbsr_qa.domain.geometry.footprints import Footprint
from cbsr_qa.domain.geometry.outlines import Disc, SheetOutline
from cbsr_qa.domain.imaging import Region
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout, Electrodes
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.draw.style import FAINT, INK, QUIET, Box, bare

Point = tuple[float, float]


def rings(region: Region) -> list[Array]:
    """Trace a region's perimeter: closed rings (n, 2) [mm], outer ones counterclockwise, holes clockwise."""
    starts, ends = region.rim_mm()
    next_points: dict[Point, list[Point]] = defaultdict(list)
    for start, end in zip(map(tuple, starts.tolist()), map(tuple, ends.tolist()), strict=True):
        next_points[start].append(end)
    rings = []
    while next_points:
        rings.append(np.array(_ring(next_points)))
    return rings


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
    corners = head.outline_mm()
    return Path(np.vstack([corners, corners[:1]]) + np.asarray(shift_mm), closed=True)


class Raster:
    """Which element lies under each pixel of a picture of the sheet: made once per mesh, used per image.

    A picture of elements is a tenth of the bytes of their polygons, and an image costs one look-up.

    Parameters
    ----------
    mesh : mesh of the images.
    sheet : its outline, in the mesh's unit; the picture ends where it does.
    pixels : along the longer side; they are square.
    """

    def __init__(self, mesh: Mesh, sheet: SheetOutline, pixels: int) -> None:
        low_x, high_x, low_y, high_y = sheet.extent_mm
        step = max(high_x - low_x, high_y - low_y) / pixels
        columns, rows = (int(np.ceil(side / step - 1e-9)) for side in (high_x - low_x, high_y - low_y))
        x, y = np.meshgrid(low_x + step * (np.arange(columns) + 0.5), low_y + step * (np.arange(rows) + 0.5))
        triangles = Triangulation(mesh.nodes_mm[:, 0], mesh.nodes_mm[:, 1], mesh.elements)
        elements = np.asarray(triangles.get_trifinder()(x, y), dtype=np.int64)
        # Round edges are polygons in a mesh: pixels of the thin rim between them take the nearest element.
        rim = elements < 0
        rim[rim] = sheet.clearance_mm(np.column_stack([x[rim], y[rim]])) >= 0
        if rim.any():
            elements[rim] = KDTree(mesh.centroids_mm).query(np.column_stack([x[rim], y[rim]]))[1]
        self.elements = elements
        self.extent = (low_x, low_x + step * columns, low_y, low_y + step * rows)

    def picture(self, values: Array) -> np.ma.MaskedArray[tuple[int, int], np.dtype[np.float64]]:
        """Return (rows, columns) values, bottom row first; masked outside the sheet."""
        outside = self.elements < 0
        return np.ma.MaskedArray(values[np.where(outside, 0, self.elements)], mask=outside)


#: Largest number of places that have room for their names.
MOST_NAMES: Final = 16
#: Number of sides with which a circle is round in print.
_SIDES: Final = 72

Shift = tuple[float, float]


def sheet_axes(figure: Canvas, place: Box, sensor: SensorType) -> Axes:
    """Add axes that show a sensor's sheet with its electrodes, to scale."""
    axes = figure.add_axes(place)
    show_sheet(axes, sensor)
    return axes


def show_sheet(axes: Axes, sensor: SensorType, *, numbered: bool = True) -> None:
    """Draw a sensor's sheet with its electrodes, to scale."""
    bare(axes)
    draw_sheet(axes, sensor.outline, filled=True)
    draw_electrodes(axes, sensor.electrodes, sensor.outline, numbered=numbered)
    fit_sheet(axes, sensor.outline)


def disc_radius_mm(places_mm: Sequence[tuple[float, float]], sensor: SensorType, least: float = 0.03) -> float:
    """Radius of discs that lets most neighbours stand clear; at least ``least`` of the sheet's radius."""
    centres_mm = np.array(places_mm)
    distances_mm = np.hypot(*(centres_mm[:, None, :] - centres_mm[None, :, :]).transpose(2, 0, 1))
    distances_mm[distances_mm < 1e-9] = np.inf
    nearest = min(float(np.median(distances_mm.min(axis=1))), sensor.radius_mm)
    return float(np.clip(0.46 * nearest, least * sensor.radius_mm, 0.15 * sensor.radius_mm))


def draw_sheet(axes: Axes, sheet: SheetOutline, shift: Shift = (0.0, 0.0), *, filled: bool = False) -> None:
    """Draw the sheet's edge."""
    axes.add_patch(sheet_patch(sheet, shift, filled=filled))


def sheet_patch(sheet: SheetOutline, shift: Shift = (0.0, 0.0), *, filled: bool = False) -> Circle | Patch:
    """Return the sheet's edge, moved."""
    face, order = ("#fbfbfb", 0) if filled else ("none", 3)
    if isinstance(sheet, Disc):
        return Circle(shift, sheet.radius_mm, facecolor=face, edgecolor=QUIET, linewidth=0.7, zorder=order)
    corners = sheet_path(sheet) + np.asarray(shift)
    return Patch(corners, closed=True, facecolor=face, edgecolor=QUIET, linewidth=0.7, zorder=order)


def sheet_path(sheet: SheetOutline) -> Array:
    """Corners of the sheet's edge as it is drawn, (n, 2): bends in steps that look round in print."""
    curve = sheet.curve
    steps = np.maximum(np.ceil(np.abs(curve.curvature * curve.length) * _SIDES / (2 * np.pi)).astype(int), 1)
    pieces = zip(curve.begins[:-1], curve.length, steps, strict=True)
    places = [begin + length * np.arange(count) / count for begin, length, count in pieces]
    return curve.points_at(np.concatenate(places))


def draw_electrodes(axes: Axes, electrodes: Electrodes, sheet: SheetOutline, *, numbered: bool = True) -> None:
    """Draw the electrodes where they are, with their numbers just outside the sheet.

    Parameters
    ----------
    sheet : sheet as drawn; a ring on a disc is scaled to it where a drawing is in units of the radius.
    numbered : every number where there is room, else only electrode 0.
    """
    if isinstance(electrodes, ElectrodeLayout) and isinstance(sheet, Disc):
        places = _draw_ring(axes, electrodes, sheet.radius_mm)
    else:
        places = _draw_placed(axes, electrodes, sheet)
    for number, (x, y) in enumerate(places):
        if numbered or number == 0:
            axes.text(x, y, str(number), ha="center", va="center", fontsize=6, color=QUIET)


def _draw_ring(axes: Axes, layout: ElectrodeLayout, radius_mm: float) -> Array:
    """Draw electrodes on a ring; returns where their numbers go."""
    angles = layout.angles_rad()
    direction = np.column_stack([np.cos(angles), np.sin(angles)])
    if layout.kind is ElectrodeKind.PIN:
        ring = min(layout.ring_radius_mm, radius_mm)
        pins = direction * ring
        axes.scatter(pins[:, 0], pins[:, 1], s=4, c=INK, linewidths=0, zorder=4)
    else:
        half_angle = layout.width_mm / layout.ring_radius_mm / 2
        arcs = [_arc(angle - half_angle, angle + half_angle, radius_mm) for angle in angles]
        axes.add_collection(LineCollection(arcs, colors=INK, linewidths=2.2, zorder=4, capstyle="butt"))
    return direction * radius_mm * 1.075


def _draw_placed(axes: Axes, electrodes: Electrodes, sheet: SheetOutline) -> Array:
    """Draw electrodes one by one; returns where their numbers go: outside the edge, or beside a pin far inside."""
    centres, curve = electrodes.positions_mm(), sheet.curve
    along, distance_mm = curve.nearest(centres)
    if electrodes.kind is ElectrodeKind.PIN:
        axes.scatter(centres[:, 0], centres[:, 1], s=4, c=INK, linewidths=0, zorder=4)
    else:
        half_width_mm = electrodes.width_mm / 2
        strips = [
            curve.points_at(np.linspace(place - half_width_mm, place + half_width_mm, _SIDES)) for place in along
        ]
        axes.add_collection(LineCollection(strips, colors=INK, linewidths=2.2, zorder=4, capstyle="butt"))
    size = 0.075 * reach(sheet)
    ahead = curve.points_at(along + size / 8) - curve.points_at(along - size / 8)
    outward = np.column_stack([ahead[:, 1], -ahead[:, 0]]) / np.hypot(*ahead.T)[:, None]
    inner = (distance_mm > 4 * size)[:, None]
    return np.where(inner, centres + size / 2, curve.points_at(along) + size * outward)


def draw_circles(
    axes: Axes,
    centres_mm: Array,
    radius_mm: float,
    *,
    color: str = INK,
    width: float = 0.8,
    dashed: bool = False,
) -> None:
    """Draw equal circles at (n, 2) centres as one collection."""
    round_ = _arc(0.0, 2 * np.pi, radius_mm)
    collection = PolyCollection(
        [round_ + centre for centre in np.asarray(centres_mm).reshape(-1, 2)],
        facecolors="none",
        edgecolors=color,
        linewidths=width,
        linestyles=[(0, (2.5, 1.8))] if dashed else "solid",
        zorder=6,
    )
    axes.add_collection(collection)


def draw_outlines(axes: Axes, paths: list[Path], *, color: str = INK, width: float = 1.1, face: str = "none") -> None:
    """Draw outlines of regions (see :func:`cbsr_qa.report.draw.sheet.region_path`) as one collection."""
    if paths:
        axes.add_collection(PathCollection(paths, facecolors=face, edgecolors=color, linewidths=width, zorder=5))


def draw_heads(axes: Axes, paths: list[Path], *, color: str = INK, dashed: bool = False) -> None:
    """Draw the indenter at many places (see :func:`cbsr_qa.report.draw.sheet.head_path`) as one collection."""
    style = [(0, (2.5, 1.8))] if dashed else "solid"
    axes.add_collection(
        PathCollection(paths, facecolors="none", edgecolors=color, linewidths=0.8, linestyles=style, zorder=6)
    )


def add_scale(
    figure: Canvas,
    axes: Axes,
    norm: Normalize,
    colours: Colormap,
    *,
    label: str,
    place: str,
    bottom_in: float = 0.36,
) -> None:
    """Draw a slim colour scale beside (``"right"``) or below (``"bottom"``) the axes, there ``bottom_in`` up."""
    box = axes.get_position()
    is_vertical = place == "right"
    if is_vertical:
        slot = figure.add_axes((box.x1 + 0.015, box.y0 + 0.15 * box.height, 0.013, 0.7 * box.height))
    else:
        height_in = figure.get_size_inches()[1]
        slot = figure.add_axes((box.x0 + 0.3 * box.width, bottom_in / height_in, 0.4 * box.width, 0.09 / height_in))
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
    ramp = np.linspace(low, high, 128)[None, :]
    extent = (0, 1, low, high) if is_vertical else (low, high, 0, 1)
    picture = ramp.T if is_vertical else ramp
    slot.imshow(picture, norm=norm, cmap=colours, extent=extent, aspect="auto", origin="lower")
    for side in slot.spines.values():
        side.set_visible(False)
    slot.tick_params(length=2, color=FAINT)
    if is_vertical:
        slot.set_xticks([])
        slot.yaxis.tick_right()
        slot.yaxis.set_label_position("right")
        slot.set_ylabel(label)
    else:
        slot.set_yticks([])
        slot.set_xlabel(label)


def fit_sheet(axes: Axes, sheet: SheetOutline) -> None:
    """Show exactly the sheet with room for the electrodes' numbers."""
    low_x, high_x, low_y, high_y = sheet.extent_mm
    room = 0.16 * reach(sheet)
    axes.set_xlim(low_x - room, high_x + room)
    axes.set_ylim(low_y - room, high_y + room)


def reach(sheet: SheetOutline) -> float:
    """Return half the longer side of the box round a sheet; what is drawn next to the sheet is placed by it."""
    low_x, high_x, low_y, high_y = sheet.extent_mm
    return max(high_x - low_x, high_y - low_y) / 2


def _arc(start: float, end: float, radius: float) -> Array:
    steps = max(int(_SIDES * abs(end - start) / (2 * np.pi)), 4)
    angles = np.linspace(start, end, steps + 1)
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])
