"""Keeping a database: backups, restoring one, and a check of everything that is stored."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Final

from cbsr_qa.app.command_hints import database_option
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Section
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import plural, text_table
from cbsr_qa.store.copies import copy_database, put_back
from cbsr_qa.store.damage import OddCellError, address
from cbsr_qa.store.engine import open_engine, parse_url, sqlite_file
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.schema import HEAD, Age, read_version
from cbsr_qa.system.clock import RealClock

#: Called with what is done, and parts done and in total.
Count = Callable[[str, int, int], None]

_RESTORE_FILE: Final = "restore a backup (cbsr-qa db restore BACKUP), or recover the file and check it again"
_RESTORE_ON_SERVER: Final = (
    "restore a backup that the server's administrator made (pg_dump, pg_restore). A run that a station sent here is"
    " also in its own database: once the owner of the tables has deleted all rows of it here, cbsr-qa db sync"
    " --compare-since at that station sends it again"
)
_VERIFIED: Final = (
    "verified: the file is intact, and the chain of every run ends as in the database; db check reads frames too"
)
_UNCHAINED: Final = "{count} without a chain of digests: changed rows of it cannot be detected"
_UNSIGNED: Final = "{count} not signed with the key that is set: anyone who can write the database can have made them"


@dataclass(frozen=True, slots=True)
class Backup:
    """A verified copy of a database."""

    url: str
    backup: Path
    schema: str | None
    size_bytes: int


@dataclass(frozen=True, slots=True)
class Restored:
    """A backup in the place of a database; ``replaced`` is what was there, None if nothing was."""

    url: str
    backup: Path
    replaced: Path | None
    schema: str | None
    head: str


@dataclass(frozen=True, slots=True)
class FoundProblem:
    """A problem of the file (``run`` is None) or of a run; ``what`` names table and row."""

    run: str | None
    what: str


@dataclass(frozen=True, slots=True)
class DatabaseCheck:
    """What a check of a database found.

    Parameters
    ----------
    quick : frames, samples and files of calibrations were not checked.
    runs, unchained : runs that were checked, and those of them without a chain of digests.
    unsigned : runs that are not signed with the key that is set; None where none is set.
    notes : what is no damage, in words: runs that were refused here, and databases that were worked with in copies.
    """

    url: str
    quick: bool
    since: date | None
    runs: int
    unchained: int
    problems: tuple[FoundProblem, ...]
    unsigned: int | None = None
    notes: tuple[str, ...] = ()


def timestamp_path(path: Path, words: str) -> Path:
    """Return a path next to a file whose name says what it is and when it was made."""
    return path.with_name(f"{path.stem}-{words}-{RealClock().wall():%Y%m%dT%H%M%S}{path.suffix}")


def back_up(option: str | None, to: Path, count: Count) -> CommandOutcome[Backup]:
    """Write a verified backup of a database, which others may use meanwhile.

    Raises
    ------
    RefusedError, StoreError
        If it cannot be made; there is no file then. See :func:`cbsr_qa.store.copies.copy_database`.
    """
    engine = open_engine(parse_url(database_url(option)))
    try:
        copy_database(engine, to, count)
        version = read_version(engine)
    finally:
        engine.dispose()
    url = address(engine.url)
    written = Backup(url, to, version.revision, to.stat().st_size)
    facts = (("Of", url), ("Schema", str(written.schema)), ("Size", f"{written.size_bytes / 1e6:.1f} MB"))
    return answer(written, "backup written", _VERIFIED, facts, printed=(("Backup", str(to)),))


def restore_backup(option: str | None, backup: Path, count: Count) -> CommandOutcome[Restored]:
    """Replace a database that nobody uses by a backup; the replaced file is kept next to it.

    Raises
    ------
    RefusedError, StoreError
        If the backup or the place cannot be used; nothing is changed then. See :func:`cbsr_qa.store.copies.put_back`.
    """
    engine = open_engine(parse_url(database_url(option)))
    file = sqlite_file(engine.url)
    had_database = file is not None and file.exists()
    replaced_file = timestamp_path(file or backup, "replaced")
    try:
        version = put_back(engine, backup, replaced_file, count)
    finally:
        engine.dispose()
    url = address(engine.url)
    restored = Restored(url, backup, replaced_file if had_database else None, version.revision, HEAD)
    facts = [("Database", url), ("Schema", f"{restored.schema} (this program's is {HEAD})")]
    printed = [("Kept", str(restored.replaced))] if restored.replaced else []
    if version.age is not Age.CURRENT:
        printed.append(
            ("Go on with", f"cbsr-qa db upgrade{database_option(option)}, or an earlier version of cbsr-qa")
        )
    return answer(restored, f"{backup} restored", "it was verified before", facts, printed=printed)


def check_database(
    option: str | None, since: date | None, count: Count, *, quick: bool
) -> CommandOutcome[DatabaseCheck]:
    """Check a database: its file, its references, whether a run is missing, and every run with its chain and frames.

    Parameters
    ----------
    since : first day of the runs, UTC; None for all runs.
    quick : whether frames, samples and files of calibrations were left out.

    Raises
    ------
    StoreError
        If it cannot be opened or is not of this version. Damage is part of the outcome.
    """
    problems: list[FoundProblem] = []
    checked = unchained = unsigned = 0
    with open_store(database_url(option), create=False) as store:
        count("checking the file", 0, 1)
        problems += _list_problems(store.soundness.find_file_problems)
        problems += _list_problems(store.soundness.find_odd_rows)
        problems += _list_problems(store.name_unread_entries)
        problems += _list_problems(store.soundness.find_misplaced_rows)
        missing, notes = _order_problems(store)
        problems += missing
        runs = store.lists.read_names(RunSelection(since=since))
        for run in runs:
            count("checking runs", checked, len(runs))
            try:
                chain = store.soundness.check_run(run, frames=not quick)
                unchained, unsigned = unchained + (not chain.chained), unsigned + (chain.signature != "checked")
            except StoreError as error:
                problems.append(FoundProblem(run, error.reason.removeprefix(f"run {run}: ")))
            checked += 1
        problems += _list_problems(store.soundness.find_seal_problems)
        if not quick:
            problems += _list_problems(store.soundness.find_ring_problems)
        without_key = unsigned if store.key_id else None
        checked_database = DatabaseCheck(
            store.address, quick, since, checked, unchained, tuple(problems), without_key, notes
        )
    of_file = sqlite_file(parse_url(database_url(option))) is not None
    return _laid_out(checked_database, _RESTORE_FILE if of_file else _RESTORE_ON_SERVER)


def _list_problems(find: Callable[[], Iterable[str]]) -> Iterator[FoundProblem]:
    """Yield what a part of the check finds; where a cell that cannot be read ends it, that too: the others go on."""
    try:
        for problem in find():
            yield FoundProblem(None, problem)
    except OddCellError as error:
        yield FoundProblem(None, error.reason)


def _order_problems(store: Repository) -> tuple[list[FoundProblem], tuple[str, ...]]:
    """Return runs that are missing between others, and notes on the order of runs."""
    try:
        gaps, notes = store.soundness.find_order_problems()
    except OddCellError as error:
        return [FoundProblem(None, error.reason)], ()
    return [FoundProblem(gap.after or None, gap.words) for gap in gaps], notes


def _laid_out(done: DatabaseCheck, remedy: str) -> CommandOutcome[DatabaseCheck]:
    checked = "every row" if done.quick else "every row, frame and sample"
    reason = f"{checked} of {plural(done.runs, 'run')} was checked"
    banner = Banner("pass", "✓", "the database is sound", reason)
    if not done.runs:
        since = f" from {done.since} on" if done.since else ""
        banner = Banner("not-measured", "?", "no run was checked", f"the database has none{since}")
    if done.problems:
        banner = Banner("fail", "✗", f"{plural(len(done.problems), 'problem')} found", reason)
    facts = [("Database", done.url)]
    facts += [("Frames", "not checked: --quick")] if done.quick else []
    facts += [("Since", f"{done.since}: earlier runs were not checked")] if done.since else []
    facts += [("What to do", remedy)] if done.problems else []
    remarks = [_UNCHAINED.format(count=plural(done.unchained, "run is", "runs are"))] if done.unchained else []
    remarks += [_UNSIGNED.format(count=plural(done.unsigned, "run is", "runs are"))] if done.unsigned else []
    remarks += done.notes
    rows = [(problem.run or "–", problem.what) for problem in done.problems]
    sections = (Section("Problems", (text_table("", ("run", "problem"), rows),)),) if rows else ()
    return CommandOutcome(
        done, Page("", "", banner, tuple(facts), remarks=tuple(remarks)), sections, 1 if rows else 0
    )
