"""``cbsr-qa frontier``: what accuracy costs in time or in presses, and the setting to take."""

import re
from collections.abc import Mapping, Set
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, Database, PageOutput, Since, Until, list_given_options, option_names, to_day
from cbsr_qa.cli.output import Counting, check_page, note, show
from cbsr_qa.domain.errors import RefusedError

if TYPE_CHECKING:
    from cbsr_qa.analysis.recording.press_files import PressFiles
    from cbsr_qa.domain.results.fleet import RunSelection
    from cbsr_qa.domain.results.report import CommandOutcome
    from cbsr_qa.studies.frontier.recommend import Target
    from cbsr_qa.studies.frontier.study import Frontier

_CLOCKS: Final = {
    "station": ("station",),
    "computer": ("computer",),
    "both": ("station", "computer"),
}
_NEWTONS: Final = {"N": 1.0, "mN": 1e-3}
_SECONDS: Final = {"s": 1.0, "min": 60.0, "h": 3600.0}
_MILLIMETRES: Final = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "cm": 10.0}
#: Options of the simulated sweep, and of recorded presses.
_SIMULATED: Final = frozenset({"clock", "force_error", "budget", "fresh", "recipe", "png"})
_RECORDED: Final = frozenset({"presses", "pattern", "sensor_type", "differences", "rest", "row_shift", "place_error"})
#: Options of stored runs, and those of the others that are not for them.
_STORED: Final = frozenset({"of_recipe", "batch", "since", "until", "database"})
_NOT_STORED: Final = _RECORDED | {"recording", "clock", "quick", "png"}


