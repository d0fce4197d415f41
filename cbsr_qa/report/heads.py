"""The head of a report: the banner, its subject, and what was simulated."""

from collections.abc import Iterable, Sequence
from typing import Final, TypeVar

from cbsr_qa.domain.plan.limits import FailureCode, Outcome
from cbsr_qa.domain.results.findings import RecordingResult
from cbsr_qa.domain.results.measurement import explain_verdict
from cbsr_qa.domain.results.report import Banner, Page
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.tables import capital, duration, list_names, plural
from cbsr_qa.system.clock import write_local_time

_SYMBOLS: Final = {
    Outcome.PASS: "✓",
    Outcome.MARGINAL: "≈",
    Outcome.FAIL: "✗",
    Outcome.NOT_MEASURED: "?",
    Outcome.NOT_JUDGED: "–",
}

#: Headline of a run that did not finish, which its verdict alone would hide.
_ENDS: Final = {
    EndReason.RUNNING: "The run is incomplete: it began and did not end",
    EndReason.ABORTED: "The run was aborted",
    EndReason.BROKEN: "The run broke off",
}


R = TypeVar("R")
Facts = Sequence[tuple[str, str]]

#: Clock of a recording's times, if not the computer's.
_CLOCKS = {"given": "that of the given times", "none": "no time recorded", "documented": "as the format documents it"}


def run_page(result: RunResult) -> Page:
    """Return the head of a run's report."""
    record, identity, banner = result.record, result.record.identity, _verdict(result)
    facts = (
        ("Sensor", identity.sensor.serial),
        ("Batch", identity.sensor.batch or "not stated"),
        *([("Parts", ", ".join(map(str, identity.parts)))] if identity.parts else []),
        ("Type", identity.sensor.sensor_type),
        ("Material", record.material.name),
        ("Station", identity.station),
        ("Recipe", identity.recipe),
        ("Operator", identity.operator or "not stated"),
        ("Started", write_local_time(identity.started_at)),
        ("Run", identity.run),
        ("Station time", duration(record.station_s)),
        _describe_issued(result),
        *_tries(result),
        *([] if banner.actions else list_codes(result.failure_codes)),
    )
    observed = result.observation.warnings if result.observation else ()
    warnings = tuple(dict.fromkeys((*_overridden(result), *result.warnings, *observed)))
    return Page("Test report", identity.sensor.serial, banner, facts, identity.simulated, warnings)


def list_codes(codes: Iterable[FailureCode]) -> list[tuple[str, str]]:
    """Return a fact for each failure code: what failed, and what is done with the sensor."""
    return [("Failure code", code.words) for code in codes]


def _describe_issued(result: RunResult) -> tuple[str, str]:
    """Return what a run issued: a calibration, or a material file where a material was characterised."""
    characterised = result.characterisation
    if characterised is None:
        signature = result.calibration.signature if result.calibration else None
        issued = f"issued, signed by {signature.words}" if signature else "issued"
        return "Calibration", issued if result.calibration else f"none: {result.calibration_words}"
    passed = result.verdict.outcome in (Outcome.PASS, Outcome.MARGINAL)
    reason = next(iter(characterised.refused), "" if passed else "the run did not pass")
    return "Material file", f"none: {reason}" if reason else "issued"


def _tries(result: RunResult) -> tuple[tuple[str, str], ...]:
    """Number of this try of the recipe, and the sensor's runs that began before this one."""
    history = result.sensor_history
    if history is None:
        return ()
    return (("Earlier runs", history.words or "none of this sensor in the database"),)


def recording_page(result: RecordingResult) -> Page:
    """Return the head of a recording's report."""
    recording, count = result.recording, len(result.events)
    rate = result.frame_rate_hz
    sensor_type = recording.sensor_type or "not stated: lengths are in units of the radius"
    if result.sensor_type is not None:
        sensor_type = result.sensor_type.name
    facts = [
        ("File", recording.path.name),
        *((("Data set", recording.dataset),) if recording.dataset else ()),
        ("Format", recording.format),
        *((("Sensor", recording.serial),) if recording.serial is not None else ()),
        ("Sensor type", sensor_type),
        ("Frames", str(len(recording.frames))),
        ("Frame rate", "none: still images" if rate is None else f"{rate:.3g} frames/s"),
        ("Clock", _CLOCKS.get(recording.clock, f"the {recording.clock}'s")),
        ("Rows rejected", str(recording.rows_rejected)),
        ("Force", "recorded" if any(s.channel == "force" for s in recording.samples) else "not recorded"),
    ]
    if result.imaging is not None:
        name = result.imaging.reconstruction.name
        facts.append(("Images by", name if count else f"{name}: nothing was imaged"))
    headline = f"{plural(count, 'event')} found" if count else "no event"
    banner = Banner("plain", "●" if count else "○", headline, _describe_strongest(result))
    return Page(
        "Recording report", recording.path.name, banner, tuple(facts), recording.simulated, (), result.warnings
    )


def _verdict(result: RunResult) -> Banner:
    outcome, end = result.verdict.outcome, result.record.end
    tone = "plain" if outcome is Outcome.NOT_JUDGED else outcome.value.replace(" ", "-")
    reason = explain_verdict(result.verdict, result.measurements)
    if end in _ENDS:
        # An unfinished run is never judged: how it ended is the one reason.
        detail = f": {result.record.end_detail}" if result.record.end_detail else ""
        reason = f"{_ENDS[end]}{detail}"
    headline = "MARGINAL PASS" if outcome is Outcome.MARGINAL else outcome.value.upper()
    if result.overrides:
        latest = result.overrides[-1]
        headline += f", overridden to {latest.outcome.value.upper()} by {latest.by}"
    final = result.overrides[-1].outcome if result.overrides else outcome
    let_through = final in (Outcome.PASS, Outcome.MARGINAL)
    actions = () if let_through else tuple(code.words for code in result.failure_codes)
    return Banner(tone, _SYMBOLS[outcome], headline, reason, actions, _describe_failed_runs(result))


def _describe_failed_runs(result: RunResult) -> str:
    """Say that earlier tests of the sensor with the recipe failed, and on which days; empty if none did."""
    history = result.sensor_history
    if history is None or not history.failed_runs:
        return ""
    days = list_names(list(dict.fromkeys(f"{run.started_at.astimezone():%Y-%m-%d}" for run in history.failed_runs)))
    again = " as well" if result.verdict.outcome is Outcome.FAIL else ""
    return f"{capital(history.ordinal)} test with this recipe; failed on {days}{again}."


def _overridden(result: RunResult) -> tuple[str, ...]:
    """Report an override of the verdict; its history is under Traceability."""
    if not result.overrides:
        return ()
    decided = f"The verdict was {result.overrides[-1].words}"
    return (f"{decided}. What was measured and found is unchanged, and an override issues no calibration.",)


def _describe_strongest(result: RecordingResult) -> str:
    if not result.events:
        return result.events_why
    strongest = max(result.events, key=lambda event: event.snr)
    sense = "conducts more" if strongest.sign > 0 else "conducts less"
    time_words = f" at {strongest.peak_s:.1f} s"
    if result.frame_rate_hz is None:
        time_words = f" in row {round(strongest.peak_s) + 1}" if result.recording.rows else ""
    moves = "" if strongest.motion is None else f"; it moves: {strongest.motion.words}"
    return f"the clearest{time_words} near {strongest.place}: the place {sense}, SNR {strongest.snr:.3g}{moves}"
