"""``cbsr-qa scene``: what a simulated world contains, and a recording of it."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.output import Counting, say, show

app = typer.Typer(help="What a simulated world contains, and a recording of it.", no_args_is_help=True)

_Scene = Annotated[str, typer.Argument(help="Scene file, or the name of a shipped one.", metavar="FILE")]
_Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


@app.callback()
def _group() -> None:
    """What a simulated world contains, and a recording of it."""


@app.command("run")
def run(
    scene: _Scene,
    output: Annotated[
        Path | None,
        typer.Option(help="HDF5 file to write; must not exist yet. By default var/scenes/<scene>-seed<seed>.h5."),
    ] = None,
    format_: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="NAME",
            help="Also in this format, to a file beside it, e.g. ert-board-csv; repeatable.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**31 - 1, help="Of all that is random; by default the scene's own.")
    ] = None,
    as_json: _Json = False,
) -> None:
    """Simulate a scene's sensor, loads and effects, and write what its station would have recorded.

    Only effects that are on are imported. The same scene and seed give the same bytes on any number of cores.
    """
    from cbsr_qa.studies.scenes import SceneRunRequest, run_scene, scene_outcome

    request = SceneRunRequest(scene, output, tuple(format_ or ()), seed)
    with Counting("frames") as counting:
        recorded = run_scene(request, tell=counting.stage, progress=counting.count)
    show(scene_outcome(recorded), as_json=as_json)
    if not as_json:
        say(f"try: {recorded.analyse}")  # on one line, to be copied


@app.command("explain")
def explain(
    scene: _Scene,
    no_measure: Annotated[
        bool, typer.Option("--no-measure", help="Do not take frames to measure what effects cost.")
    ] = False,
    as_json: _Json = False,
) -> None:
    """Say which effects of a scene are on and what each costs, which are off, and what is not modelled.

    An effect's cost is the time within it and, where it changes how much is solved, the difference of the whole frame
    with and without it and those that need it.
    """
    from cbsr_qa.studies.scenes import explain_scene, explained_outcome

    with Counting("measurements") as counting:
        explained = explain_scene(scene, measure=not no_measure, tell=counting.stage, progress=counting.count)
    show(explained_outcome(explained), as_json=as_json)
