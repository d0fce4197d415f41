"""Changes of configuration files, control limits and verdicts; overriding a verdict."""

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final

from cbsr_qa.app.command_hints import report_command
from cbsr_qa.app.run.decided_again import check_decided, judging_recipe
from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import validate_operator, validate_reason
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.charts import ChartReference
from cbsr_qa.domain.results.report import CommandOutcome, Paragraph, Section
from cbsr_qa.domain.run.changes import NO_REASON, ConfigurationChange, VerdictOverride
from cbsr_qa.domain.run.run import run_named
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import number, plural, unit_shown
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.results.reanalyses import AdoptedRuns

_UNCHANGED: Final = "no file was changed, no limits of a control chart set, and no verdict overridden"
_PLURALS: Final = {"analysis": "analyses"}
_AT: Final = "%Y-%m-%d %H:%M"


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartChange(ChartReference):
    """Limits set for a control chart; ``earlier`` are those before, None for the first."""

    earlier: ChartReference | None


@dataclass(frozen=True, slots=True)
class Changes:
    """All recorded changes, oldest first.

    ``altered``: what is wrong with runs that do not match their chains; nothing of them is in the other lists.
    """

    changes: tuple[ConfigurationChange, ...]
    chart_references: tuple[ChartChange, ...]
    overrides: tuple[VerdictOverride, ...]
    adoptions: tuple[AdoptedRuns, ...]
    altered: tuple[str, ...] = ()


def list_changes(database: str | None) -> CommandOutcome[Changes]:
    """List changes of files and control limits, and overrides. Raise StoreError if the database is unusable."""
    with open_store(database_url(database), create=False) as store:
        charts = tuple(_chart_changes(store.charts.read_all()))
        altered_problems = store.changes.find_altered()
        changes = Changes(
            store.changes.list_all(tuple(altered_problems)),
            charts,
            store.changes.list_overrides(without=tuple(altered_problems)),
            store.reanalyses.list_adoptions(tuple(altered_problems)),
            tuple(altered_problems.values()),
        )
        names = {run.run: run_named(run.serial, run.started_at, run.run) for run in store.runs.find()}
    count_by_noun = {
        "file": len(changes.changes),
        "control chart": len(changes.chart_references),
        "verdict": len(changes.overrides),
        "analysis": sum(adoption.runs for adoption in changes.adoptions),
    }
    counts_text = ", ".join(
        plural(count, noun, _PLURALS.get(noun, "")) for noun, count in count_by_noun.items() if count
    )
    warnings = [f"altered since it was stored, and not listed: {problem}" for problem in changes.altered]
    outcome = answer(changes, f"changes of {counts_text}" if counts_text else _UNCHANGED, warnings=warnings)
    sections = tuple(_sections(changes, lambda run: names.get(run, run)))
    return replace(outcome, sections=sections, exit_code=1 if warnings else 0)


def _chart_changes(references: Iterable[ChartReference]) -> Iterator[ChartChange]:
    """Yield each reference with the one it replaced."""
    latest: dict[tuple[object, ...], ChartReference] = {}
    for reference in references:
        chart = (reference.station, reference.recipe, reference.golden, reference.key, reference.chart)
        yield fill_from_object(ChartChange, reference, why=reference.why or NO_REASON, earlier=latest.get(chart))
        latest[chart] = reference


def _sections(changes: Changes, named: Callable[[str], str]) -> Iterator[Section]:
    """Yield one section per change: what, when, by whom, why, and the earlier state."""
    for file in changes.changes:
        title = f"{file.at:{_AT}}  {file.kind} {file.name}, operator: {file.by or 'not stated'}"
        runs = f"runs: {named(file.run)}; before it {named(file.earlier_run)}"
        content = f"content (SHA-256): {file.old_digest[:12]} → {file.new_digest[:12]}"
        yield _section(title, file.why, runs, content, *(difference.words for difference in file.differences))
    for chart in changes.chart_references:
        title = f"{chart.made_at:{_AT}}  limits of {chart.label}, on station {chart.station}, by {chart.operator}"
        period = f"from {named(chart.first_run)} to {named(chart.last_run)}"
        runs = f"runs: {chart.runs} of recipe {chart.recipe}, {period}"
        verb = "set" if chart.earlier is None else "changed"
        yield _section(title, chart.why, runs, *(f"{verb}: {words}" for words in _differences(chart)))
    for override in changes.overrides:
        title = f"{override.at:{_AT}}  verdict of {named(override.run)}, by {override.by}"
        yield _section(title, override.why, f"{override.verdict} overridden to {override.outcome}")
    for adopted in changes.adoptions:
        name = json.loads(adopted.recipe)["recipe"]["name"]
        title = f"{adopted.first_at:{_AT}}  re-analyses by recipe {name} adopted, by {adopted.operator}"
        yield _section(title, adopted.why, f"{plural(adopted.runs, 'run')}, until {adopted.last_at:{_AT}}")


