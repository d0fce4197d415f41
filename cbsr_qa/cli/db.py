"""``cbsr-qa db``: looks after the database."""

from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, Database
from cbsr_qa.cli.output import Counting, emit_json, note, say, show
from cbsr_qa.domain import ConfigError

group("db", "Maintain the database.")


@command("db upgrade", prints="cbsr_qa.app:Upgrade")
def upgrade(database: Database = None, as_json: AsJson = False) -> None:
    """Upgrade a database to this version of the program, or create it."""
    from cbsr_qa.app import upgrade_database

    show(upgrade_database(database), as_json=as_json)


@command("db status", prints="cbsr_qa.app:DatabaseStatus")
def status(database: Database = None, as_json: AsJson = False) -> None:
    """Show which database is used, its version, its contents and unfinished runs."""
    from cbsr_qa.app import database_status

    show(database_status(database), as_json=as_json)


@command("db changes", prints="cbsr_qa.app:Changes")
def changes(database: Database = None, as_json: AsJson = False) -> None:
    """List changes of limits, recipes, other files, control charts and verdicts: who, when and why."""
    from cbsr_qa.app import list_changes

    show(list_changes(database), as_json=as_json)


@command("db sync", prints="cbsr_qa.app:Synchronised")
def sync(
    to: Annotated[
        str | None, typer.Option(metavar="URL|FILE", help="Central database; by default CBSR_QA_CENTRE.")
    ] = None,
    database: Database = None,
    watch: Annotated[float | None, typer.Option(min=1, metavar="SECONDS", help="Send again and again.")] = None,
    status: Annotated[bool, typer.Option("--status", help="Show what waits; send nothing.")] = False,
    retry: Annotated[str | None, typer.Option(metavar="ITEM", help="Send a quarantined item again.")] = None,
    let_go: Annotated[
        str | None, typer.Option("--let-go", metavar="ITEM", help="Do not send a quarantined item.")
    ] = None,
    limit_h: Annotated[
        float | None, typer.Option(min=0, metavar="HOURS", help="Fail if anything has waited longer.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Send what this database holds to a central one: runs, analyses, calibrations, station checks and the rest.

    Everything waits in this database until the central one has confirmed it; a command that is interrupted loses
    nothing and sends nothing twice. What does not match its digest is quarantined, and the rest goes on.

    Exit code 0 if everything was sent, 1 if something is quarantined or too old, 2 if the central database cannot be
    used.
    """
    from cbsr_qa.app import decide_item, keep_synchronised, sync_status, synchronise

    given = [option for option, value in {"--watch": watch, "--status": status, "--let-go": let_go}.items() if value]
    given += ["--retry"] if retry and (let_go or status) else []
    if len(given) > 1:
        raise ConfigError(f"{' and '.join(given)} cannot be given together", remedy="give one of them")
    if let_go:
        return show(decide_item(database, let_go, again=False), as_json=as_json)
    if retry:
        decide_item(database, retry, again=True)
    if status:
        return show(sync_status(database, to, limit_h=limit_h), as_json=as_json)
    if watch is not None:
        return show(keep_synchronised(database, to, watch, note, limit_h=limit_h), as_json=as_json)
    with Counting("items") as counting:
        done = synchronise(database, to, limit_h=limit_h, progress=lambda one, of, _: counting.count(one, of))
    return show(done, as_json=as_json)


@command("db roles", prints="cbsr_qa.app:Roles")
def roles(as_json: AsJson = False) -> None:
    """Print an SQL script that makes roles for stations and for readers of a PostgreSQL database; runs nothing.

    Stations may add rows and delete none; readers may read tables and views. For example:
    cbsr-qa db roles | psql --single-transaction -v ON_ERROR_STOP=1 URL
    """
    from cbsr_qa.app import database_roles
    from cbsr_qa.report import json_document

    made = database_roles()
    if as_json:
        emit_json(json_document(made))
    else:
        say(made.sql.removesuffix("\n"))
