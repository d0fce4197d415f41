"""``cbsr-qa db sync``: what a station stored is sent to the central database; what waits, and for how long."""

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import date, datetime
from typing import Final

from sqlalchemy import Engine

from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import ConfigError, StoreError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Paragraph, Section
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import plural
from cbsr_qa.store.chain.links import KEY_OPTION, SigningKey
from cbsr_qa.store.damage import address
from cbsr_qa.store.engine import open_engine, parse_url
from cbsr_qa.store.locks import this_process
from cbsr_qa.store.schema import Age, read_version, refusal
from cbsr_qa.store.sync.centre import check_centre, name_unread_refusals, refusals
from cbsr_qa.store.sync.queue import (
    QUARANTINED,
    Backlog,
    backlog,
    let_go,
    list_held,
    name_unread,
    send_again,
    waiting,
)
from cbsr_qa.store.sync.send import Sent, send_waiting

VARIABLE: Final = "CBSR_QA_CENTRE"
_NOT_ALL: Final = 1
_SETTLE: Final = (
    "One is settled, and no longer listed, when its station sent it (cbsr-qa db sync --retry ITEM there) or let it go"
    " (--let-go ITEM) and has sent once more."
)
_UNREAD: Final = "rows that cannot be read were passed over: what they announce or refuse is not known"
_LISTED: Final = 20

Progress = Callable[[int, int, Sent], None]


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
    lost : what this command found that the centre had lost; it was sent again.
    added : runs that this command compared, and of which the centre has rows that this database does not have.
    unread : rows of ``outbox``, and of ``sync_refusals`` and ``sync_settlements`` at the centre, that cannot be read,
        in words; they are passed over.
    waiting : number of items that wait, by kind.
    backlog_h : how long the oldest of them has waited [h]; None if nothing waits.
    limit_h : longest time that is allowed [h]; None for any.
    late : whether the backlog is older than that.
    blocked : items that wait until the centre has what they refer to.
    held : items that are quarantined or were let go.
    refused : what the centre refused of all stations and is not settled; only of ``--status`` with a centre that
        answers.
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


def centre_url(option: str | None, environment: Mapping[str, str] = os.environ) -> str:
    """URL of the central database: the option, else ``CBSR_QA_CENTRE``; empty if neither is given."""
    chosen = option or environment.get(VARIABLE) or ""
    return database_url(chosen) if chosen else ""


def synchronise(
    option: str | None,
    to: str | None,
    *,
    limit_h: float | None = None,
    progress: Progress | None = None,
    compare_since: date | None = None,
) -> CommandOutcome[Synchronised]:
    """Send everything that waits in a database to the central one.

    Parameters
    ----------
    option : the station's database: URL or path; None for ``CBSR_QA_DATABASE`` or the default.
    to : the central one; None for ``CBSR_QA_CENTRE``.
    limit_h : longest time that something may wait [h]; None for any.
    progress : called with items done, their number and what was sent so far.
    compare_since : compare everything from this day on (UTC) with the centre's; None: only runs that are sent again.

    Raises
    ------
    ConfigError
        If no central database is named.
    StoreError
        If a database cannot be used; the message says what waits. What was confirmed before stays sent.
    """
    with _station(option) as station, _centre(to) as centre:
        begun_s = time.monotonic()
        sent = _send(station, centre, progress, compare_since)
        return _outcome(station, address(centre.url), sent, time.monotonic() - begun_s, limit_h)


