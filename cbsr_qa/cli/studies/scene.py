"""``cbsr-qa scene``: what a simulated world contains, and a recording of it."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson
from cbsr_qa.cli.output import Counting, say, show

group("scene", "Explain simulated scenes, and record them.")

_Scene = Annotated[str, typer.Argument(help="Scene file, or the name of a shipped one.", metavar="FILE")]


@command("scene run", prints="cbsr_qa.studies.scenes.run:SceneRun")
def run(
    scene: _Scene,
    output: Annotated[
        Path | None,
        typer.Option(help="HDF5 file to write; must not exist yet. By default var/scenes/SCENE-seedN.h5."),
    ] = None,
    format_: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="NAME",
            help="Write this format too, to a file beside it, e.g. ert-board-csv; repeatable.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**31 - 1, help="Seed of everything random; by default the scene's own.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a scene's sensor, loads and effects, and write what its station would have recorded.

    Only effects that are on are imported. The same scene and seed give the same bytes on any number of cores.
    """
    from cbsr_qa.studies.scenes.report import scene_outcome
    from cbsr_qa.studies.scenes.run import SceneRunRequest, run_scene

    request = SceneRunRequest(scene, output, tuple(format_ or ()), seed)
    with Counting("frames") as counting:
        recorded = run_scene(request, tell=counting.stage, progress=counting.count)
    show(scene_outcome(recorded), as_json=as_json)
    if not as_json:
        say(f"try: {recorded.analyse}")  # on one line, to be copied


@command("scene explain", prints="cbsr_qa.studies.scenes.explain:Explained")
def explain(
    scene: _Scene,
    no_measure: Annotated[bool, typer.Option("--no-measure", help="Do not measure what effects cost.")] = False,
    as_json: AsJson = False,
) -> None:
    """Say which effects of a scene are on and what each costs, which are off, and what is not modelled.

    The cost of an effect is its own computing time per frame. Of an effect that changes how much has to be solved, it
    is the difference between frames with and without it and the effects that need it.
    """
    from cbsr_qa.studies.scenes.explain import explain_scene
    from cbsr_qa.studies.scenes.report import explain_outcome

    with Counting("measurements") as counting:
        explained = explain_scene(scene, measure=not no_measure, tell=counting.stage, progress=counting.count)
    show(explain_outcome(explained), as_json=as_json)
