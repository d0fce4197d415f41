"""``cbsr-qa db``: looks after the database."""

import typer

from cbsr_qa.cli.options import AsJson, Database
from cbsr_qa.cli.output import show

app = typer.Typer(help="Maintain the database.", no_args_is_help=True)


@app.command()
def upgrade(database: Database = None, as_json: AsJson = False) -> None:
    """Upgrade a database to this version of the program, or create it."""
    from cbsr_qa.app import upgrade_database

    show(upgrade_database(database), as_json=as_json)


@app.command()
def status(database: Database = None, as_json: AsJson = False) -> None:
    """Show which database is used, its version, its contents and unfinished runs."""
    from cbsr_qa.app import database_status

    show(database_status(database), as_json=as_json)


@app.command()
def changes(database: Database = None, as_json: AsJson = False) -> None:
    """List changes of limits, recipes, other files, control charts and verdicts: who, when and why."""
    from cbsr_qa.app import list_changes

    show(list_changes(database), as_json=as_json)
