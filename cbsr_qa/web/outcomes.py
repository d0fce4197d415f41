"""How runs ended, in the words, signs and sounds of pages."""

from datetime import UTC, datetime
from typing import Final

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.listed import ALTERED, ListedRun
from cbsr_qa.domain.run.states import EndReason, name_stopper, was_emergency
from cbsr_qa.store.runs.live import RunLook
from cbsr_qa.system.clock import write_local_time
from cbsr_qa.web.state import Mode, Snapshot
from cbsr_qa.web.texts import text

#: Outcomes of which the limits that decided them are shown.
SHOWN_OUTCOMES: Final = (Outcome.FAIL, Outcome.NOT_MEASURED, Outcome.MARGINAL)
#: Sign of each kind of badge.
SIGNS: Final = {
    "pass": "pass",
    "marginal": "marginal",
    "fail": "fail",
    "standing": "warn",
    "not_measured": "unknown",
    "not_judged": "unknown",
    "none": "unknown",
    "altered": "warn",
    "aborted": "stop",
    "emergency": "warn",
    "unsafe": "warn",
    "broken": "warn",
    "ready": "ready",
    "done": "ready",
    "starting": "wait",
    "running": "run",
    "paused": "pause",
    "asking": "unknown",
    "concluding": "wait",
    "interrupted": "warn",
    "held": "wait",
    "open": "ready",
    "pressed": "pressed",
    "passed": "pass",
    "warned": "warn",
    "refused": "fail",
    "overridden": "marginal",
    "off": "ready",
    "may": "run",
    "again": "unknown",
}


def verdict_kind(look: RunLook | None) -> str:
    """Return the kind of a run's result, a key of :data:`SIGNS`."""
    if look is None:
        return "none"
    if look.altered:
        return ALTERED
    return _kind_of_end(look.end, look.detail) or _kind_of_verdict(look.verdict)


def kind_of_sensor(snapshot: Snapshot) -> str:
    """Return the kind of what is said of the sensor at a station, a key of :data:`SIGNS`.

    A sensor that passed is no good part while its failure with another recipe stands.
    """
    return "standing" if snapshot.standing_failure is not None else verdict_kind(snapshot.look)


def kind_of_result(run: ListedRun, in_progress: frozenset[str]) -> str:
    """Return the kind of a listed run's result, a key of :data:`SIGNS`."""
    if run.run in in_progress:
        return "running"
    if run.altered:
        return ALTERED
    return _kind_of_end(run.end, run.end_detail) or _kind_of_verdict(run.verdict)


def _kind_of_end(end: EndReason, detail: str) -> str:
    """Return the kind of an end; empty for that of a finished run, of which the verdict counts."""
    if end is EndReason.RUNNING:
        return "interrupted"
    if end is EndReason.ABORTED:
        return "emergency" if was_emergency(detail) else str(end)
    return str(end) if end is EndReason.BROKEN else ""


def _kind_of_verdict(verdict: Outcome | None) -> str:
    return "none" if verdict is None else str(verdict).replace(" ", "_")


def cue(snapshot: Snapshot | None) -> str:
    """Return the sound that belongs to what a station shows, and what makes it another one; empty for silence."""
    if snapshot is None:
        return ""
    look, mode = snapshot.look, snapshot.mode
    if mode is Mode.ASKING and snapshot.control is not None and snapshot.control.prompt is not None:
        return f"attention {snapshot.control.run} {snapshot.control.prompt.number}"
    if snapshot.trouble and mode is Mode.RUNNING:
        return "attention trouble"
    if look is None or mode not in (Mode.CONCLUDING, Mode.DONE, Mode.UNSAFE, Mode.INTERRUPTED):
        return ""
    if mode is Mode.CONCLUDING or snapshot.not_started:
        return f"end {look.run} {look.session_at} {snapshot.not_started}"
    kind = kind_of_sensor(snapshot)
    sounds = {"pass": "pass", "marginal": "pass", "fail": "fail", "aborted": "end"}
    return f"{sounds.get(kind, 'attention')} {look.run} {look.session_at}"


def standing_words(failed: RunLook, recipe: str) -> str:
    """Return that a sensor's failure stands, though it passed with this recipe."""
    return text(
        "failed.stands",
        recipe=failed.recipe,
        station=failed.station,
        ago=ago_words(failed.worked_at),
        passed=recipe,
    )


def ago_words(moment: datetime) -> str:
    """Return how long ago something was, to the minute or hour; the time itself after a day, or if it is to come."""
    past_s = (datetime.now(UTC) - moment).total_seconds()
    if not 0 <= past_s < 86_400:
        return text("ago.at", when=write_local_time(moment))
    if past_s < 60:
        return text("ago.now")
    if past_s < 3600:
        return text("ago.minutes", count=int(past_s // 60))
    return text("ago.hours", count=int(past_s // 3600))


def earlier_words(look: RunLook) -> str:
    """Return what an earlier run of a sensor came to, with which recipe, where, and how long ago."""
    return text(
        "gate.earlier",
        outcome=text(f"outcome.{verdict_kind(look)}"),
        recipe=look.recipe,
        station=look.station,
        ago=ago_words(look.worked_at),
    )


def reason_words(look: RunLook | None) -> str:
    """Return who stopped a run, or what broke it; the reason of its verdict if it was not cut off."""
    if look is None:
        return ""
    if look.end is EndReason.ABORTED and look.detail:
        return text("station.stopped_by", who=name_stopper(look.detail))
    return look.detail if look.end is EndReason.BROKEN and look.detail else describe_decision(look)


def describe_decision(run: RunLook | ListedRun) -> str:
    """Return the reason of the verdict that counts: that of its override, if it has one."""
    if run.decision is None:
        return run.reason
    return text("outcome.overridden", by=run.decision.operator, why=run.decision.why)
