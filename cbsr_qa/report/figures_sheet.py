"""Images of the sheet: electrodes, what conducts more or less, and what was found there."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.electrodes import ElectrodeLayout
from cbsr_qa.domain.image import Image
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.report import Figure
from cbsr_qa.report.outlines import Raster
from cbsr_qa.report.sheet import add_scale, draw_electrodes, draw_sheet, fit_sheet
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
    radius: float,
    caption: str,
    alternative: str,
    electrodes: ElectrodeLayout | None = None,
    columns: int = 3,
    shared_scale: bool = True,
) -> Figure:
    """Draw images side by side, with electrodes and markers.

    Parameters
    ----------
    panels : at least one; all in the same unit of length.
    radius : of the sheet in that unit (1 where lengths are in units of the radius).
    electrodes : drawn and numbered where they are known; their ring is taken as the sheet's edge where ``radius``
        is in another unit than millimetres.
    columns : at most this many side by side.
    shared_scale : one colour scale for all; otherwise each image has its own, stated below it.

    Returns
    -------
    Figure
        Colours show the relative conductance change in percent: blue conducts more, brown less.
    """

    def build() -> Canvas:
        across = min(columns, len(panels))
        rows = ceil(len(panels) / across)
        side_in = min((WIDTH_IN - 0.6) / across, 2.9)
        height_in = rows * (side_in + 0.42) + (0.6 if shared_scale else 0.1)
        figure = canvas(height_in)
        largest = max(float(np.abs(panel.image.values).max()) for panel in panels)
        pixels = 420 if across < 3 else 300
        rasters: dict[int, Raster] = {}
        left_in = (WIDTH_IN - across * side_in) / 2
        for index, panel in enumerate(panels):
            row, column = divmod(index, across)
            bottom_in = height_in - (row + 1) * (side_in + 0.42) + 0.2
            box = (left_in + column * side_in, bottom_in, side_in, side_in)
            axes = figure.add_axes((box[0] / WIDTH_IN, box[1] / height_in, box[2] / WIDTH_IN, box[3] / height_in))
            raster = rasters.setdefault(id(panel.image.mesh), Raster(panel.image.mesh, radius, pixels))
            own = float(np.abs(panel.image.values).max())
            _draw_panel(axes, panel, raster, radius, largest if shared_scale else own)
            if electrodes is not None:
                draw_electrodes(axes, electrodes, radius)
        if shared_scale:
            whole = figure.add_axes((0, 0, 1, 1))
            whole.set_axis_off()
            scale_label = "conductance change Δγ/γ₀ [%]"
            add_scale(figure, whole, change_norm(100 * largest), CHANGE_MAP, label=scale_label, place="bottom")
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _draw_panel(axes: Axes, panel: ImagePanel, raster: Raster, radius: float, largest: float) -> None:
    bare(axes)
    axes.imshow(
        raster.picture(panel.image.values),
        origin="lower",
        extent=raster.extent,
        cmap=CHANGE_MAP,
        norm=change_norm(largest),
    )
    draw_sheet(axes, radius)
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
    fit_sheet(axes, radius)


def sheet_radius(mesh: Mesh) -> float:
    """Return the radius of the sheet a mesh covers, in the mesh's unit."""
    return float(np.linalg.norm(mesh.nodes_mm, axis=1).max())