def _section(title: str, why: str, *lines: str) -> Section:
    return Section(title, tuple(map(Paragraph, (f"why: {why}", *lines))))


def _differences(now: ChartChange) -> Iterator[str]:
    """Yield a chart's new and earlier limits."""
    earlier = now.earlier
    if now.retired:
        yield "retired: nothing is charted against these limits from here on"
        return
    for name in ("mean", "deviation"):
        was = "" if earlier is None else f"{number(getattr(earlier, name), 4)} → "
        yield f"{name} {was}{number(getattr(now, name), 4)} {unit_shown(now.unit)}".rstrip()
    if earlier is not None and earlier.settings != now.settings:
        yield f"settings {_settings(earlier)} → {_settings(now)}"


def _settings(reference: ChartReference) -> str:
    grouped = f"groups of {reference.subgroup}, " if reference.subgroup > 1 else ""
    return f"{grouped}rules {', '.join(map(str, reference.rules))}"


_OUTCOMES: Final = {"pass": Outcome.PASS, "fail": Outcome.FAIL}


@dataclass(frozen=True, slots=True)
class Overridden(VerdictOverride):
    """The override that was stored, the calibration that the run issued, and what becomes of it (``note``).

    Parameters
    ----------
    standing_certificates : numbers of certificates of the run that nothing replaced or revoked.
    """

    calibration: str | None
    note: str
    standing_certificates: tuple[str, ...]


def override_verdict(
    run: str, outcome: str, *, by: str, why: str, database: str | None
) -> CommandOutcome[Overridden]:
    """Override the verdict of a run; verdict and measurements are kept.

    Parameters
    ----------
    outcome : ``"pass"`` or ``"fail"``.
    by, why : operator and reason; neither may be empty.
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.

    Raises
    ------
    ConfigError
        If the outcome, the name or the reason cannot be used.
    StoreError
        If the run does not exist, was altered, or has no verdict.
    """
    if outcome not in _OUTCOMES:
        raise ConfigError(f"a verdict cannot be overridden to {outcome!r}", remedy=f"allowed: {', '.join(_OUTCOMES)}")
    for option, text, missing_fact in (("--by", by, "who decides"), ("--why", why, "for what reason")):
        if not text.strip():
            raise ConfigError(f"an override needs {option}", remedy=f"say {missing_fact}")
    name, reason = validate_operator(by), validate_reason(why)
    with open_store(database_url(database), create=False) as store:
        analyses = store.analyses.load(run)
        for latest in analyses[:1]:
            check_decided(store.runs.load(run), latest, judging_recipe(store, run, latest).limits)
        override = store.changes.override_verdict(run, _OUTCOMES[outcome], operator=name, why=reason)
        calibration = next((analysis.calibration for analysis in analyses if analysis.calibration is not None), None)
        identity, report = store.runs.read_identity(run), report_command(run, store)
        issued = store.certificates.list_all(identity.sensor.serial)
        standing = [one.issued.number for one in issued if one.issued.run == run and not one.withdrawals]
    note = "no calibration was issued; an override does not issue one"
    if calibration is not None and override.outcome is Outcome.FAIL:
        note = (
            f"calibration {calibration} is still stored: an override does not withdraw it; take its file out of use"
        )
    elif calibration is not None:
        note = f"calibration {calibration} is unchanged"
    facts = [("Run", identity.words), ("Calibration", note)]
    if override.outcome is Outcome.FAIL:
        facts += [("Certificate", f"{number} stands; cbsr-qa certificate revoke {number}") for number in standing]
    overridden = fill_from_object(
        Overridden, override, calibration=calibration, note=note, standing_certificates=tuple(standing)
    )
    printed = (("Report", f"{report} writes it with this"),)
    return answer(overridden, f"verdict {override.words}", "", facts, printed=printed)
