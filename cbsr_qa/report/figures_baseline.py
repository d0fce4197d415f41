"""The baseline conductance ρ̄₀ over the sheet, with its uncertainty."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import PathPatch

from cbsr_qa.domain.calibration import BaselineConductance
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.report import Figure
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.report.numbers import with_uncertainty
from cbsr_qa.report.outlines import head_path
from cbsr_qa.report.sheet import add_scale, draw_electrodes, draw_sheet, fit_sheet
from cbsr_qa.report.style import AMOUNT_MAP, BLUE, INK, QUIET, VERMILION, bare, canvas, light_grid, name_rows
from cbsr_qa.report.svg import drawn


def baseline_figure(
    places: Sequence[BaselineConductance],
    sensor: SensorType,
    indenter: Indenter,
    *,
    caption: str,
    alternative: str,
) -> Figure:
    """Draw ρ̄₀ at its places on the sheet, and the same values with error bars around their mean.

    Parameters
    ----------
    places : at least one with a value.
    """

    def build() -> Canvas:
        figure = canvas(3.5)
        axes = figure.add_axes((0.0, 0.01, 0.5, 0.98))
        known = [(place, place.value) for place in places if place.value is not None]
        values = [value for _, value in known]
        low, high = min(values), max(values)
        room = 0.25 * (high - low) or 0.1 * abs(high) or 1e-6
        norm = Normalize(low - room, high + room)
        _draw_map(axes, places, sensor, indenter, norm)
        add_scale(figure, axes, norm, AMOUNT_MAP, label="ρ̄₀ [relative]", place="right")
        side = figure.add_axes((0.685, 0.13, 0.3, 0.78))
        _draw_values(side, places, sum(values) / len(values))
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _draw_map(
    axes: Axes,
    places: Sequence[BaselineConductance],
    sensor: SensorType,
    indenter: Indenter,
    norm: Normalize,
) -> None:
    bare(axes)
    draw_sheet(axes, sensor.outline, filled=True)
    draw_electrodes(axes, sensor.electrodes, sensor.outline)
    for place in places:
        at = (place.x_mm, place.y_mm)
        known = place.value is not None
        face = AMOUNT_MAP(norm(place.value)) if place.value is not None else "white"
        edge = QUIET if known else VERMILION
        head = head_path(indenter.at(*at))
        axes.add_patch(PathPatch(head, facecolor=face, edgecolor=edge, linewidth=0.7, zorder=4))
        below = float(head.get_extents().ymin) - 0.02 * sensor.radius_mm
        text = "no value" if place.value is None else with_uncertainty(place.value, place.stderr)
        axes.text(place.x_mm, below, text, ha="center", va="top", fontsize=6.5, zorder=6)
        dark = place.value is not None and norm(place.value) > 0.55
        name = axes.text(*at, place.location, ha="center", va="center", fontsize=7, fontweight="bold", zorder=6)
        name.set_color("white" if dark else INK)
    fit_sheet(axes, sensor.outline)


def _draw_values(axes: Axes, places: Sequence[BaselineConductance], mean: float) -> None:
    light_grid(axes, "x")
    for row, place in enumerate(places):
        if place.value is None:
            continue
        axes.errorbar(
            [place.value], [row], xerr=[place.stderr or 0.0], fmt="o", markersize=3.5, color=BLUE, elinewidth=0.9
        )
    axes.axvline(mean, color=INK, linewidth=0.8)
    name_rows(axes, [place.location for place in places])
    axes.set_title("ρ̄₀ ± its uncertainty; line: mean", fontweight="normal")
