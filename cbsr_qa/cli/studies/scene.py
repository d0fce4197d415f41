"""The words of ``cbsr-qa scene explain``: a table of effects that fits a page of a hundred columns.

``cbsr-qa scene``: what a simulated world contains, and a recording of it.
"""

import json
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cbsr_qa.cli.output import Counting, emit_json, note, say
from cbsr_qa.config import text as echo

if TYPE_CHECKING:
    from cbsr_qa.studies.scenes import Explained, ExplainedEffect, SceneRun


WIDTH = 100
_STAGE = 10  # "impedance" and a space
_MOST = 5  # signs of a bar, of an effect that costs as much as a whole frame
_COST = 8 + 1 + _MOST  # milliseconds, and a bar or the word "once"
#: Effects of these stages act as the sheet is made, as heads move or before frames are written, and not in a frame.
_ONCE_STAGES = ("sheet", "position", "geometry", "recording")


def lines(explained: "Explained") -> Iterator[str]:
    """Lay out what a scene contains, one line after another."""
    on = in_order_of_stage(effect for effect in explained.effects if effect.on)
    off = [effect for effect in explained.effects if not effect.on]
    yield f"scene {explained.scene}: {len(on)} of {counted(len(on) + len(off), 'effect')} on"
    names = 2 + max((len(effect.name) for effect in explained.effects), default=0)
    yield from _on(on, explained.frame_ms, names)
    if off:
        yield "off"
    for effect in off:
        yield from _hanging(f"  {effect.name:<{names}}", [_off_words(effect)])
    yield from _totals(explained, once=any(effect.perturbs in _ONCE_STAGES for effect in on))
    yield "not modelled"
    for what in explained.not_modelled:
        yield from _hanging("  ", [what])


def in_order_of_stage(effects: Iterable["ExplainedEffect"]) -> list["ExplainedEffect"]:
    """Sort effects as a world comes to them; within a stage the scene's order stays."""
    from cbsr_qa.simulate import STAGES

    return sorted(effects, key=lambda effect: STAGES.index(effect.perturbs))


def counted(count: int, noun: str) -> str:
    """Say how many there are."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _on(on: list["ExplainedEffect"], frame_ms: float | None, names: int) -> Iterator[str]:
    """Effects that are on, in order of stage, which stands at the first of each."""
    if not on:
        return
    costs = "" if frame_ms is None else f"{'ms/frame':<{_COST}}  "
    yield f"{'on':<{_STAGE + 2}}{'':<{names}}{costs}parameters, needs"
    last = ""
    for effect in on:
        stage, last = ("" if effect.perturbs == last else effect.perturbs), effect.perturbs
        cost = "" if frame_ms is None else f"{_cost(effect, frame_ms):<{_COST}}  "
        yield from _hanging(f"  {stage:<{_STAGE}}{effect.name:<{names}}{cost}", _settings(effect))


def _cost(effect: "ExplainedEffect", frame_ms: float) -> str:
    """Milliseconds a frame with a bar as long as their share of a whole one, or what happens once a scene."""
    if effect.perturbs in _ONCE_STAGES:
        return f"{_milliseconds(effect.once_ms or 0.0):>8} once"
    each_ms = effect.each_ms or 0.0
    share = each_ms / frame_ms if frame_ms > 0 else 0.0
    return f"{_milliseconds(each_ms):>8} {'#' * min(round(_MOST * share), _MOST)}"


def _milliseconds(cost_ms: float) -> str:
    return "< 0.001" if cost_ms < 0.0005 else f"{cost_ms:.3f}"


def _settings(effect: "ExplainedEffect") -> list[str]:
    given = [f"{key} = {plainly(value)}" for key, value in effect.parameters.items()]
    return given + ([f"needs {', '.join(effect.needs)}"] if effect.needs else [])


def plainly(value: Any) -> str:
    """A parameter as people write it in a scene file."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {plainly(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(plainly(each) for each in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return re.sub(r"e\+?(-?)0*", r"e\1", echo.plainly(value))
    return json.dumps(value, ensure_ascii=not value.isprintable()) if isinstance(value, str) else str(value)


def _off_words(effect: "ExplainedEffect") -> str:
    return effect.does or (f"perturbs {effect.perturbs}" if effect.perturbs else "")


def _totals(explained: "Explained", *, once: bool) -> Iterator[str]:
    if explained.frame_ms is None:
        yield "costs not measured"
        return
    recording = ""
    if explained.frames and explained.compute_s is not None:
        recording = f"; {counted(explained.frames, 'frame')} of the recording about {explained.compute_s:.2g} s"
    yield f"a frame takes {_milliseconds(explained.frame_ms)} ms{recording}"
    yield from _hanging("  ", [f"measured with {explained.measured_with}"])
    if once:
        yield "  once: in all, as the sheet is made, as heads move or before frames are written"


def _printable(words: str) -> str:
    """Words that may be anybody's, without what a terminal takes for commands."""
    return "".join(sign if sign.isprintable() else "\N{REPLACEMENT CHARACTER}" for sign in words.expandtabs(1))


def _hanging(head: str, parts: Iterable[str]) -> Iterator[str]:
    """A head with parts behind it, two spaces apart, and what does not fit below them."""
    rows: list[str] = []
    room = max(WIDTH - len(head), 20)
    for part in map(_printable, parts):
        if rows and len(rows[-1]) + 2 + len(part) <= room:
            rows[-1] += f"  {part}"
        else:
            rows += textwrap.wrap(part, room, break_long_words=False, break_on_hyphens=False)
    yield (head + (rows[0] if rows else "")).rstrip()
    for row in rows[1:]:
        yield " " * len(head) + row


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
    from cbsr_qa.studies.scenes import SceneRunRequest, run_scene

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
    from cbsr_qa.studies.scenes import explain_scene

    with Counting("measurements") as counting:
        explained = explain_scene(scene, measure=not no_measure, tell=counting.stage, progress=counting.count)
    if as_json:
        emit_json(explained.document())
    else:
        for line in lines(explained):
            say(line)
