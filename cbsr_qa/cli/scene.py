"""``cbsr-qa scene``: what a simulated world contains, and a recording of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.counting import Counting
from cbsr_qa.cli.output import emit_json, note, say

if TYPE_CHECKING:
    from cbsr_qa.app.scene_explain import Explained, ExplainedEffect
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
    simulated = f"{document['sensor_type']} of {document['material']}, {_counted(len(document['effects']), 'effect')}"
    say(f"scene {document['scene']}, seed {done.seed}: {simulated}")
    frames = f"{_counted(document['frames'], 'frame')} in {document['duration_s']:g} s"
    dumps = f", {_counted(document['dumps'], 'watchdog dump')}" if document["dumps"] else ""
    lost = f", {document['frames_lost']} of them cut" if document["frames_lost"] else ""
    say(f"{frames}{lost}{dumps}; {_counted(len(document['loads']), 'load')}")
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
        _show_explained(explained)


def _show_explained(explained: "Explained") -> None:
    on = [effect for effect in explained.effects if effect.on]
    off = [effect for effect in explained.effects if not effect.on]
    say(f"scene {explained.scene}: {len(on)} of {_counted(len(on) + len(off), 'effect')} on")
    say(f"measured with {explained.measured_with}" if explained.frame_ms is not None else "costs not measured")
    for effect in on:
        _show_effect(effect)
    if explained.frame_ms is not None:
        say(f"a frame takes {explained.frame_ms:.3g} ms{_estimate(explained)}")
    if off:
        say("off:")
    for effect in off:
        _show_effect(effect)
    say("not modelled:")
    for what in explained.not_modelled:
        say(f"  {what}")


def _show_effect(effect: "ExplainedEffect") -> None:
    cost = "" if not effect.on or effect.cost_ms is None else f"  {effect.cost_ms:.3g} ms a frame"
    given = "".join(f"  {key} = {_plainly(value)}" for key, value in effect.parameters.items())
    needs = f", needs {', '.join(effect.needs)}" if effect.needs else ""
    say(f"  {effect.name}{cost}{given}")
    say(f"      perturbs {effect.perturbs}{needs}: {effect.does}")


def _plainly(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _estimate(explained: "Explained") -> str:
    if not explained.frames or explained.compute_s is None:
        return ""
    return f"; {explained.frames} frames of the recording take about {explained.compute_s:.3g} s to simulate"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
