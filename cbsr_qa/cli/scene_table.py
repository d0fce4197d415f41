"""The words of ``cbsr-qa scene explain``: a table of effects that fits a page of a hundred columns."""

import json
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from cbsr_qa.config import echo

if TYPE_CHECKING:
    from cbsr_qa.app.scene_explain import Explained, ExplainedEffect

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
    from cbsr_qa.simulate.chain import STAGES

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
