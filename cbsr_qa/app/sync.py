"""``cbsr-qa db sync``: what a station stored is sent to the central database; what waits, and for how long."""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import date
from typing import Final

from sqlalchemy import Engine

from cbsr_qa.app.sync_outcome import (
    MOST_LISTED,
    Synchronised,
    add_refusals,
    describe_backlog,
    describe_sent,
    sync_outcome,
)
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import ConfigError, StoreError
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.store.chain.links import KEY_OPTION, SigningKey
from cbsr_qa.store.damage import address
from cbsr_qa.store.engine import open_engine, parse_url
from cbsr_qa.store.locks import this_process
from cbsr_qa.store.schema import Age, read_version, refusal
from cbsr_qa.store.sync.centre import check_centre
from cbsr_qa.store.sync.queue import (
    backlog,
    let_go,
    send_again,
)
from cbsr_qa.store.sync.send import Sent, send_waiting

VARIABLE: Final = "CBSR_QA_CENTRE"

Progress = Callable[[int, int, Sent], None]


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
        return sync_outcome(station, address(centre.url), sent, time.monotonic() - begun_s, limit_h)


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
                return sync_outcome(station, address(centre.url), total, time.monotonic() - begun_s, limit_h)


def _tell_pass(sent: Sent, tell: Callable[[str], None], *, told: Sequence[str]) -> None:
    """Tell what a pass did, and rows that it passed over unless they were told before."""
    for row in (row for row in sent.unread[:MOST_LISTED] if row not in told):
        tell(f"passed over: {row}")
    if sent.items or sent.quarantined:
        tell(describe_sent(sent, len(sent.quarantined)))
    for lost in sent.lost[:MOST_LISTED]:
        tell(f"{lost.kind} {lost.item}: {lost.why}")
    for added in sent.added[:MOST_LISTED]:
        tell(added.why)


def sync_status(option: str | None, to: str | None, *, limit_h: float | None = None) -> CommandOutcome[Synchronised]:
    """Return what waits, is quarantined or was let go, whether the centre answers or not; nothing is sent."""
    url = centre_url(to)
    with _station(option) as station:
        outcome = sync_outcome(station, "", Sent(), 0.0, limit_h)
        if not url:
            return outcome
        with _centre(to) as centre:
            try:
                check_centre(centre, station)
                return add_refusals(outcome, centre)
            except StoreError as error:  # what waits is known without it
                identity = (*outcome.page.identity, ("Centre", f"{error.reason}; what it refused is not listed"))
                return replace(
                    outcome,
                    result=replace(outcome.result, centre=address(centre.url), centre_problem=error.reason),
                    page=replace(outcome.page, identity=identity),
                )


def decide_item(option: str | None, item: str, *, again: bool) -> CommandOutcome[Synchronised]:
    """Have a quarantined item sent again, or let it go; StoreError where no such item is held."""
    with _station(option) as station:
        (send_again if again else let_go)(station, item)
        return sync_outcome(station, "", Sent(), 0.0, None)


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
        with_backlog = f"{error.reason}; {describe_backlog(backlog(station))}"
        raise StoreError(with_backlog, remedy=error.remedy) from error
