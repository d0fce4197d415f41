"""``cbsr-qa report``: renders a report again from the store."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.output import emit_json, say


def report(
    run: Annotated[str, typer.Argument(help="A run, or a serial number for its latest run.")],
    to: Annotated[Path | None, typer.Option("--to", help="Folder to write to; by default var/reports.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Render the report of a stored run again; a verdict that does not follow is refused."""
    from cbsr_qa.app.render import render_stored

    rendered = render_stored(run, database=database, folder=to)
    if as_json:
        emit_json(
            {
                "run": rendered.run,
                "serial": rendered.serial,
                "outcome": rendered.outcome,
                "reason": rendered.reason,
                "report": str(rendered.report),
                "chain": rendered.chain.document(),
                "overrides": [override.document() for override in rendered.overrides],
                "warnings": list(rendered.warnings),
            }
        )
    else:
        said = "".join(f", overridden to {one.outcome} by {one.operator}" for one in rendered.overrides[-1:])
        say(f"{rendered.report}: run {rendered.run}, {rendered.outcome}{said}")
        say(f"rows: {rendered.chain.words}")
