"""The outcome of ``cbsr-qa db sync``: what was sent, what waits, what was passed over, and in words."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Final

from sqlalchemy import Engine

from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Paragraph, Section
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import plural
from cbsr_qa.store.damage import address
from cbsr_qa.store.sync.centre import name_unread_refusals, refusals
from cbsr_qa.store.sync.queue import (
    QUARANTINED,
    Backlog,
    backlog,
    list_held,
    name_unread,
    waiting,
)
from cbsr_qa.store.sync.send import Sent
from cbsr_qa.system.clock import write_local_time

_NOT_ALL: Final = 1


_SETTLE: Final = (
    "One is settled, and no longer listed, when its station sent it (cbsr-qa db sync --retry ITEM there) or let it go"
    " (--let-go ITEM) and has sent once more."
)


_UNREAD: Final = "rows that cannot be read were passed over: what they announce or refuse is not known"


MOST_LISTED: Final = 20


@dataclass(frozen=True, slots=True)
class WaitingItem:
    """Something that the centre does not have, or not all of; see the table ``outbox``."""

    kind: str
    item: str
    noted_at: datetime
    state: str
    why: str


@dataclass(frozen=True, slots=True)
class RefusedItem:
    """Something that the centre refused, of any station; see the table ``sync_refusals``."""

    kind: str
    item: str
    run: str | None
    station: str
    station_sha256: str
    centre_sha256: str
    noted_at: datetime
    why: str


@dataclass(frozen=True, slots=True)
class LostItem:
    """Something that the centre had confirmed, had lost (or part of it), and has again."""

    kind: str
    item: str
    why: str


@dataclass(frozen=True, slots=True)
class AddedRows:
    """A run of which the centre has rows that this database does not have."""

    run: str
    why: str


@dataclass(frozen=True, slots=True)
class Synchronised:
    """What was sent, and what waits.

    Parameters
    ----------
    database, centre : passwords hidden; centre empty where none is configured.
    centre_problem : why ``--status`` could not read the centre; empty if it could.
    items, runs, rows, bytes, seconds : sent by this command.
    compared : runs that the centre had rows of, compared at both ends by this command.
    notes : runs that the centre has more than this database, in words; only of a command that sends.
    lost : items that this command found the centre had lost; it sent them again.
    added : runs that this command compared, and of which the centre has rows that this database does not have.
    unread : rows of ``outbox``, and of ``sync_refusals`` and ``sync_settlements`` at the centre, that cannot be read,
        in words; they are passed over.
    waiting : number of items that wait, by kind.
    backlog_h : waiting time of the oldest of them [h]; None if nothing waits.
    limit_h : longest time that is allowed [h]; None for any.
    late : whether the backlog is older than that.
    blocked : items that wait until the centre has what they refer to.
    held : items that are quarantined or were let go.
    refused : items that the centre refused of all stations and that are not settled; only of ``--status`` with a
        centre that answers.
    """

    database: str
    centre: str
    items: int
    runs: int
    rows: int
    bytes: int
    seconds: float
    waiting: Mapping[str, int]
    backlog_h: float | None
    limit_h: float | None
    late: bool
    blocked: tuple[WaitingItem, ...]
    held: tuple[WaitingItem, ...]
    refused: tuple[RefusedItem, ...] = ()
    centre_problem: str = ""
    compared: int = 0
    notes: tuple[str, ...] = ()
    lost: tuple[LostItem, ...] = ()
    added: tuple[AddedRows, ...] = ()
    unread: tuple[str, ...] = ()


def describe_backlog(backlog: Backlog) -> str:
    """Say what waits, and that it is not lost."""
    return backlog.words if backlog.age_h is None else f"{backlog.words}; nothing is lost"


def describe_sent(sent: Sent, quarantined: int) -> str:
    """Say in a line what was sent, and what a reader has to look after.

    Parameters
    ----------
    quarantined : number of items that the centre or this database holds back.
    """
    sentence = (
        f"sent: {plural(sent.runs, 'run')}, {plural(sent.items - sent.runs, 'other item')} ({sent.size / 1e6:.1f} MB)"
    )
    if not sent.items:
        sentence = "nothing was sent" if quarantined or sent.blocked else "there was nothing to send"
    compared_words = f"; {plural(sent.compared, 'run')} compared at both ends" if sent.compared else ""
    lost_words = f"; the centre had lost {plural(len(sent.lost), 'item')}" if sent.lost else ""
    added_words = f"; the centre has more rows of {plural(len(sent.added), 'run')}" if sent.added else ""
    unread_words = f"; {plural(len(sent.unread), 'row')} passed over" if sent.unread else ""
    return sentence + compared_words + lost_words + added_words + _describe_quarantine(quarantined) + unread_words


def _describe_quarantine(quarantined: int) -> str:
    return f"; {plural(quarantined, 'item')} quarantined" if quarantined else ""


def _why(kind: str, item: str, why: str) -> str:
    """Return why an item is held back, without its name, which stands before it."""
    name = f"{kind} {item}"
    return why.replace(f"{name}: ", "", 1).replace(f" of {name} ", " ", 1).removeprefix(f"{name} ")


def sync_outcome(
    station: Engine, centre: str, sent: Sent, seconds: float, limit_h: float | None
) -> CommandOutcome[Synchronised]:
    """Lay out what was sent and what waits; exit code 1 if something is late, lost, added, quarantined or unread.

    Parameters
    ----------
    centre : its address; empty if nothing was to be sent.
    limit_h : longest time that something may wait [h]; None for any.
    """
    entries, held_entries, station_backlog = waiting(station), list_held(station), backlog(station)
    unread = sent.unread or name_unread(station)
    result = Synchronised(
        database=address(station.url),
        centre=centre,
        items=sent.items,
        runs=sent.runs,
        rows=sent.rows,
        bytes=sent.size,
        seconds=round(seconds, 3),
        compared=sent.compared,
        notes=tuple(sent.notes),
        lost=tuple(fill_from_object(LostItem, lost_item) for lost_item in sent.lost),
        added=tuple(fill_from_object(AddedRows, added_rows) for added_rows in sent.added),
        unread=tuple(unread),
        waiting=dict(Counter(entry.kind for entry in entries)),
        backlog_h=station_backlog.age_h,
        limit_h=limit_h,
        late=station_backlog.late(limit_h),
        blocked=tuple(fill_from_object(WaitingItem, entry) for entry in entries if entry.why),
        held=tuple(fill_from_object(WaitingItem, entry) for entry in held_entries),
    )
    quarantined = [entry for entry in held_entries if entry.state == QUARANTINED]
    facts = [("Database", address(station.url))]
    facts += [("Waits", describe_backlog(station_backlog))] if entries and centre else []
    facts += [
        (f"quarantined {entry.kind}", f"{entry.item}: {_why(entry.kind, entry.item, entry.why)}")
        for entry in quarantined[:MOST_LISTED]
    ]
    facts += [(f"blocked {entry.kind}", f"{entry.item}: {entry.why}") for entry in result.blocked[:MOST_LISTED]]
    facts += [
        (f"lost {lost_item.kind}", f"{lost_item.item}: {lost_item.why}") for lost_item in sent.lost[:MOST_LISTED]
    ]
    facts += [("rows added", added_rows.why) for added_rows in sent.added[:MOST_LISTED]]
    facts += [("passed over", note) for note in unread[:MOST_LISTED]]
    facts += [("Note", note) for note in sent.notes[:MOST_LISTED]]
    facts += (
        [("Let go", plural(len(held_entries) - len(quarantined), "item"))]
        if len(held_entries) > len(quarantined)
        else []
    )
    count = len(quarantined)
    headline = (
        describe_sent(sent, count) if centre else describe_backlog(station_backlog) + _describe_quarantine(count)
    )
    remedies = (("Quarantine", "cbsr-qa db sync --retry ITEM sends one again, --let-go ITEM leaves it here"),)
    outcome = answer(result, headline, "", facts, printed=remedies if quarantined else ())
    failure = _describe_failure(result, quarantined=bool(quarantined))
    return _mark_failed(outcome, headline, failure) if failure else outcome


def _describe_failure(result: Synchronised, *, quarantined: bool) -> str:
    """Return why the exit code is not 0, in words; empty if it is."""
    if result.late:
        return f"the backlog is older than {result.limit_h:g} h"
    if result.added:
        return "the centre has rows of runs that this database does not have"
    if result.lost:
        return "the centre had lost something that it had confirmed"
    if quarantined:
        return "not everything was accepted"
    return _UNREAD if result.unread else ""


def _mark_failed(done: CommandOutcome[Synchronised], headline: str, why: str) -> CommandOutcome[Synchronised]:
    return replace(done, exit_code=_NOT_ALL, page=replace(done.page, banner=Banner("fail", "✗", headline, why)))


def add_refusals(done: CommandOutcome[Synchronised], centre: Engine) -> CommandOutcome[Synchronised]:
    """Add what the centre refused of all stations."""
    refused_items = tuple(fill_from_object(RefusedItem, row) for row in refusals(centre))
    unread = tuple(f"at the centre, {words}" for words in name_unread_refusals(centre))
    result = replace(
        done.result, centre=address(centre.url), refused=refused_items, unread=done.result.unread + unread
    )
    if unread:
        facts = (*done.page.identity, *(("passed over", words) for words in unread[:MOST_LISTED]))
        done = replace(done, page=replace(done.page, identity=facts))
        done = done if done.exit_code else _mark_failed(done, done.page.banner.headline, _UNREAD)
    if not refused_items:
        return replace(done, result=result)
    lines = tuple(
        Paragraph(
            f"{write_local_time(refusal.noted_at)}, station {refusal.station or '–'}, {refusal.kind} {refusal.item}:"
            f" {_why(refusal.kind, refusal.item, refusal.why)}"
        )
        for refusal in refused_items[-MOST_LISTED:]
    )
    settle = Paragraph(_SETTLE)
    return replace(done, result=result, sections=(*done.sections, Section("Refused by the centre", (*lines, settle))))
