"""``cbsr-qa verdict``: decisions of people about verdicts.

``cbsr-qa report``: renders a report again from the store.

``cbsr-qa export``: a stored run as a recording that ``analyse`` reads.
"""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.options import AsJson, Database
from cbsr_qa.cli.output import show

_Run = Annotated[str, typer.Argument(help="A run, or a serial number for its latest run.")]


def report(
    run: _Run,
    to: Annotated[Path | None, typer.Option("--to", help="Folder to write to; by default var/reports.")] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Render the report of a stored run again, from its stored frames and verdict.

    A verdict that does not follow from the stored measurements is refused.
    """
    from cbsr_qa.app.run import render_stored, rendered_outcome

    show(rendered_outcome(render_stored(run, database=database, folder=to)), as_json=as_json)


def export(
    run: _Run,
    to: Annotated[Path, typer.Option("--to", help="File to write; must not exist yet.")],
    phase: Annotated[str | None, typer.Option(help="Only this phase.")] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Write the frames, force and presses of a stored run to one HDF5 recording."""
    from cbsr_qa.app import export_run

    show(export_run(run, to, phase=phase, database=database), as_json=as_json)


app = typer.Typer(help="Decide against a verdict.", no_args_is_help=True)


@app.callback()
def _verdict() -> None:
    """Decide against a verdict."""


@app.command()
def override(
    run: Annotated[str, typer.Argument(help="The run; a serial number is not enough.")],
    outcome: Annotated[str, typer.Option(help="pass or fail.")],
    by: Annotated[str, typer.Option(metavar="NAME", help="Who decides.")],
    why: Annotated[str, typer.Option(metavar="TEXT", help="The reason.")],
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Store a decision against a run's verdict, with who, when and why; the verdict itself stays beside it."""
    from cbsr_qa.app import override_verdict

    show(override_verdict(run, outcome, by=by, why=why, database=database), as_json=as_json)
