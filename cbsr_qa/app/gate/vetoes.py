"""Vetoes of plugins: the hook ``cbsr_before_run``."""

from cbsr_qa.app.gate.request import Asked, Finding
from cbsr_qa.plugin.hooks import Veto
from cbsr_qa.system.words import echo, printable

#: Longer texts of plugins are cut [characters].
_LONGEST = 300


def plugins_agree(asked: Asked) -> Finding:
    """Ask every plugin with the hook; one that does not answer has not agreed."""
    answers = asked.plugins.ask(
        "cbsr_before_run",
        asked.settings.before_run_s,
        sensor=asked.sensor,
        station=asked.configuration.station.name,
        recipe=asked.configuration.recipe.name,
        operator=asked.request.operator,
    )
    if not answers:
        return Finding(None, "no plugin is asked before a run")
    objections = [objection for answer in answers if (objection := _objection(*answer)) is not None]
    if not objections:
        return Finding(True, f"no objection: {', '.join(sorted(name for name, _, _ in answers))}")
    reasons, remedies = zip(*objections, strict=True)
    return Finding(False, "; ".join(reasons), "; ".join(filter(None, remedies)))


def _objection(plugin: str, answer: object, why_none: str) -> tuple[str, str] | None:
    """Return what speaks against the run, and the remedy; None if nothing does."""
    if why_none:
        return f"plugin {plugin} could not answer: {why_none}", "repair or uninstall that plugin"
    if answer is None:
        return None
    if not isinstance(answer, Veto) or not all(
        isinstance(text, str) for text in (answer.name, answer.reason, answer.remedy)
    ):
        return f"plugin {plugin} answered {echo(type(answer).__name__)}, which is neither None nor a Veto", ""
    return f"{_cut(answer.name) or plugin}: {_cut(answer.reason) or 'no reason given'}", _cut(answer.remedy)


def _cut(text: str) -> str:
    plain = " ".join(printable(text[: _LONGEST + 1]).split())
    return plain if len(plain) <= _LONGEST else f"{plain[:_LONGEST]}…"
