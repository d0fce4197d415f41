"""Draw the first figure of docs/explanation/what-accuracy-costs.md from the first table of that page.

Run ``python docs/figures/draw_minutes.py`` after the table has changed; the commands below it measure it again.
"""

import re
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure as Canvas

from cbsr_qa.report.draw.style import BLUE, INK, VERMILION, canvas, dots, draw_svg, place_plain_ticks, plot

PAGE: Final = Path(__file__).resolve().parents[1] / "explanation" / "what-accuracy-costs.md"
FIGURE: Final = PAGE.parent / "figures" / "frontier" / "minutes.svg"
_TICKS: Final = (0.15, *(digit * 10.0**power for power in range(-1, 4) for digit in (1, 2, 5)))
#: A row of the table: recipe, presses, minutes and force error with its standard error.
_ROW: Final = re.compile(r"^\| ([^|]+) \| [^|]+ \| ([\d.]+)[^|]* \| ([\d.]+) ± ([\d.]+) \|$", re.MULTILINE)
_COLOURS: Final = {"adaptive,": BLUE, "adaptive-batch": VERMILION}
#: Of each row in order: where its name stands, and how it is aligned with the point.
_PLACED: Final = (("middle", "right"), ("below", "left"), ("above", "left"), ("below", "center"), ("above", "center"))


def read_rows(page: str) -> list[tuple[str, float, float, float]]:
    """Return name, minutes, force error and its standard error of each way in the page's first table."""
    return [(name.replace("`", ""), *map(float, numbers)) for name, *numbers in _ROW.findall(page)]


@draw_svg
def draw_minutes(rows: list[tuple[str, float, float, float]]) -> Canvas:
    """Draw force error against minutes of the station, both logarithmic, with standard errors."""
    figure = canvas(3.1)
    axes = plot(figure, (0.1, 0.15, 0.86, 0.8), "force error [N]", x="minutes of the station per sensor", grid="both")
    axes.set_xscale("log")
    axes.set_yscale("log")
    for (name, minutes, error_N, stderr_N), (where, aligned) in zip(rows, _PLACED, strict=True):
        colour = next((colour for start, colour in _COLOURS.items() if name.startswith(start)), INK)
        dots(axes, [minutes], [error_N], colour, errors=[stderr_N])
        height_N = error_N + {"above": stderr_N, "middle": 0.0, "below": -stderr_N}[where]
        shift = (-6 if where == "middle" else 0, {"above": 3, "middle": 0, "below": -9}[where])
        axes.annotate(
            name, (minutes, height_N), xytext=shift, textcoords="offset points", ha=aligned, fontsize=7, color=colour
        )
    for axis in (axes.xaxis, axes.yaxis):
        place_plain_ticks(axis, _TICKS)
    axes.set_xlim(4, 600)
    axes.set_ylim(0.1, 0.22)
    return figure


def draw_page(page: str) -> str:
    """Return the figure of the page's table."""
    return draw_minutes(read_rows(page)) + "\n"


if __name__ == "__main__":
    FIGURE.write_text(draw_page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
