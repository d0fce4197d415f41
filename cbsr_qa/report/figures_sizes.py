"""Size of regions against size of what presses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.report import Figure
from cbsr_qa.report.style import CYCLE, FAINT, INK, QUIET, canvas, light_grid
from cbsr_qa.report.svg import drawn


@dataclass(frozen=True, slots=True)
class SizeSeries:
    """Diameters of targets and of circles with the regions' areas, at one place [mm]."""

    title: str
    targets_mm: tuple[float, ...]
    regions_mm: tuple[float, ...]


def size_figure(series: Sequence[SizeSeries], head_mm: float, *, caption: str, alternative: str) -> Figure:
    """Draw regions' diameters against targets', with the line on which they are equal and the head's size marked."""

    def build() -> Canvas:
        figure = canvas(2.1)
        axes = figure.add_axes((0.075, 0.19, 0.4, 0.74))
        _draw(axes, series, head_mm)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _draw(axes: Axes, series: Sequence[SizeSeries], head_mm: float) -> None:
    light_grid(axes, "both")
    largest = 1.12 * max(max((*one.targets_mm, *one.regions_mm)) for one in series)
    axes.plot([0, largest], [0, largest], color=FAINT, linestyle=(0, (4, 3)), zorder=1)
    axes.annotate("as large as the target", (0.9 * largest, 0.97 * largest), (-4, 0), textcoords="offset points",
                  ha="right", va="top", fontsize=7, color=QUIET, rotation=0)  # fmt: skip
    axes.axvline(head_mm, color=FAINT, linewidth=0.6, zorder=1)
    axes.annotate("head", (head_mm, 0), (3, 3), textcoords="offset points", fontsize=7, color=QUIET)
    for number, (one, colour) in enumerate(zip(series, CYCLE, strict=False)):
        axes.plot(one.targets_mm, one.regions_mm, color=colour, marker="os^"[number % 3], markersize=4, zorder=3)
        end = (one.targets_mm[-1], one.regions_mm[-1])
        axes.annotate(one.title, end, (6, 0), textcoords="offset points", va="center", fontsize=7, color=INK,
                      annotation_clip=False)  # fmt: skip
    axes.set_xlim(0, largest)
    axes.set_ylim(0, largest)
    axes.set_xlabel("diameter of the target [mm]")
    axes.set_ylabel("diameter of the region [mm]")
    ticks = np.arange(0, largest, 5 if largest < 40 else 10 if largest < 80 else 20)
    axes.set_xticks(ticks)
    axes.set_yticks(ticks)
