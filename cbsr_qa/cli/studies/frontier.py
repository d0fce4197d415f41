"""``cbsr-qa frontier``: what accuracy costs in time, and the setting to take."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.output import Counting, note, show
from cbsr_qa.domain import RefusedError

_CLOCKS: Final = {
    "station": ("station",),
    "computer": ("computer",),
    "both": ("station", "computer"),
}
_NEWTONS: Final = {"N": 1.0, "mN": 1e-3}
_SECONDS: Final = {"s": 1.0, "min": 60.0, "h": 3600.0}


@command("frontier", prints="cbsr_qa.studies.frontier:Frontier")
def frontier(
    clock: Annotated[str, typer.Option(help="Time to save: of the station, the computer or both.")] = "both",
    force_error: Annotated[
        str | None,
        typer.Option(
            metavar="0.5N", help="Recommend the cheapest setting with at most this force error, with its unit."
        ),
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(
            metavar="20min",
            help="Recommend a setting that takes at most this station time per sensor, with its unit.",
        ),
    ] = None,
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
    from cbsr_qa.studies.frontier import Files, TimeBasis, Wish, frontier as sweep, frontier_outcome, write_png

    wish = Wish(
        _amount("--force-error", force_error, _NEWTONS, "a force above 0 with its unit, e.g. 0.5N or 80mN"),
        _amount("--budget", budget, _SECONDS, "a time above 0 with its unit, e.g. 20min, 1.5h or 900s"),
    )
    if clock not in _CLOCKS:
        raise RefusedError(f"--clock is {clock!r}", remedy=f"give one of {', '.join(_CLOCKS)}")
    replaced = recipe is not None and recipe.exists()
    with Counting("simulations and measurements") as counting:
        counting.stage("what accuracy costs in time")
        swept = sweep(
            tuple(TimeBasis(time) for time in _CLOCKS[clock]),
            wish,
            Files(recipe, output, png),
            quick=quick,
            fresh=fresh,
            tell=lambda done, of, _: counting.count(done, of),
        )
    if recipe is not None:
        note(f"recipe       {recipe}{', in place of the one that was there' if replaced else ''}")
    if png is not None:
        write_png(swept.points, swept.chosen, png)
        note(f"picture      {png}")
    show(frontier_outcome(swept), output=output, as_json=as_json)


def _amount(option: str, text: str | None, units: Mapping[str, float], wanted: str) -> float | None:
    if text is None:
        return None
    match = re.fullmatch(rf"\s*(\d+(?:\.\d+)?)\s*({'|'.join(units)})\s*", text)
    value = float(match[1]) * units[match[2]] if match else 0.0
    if value <= 0:
        raise RefusedError(f"{option} is {text!r}", remedy=f"give {wanted}")
    return value
