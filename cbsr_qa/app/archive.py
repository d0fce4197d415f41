"""Frames of old runs, moved to files and back."""

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cbsr_qa.app.command_hints import database_option
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import ConfigError, StoreError
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.run.run import run_named
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import plural
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.runs.archiving import ArchivedRun
from cbsr_qa.store.types import time_of_id

_DAYS: Final = {"d": 1, "w": 7, "y": 365}
_LISTED: Final = 20


@dataclass(frozen=True, slots=True)
class Archived:
    """What was moved.

    Parameters
    ----------
    runs : those whose frames were moved, or would be.
    problems : problems of runs that were left as they were, by name.
    before_bytes, after_bytes : size of the database.
    archive_bytes : size of the files that were written.
    dry_run : whether nothing was moved.
    """

    runs: tuple[ArchivedRun, ...]
    problems: tuple[str, ...]
    before_bytes: int
    after_bytes: int
    archive_bytes: int
    dry_run: bool = False


def archive_runs(
    database: str | None, older_than: str, to: Path | None, *, dry_run: bool
) -> CommandOutcome[Archived]:
    """Move the frames of passed sensors' runs that are older than an age to files.

    A run that cannot be moved stays as it is and is named; the others are moved.

    Raises
    ------
    ConfigError
        If the age cannot be read.
    StoreError
        If the database cannot be used.
    """
    now = datetime.now(UTC)
    begun_before = now - _age(older_than)
    with open_store(database_url(database), create=False) as store:
        folder, runs, size = (
            store.archives.choose_folder(to),
            store.archives.find_archivable(begun_before),
            store.measure_size_bytes(),
        )
        if dry_run:
            return _laid_out(Archived(runs, (), size, size, 0, dry_run=True), folder, database)
        archived_runs, problems = _archive_each(store, runs, folder, now)
        if archived_runs:
            problems += _shrunk(store)
        written_bytes = sum(run.file_bytes for run in archived_runs)
        return _laid_out(
            Archived(archived_runs, problems, size, store.measure_size_bytes(), written_bytes), folder, database
        )


def _age(text: str) -> timedelta:
    match = re.fullmatch(r"([0-9]{1,5})([dwy])", text.strip())
    if match is None:
        raise ConfigError(
            f"--older-than is {text[:40]!r}", remedy="give a number of days, weeks or years: 90d, 12w or 2y"
        )
    return timedelta(days=int(match[1]) * _DAYS[match[2]])


def _archive_each(
    store: Repository, runs: tuple[ArchivedRun, ...], folder: Path, at: datetime
) -> tuple[tuple[ArchivedRun, ...], tuple[str, ...]]:
    archived_runs, problems = [], []
    for number, run in enumerate(runs):
        on_stderr(f"archiving run {number + 1} of {len(runs)} …")
        try:
            archived_runs.append(store.archives.archive(run, folder, at))
        except StoreError as error:
            problems.append(error.reason)
    return tuple(archived_runs), tuple(problems)


def _shrunk(store: Repository) -> tuple[str, ...]:
    try:
        store.shrink()
    except StoreError as error:
        return (f"the database file was not made smaller: {error.reason}",)
    return ()


def unarchive_runs(database: str | None, run_or_serial: str) -> CommandOutcome[Archived]:
    """Bring the frames of a run back. Raise StoreError if it is not archived, or its file is missing or altered."""
    with open_store(database_url(database), create=False) as store:
        size = store.measure_size_bytes()
        run = store.archives.unarchive(store.runs.resolve(run_or_serial))
        archived = Archived((run,), (), size, store.measure_size_bytes(), 0)
    facts = (
        ("Run", _describe_run(run)),
        ("File", f"{run.file} stays: copies of the database may need it"),
        _size(archived),
    )
    return answer(archived, f"{plural(run.frames, 'frame')} brought back into the database", facts=facts)


def _laid_out(done: Archived, folder: Path, database: str | None) -> CommandOutcome[Archived]:
    frames, held_bytes = sum(run.frames for run in done.runs), sum(run.database_bytes for run in done.runs)
    content = f"{plural(frames, 'frame')} of {plural(len(done.runs), 'run')}"
    facts = [("Folder", str(folder)), ("Arrays", f"{_megabytes(held_bytes)} in the database")]
    if not done.dry_run:
        facts += [("Files", _megabytes(done.archive_bytes)), _size(done)]
    facts += [("Run", _describe_run(run)) for run in done.runs[:_LISTED]]
    if len(done.runs) > _LISTED:
        facts.append(("Run", f"and {len(done.runs) - _LISTED} more; --json lists all"))
    undo_facts = (("Bring back", f"cbsr-qa db unarchive RUN{database_option(database)}"),)
    headline = f"{content} would be archived" if done.dry_run else f"{content} archived"
    if not done.runs and not done.problems:
        why = "every run is too recent, did not pass, or is archived already"
        return answer(done, "nothing to archive", why, facts=facts[:1])
    printed = undo_facts if done.runs and not done.dry_run else ()
    return answer(done, headline, facts=facts, printed=printed, warnings=done.problems)


def _describe_run(run: ArchivedRun) -> str:
    return f"{run_named(run.serial, time_of_id(run.run), run.run)}: {plural(run.frames, 'frame')}"


def _size(done: Archived) -> tuple[str, str]:
    return "Database", f"{_megabytes(done.before_bytes)} before, {_megabytes(done.after_bytes)} after"


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.2f} MB"
