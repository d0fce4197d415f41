"""``cbsr-qa report`` and ``verdict``: reports and overrides of stored runs."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, Database
from cbsr_qa.cli.output import show

_Run = Annotated[str, typer.Argument(help="Run, or a serial number for the latest run of that sensor.")]


@command("report", prints="cbsr_qa.app.run.render:Rendered")
def report(
    run: _Run,
    to: Annotated[
        Path | None, typer.Option("--to", metavar="FOLDER", help="Folder to write to; by default var/reports.")
    ] = None,
    annex: Annotated[
        list[str] | None,
        typer.Option(
            metavar="all|none|NAME",
            help="Annexes to print; may be repeated. By default those that the recipe names are there, folded.",
        ),
    ] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Write the report of a stored run again, from its stored frames and verdict.

    Refuses a verdict that does not follow from the stored measurements. A run without a stored result has no verdict:
    the report says how to get one, and the exit code is 3.
    """
    from cbsr_qa.app.run.render import render_outcome, render_stored

    rendered = render_stored(run, database=database, folder=to, annexes=annex or ())
    raise typer.Exit(show(render_outcome(rendered), as_json=as_json))


group("verdict", "Override verdicts.")


@command("verdict override", prints="cbsr_qa.app.changes:Overridden")
def override(
    run: Annotated[
        str,
        typer.Argument(help="Identifier of one run, as its report prints it; not a serial number."),
    ],
    outcome: Annotated[str, typer.Option(metavar="pass|fail", help="New outcome.")],
    by: Annotated[str, typer.Option(metavar="NAME", help="Who decides.")],
    why: Annotated[str, typer.Option(metavar="TEXT", help="Reason for the override.")],
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Override the verdict of a run, recording who, when and why; the original verdict is kept.

    A sensor may have several runs, so RUN is the identifier of one of them, not a serial number. For example:
    cbsr-qa verdict override 01989c3e-6d1f-7a42-b6d0-0e6f5a1f2c3d --outcome fail --by Ada --why "scratched sheet"
    """
    from cbsr_qa.app.changes import override_verdict

    show(override_verdict(run, outcome, by=by, why=why, database=database), as_json=as_json)
