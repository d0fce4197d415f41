"""``cbsr-qa db``: looks after the database."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, Database, Since, to_day
from cbsr_qa.cli.output import Counting, emit_json, note, say, show
from cbsr_qa.domain.errors import ConfigError

group("db", "Maintain the database.")


@command("db upgrade", prints="cbsr_qa.app.database:Upgrade")
def upgrade(
    no_backup: Annotated[
        bool, typer.Option("--no-backup", help="Make no backup of a SQLite file before it is changed.")
    ] = False,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Upgrade a database to this version of the program, or create it.

    A SQLite file is copied first; db restore puts the copy back.
    """
    from cbsr_qa.app.database import upgrade_database

    with _show_stages() as count:
        outcome = upgrade_database(database, count, backup=not no_backup)
    show(outcome, as_json=as_json)


@command("db backup", prints="cbsr_qa.app.keeping:Backup")
def backup(
    file: Annotated[Path, typer.Argument(help="File to write; must not exist yet.")],
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Write a verified copy of the database, also while runs are under way.

    The file is there whole, or not at all. A PostgreSQL server makes backups itself (pg_dump).
    """
    from cbsr_qa.app.keeping import back_up

    with _show_stages() as count:
        outcome = back_up(database, file, count)
    show(outcome, as_json=as_json)


@command("db restore", prints="cbsr_qa.app.keeping:Restored")
def restore(
    backup: Annotated[Path, typer.Argument(help="Backup to restore.")],
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Restore the database from a backup; nobody may use it meanwhile, and the old one is kept beside it."""
    from cbsr_qa.app.keeping import restore_backup

    with _show_stages() as count:
        outcome = restore_backup(database, backup, count)
    show(outcome, as_json=as_json)


@command("db check", prints="cbsr_qa.app.keeping:DatabaseCheck")
def check(
    since: Since = None,
    quick: Annotated[bool, typer.Option("--quick", help="Every row, without frames, samples and files.")] = False,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Check the database file, and every run with its chain of digests, frames and samples.

    Exit code 1 if anything is not as it was stored; table and row are named, and nothing is changed.
    """
    from cbsr_qa.app.keeping import check_database

    with _show_stages() as count:
        outcome = check_database(database, to_day(since), count, quick=quick)
    raise typer.Exit(show(outcome, as_json=as_json))


@contextmanager
def _show_stages() -> Iterator[Callable[[str, int, int], None]]:
    """Show stages and their progress."""
    stages: list[str] = []
    with Counting("") as counting:

        def count(stage: str, done: int, of: int) -> None:
            if stages[-1:] != [stage]:
                stages.append(stage)
                counting.stage(stage)
            counting.count(done, of)

        yield count


@command("db archive", prints="cbsr_qa.app.archive:Archived")
def archive(
    older_than: Annotated[
        str, typer.Option("--older-than", metavar="AGE", help="Runs that began longer ago: 90d, 12w or 2y.")
    ],
    to: Annotated[
        Path | None,
        typer.Option(
            "--to",
            metavar="FOLDER",
            help="Folder of the files; by default beside a SQLite file, else CBSR_QA_ARCHIVE.",
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show which runs; nothing is moved.")] = False,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Move the frames of passed sensors' old runs to files, one a run.

    They are found and read there as before. Frames of runs that failed, were overridden, broke off or are not
    finished stay.
    """
    from cbsr_qa.app.archive import archive_runs

    show(archive_runs(database, older_than, to, dry_run=dry_run), as_json=as_json)


@command("db unarchive", prints="cbsr_qa.app.archive:Archived")
def unarchive(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Run, or the serial number of a sensor: its latest run.")],
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Bring the archived frames of a run back into the database; the file stays."""
    from cbsr_qa.app.archive import unarchive_runs

    show(unarchive_runs(database, run), as_json=as_json)


@command("db status", prints="cbsr_qa.app.database:DatabaseStatus")
def status(database: Database = None, as_json: AsJson = False) -> None:
    """Show which database is used, its version, its contents and unfinished runs."""
    from cbsr_qa.app.database import database_status

    show(database_status(database), as_json=as_json)


@command("db changes", prints="cbsr_qa.app.changes:Changes")
def changes(database: Database = None, as_json: AsJson = False) -> None:
    """List changes of limits, recipes, other files, control charts and verdicts: who, when and why."""
    from cbsr_qa.app.changes import list_changes

    raise typer.Exit(show(list_changes(database), as_json=as_json))


@command("db sync", prints="cbsr_qa.app.sync_outcome:Synchronised")
def sync(
    to: Annotated[
        str | None, typer.Option(metavar="URL|FILE", help="Central database; by default CBSR_QA_CENTRE.")
    ] = None,
    station: Annotated[
        str | None,
        typer.Option(help="Station whose file names the central database and the limit, in its table sync."),
    ] = None,
    database: Database = None,
    watch: Annotated[float | None, typer.Option(min=1, metavar="SECONDS", help="Keep sending until stopped.")] = None,
    status: Annotated[bool, typer.Option("--status", help="Show what waits; send nothing.")] = False,
    retry: Annotated[str | None, typer.Option(metavar="ITEM", help="Send a quarantined item again.")] = None,
    let_go: Annotated[
        str | None, typer.Option("--let-go", metavar="ITEM", help="Do not send a quarantined item.")
    ] = None,
    limit_h: Annotated[
        float | None, typer.Option(min=0, metavar="HOURS", help="Fail if anything has waited longer.")
    ] = None,
    compare_since: Annotated[
        datetime | None,
        typer.Option(
            "--compare-since", formats=["%Y-%m-%d"], help="Compare all from this day on with the centre's (UTC)."
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Send what this database holds to a central one: runs, analyses, calibrations, station checks and the rest.

    Everything waits in this database until the central one has confirmed it; a command that is interrupted loses
    nothing and sends nothing twice. What does not match its digest is quarantined, and the rest goes on. Before more
    of a run is sent, what the central database has of it is compared at both ends; --compare-since compares all.

    Exit code 0 if everything was sent, 1 if something is quarantined or too old, was lost or added at the central
    database, or cannot be read, 2 if the central database cannot be used. --status needs no central database.
    """
    from cbsr_qa.app.sync import decide_item, keep_synchronised, sync_status, synchronise
    from cbsr_qa.config.loader import load_station

    if station is not None:
        stated = load_station(station).value.sync
        to, limit_h = to or stated.centre, stated.backlog_hours if limit_h is None else limit_h
    exclusive_options = [
        option for option, value in {"--watch": watch, "--status": status, "--let-go": let_go}.items() if value
    ]
    exclusive_options += ["--compare-since"] if compare_since and exclusive_options else []
    exclusive_options += ["--retry"] if retry and (let_go or status) else []
    if len(exclusive_options) > 1:
        raise ConfigError(f"{' and '.join(exclusive_options)} cannot be given together", remedy="give one of them")
    if let_go:
        return show(decide_item(database, let_go, again=False), as_json=as_json)
    if retry:
        decide_item(database, retry, again=True)
    if status:
        return show(sync_status(database, to, limit_h=limit_h), as_json=as_json)
    if watch is not None:
        return show(keep_synchronised(database, to, watch, note, limit_h=limit_h), as_json=as_json)
    with Counting("items") as counting:
        outcome = synchronise(
            database,
            to,
            limit_h=limit_h,
            progress=lambda one, of, _: counting.count(one, of),
            compare_since=to_day(compare_since),
        )
    return show(outcome, as_json=as_json)


@command("db roles", prints="cbsr_qa.app.database:Roles")
def roles(as_json: AsJson = False) -> None:
    """Print an SQL script that makes roles for stations and for readers of a PostgreSQL database; runs nothing.

    Stations may add rows and delete none; readers may read tables and views. For example:
    cbsr-qa db roles | psql --single-transaction -v ON_ERROR_STOP=1 URL
    """
    from cbsr_qa.app.database import database_roles
    from cbsr_qa.report.document import json_document

    script = database_roles()
    if as_json:
        emit_json(json_document(script))
    else:
        say(script.sql.removesuffix("\n"))
