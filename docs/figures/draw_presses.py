"""Draw the figure of presses in docs/explanation/what-accuracy-costs.md from the table of docs/explanation/place.md.

Run ``python docs/figures/draw_presses.py`` after the table has changed. ``make soak`` measures the table again.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.presses.figures import draw_press_errors

TABLE: Final = Path(__file__).resolve().parents[1] / "explanation" / "place.md"
FIGURE: Final = TABLE.parent / "figures" / "frontier" / "presses.svg"
_SKINS: Final = ("no pattern", "parallel lines")


def points_of(page: str) -> Iterator[tuple[str, list[Point]]]:
    """Points of each skin from the page's table: mean error ± standard error, and below it what regions hold."""
    numbers = [int(cell) for cell in _cells(page, "presses")]
    for skin in _SKINS:
        errors = [re.findall(r"[\d.]+", cell) for cell in _cells(page, skin)]
        held = [re.findall(r"\d+", cell) for cell in _cells(page[page.index(f"| {skin} |") :], "in their regions")]
        yield skin, [_point(*row) for row in zip(numbers, errors, held, strict=True)]


def _cells(page: str, name: str) -> list[str]:
    row = next(line for line in page.splitlines() if line.startswith(f"| {name} |"))
    return [cell.strip() for cell in row.split("|")[2:-1]]


def _point(number: int, error: list[str], held: list[str]) -> Point:
    mean, stderr = map(float, error)
    low, high = (Accuracy(int(share) / 100, None, "1", "stated") for share in held)
    accuracy = {"place_error": Accuracy(mean, stderr, "mm"), "covered_68": low, "covered_95": high}
    return Point(TimeBasis.PRESSES, "skins", {"presses": number}, accuracy, None, None, 1)


def drawn_from(page: str) -> str:
    """The figure of a page's table."""
    return draw_press_errors(list(points_of(page))) + "\n"


if __name__ == "__main__":
    FIGURE.write_text(drawn_from(TABLE.read_text(encoding="utf-8")), encoding="utf-8")
