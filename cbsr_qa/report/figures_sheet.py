"""Images of the sheet: electrodes, what conducts more or less, and what was found there."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.electrodes import Electrodes
from cbsr_qa.domain.image import Image
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.outlines import SheetOutline
from cbsr_qa.domain.report import Figure
from cbsr_qa.report.outlines import Raster
from cbsr_qa.report.sheet import add_scale, draw_electrodes, draw_sheet, fit_sheet, reach
from cbsr_qa.report.style import CHANGE_MAP, INK, QUIET, WIDTH_IN, bare, canvas, change_norm
from cbsr_qa.report.svg import drawn


@dataclass(frozen=True, slots=True)
class Marker:
    """A place on an image.

    Parameters
    ----------
    x, y : in the unit of the image's mesh.
    label : short; empty for none.
    """

    x: float
    y: float
    label: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ImagePanel:
    """One image with a title, a line below it, and the places found on it."""

    title: str
    image: Image
    markers: tuple[Marker, ...] = ()
    note: str = ""


def image_figure(
    panels: Sequence[ImagePanel],
    *,
    sheet: SheetOutline,
    caption: str,
    alternative: str,
    electrodes: Electrodes | None = None,
    columns: int = 3,
    shared_scale: bool = True,
) -> Figure:
    """Draw images side by side, with electrodes and markers.

    Parameters
    ----------
    panels : at least one; all in the same unit of length.
    sheet : its outline in that unit (a disc of radius 1 where lengths are in units of the radius).
    electrodes : drawn and numbered where they are known; a ring is drawn on a disc's edge where it would be
        outside of it, the disc being in another unit than millimetres.
    columns : at most this many side by side.
    shared_scale : one colour scale for all; otherwise each image has its own, stated below it.

    Returns
    -------
    Figure
        Colours show the relative conductance change in percent: blue conducts more, brown less.
    """

    def build() -> Canvas:
        across = min(columns, len(panels))
        figure, places = _laid_out(len(panels), across, below_in=0.6 if shared_scale else 0.1)
        sizes = [float(np.abs(panel.image.values).max()) for panel in panels]
        rasters: dict[int, Raster] = {}
        for panel, size, axes in zip(panels, sizes, places, strict=True):
            mesh = panel.image.mesh
            if id(mesh) not in rasters:
                rasters[id(mesh)] = Raster(mesh, sheet, 420 if across < 3 else 300)
            _draw_panel(axes, panel, rasters[id(mesh)], sheet, max(sizes) if shared_scale else size)
            if electrodes is not None:
                draw_electrodes(axes, electrodes, sheet)
        if shared_scale:
            _draw_scale(figure, max(sizes))
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _laid_out(count: int, across: int, *, below_in: float) -> tuple[Canvas, list[Axes]]:
    """Square axes in rows, with room for a title above and a note below each, and below them all."""
    side_in = min((WIDTH_IN - 0.6) / across, 2.9)
    height_in = ceil(count / across) * (side_in + 0.42) + below_in
    figure = canvas(height_in)
    left_in = (WIDTH_IN - across * side_in) / 2
    places = []
    for index in range(count):
        row, column = divmod(index, across)
        bottom_in = height_in - (row + 1) * (side_in + 0.42) + 0.2
        corner = ((left_in + column * side_in) / WIDTH_IN, bottom_in / height_in)
        places.append(figure.add_axes((*corner, side_in / WIDTH_IN, side_in / height_in)))
    return figure, places


def _draw_scale(figure: Canvas, largest: float) -> None:
    whole = figure.add_axes((0, 0, 1, 1))
    whole.set_axis_off()
    label = "conductance change Δγ/γ₀ [%]"
    add_scale(figure, whole, change_norm(100 * largest), CHANGE_MAP, label=label, place="bottom")


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
    for marker in panel.markers:
        axes.plot([marker.x], [marker.y], marker="+", markersize=8, color="white", markeredgewidth=2.6, zorder=7)
        axes.plot([marker.x], [marker.y], marker="+", markersize=7, color=INK, markeredgewidth=1.1, zorder=8)
        if marker.label:
            left = marker.x > 0.5 * radius
            shift = -0.09 * radius if left else 0.09 * radius
            label = axes.text(marker.x + shift, marker.y + 0.09 * radius, marker.label, zorder=9)
            label.set(ha="right" if left else "left", va="bottom", fontsize=7, fontweight="bold")
            label.set_bbox(
                {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 1.0}
            )  # readable on dark images
    axes.set_title(panel.title, loc="center", pad=2)
    if panel.note:
        axes.text(0.5, -0.01, panel.note, transform=axes.transAxes, ha="center", va="top", fontsize=7, color=QUIET)
    fit_sheet(axes, sheet)


def sheet_radius(mesh: Mesh) -> float:
    """Return the radius of the disc a mesh covers, in the mesh's unit."""
    return float(np.linalg.norm(mesh.nodes_mm, axis=1).max())
