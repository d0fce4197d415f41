"""Images of the sheet with what was found there, and where on the sheet limits were met."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle

from cbsr_qa.domain.geometry.outlines import SheetOutline
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.limits import SEVERITY, Outcome
from cbsr_qa.domain.sensor.electrodes import Electrodes
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.draw.sheet import (
    MOST_NAMES,
    Raster,
    add_scale,
    disc_radius_mm,
    draw_electrodes,
    draw_sheet,
    fit_sheet,
    reach,
    show_sheet,
)
from cbsr_qa.report.draw.style import CHANGE_MAP, INK, QUIET, WIDTH_IN, bare, canvas, change_norm, draw_svg, note
from cbsr_qa.report.location_verdicts import SIGNS, LocationVerdict, outcome_counts

_ACROSS: Final = 3
#: Darker in grey print for worse outcomes; edges differ as well.
_LOOK: Final[dict[Outcome, dict[str, Any]]] = {
    Outcome.PASS: {"facecolor": "#e9f5f0", "edgecolor": "#00664b", "linewidth": 0.8},
    Outcome.MARGINAL: {"facecolor": "#f3d9a0", "edgecolor": "#8a5a00", "linewidth": 1.1, "linestyle": (0, (3, 1.5))},
    Outcome.FAIL: {"facecolor": "#a32900", "edgecolor": "#5e1800", "linewidth": 1.6},
    Outcome.NOT_MEASURED: {
        "facecolor": "white",
        "edgecolor": "#4d4d4d",
        "linewidth": 1.1,
        "linestyle": (0, (1, 1.5)),
    },
}


@draw_svg
def verdict_figure(verdicts: Sequence[LocationVerdict], sensor: SensorType) -> Canvas:
    """Draw a sheet for each phase with the outcome of every place."""
    phases = list(dict.fromkeys(verdict.phase for verdict in verdicts))
    figure, places = _lay_out(len(phases), min(len(phases), _ACROSS))
    for phase, axes in zip(phases, places, strict=True):
        show_sheet(axes, sensor, numbered=False)
        _draw_phase(axes, phase, [verdict for verdict in verdicts if verdict.phase == phase], sensor)
    return figure


def _draw_phase(axes: Axes, phase: str, verdicts: Sequence[LocationVerdict], sensor: SensorType) -> None:
    radius_mm = disc_radius_mm([(verdict.x_mm, verdict.y_mm) for verdict in verdicts], sensor, least=0.06)
    # The worst last, so that none hides below a neighbour that passed.
    for verdict in sorted(verdicts, key=lambda v: -SEVERITY.index(v.outcome)):
        centre_mm, sign = (verdict.x_mm, verdict.y_mm), SIGNS[verdict.outcome]
        axes.add_patch(Circle(centre_mm, radius_mm, zorder=4, **_LOOK[verdict.outcome]))
        text = axes.text(*centre_mm, f"{sign}\n{verdict.label}" if len(verdicts) <= MOST_NAMES else sign)
        text.set(ha="center", va="center", fontsize=5.5, linespacing=0.95, zorder=6)
        text.set_color("white" if verdict.outcome is Outcome.FAIL else INK)
        text.set_fontweight("normal" if verdict.outcome is Outcome.PASS else "bold")
    axes.set_title(phase, loc="center", pad=2, fontweight="normal")
    note(axes, 0.5, -0.015, outcome_counts([verdict.outcome for verdict in verdicts]), ha="center", va="top")


_SCALE_LABEL: Final = "conductance change Δγ/γ₀ [%]"
_SCALE_IN: Final = 0.42  #: room for a scale below each image


@dataclass(frozen=True, slots=True)
class Marker:
    """A place on an image, in the unit of its mesh; the label may be empty."""

    x: float
    y: float
    label: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ImagePanel:
    """One image with a title, a line below it, the places found on it, and the way an object took.

    Parameters
    ----------
    track : (n, 2) places in the unit of the image's mesh, in order of time; None where nothing moves.
    """

    title: str
    image: Image
    markers: tuple[Marker, ...] = ()
    note: str = ""
    track: Array | None = None


@draw_svg
def image_figure(
    panels: Sequence[ImagePanel],
    *,
    sheet: SheetOutline,
    electrodes: Electrodes | None = None,
    columns: int = 3,
    shared_scale: bool = True,
) -> Canvas:
    """Draw images side by side, with electrodes and markers: blue conducts more [%], brown less.

    Parameters
    ----------
    panels : panels, at least one; all in the same unit of length.
    sheet : its outline in that unit (a disc of radius 1 where lengths are in units of the radius).
    electrodes : drawn and numbered where they are known, on a disc's edge where the disc is in another unit.
    columns : largest number of panels side by side.
    shared_scale : one colour scale for all, below them; otherwise each image has its own below it.
    """
    columns_used = min(columns, len(panels))
    each_in, below_in = (0.0, 0.6) if shared_scale else (_SCALE_IN, 0.1)
    figure, places = _lay_out(len(panels), columns_used, each_in=each_in, below_in=below_in)
    sizes = [float(np.abs(panel.image.values).max()) for panel in panels]
    rasters: dict[int, Raster] = {}
    for panel, size, axes in zip(panels, sizes, places, strict=True):
        mesh = panel.image.mesh
        if id(mesh) not in rasters:
            rasters[id(mesh)] = Raster(mesh, sheet, 420 if columns_used < 3 else 300)
        _draw_panel(axes, panel, rasters[id(mesh)], sheet, max(sizes) if shared_scale else size)
        if electrodes is not None:
            draw_electrodes(axes, electrodes, sheet)
        if not shared_scale:
            bottom_in = axes.get_position().y0 * figure.get_size_inches()[1] - 0.3
            norm = change_norm(100 * size)
            add_scale(figure, axes, norm, CHANGE_MAP, label=_SCALE_LABEL, place="bottom", bottom_in=bottom_in)
    if shared_scale:
        whole_axes = figure.add_axes((0, 0, 1, 1))
        whole_axes.set_axis_off()
        norm = change_norm(100 * max(sizes))
        add_scale(figure, whole_axes, norm, CHANGE_MAP, label=_SCALE_LABEL, place="bottom")
    return figure


def draw_image(axes: Axes, panel: ImagePanel, sensor: SensorType) -> None:
    """Draw one image with electrodes and its own scale on the axes of any figure."""
    largest = float(np.abs(panel.image.values).max())
    _draw_panel(axes, panel, Raster(panel.image.mesh, sensor.outline, 420), sensor.outline, largest)
    draw_electrodes(axes, sensor.electrodes, sensor.outline)
    scale = ScalarMappable(change_norm(100 * largest), CHANGE_MAP)
    axes.get_figure(root=True).colorbar(scale, ax=axes, label=_SCALE_LABEL, shrink=0.8)  # type: ignore[union-attr]


def _lay_out(count: int, across: int, *, each_in: float = 0.0, below_in: float = 0.0) -> tuple[Canvas, list[Axes]]:
    """Square axes in rows, with room for a title above and a note (and more) below each, and below them all."""
    side_in = min((WIDTH_IN - 0.6) / across, 2.9)
    row_in = side_in + 0.42 + each_in
    height_in = ceil(count / across) * row_in + below_in
    figure = canvas(height_in)
    places = []
    for index in range(count):
        row, column = divmod(index, across)
        bottom_in = height_in - (row + 1) * row_in + 0.2 + each_in
        corner = ((column + 0.5) / across - side_in / WIDTH_IN / 2, bottom_in / height_in)
        places.append(figure.add_axes((*corner, side_in / WIDTH_IN, side_in / height_in)))
    return figure, places


def _draw_panel(axes: Axes, panel: ImagePanel, raster: Raster, sheet: SheetOutline, largest: float) -> None:
    bare(axes)
    radius = reach(sheet)
    axes.imshow(
        raster.picture(panel.image.values),
        origin="lower",
        extent=raster.extent,
        cmap=CHANGE_MAP,
        norm=change_norm(largest),
    )
    draw_sheet(axes, sheet)
    if panel.track is not None:
        _draw_track(axes, panel.track)
    for marker in panel.markers:
        axes.plot([marker.x], [marker.y], marker="+", markersize=8, color="white", markeredgewidth=2.6, zorder=7)
        axes.plot([marker.x], [marker.y], marker="+", markersize=7, color=INK, markeredgewidth=1.1, zorder=8)
        if marker.label:
            label_left = marker.x > 0.5 * radius
            shift = -0.09 * radius if label_left else 0.09 * radius
            label = axes.text(marker.x + shift, marker.y + 0.09 * radius, marker.label, zorder=9)
            label.set(ha="right" if label_left else "left", va="bottom", fontsize=7, fontweight="bold")
            label.set_bbox(
                {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 1.0}
            )  # readable on dark images
    axes.set_title(panel.title, loc="center", pad=2)
    if panel.note:
        note(axes, 0.5, -0.01, panel.note, QUIET, ha="center", va="top")
    fit_sheet(axes, sheet)


def _draw_track(axes: Axes, track: Array) -> None:
    """Draw a path from a ring to a dot, readable on dark and pale images."""
    for width, colour, order in ((2.4, "white", 4.5), (0.9, INK, 5)):
        axes.plot(*track.T, color=colour, linewidth=width, zorder=order)
    for place, face in ((track[0], "white"), (track[-1], INK)):
        axes.plot(*place, "o", markersize=4.5, markerfacecolor=face, markeredgecolor=INK, zorder=6)


def sheet_radius(mesh: Mesh) -> float:
    """Return the radius of the disc a mesh covers, in the mesh's unit."""
    return float(np.linalg.norm(mesh.nodes_mm, axis=1).max())
