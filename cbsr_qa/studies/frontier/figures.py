"""The station's plot of the frontier: force error against station time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.report.draw.style import CYCLE, FAINT, INK, QUIET, canvas, drawing, light_grid, place_plain_ticks, svg_of
from cbsr_qa.studies.frontier.point import Point, TimeBasis
from cbsr_qa.studies.frontier.recommend import Recommendation
from cbsr_qa.studies.frontier.station import NAMES
from cbsr_qa.system.files import writing

_COLOURS: Final = (*CYCLE, INK)  # one per series
_LATE_MIN: Final = 100.0  # names of later points stand to their left


def draw_station(points: Sequence[Point], chosen: Recommendation) -> str:
    """Draw force error against minutes of the station."""
    return svg_of(lambda: _canvas(points, chosen))


def _canvas(points: Sequence[Point], chosen: Recommendation) -> Canvas:
    figure = canvas(3.6)
    axes = figure.add_axes((0.09, 0.13, 0.66, 0.83))
    axes.set_xscale("log")
    axes.set_yscale("log")
    light_grid(axes, "both")
    members = [point for point in points if point.clock is TimeBasis.STATION]
    names = list(dict.fromkeys(point.series for point in members))
    colours = {name: _COLOURS[number % len(_COLOURS)] for number, name in enumerate(names)}
    for point in members:
        if "force_error" in point.accuracy:
            _draw_point(axes, point, colours[point.series])
    ringed = [point for point in members if point.knobs == chosen.setting and "force_error" in point.accuracy][:1]
    for point in ringed:
        place = (point.station_s or 0) / 60, point.accuracy["force_error"].value
        axes.plot(*place, "o", color=INK, markersize=10, markerfacecolor="none", markeredgewidth=1.2)
    place_plain_ticks(axes.xaxis, (10, 15, 20, 30, 45, 60, 90, 120, 180, 240, 360))
    place_plain_ticks(axes.yaxis, (0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 1, 2, 3, 5))
    axes.set_xlabel("station time a sensor [min]")
    axes.set_ylabel("force error [N]")
    for number, (name, colour) in enumerate(colours.items()):
        axes.text(1.03, 0.97 - 0.06 * number, name, color=colour, transform=axes.transAxes, va="top")
    return figure


def _draw_point(axes: Axes, point: Point, colour: str) -> None:
    minutes, force = (point.station_s or 0) / 60, point.accuracy["force_error"]
    low = min(force.stderr or 0.0, 0.9 * force.value)
    axes.errorbar(minutes, force.value, yerr=[[low], [force.stderr or 0.0]], color=FAINT, linewidth=0.8)
    marker = "s" if point.knobs.get("transients") == "predicted" else "o"
    face = colour if point.pareto else "none"
    axes.plot(minutes, force.value, marker, color=colour, markersize=4, markerfacecolor=face, linestyle="none")
    name = next((name for name in NAMES.values() if point.note.startswith(name)), "")
    side = "right" if minutes > _LATE_MIN else "left"
    axes.annotate(
        name,
        (minutes, force.value),
        (0, 6),
        textcoords="offset points",
        color=QUIET,
        fontsize=7,
        ha=side,
        va="bottom",
    )


def write_png(points: Sequence[Point], chosen: Recommendation, path: Path) -> None:
    """Draw the station's frontier as a PNG picture. RefusedError if the file cannot be written."""
    if not any("force_error" in point.accuracy for point in points):
        raise RefusedError("there is no force error to draw", remedy="sweep the station's clock")
    with writing(path), drawing(), mpl.rc_context({"svg.fonttype": "path"}):
        _canvas(points, chosen).savefig(path, dpi=200, metadata={"Software": None})
