"""The words of ``cbsr-qa frontier``: a table a series, and the setting to take."""

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cbsr_qa.app.frontier import Frontier

WIDTH = 110


def lines(found: "Frontier") -> Iterator[str]:
    """Lay out every series, then what is recommended."""
    from cbsr_qa.app.frontier_page import alike_in, notes_of, table_of

    for clock, series in dict.fromkeys((point.clock, point.series) for point in found.points):
        members = [
            (point, on)
            for point, on in zip(found.points, found.pareto, strict=True)
            if point.clock is clock and point.series == series
        ]
        columns, rows = table_of(members)
        seeds = members[0][0].seeds
        yield f"{clock} clock, {series} ({seeds} {'repetition' if seeds == 1 else 'repetitions'})"
        yield from _table(columns, rows)
        own = [point for point, _ in members]
        if alike := alike_in(own, found.points):
            yield from textwrap.wrap(f"in all: {alike}", WIDTH, initial_indent="    ", subsequent_indent="    ")
        for note in notes_of(own):
            yield from textwrap.wrap(note, WIDTH, initial_indent="    ", subsequent_indent="    ")
        yield ""
    yield "• nothing that was tried is as accurate for less time"
    yield from _recommended(found)


def _table(columns: list[str], rows: list[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(len(cell) for cell in column) for column in zip(columns, *rows, strict=True)]
    for row in (columns, *rows):
        yield ("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))).rstrip()


def _recommended(found: "Frontier") -> Iterator[str]:
    if found.recommended is None:
        yield from textwrap.wrap(f"recommended: none; {found.why_not}", WIDTH)
        return
    setting = found.recommended.setting
    how = "holds predicted to where long ones end" if setting.predicted else "holds taken as they are"
    strains = ", ".join(f"{percent:g}" for percent in setting.strains_percent)
    words = (
        f"recommended: {setting.places} places at {strains} % strain,"
        f" {setting.trials} {'time' if setting.trials == 1 else 'times'}, held {setting.hold_s:g} s, rested"
        f" {setting.rest_s:g} s, {how}: {found.recommended.why}"
    )
    yield from textwrap.wrap(words, WIDTH)
