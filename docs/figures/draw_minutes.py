"""Draw the first figure of docs/explanation/what-accuracy-costs.md from the first table of that page.

Run ``python docs/figures/draw_minutes.py`` after the table has changed; the commands below it measure it again.
"""

import re
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure as Canvas

from cbsr_qa.report.draw.style import BLUE, INK, VERMILION, canvas, dots, draw_svg, plain_ticks, plot

PAGE: Final = Path(__file__).resolve().parents[1] / "explanation" / "what-accuracy-costs.md"
FIGURE: Final = PAGE.parent / "figures" / "frontier" / "minutes.svg"
_TICKS: Final = tuple(digit * 10.0**power for power in range(-2, 4) for digit in (1, 2, 5))
#: A row of the table: recipe, presses, minutes and force error with its standard error.
_ROW: Final = re.compile(r"^\| ([^|]+) \| [^|]+ \| ([\d.]+)[^|]* \| ([\d.]+) ± ([\d.]+) \|$", re.MULTILINE)
_COLOURS: Final = {"adaptive,": BLUE, "adaptive-batch": VERMILION}


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
    for name, minutes, error_N, stderr_N in rows:
        colour = next((colour for start, colour in _COLOURS.items() if name.startswith(start)), INK)
        dots(axes, [minutes], [error_N], colour, errors=[stderr_N])
        axes.annotate(name, (minutes, error_N), xytext=(5, 4), textcoords="offset points", fontsize=7, color=colour)
    for axis in (axes.xaxis, axes.yaxis):
        plain_ticks(axis, _TICKS)
    axes.set_xlim(5, 1000)
    return figure


def draw_page(page: str) -> str:
    """Return the figure of the page's table."""
    return draw_minutes(read_rows(page)) + "\n"


if __name__ == "__main__":
    FIGURE.write_text(draw_page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
