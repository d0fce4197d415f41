"""Released contents: every release and withdrawal, and which of them hold."""

from dataclasses import dataclass, replace
from typing import Final

from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.report import Banner, Cell, CommandOutcome, Section
from cbsr_qa.domain.run.gate import Release
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import plural, text_table
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.clock import write_local_time

#: Digits of a digest that are shown; ``--json`` has all.
_DIGITS: Final = 12


@dataclass(frozen=True, slots=True)
class ListedRelease(Release):
    """A release or withdrawal. ``holds``: whether it is the latest of its kind and content."""

    holds: bool


@dataclass(frozen=True, slots=True)
class ReleaseList:
    """Releases and withdrawals in the order they were made in.

    ``unread`` names rows that cannot be read: a release in one of them does not count.
    """

    releases: tuple[ListedRelease, ...]
    unread: tuple[str, ...] = ()


def list_releases(database: str | None) -> CommandOutcome[ReleaseList]:
    """List releases. Raise StoreError if there is no database, or it cannot be read."""
    with open_store(database_url(database), create=False) as store:
        releases, unread = store.releases.read_all(), store.releases.name_unread()
    latest = {(release.kind, release.sha256): release.release for release in releases}
    listed = tuple(
        fill_from_object(ListedRelease, release, holds=latest[release.kind, release.sha256] == release.release)
        for release in releases
    )
    released = sum(release.holds and release.action == "released" for release in listed)
    table = text_table(
        "Releases and withdrawals, the last one below; the latest of a content holds.",
        ("when (UTC)", "kind", "name", "SHA-256", "what", "by", "why"),
        [_row(release) for release in listed],
    )
    headline, facts = f"{plural(released, 'content')} released", [("passed over", row) for row in unread]
    outcome = answer(ReleaseList(listed, unread), headline, "", facts)
    if unread:
        banner = Banner(
            "fail", "✗", headline, f"{plural(len(unread), 'row')} cannot be read: no release is among them"
        )
        outcome = replace(outcome, exit_code=1, page=replace(outcome.page, banner=banner))
    return replace(outcome, sections=(Section("Releases", (table,)),)) if listed else outcome


def _row(release: ListedRelease) -> tuple[str | Cell, ...]:
    action = release.action if release.holds else f"{release.action}, superseded"
    passes = release.holds and release.action == "released"
    return (
        write_local_time(release.at),
        release.kind,
        release.name,
        release.sha256[:_DIGITS],
        Cell(action, Outcome.PASS if passes else None),
        release.by,
        release.why,
    )