@command("frontier", prints="cbsr_qa.studies.frontier.study:Frontier")
def frontier(
    context: typer.Context,
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
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="A quick look: few settings and one simulated sensor; of a recording, few draws."
        ),
    ] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Forget what an earlier sweep has finished.")] = False,
    recipe: Annotated[Path | None, typer.Option(help="Recipe file to write the recommended setting to.")] = None,
    output: PageOutput = None,
    png: Annotated[Path | None, typer.Option(help="Picture of the station's frontier to write.")] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            metavar="READINGS", help="Presses of your own in place of simulations, as calibrate takes them."
        ),
    ] = None,
    presses: Annotated[Path | None, typer.Option(help="With --recording: table of where they were made.")] = None,
    sensor_type: Annotated[str | None, typer.Option(help="With --recording: sensor type.")] = None,
    pattern: Annotated[Path | None, typer.Option(help="With --recording: electrode pairs of a table.")] = None,
    differences: Annotated[
        bool,
        typer.Option("--differences", help="With --recording: READINGS are differences from the unloaded sheet."),
    ] = False,
    rest: Annotated[Path | None, typer.Option(help="With --recording: frames of the unloaded sheet.")] = None,
    row_shift: Annotated[
        int,
        typer.Option(
            help="With --recording: number of rows by which places stand below their readings; the ends are left out."
        ),
    ] = 0,
    place_error: Annotated[
        str | None,
        typer.Option(
            metavar="2mm", help="With --recording: recommend the fewest presses with at most this error of place."
        ),
    ] = None,
    stored: Annotated[
        bool, typer.Option("--stored", help="Stored runs of your own in place of simulations, one of each sensor.")
    ] = False,
    of_recipe: Annotated[
        str | None, typer.Option(metavar="NAME", help="With --stored: runs of the recipe of this name.")
    ] = None,
    batch: Annotated[str | None, typer.Option(help="With --stored: runs of this batch.")] = None,
    since: Since = None,
    until: Until = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Sweep settings of computer and station, and show how much time each accuracy costs.

    Finished parts are kept: a sweep that was stopped goes on where it was.

    With --recording, learn from growing numbers of your own presses, and say how many an accuracy needs.

    With --stored, say what fewer places, shorter holds or the batch as prior would have cost; a recipe follows.
    """
    given = list_given_options(context)
    if stored:
        from cbsr_qa.domain.results.fleet import RunSelection

        _refuse(given & _NOT_STORED, "is not for --stored")
        check_page(output)
        selection = RunSelection(recipe=of_recipe, batch=batch, since=to_day(since), until=to_day(until))
        show(
            _study_stored(selection, force_error, budget, database, recipe, fresh=fresh),
            output=output,
            as_json=as_json,
        )
        return
    _refuse(given & _STORED, "is for stored runs, and --stored is missing")
    if recording is not None:
        _refuse(given & _SIMULATED, "is not for --recording but for the simulated sweep")
        target_mm = _amount("--place-error", place_error, _MILLIMETRES, "a distance above 0 with its unit, e.g. 2mm")
        if presses is None or sensor_type is None:
            missing = "--presses" if presses is None else "--sensor-type"
            raise RefusedError(f"--recording needs {missing}", remedy="give it as to cbsr-qa calibrate")
        check_page(output)
        from cbsr_qa.analysis.recording.press_files import PressFiles

        files = PressFiles(recording, presses, sensor_type, pattern, differences, rest, row_shift)
        show(_study_presses(files, target_mm, quick=quick), output=output, as_json=as_json)
        return
    _refuse(given & _RECORDED, "is for presses of your own, and --recording is missing")
    from cbsr_qa.studies.frontier.figures import write_png
    from cbsr_qa.studies.frontier.files import Files
    from cbsr_qa.studies.frontier.point import TimeBasis
    from cbsr_qa.studies.frontier.report import lay_out_frontier
    from cbsr_qa.studies.frontier.study import frontier as sweep

    target = _read_target(force_error, budget)
    if clock not in _CLOCKS:
        raise RefusedError(f"--clock is {clock!r}", remedy=f"give one of {', '.join(_CLOCKS)}")
    replaced = recipe is not None and recipe.exists()
    with Counting("simulations and measurements") as counting:
        counting.stage("what accuracy costs in time")
        swept = sweep(
            tuple(TimeBasis(time) for time in _CLOCKS[clock]),
            target,
            Files(recipe, output, png),
            quick=quick,
            fresh=fresh,
            tell=lambda done, of, _: counting.count(done, of),
        )
    if recipe is not None:
        note(f"recipe       {recipe}{', in place of the one that was there' if replaced else ''}")
    if png is not None:
        write_png(swept.points, swept.recommended, png)
        note(f"picture      {png}")
    show(lay_out_frontier(swept), output=output, as_json=as_json)


def _read_target(force_error: str | None, budget: str | None) -> "Target":
    from cbsr_qa.studies.frontier.recommend import Target

    return Target(
        _amount("--force-error", force_error, _NEWTONS, "a force above 0 with its unit, e.g. 0.5N or 80mN"),
        _amount("--budget", budget, _SECONDS, "a time above 0 with its unit, e.g. 20min, 1.5h or 900s"),
    )


def _study_stored(
    selection: "RunSelection",
    force_error: str | None,
    budget: str | None,
    database: str | None,
    recipe: Path | None,
    *,
    fresh: bool,
) -> "CommandOutcome[Frontier]":
    from cbsr_qa.studies.frontier.stored.report import lay_out_stored
    from cbsr_qa.studies.frontier.stored.study import study_stored

    target = _read_target(force_error, budget)
    with Counting("stored runs") as counting:
        counting.stage("what accuracy costs in stored runs")
        frontier = study_stored(
            selection,
            target,
            database=database,
            recipe=recipe,
            fresh=fresh,
            tell=lambda done, of, _: counting.count(done, of),
        )
    return lay_out_stored(frontier)


def _study_presses(files: "PressFiles", target_mm: float | None, *, quick: bool) -> "CommandOutcome[Frontier]":
    from cbsr_qa.analysis.recording.press_files import read_labelled_presses
    from cbsr_qa.studies.frontier.presses.report import lay_out_presses
    from cbsr_qa.studies.frontier.presses.study import study_presses

    with Counting("draws of presses") as counting:
        counting.stage("what accuracy costs in presses")
        labelled, _ = read_labelled_presses(files)
        swept = study_presses(labelled, target_mm, quick=quick, tell=lambda done, of, _: counting.count(done, of))
    return lay_out_presses(swept, files.readings.name, target_mm)


def _refuse(wrong: Set[str], why: str) -> None:
    if wrong:
        raise RefusedError(f"{option_names(sorted(wrong))} {why}", remedy="leave it out, or ask in two commands")


def _amount(option: str, text: str | None, units: Mapping[str, float], wanted: str) -> float | None:
    if text is None:
        return None
    match = re.fullmatch(rf"\s*(\d+(?:\.\d+)?)\s*({'|'.join(units)})\s*", text)
    value = float(match[1]) * units[match[2]] if match else 0.0
    if value <= 0:
        raise RefusedError(f"{option} is {text!r}", remedy=f"give {wanted}")
    return value