def keep_synchronised(
    option: str | None,
    to: str | None,
    every_s: float,
    tell: Callable[[str], None],
    *,
    limit_h: float | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> CommandOutcome[Synchronised]:
    """Send again and again until Ctrl-C, through failures of both databases.

    Parameters
    ----------
    every_s : pause between two passes [s].
    tell : called with a line for each pass that sent something, or failed in another way than the one before.

    Raises
    ------
    ConfigError
        If no central database is named.
    StoreError
        If there is still no database of the station when Ctrl-C ends this.
    """
    total, begun_s, trouble = Sent(), time.monotonic(), ""
    with _centre(to) as centre:
        tell(f"sending to {address(centre.url)} every {every_s:g} s; Ctrl-C ends")
        try:
            while True:
                try:
                    with _station(option) as station:
                        sent = _send(station, centre, None, None)
                except StoreError as error:
                    centre.dispose()  # a connection that was cut is not used again
                    if error.reason != trouble:
                        tell(f"{error.reason}; trying again every {every_s:g} s")
                    trouble = error.reason
                else:
                    trouble = ""
                    _tell_pass(sent, tell, told=total.unread)
                    sums = {name: getattr(total, name) + getattr(sent, name) for name in _TOTALS}
                    total = replace(total, **sums, notes=sent.notes, unread=sent.unread)
                sleep(every_s)
        except KeyboardInterrupt:
            with _station(option) as station:
                return _outcome(station, address(centre.url), total, time.monotonic() - begun_s, limit_h)


def _tell_pass(sent: Sent, tell: Callable[[str], None], *, told: Sequence[str]) -> None:
    """Tell what a pass did, and rows that it passed over unless they were told before."""
    for words in (words for words in sent.unread[:_LISTED] if words not in told):
        tell(f"passed over: {words}")
    if sent.items or sent.quarantined:
        tell(_describe_sent(sent, len(sent.quarantined)))
    for lost in sent.lost[:_LISTED]:
        tell(f"{lost.kind} {lost.item}: {lost.why}")
    for added in sent.added[:_LISTED]:
        tell(added.why)


def sync_status(option: str | None, to: str | None, *, limit_h: float | None = None) -> CommandOutcome[Synchronised]:
    """Return what waits, is quarantined or was let go, whether the centre answers or not; nothing is sent."""
    url = centre_url(to)
    with _station(option) as station:
        done = _outcome(station, "", Sent(), 0.0, limit_h)
        if not url:
            return done
        with _centre(to) as centre:
            try:
                check_centre(centre, station)
                return _with_refusals(done, centre)
            except StoreError as error:  # what waits is known without it
                identity = (*done.page.identity, ("Centre", f"{error.reason}; what it refused is not listed"))
                return replace(
                    done,
                    result=replace(done.result, centre=address(centre.url), centre_problem=error.reason),
                    page=replace(done.page, identity=identity),
                )


def decide_item(option: str | None, item: str, *, again: bool) -> CommandOutcome[Synchronised]:
    """Have a quarantined item sent again, or let it go; StoreError where no such item is held."""
    with _station(option) as station:
        (send_again if again else let_go)(station, item)
        return _outcome(station, "", Sent(), 0.0, None)


_TOTALS: Final = ("items", "runs", "compared", "rows", "size", "lost", "added")


@contextmanager
def _station(option: str | None) -> Iterator[Engine]:
    engine = _signing(open_engine(parse_url(database_url(option))))
    try:
        version = read_version(engine)
        if version.age is not Age.CURRENT:
            raise refusal(engine, version)
        yield engine
    finally:
        engine.dispose()


@contextmanager
def _centre(to: str | None) -> Iterator[Engine]:
    url = centre_url(to)
    if not url:
        raise ConfigError("no central database is named", remedy=f"give --to URL, or set {VARIABLE}")
    engine = _signing(open_engine(parse_url(url)))
    try:
        yield engine
    finally:
        engine.dispose()


def _signing(engine: Engine) -> Engine:
    """Return an engine that checks signatures with the key that is set, as an open store does."""
    return engine.execution_options(**{KEY_OPTION: SigningKey.from_environment()})


def _send(station: Engine, centre: Engine, progress: Progress | None, compare_since: date | None) -> Sent:
    """Send; an error says what waits."""
    try:
        return send_waiting(station, centre, this_process(""), progress, compare_since=compare_since)
    except StoreError as error:
        with_backlog = f"{error.reason}; {_safe(backlog(station))}"
        raise StoreError(with_backlog, remedy=error.remedy) from error


def _safe(backlog: Backlog) -> str:
    return backlog.words if backlog.age_h is None else f"{backlog.words}; nothing is lost"


def _describe_sent(sent: Sent, quarantined: int) -> str:
    words = (
        f"sent: {plural(sent.runs, 'run')}, {plural(sent.items - sent.runs, 'other item')} ({sent.size / 1e6:.1f} MB)"
    )
    if not sent.items:
        words = "nothing was sent" if quarantined or sent.blocked else "there was nothing to send"
    compared = f"; {plural(sent.compared, 'run')} compared at both ends" if sent.compared else ""
    lost = f"; the centre had lost {plural(len(sent.lost), 'item')}" if sent.lost else ""
    added = f"; the centre has more rows of {plural(len(sent.added), 'run')}" if sent.added else ""
    unread = f"; {plural(len(sent.unread), 'row')} passed over" if sent.unread else ""
    return words + compared + lost + added + _describe_quarantine(quarantined) + unread


def _describe_quarantine(quarantined: int) -> str:
    return f"; {plural(quarantined, 'item')} quarantined" if quarantined else ""


def _why(kind: str, item: str, why: str) -> str:
    """Return why an item is held back, without its name, which stands before it."""
    name = f"{kind} {item}"
    return why.replace(f"{name}: ", "", 1).replace(f" of {name} ", " ", 1).removeprefix(f"{name} ")


def _outcome(
    station: Engine, centre: str, sent: Sent, seconds: float, limit_h: float | None
) -> CommandOutcome[Synchronised]:
    entries, kept, waits = waiting(station), list_held(station), backlog(station)
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
        lost=tuple(fill_from_object(LostItem, lost) for lost in sent.lost),
        added=tuple(fill_from_object(AddedRows, one) for one in sent.added),
        unread=tuple(unread),
        waiting=dict(Counter(entry.kind for entry in entries)),
        backlog_h=waits.age_h,
        limit_h=limit_h,
        late=waits.late(limit_h),
        blocked=tuple(fill_from_object(WaitingItem, entry) for entry in entries if entry.why),
        held=tuple(fill_from_object(WaitingItem, entry) for entry in kept),
    )
    quarantined = [entry for entry in kept if entry.state == QUARANTINED]
    facts = [("Database", address(station.url))]
    facts += [("Waits", _safe(waits))] if entries and centre else []
    facts += [
        (f"quarantined {entry.kind}", f"{entry.item}: {_why(entry.kind, entry.item, entry.why)}")
        for entry in quarantined[:_LISTED]
    ]
    facts += [(f"blocked {entry.kind}", f"{entry.item}: {entry.why}") for entry in result.blocked[:_LISTED]]
    facts += [(f"lost {lost.kind}", f"{lost.item}: {lost.why}") for lost in sent.lost[:_LISTED]]
    facts += [("rows added", one.why) for one in sent.added[:_LISTED]]
    facts += [("passed over", words) for words in unread[:_LISTED]]
    facts += [("Note", words) for words in sent.notes[:_LISTED]]
    facts += [("Let go", plural(len(kept) - len(quarantined), "item"))] if len(kept) > len(quarantined) else []
    count = len(quarantined)
    headline = _describe_sent(sent, count) if centre else _safe(waits) + _describe_quarantine(count)
    remedies = (("Quarantine", "cbsr-qa db sync --retry ITEM sends one again, --let-go ITEM leaves it here"),)
    done = answer(result, headline, "", facts, printed=remedies if quarantined else ())
    why = _describe_failure(result, quarantined=bool(quarantined))
    return _mark_failed(done, headline, why) if why else done


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


def _with_refusals(done: CommandOutcome[Synchronised], centre: Engine) -> CommandOutcome[Synchronised]:
    """Add what the centre refused of all stations."""
    refused = tuple(fill_from_object(RefusedItem, row) for row in refusals(centre))
    unread = tuple(f"at the centre, {words}" for words in name_unread_refusals(centre))
    result = replace(done.result, centre=address(centre.url), refused=refused, unread=done.result.unread + unread)
    if unread:
        facts = (*done.page.identity, *(("passed over", words) for words in unread[:_LISTED]))
        done = replace(done, page=replace(done.page, identity=facts))
        done = done if done.exit_code else _mark_failed(done, done.page.banner.headline, _UNREAD)
    if not refused:
        return replace(done, result=result)
    lines = tuple(
        Paragraph(
            f"{one.noted_at:%Y-%m-%d %H:%M}, station {one.station or '–'}, {one.kind} {one.item}:"
            f" {_why(one.kind, one.item, one.why)}"
        )
        for one in refused[-_LISTED:]
    )
    settle = Paragraph(_SETTLE)
    return replace(done, result=result, sections=(*done.sections, Section("Refused by the centre", (*lines, settle))))
