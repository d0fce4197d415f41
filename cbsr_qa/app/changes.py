"""What people changed: files that runs were configured by, and verdicts."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.changes import NO_REASON, ConfigurationChange, VerdictOverride
from cbsr_qa.store.repository import open_store


@dataclass(frozen=True, slots=True)
class Changes:
    """Every change a database knows of, oldest first."""

    files: tuple[ConfigurationChange, ...]
    overrides: tuple[VerdictOverride, ...]

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        return {
            "changes": [change_row(change) for change in self.files],
            "overrides": [override.document() for override in self.overrides],
        }


def list_changes(database: str | None) -> Changes:
    """List changes of files and overrides of verdicts.

    Parameters
    ----------
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.

    Raises
    ------
    StoreError
        If there is no such database, or it is of another version.
    """
    with open_store(database_url(database), create=False) as store:
        return Changes(store.changes(), store.overrides())


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
