"""Upgrading the database, and its status."""

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from cbsr_qa.app.command_hints import database_option
from cbsr_qa.app.keeping import Count, timestamp_path
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.report import Banner, CommandOutcome
from cbsr_qa.domain.run.run import run_named
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.page import answer
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.store.copies import copy_database
from cbsr_qa.store.damage import address
from cbsr_qa.store.engine import open_engine, parse_url, sqlite_file
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.roles import READER, STATION, roles_script
from cbsr_qa.store.runs.sessions import IncompleteRun
from cbsr_qa.store.schema import HEAD, Age, read_version, refusal, upgrade
from cbsr_qa.store.types import time_of_id
from cbsr_qa.system.clock import RealClock

#: Ends of runs that were stopped, unlike those that were interrupted.
_STOPPED: Final = (str(EndReason.ABORTED), str(EndReason.BROKEN))


@dataclass(frozen=True, slots=True)
class Upgrade:
    """The upgrade of a database; ``before`` is None if it was empty, ``backup`` if none was made."""

    url: str
    before: str | None
    after: str
    changed: bool
    backup: Path | None


@dataclass(frozen=True, slots=True)
class UnfinishedRun:
    """A run that was interrupted or is in progress; see :class:`~cbsr_qa.store.runs.sessions.IncompleteRun`."""

    run: str
    serial: str
    phase: str
    next: str
    state: str


@dataclass(frozen=True, slots=True)
class StoppedRun:
    """A run that was aborted or broken, which can be resumed too; see ``IncompleteRun``."""

    run: str
    serial: str
    phase: str
    next: str
    end: str
    detail: str


@dataclass(frozen=True, slots=True)
class UnconcludedRun:
    """A run whose steps were all carried out, without a result yet."""

    run: str
    serial: str


@dataclass(frozen=True, slots=True)
class DatabaseStatus:
    """State of a database; nothing is counted or listed unless it is current.

    Parameters
    ----------
    url : a password hidden.
    schema, head : version found (None: empty or absent) and version this program reads and writes.
    state : ``"empty"``, ``"current"``, ``"older"``, ``"newer"`` or ``"of another program"``.
    remedy : what to do if the schema is not current.
    counts : rows by kind.
    """

    url: str
    schema: str | None
    head: str
    state: str
    remedy: str
    counts: dict[str, int]
    incomplete: tuple[UnfinishedRun, ...]
    stopped: tuple[StoppedRun, ...]
    without_result: tuple[UnconcludedRun, ...]


def _state(run: IncompleteRun) -> str:
    return f"under way: {run.writer}" if run.writer else run.end if run.end in _STOPPED else "cut off"


def _with_next(runs: tuple[IncompleteRun, ...], url: str) -> tuple[IncompleteRun, ...]:
    """Return runs with the step at which they would be resumed, or were interrupted if a plugin is missing."""
    from cbsr_qa.app.run.resume import find_next_step  # imports all that a run needs
    from cbsr_qa.plugin.discovery import discover

    plugins = discover()
    with open_store(url, create=False) as store:
        next_steps = [find_next_step(store, run.run, plugins) for run in runs]
    return tuple(
        run if next_step is None else replace(run, phase=next_step[0] or run.phase, next=next_step[1])
        for run, next_step in zip(runs, next_steps, strict=True)
    )


def upgrade_database(
    option: str | None, count: Count = lambda what, done, of: None, *, backup: bool = True
) -> CommandOutcome[Upgrade]:
    """Upgrade a database to this program's schema; create it if missing.

    Parameters
    ----------
    option : URL or path; None for ``CBSR_QA_DATABASE`` or the default.
    backup : copy a SQLite file before it is changed; a server's database is not copied.

    Raises
    ------
    RefusedError, StoreError
        If it cannot be opened or copied, belongs to another program, or is newer; it is not changed.
    """
    engine = open_engine(parse_url(database_url(option)))
    try:
        file, version = sqlite_file(engine.url), read_version(engine)
        backup_file = None
        if backup and file is not None and version.age is Age.OLDER:
            backup_file = timestamp_path(file, f"schema-{version.revision}")
            copy_database(engine, backup_file, count)
        version_before = upgrade(engine, tell=on_stderr)
    finally:
        engine.dispose()
    url, revision_before = address(engine.url), version_before.revision
    done = Upgrade(url, revision_before, HEAD, revision_before != HEAD, backup_file)
    headline = f"schema {revision_before or 'none'} → {HEAD}" if done.changed else f"schema {HEAD} is up to date"
    undo = f"cbsr-qa db restore {shlex.quote(str(backup_file))}{database_option(option)}"
    printed = (("Backup", str(backup_file)), ("Undone by", undo)) if backup_file else ()
    return answer(done, url, headline, printed=printed)


@dataclass(frozen=True, slots=True)
class Roles:
    """An SQL script for PostgreSQL, and the roles it makes."""

    station: str
    reader: str
    sql: str


def database_roles() -> Roles:
    """Return the script that makes the roles of stations and readers; nothing is run."""
    return Roles(STATION, READER, roles_script())


def database_status(option: str | None) -> CommandOutcome[DatabaseStatus]:
    """Return the state of a database without changing it. Raise StoreError if it cannot be opened or read."""
    engine = open_engine(parse_url(database_url(option)))
    try:
        version = read_version(engine)
        current = version.age is Age.CURRENT
        store = Repository(engine, RealClock().wall) if current else None
        runs = store.unfinished.list_incomplete() if store else ()
        if runs:
            runs = _with_next(runs, database_url(option))
        status = DatabaseStatus(
            url=address(engine.url),
            schema=version.revision,
            head=HEAD,
            state=version.age.value,
            remedy="" if store else refusal(engine, version).remedy,
            counts=store.count_rows() if store else {},
            incomplete=tuple(
                fill_from_object(UnfinishedRun, run, state=_state(run)) for run in runs if run.end not in _STOPPED
            ),
            stopped=tuple(fill_from_object(StoppedRun, run) for run in runs if run.end in _STOPPED),
            without_result=tuple(UnconcludedRun(*run) for run in store.unfinished.list_without_result())
            if store
            else (),
        )
    finally:
        engine.dispose()
    return _laid_out(status, runs, option)


def _laid_out(
    status: DatabaseStatus, runs: tuple[IncompleteRun, ...], option: str | None
) -> CommandOutcome[DatabaseStatus]:
    facts = [("Schema", f"{status.schema or 'none'} ({status.state}; this program's is {status.head})")]
    facts += [("What to do", status.remedy)] if status.remedy else []
    facts += [(kind, str(count)) for kind, count in status.counts.items()]
    for run in runs:
        phase = f" in {run.phase!r}" if run.phase else ""
        kind = "stopped" if run.end in _STOPPED else "incomplete"
        name = run_named(run.serial, time_of_id(run.run), run.run)
        facts.append((kind, f"{name}: {_state(run)}{phase}; next: {run.next}"))
    for finished in status.without_result:
        name = run_named(finished.serial, time_of_id(finished.run), finished.run)
        facts.append(("no result", f"{name}: finished; next: its result"))
    resume = f"cbsr-qa run --resume RUN{database_option(option)} continues one of them"
    resumable = status.without_result or any(not run.writer for run in runs)
    outcome = answer(status, status.url, "", facts, printed=(("Continue with", resume),) if resumable else ())
    if not status.remedy:
        return outcome
    return replace(outcome, page=replace(outcome.page, banner=Banner("plain", "–", status.url, "")))
