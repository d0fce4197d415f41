"""``cbsr-qa scene``: what a simulated world contains, and a recording of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.counting import Counting
from cbsr_qa.cli.output import emit_json, note, say
from cbsr_qa.cli.scene_table import counted, lines

if TYPE_CHECKING:
    from cbsr_qa.app.scene_run import SceneRun

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
    from cbsr_qa.app.scene_run import SceneRunRequest, run_scene

    request = SceneRunRequest(scene, output, tuple(format_ or ()), seed)
    with Counting("frames") as counting:
        done = run_scene(request, tell=counting.stage, progress=counting.count)
    for remark in done.remarks.values():
        note(f"note: {remark}")
    if as_json:
        emit_json(done.document())
    else:
        _show_run(done)


def _show_run(done: "SceneRun") -> None:
    document = done.document()
    simulated = f"{document['sensor_type']} of {document['material']}, {counted(len(document['effects']), 'effect')}"
    say(f"scene {document['scene']}, seed {done.seed}: {simulated}")
    frames = f"{counted(document['frames'], 'frame')} in {document['duration_s']:g} s"
    dumps = f", {counted(document['dumps'], 'watchdog dump')}" if document["dumps"] else ""
    lost = f", {document['frames_lost']} of them cut" if document["frames_lost"] else ""
    say(f"{frames}{lost}{dumps}; {counted(len(document['loads']), 'load')}")
    for file in done.files:
        say(f"{file.format}: {file.path}")
        for what in file.notes:
            say(f"  {what}")
    say(f"try: {done.analyse_command()}")


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
    from cbsr_qa.app.scene_explain import explain_scene

    with Counting("measurements") as counting:
        explained = explain_scene(scene, measure=not no_measure, tell=counting.stage, progress=counting.count)
    if as_json:
        emit_json(explained.document())
    else:
        for line in lines(explained):
            say(line)
