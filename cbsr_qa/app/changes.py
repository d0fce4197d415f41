"""What people changed: files that runs were configured by, limits of control charts, and verdicts."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from cbsr_qa.app.charts_document import reference_document
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.changes import NO_REASON, ConfigurationChange, VerdictOverride
from cbsr_qa.domain.station_charts import ChartReference
from cbsr_qa.report.numbers import number, unit_shown
from cbsr_qa.store.repository import open_store


@dataclass(frozen=True, slots=True)
class ChartChange:
    """Limits of a control chart that were set; ``earlier`` are those that held before, None for the chart's first."""

    reference: ChartReference
    earlier: ChartReference | None

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        one = self.reference
        return {
            **reference_document(one),
            "station": one.station,
            "recipe": one.recipe,
            "golden": one.golden or None,
            "unit": one.unit,
            "why": one.why or NO_REASON,
            "earlier": None if self.earlier is None else reference_document(self.earlier),
        }

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
        chart = (one.station, one.recipe, one.golden, one.key, one.settings.kind)
        yield ChartChange(one, holds.get(chart))
        holds[chart] = one


def _settings(one: ChartReference) -> str:
    grouped = f"groups of {one.settings.subgroup}, " if one.settings.subgroup > 1 else ""
    return f"{grouped}rules {', '.join(map(str, one.settings.rules))}"


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
