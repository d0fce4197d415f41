"""``cbsr-qa frontier``: what accuracy costs in time, and the setting to take.

The words of ``cbsr-qa frontier``: a table a series, and the setting to take.
"""

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.output import Counting, emit_json, note, say
from cbsr_qa.domain import RefusedError
from cbsr_qa.studies.frontier import Clock

if TYPE_CHECKING:
    from cbsr_qa.studies.frontier import Frontier


_MINUTES = {"min": 1.0, "h": 60.0, "s": 1 / 60}


def frontier(
    clock: Annotated[str, typer.Option(help="Whose time: station, computer or both.")] = "both",
    force_error: Annotated[str | None, typer.Option(metavar="0.5N", help="Cheapest setting this accurate.")] = None,
    budget: Annotated[str | None, typer.Option(metavar="20min", help="Station time a sensor may take.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few settings and one simulated sensor.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Forget what an earlier sweep has finished.")] = False,
    recipe: Annotated[Path | None, typer.Option(help="Recipe file to write the recommended setting to.")] = None,
    output: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    png: Annotated[Path | None, typer.Option(help="Picture of the station's frontier to write.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Sweep settings of computer and station, and say which accuracy costs how much time.

    Finished parts are kept: a sweep that was stopped goes on where it was.
    """
    from cbsr_qa.studies.frontier import Files, Wish, frontier as sweep

    wish, clocks = Wish(_newtons(force_error), _seconds(budget)), _clocks(clock)
    Files(recipe, output, png).check(clocks)
    with Counting("simulations and measurements") as counting:
        counting.stage("what accuracy costs in time")
        found = sweep(clocks, wish, quick=quick, fresh=fresh, tell=lambda done, of, _: counting.count(done, of))
    _write(found, recipe, output, png)
    if as_json:
        emit_json(found.document(recipe if found.recommended else None))
        return
    for line in lines(found):
        say(line)


def _write(found: "Frontier", recipe: Path | None, output: Path | None, png: Path | None) -> None:
    if recipe is not None:
        there = recipe.exists()
        found.write_recipe(recipe)
        note(f"recipe       {recipe}{', in place of the one that was there' if there else ''}")
    if output is not None:
        from cbsr_qa.studies.frontier import write_page

        write_page(found, output)
        note(f"page         {output}")
    if png is not None:
        from cbsr_qa.studies.frontier import write_png

        write_png(found, png)
        note(f"picture      {png}")


def _clocks(text: str) -> tuple[Clock, ...]:
    clocks = {"station": (Clock.STATION,), "computer": (Clock.COMPUTER,), "both": (Clock.STATION, Clock.COMPUTER)}
    if text not in clocks:
        raise RefusedError(f"--clock is {text!r}", remedy="give station, computer or both")
    return clocks[text]


def _newtons(text: str | None) -> float | None:
    if text is None:
        return None
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(m?N)\s*", text)
    value = float(found[1]) * (1e-3 if found[2] == "mN" else 1.0) if found else 0.0
    if value <= 0:
        raise RefusedError(
            f"--force-error is {text!r}", remedy="give a force above 0 with its unit, e.g. 0.5N or 80mN"
        )
    return value


def _seconds(text: str | None) -> float | None:
    if text is None:
        return None
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(min|h|s)\s*", text)
    value = 60 * float(found[1]) * _MINUTES[found[2]] if found else 0.0
    if value <= 0:
        raise RefusedError(
            f"--budget is {text!r}", remedy="give a time above 0 with its unit, e.g. 20min, 1.5h or 900s"
        )
    return value


WIDTH = 110


def lines(found: "Frontier") -> Iterator[str]:
    """Lay out every series, then what is recommended."""
    from cbsr_qa.studies.frontier import alike_in, notes_of, table_of

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
        for remark in notes_of(own):
            yield from textwrap.wrap(remark, WIDTH, initial_indent="    ", subsequent_indent="    ")
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
