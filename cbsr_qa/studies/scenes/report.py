"""Report of a scene: its effects with their costs and parameters, or its recording."""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from cbsr_qa.config import text as echo
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Paragraph, Section, Table
from cbsr_qa.report.tables import plural, text_table
from cbsr_qa.simulate.chain import STAGES
from cbsr_qa.studies.scenes.explain import Explained, ExplainedEffect
from cbsr_qa.studies.scenes.run import SceneRun

_NONE: Final = "–"
#: Effects of these stages act when the sheet is made, when heads move or before frames are written, not within a
#: frame.
_ONCE_STAGES: Final = ("sheet", "position", "geometry", "recording")
_COLUMNS: Final = ("stage", "effect", "ms/frame", "share", "parameters; needs")
_BAR: Final = 5  # characters of the bar of an effect that costs as much as a whole frame

# Sentences, in reading order.
_ON: Final = "{on} of {effects} on"
_NOT_MEASURED: Final = "costs not measured"
_FRAME: Final = "a frame takes {frame} ms{recording}"
_RECORDING: Final = "; {frames} of the recording about {seconds:.2g} s"
_ORDER: Final = "In order of stage."
_ONCE: Final = " Once: in all, as the sheet is made, as heads move or before frames are written."
_OFF: Final = "What each would do."
_FRAMES: Final = "{frames} in {seconds:g} s"
_LOST: Final = "{lost} of them cut, "
_DUMPS: Final = "{dumps}, "
_SEEDED: Final = "{scene}, seed {seed}"
_SENSOR: Final = "{sensor_type} of {material}, {effects}"


def explain_outcome(explained: Explained) -> CommandOutcome[Explained]:
    """Lay out what a scene contains."""
    effects_on = sorted((e for e in explained.effects if e.on), key=lambda effect: STAGES.index(effect.perturbs))
    effects_off = [effect for effect in explained.effects if not effect.on]
    sections = [Section("On", (_make_effects_table(effects_on, explained.frame_ms),))] if effects_on else []
    if effects_off:
        rows = [(e.name, e.does or (f"perturbs {e.perturbs}" if e.perturbs else "")) for e in effects_off]
        sections.append(Section("Off", (text_table(_OFF, ("effect", "what it does"), rows),)))
    sections.append(Section("Not modelled", tuple(map(Paragraph, explained.not_modelled))))
    headline = _ON.format(on=len(effects_on), effects=plural(len(explained.effects), "effect"))
    facts = [("Scene", explained.scene)]
    facts += [("Measured with", explained.measured_with)] if explained.measured_with else []
    page = Page("Scene", explained.scene, Banner("plain", _NONE, headline, _total(explained)), tuple(facts), (), ())
    return CommandOutcome(explained, page, tuple(sections))


def _total(explained: Explained) -> str:
    if explained.frame_ms is None:
        return _NOT_MEASURED
    recording = ""
    if explained.frames and explained.compute_s is not None:
        recording = _RECORDING.format(frames=plural(explained.frames, "frame"), seconds=explained.compute_s)
    return _FRAME.format(frame=_milliseconds(explained.frame_ms), recording=recording)


def _make_effects_table(effects: Sequence[ExplainedEffect], frame_ms: float | None) -> Table:
    """Effects in order of stage, which is given for the first of each."""
    columns = (*_COLUMNS[:2], *_COLUMNS[4:]) if frame_ms is None else _COLUMNS
    rows, last_stage = [], ""
    for effect in effects:
        stage, last_stage = "" if effect.perturbs == last_stage else effect.perturbs, effect.perturbs
        cost = () if frame_ms is None else _cost(effect, frame_ms)
        needs = f"needs {', '.join(effect.needs)}" if effect.needs else ""
        rows.append((stage, effect.name, *cost, "; ".join(filter(None, (_parameters(effect.parameters), needs)))))
    once = frame_ms is not None and any(effect.perturbs in _ONCE_STAGES for effect in effects)
    return text_table(_ORDER + _ONCE * once, columns, rows, () if frame_ms is None else (2,))


def _cost(effect: ExplainedEffect, frame_ms: float) -> tuple[str, str]:
    """Milliseconds per frame and a bar for their share of a whole frame, or the cost once per scene."""
    if effect.perturbs in _ONCE_STAGES:
        return _milliseconds(effect.once_ms or 0.0), "once"
    each_ms = effect.each_ms or 0.0
    share = each_ms / frame_ms if frame_ms > 0 else 0.0
    return _milliseconds(each_ms), "#" * min(round(_BAR * share), _BAR)


def _milliseconds(cost_ms: float) -> str:
    return "< 0.001" if cost_ms < 0.0005 else f"{cost_ms:.3f}"


def _parameters(parameters: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {plainly(value)}" for key, value in parameters.items())


def plainly(value: Any) -> str:
    """Format a parameter as written in a scene file."""
    if isinstance(value, Mapping):
        return f"{{{_parameters(value)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(plainly, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return re.sub(r"e\+?(-?)0*", r"e\1", echo.plainly(value))
    return json.dumps(value, ensure_ascii=not value.isprintable()) if isinstance(value, str) else str(value)


def scene_outcome(run: SceneRun) -> CommandOutcome[SceneRun]:
    """Lay out the recording, with the losses of each format."""
    headline = _FRAMES.format(frames=plural(run.frames, "frame"), seconds=run.duration_s)
    reason = _LOST.format(lost=run.frames_lost) if run.frames_lost else ""
    reason += _DUMPS.format(dumps=plural(run.dumps, "watchdog dump")) if run.dumps else ""
    sensor = _SENSOR.format(
        sensor_type=run.sensor_type, material=run.material, effects=plural(len(run.effects), "effect")
    )
    facts = (("Scene", _SEEDED.format(scene=run.scene, seed=run.seed)), ("Sensor", sensor))
    remarks = tuple(load.remark for load in run.loads if load.remark is not None)
    banner = Banner("plain", _NONE, headline, reason + plural(len(run.loads), "load"))
    sections = tuple(
        Section(file.format, (Paragraph(file.path), *(Paragraph(note, "note") for note in file.notes)))
        for file in run.files
    )
    return CommandOutcome(run, Page("Scene", run.scene, banner, facts, (), (), remarks), sections)
