"""Error of place and coverage of the regions against the number of presses."""

from collections.abc import Sequence
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.report.draw.style import BLUE, FAINT, INK, VERMILION, canvas, dots, draw_svg, place_plain_ticks, plot
from cbsr_qa.studies.frontier.point import Point
from cbsr_qa.studies.frontier.presses.needed import PLACE

_COLOURS: Final = (BLUE, VERMILION, INK)
_TICKS: Final = tuple(digit * 10.0**power for power in range(-2, 5) for digit in (1, 2, 5))


@draw_svg
def draw_press_errors(
    series: Sequence[tuple[str, Sequence[Point]]], target_mm: float | None = None, guess_mm: float | None = None
) -> Canvas:
    """Draw error of place and coverage against presses, each with standard errors.

    Parameters
    ----------
    series : names, and points of each in the order of their presses.
    target_mm, guess_mm : target, and error of guessing, as lines.
    """
    figure = canvas(3.1)
    error = plot(figure, (0.07, 0.14, 0.4, 0.74), "mean error of place [mm]", x="presses", grid="both")
    coverage = plot(figure, (0.56, 0.14, 0.4, 0.74), "places inside their region [%]", x="presses", grid="both")
    for number, (name, points) in enumerate(series):
        colour = _COLOURS[number % len(_COLOURS)]
        _draw(error, points, PLACE, colour, line="solid", label=name)
        for covered, look in (("covered_68", "solid"), ("covered_95", "dashed")):
            _draw(coverage, points, covered, colour, scale=100, line=look)
    error.set_yscale("log")
    if target_mm is not None:
        error.axhline(target_mm, color=FAINT, linewidth=0.8, zorder=1)
    if guess_mm is not None:
        error.axhline(guess_mm, color=INK, linewidth=0.8, linestyle="dashed", zorder=1)
        error.text(
            0.99, guess_mm, "guessing", transform=error.get_yaxis_transform(), ha="right", va="bottom", fontsize=7
        )
    for level_percent in (68, 95):
        coverage.axhline(level_percent, color=INK, linewidth=0.8, zorder=1)
        coverage.text(
            1.01,
            level_percent,
            f"{level_percent} %",
            transform=coverage.get_yaxis_transform(),
            va="center",
            fontsize=7,
        )
    coverage.set_ylim(min(40.0, coverage.get_ylim()[0]), 103)
    for axis in (error.xaxis, coverage.xaxis, error.yaxis):
        place_plain_ticks(axis, _TICKS)
    error.legend(frameon=False, fontsize=7, loc="lower left")
    return figure


def _draw(
    axes: Axes, points: Sequence[Point], name: str, colour: str, *, line: str, scale: float = 1, label: str = ""
) -> None:
    axes.set_xscale("log")
    numbers = [float(point.knobs["presses"]) for point in points]
    values = [scale * point.accuracy[name].value for point in points]
    errors = [scale * (point.accuracy[name].stderr or 0.0) for point in points]
    dots(axes, numbers, values, colour, errors=errors, linestyle=line, label=label or None, hollow=line == "dashed")
