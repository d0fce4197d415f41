"""What people changed: files that runs were configured by, limits of control charts, and verdicts.

Override a verdict: a decision of a person, stored beside what was found.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from cbsr_qa.app.run import check_decided
from cbsr_qa.config import database_url, restore, validate_operator, validate_reason
from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.results import Outcome
from cbsr_qa.domain.run import NO_REASON, ChartReference, ConfigurationChange, VerdictOverride
from cbsr_qa.report import json_document, number, unit_shown
from cbsr_qa.store import Repository, open_store


@dataclass(frozen=True, slots=True)
class ChartChange:
    """Limits of a control chart that were set; ``earlier`` are those that held before, None for the chart's first."""

    reference: ChartReference
    earlier: ChartReference | None

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        one = self.reference
        earlier = None if self.earlier is None else json_document(self.earlier)
        return json_document(one) | {"why": one.why or NO_REASON, "earlier": earlier}

    def words(self) -> Iterator[str]:
        """Say what was set, and what it was before."""
        now, before = self.reference, self.earlier
        if now.retired:
            yield "retired: nothing is charted against these limits from here on"
            return
        unit = unit_shown(now.unit)
        for name, old, new in (
            ("mean", None if before is None else before.mean, now.mean),
            ("deviation", None if before is None else before.deviation, now.deviation),
        ):
            was = "" if old is None else f"{number(old, 4)} → "
            yield f"{name} {was}{number(new, 4)} {unit}".rstrip()
        if before is not None and before.settings != now.settings:
            yield f"settings {_settings(before)} → {_settings(now)}"


@dataclass(frozen=True, slots=True)
class Changes:
    """Every change a database knows of, oldest first."""

    files: tuple[ConfigurationChange, ...]
    charts: tuple[ChartChange, ...]
    overrides: tuple[VerdictOverride, ...]

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        return {
            "changes": [change_row(change) for change in self.files],
            "chart_references": [change.document() for change in self.charts],
            "overrides": [override.document() for override in self.overrides],
        }


def list_changes(database: str | None) -> Changes:
    """List changes of files, limits of control charts that were set, and overrides of verdicts.

    Parameters
    ----------
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.

    Raises
    ------
    StoreError
        If there is no such database, or it is of another version.
    """
    with open_store(database_url(database), create=False) as store:
        charts = tuple(_chart_changes(store.all_chart_references()))
        return Changes(store.changes(), charts, store.overrides())


def _chart_changes(references: Iterable[ChartReference]) -> Iterator[ChartChange]:
    """Yield each reference with the one that it took the place of."""
    holds: dict[tuple[object, ...], ChartReference] = {}
    for one in references:
        chart = (one.station, one.recipe, one.golden, one.key, one.chart)
        yield ChartChange(one, holds.get(chart))
        holds[chart] = one


def _settings(one: ChartReference) -> str:
    grouped = f"groups of {one.subgroup}, " if one.subgroup > 1 else ""
    return f"{grouped}rules {', '.join(map(str, one.rules))}"


def change_row(change: ConfigurationChange) -> dict[str, Any]:
    """Return one change as a JSON object; a key that was not there has no value before, or after."""
    return {
        "run": change.run,
        "kind": str(change.kind),
        "name": change.name,
        "earlier_run": change.earlier_run,
        "old_digest": change.old_digest,
        "new_digest": change.new_digest,
        "differences": [{"key": one.key, "before": one.before, "after": one.after} for one in change.differences],
        "by": change.operator,
        "at": change.noted_at.isoformat(),
        "why": change.why,
    }


def unexplained(changes: Iterable[ConfigurationChange]) -> tuple[str, ...]:
    """Return a warning for each change nobody gave a reason for."""
    return tuple(
        f"{change.kind} {change.name!r} is not what run {change.earlier_run} used: {change.words()};"
        f" {NO_REASON} (cbsr-qa run --why TEXT gives one)"
        for change in changes
        if change.why == NO_REASON
    )


_OUTCOMES: Final = {"pass": Outcome.PASS, "fail": Outcome.FAIL}


@dataclass(frozen=True, slots=True)
class Overridden:
    """What was stored.

    Parameters
    ----------
    calibration : of the run, as it was issued; None where none was.
    """

    override: VerdictOverride
    calibration: str | None

    @property
    def about_calibration(self) -> str:
        """Say what becomes of the run's calibration."""
        if self.calibration is None:
            return "no calibration was issued, and an override issues none"
        if self.override.outcome is Outcome.FAIL:
            return (
                f"calibration {self.calibration} stays stored: an override withdraws none; take its file out of use"
            )
        return f"calibration {self.calibration} stays as it was issued"

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        return {**self.override.document(), "calibration": self.calibration, "note": self.about_calibration}


def override_verdict(run: str, outcome: str, *, by: str, why: str, database: str | None) -> Overridden:
    """Store a decision against the verdict of a run; nothing that was found is changed.

    Parameters
    ----------
    outcome : ``"pass"`` or ``"fail"``.
    by, why : who decides, and for what reason; neither may be empty.
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.

    Raises
    ------
    ConfigError
        If the outcome, the name or the reason cannot be used.
    StoreError
        If there is no such run, it is not what was stored, or it has no verdict.
    """
    if outcome not in _OUTCOMES:
        raise ConfigError(f"a verdict cannot be overridden to {outcome!r}", remedy=f"allowed: {', '.join(_OUTCOMES)}")
    for option, text, what in (("--by", by, "who decides"), ("--why", why, "for what reason")):
        if not text.strip():
            raise ConfigError(f"an override needs {option}", remedy=f"say {what}")
    name, reason = validate_operator(by), validate_reason(why)
    with open_store(database_url(database), create=False) as store:
        _check_decided(store, run)
        made = store.override_verdict(run, _OUTCOMES[outcome], operator=name, why=reason)
        (analysis, *_) = store.analyses(run)
    return Overridden(made, analysis.calibration)


def _check_decided(store: Repository, run: str) -> None:
    """Refuse to decide against a verdict that does not follow from what is stored."""
    analyses = store.analyses(run)
    if analyses:
        limits = restore(store.configuration(run)).recipe.limits
        check_decided(store.load_run(run), analyses[0], limits)
