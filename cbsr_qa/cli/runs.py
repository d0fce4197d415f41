"""``cbsr-qa verdict``: decisions of people about verdicts.

``cbsr-qa report``: renders a report again from the store.

``cbsr-qa export``: a stored run as a recording that ``analyse`` reads.
"""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.output import again, emit_json, note, say


def report(
    run: Annotated[str, typer.Argument(help="A run, or a serial number for its latest run.")],
    to: Annotated[Path | None, typer.Option("--to", help="Folder to write to; by default var/reports.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Render the report of a stored run again; a verdict that does not follow is refused."""
    from cbsr_qa.app.run import render_stored

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
        for warning in rendered.warnings:
            note(f"warning: {warning}")
        said = "".join(f", overridden to {one.outcome} by {one.operator}" for one in rendered.overrides[-1:])
        say(f"{rendered.report}: run {rendered.run}, {rendered.outcome}{said}")
        say(f"rows: {rendered.chain.words}")


def export(
    run: Annotated[str, typer.Argument(help="A run, or a serial number for its latest run.")],
    to: Annotated[Path, typer.Option("--to", help="File to write; must not exist yet.")],
    phase: Annotated[str | None, typer.Option(help="Only this phase.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Write the frames, force and presses of a stored run to one HDF5 recording."""
    from cbsr_qa.app import export_run

    exported = export_run(run, to, phase=phase, database=database)
    if as_json:
        emit_json(
            {
                "run": exported.run,
                "recording": str(to),
                "frames": exported.frames,
                "loads": exported.loads,
                "overrides": [override.document() for override in exported.overrides],
            }
        )
    else:
        say(f"{to}: {exported.frames} frames and {exported.loads} presses of run {exported.run}")


app = typer.Typer(help="Decide against a verdict, beside it.", no_args_is_help=True)


@app.callback()
def _verdict() -> None:
    """Decide against a verdict, beside it."""


@app.command()
def override(
    run: Annotated[str, typer.Argument(help="The run; a serial number will not do.")],
    outcome: Annotated[str, typer.Option(help="pass or fail.")],
    by: Annotated[str, typer.Option(metavar="NAME", help="Who decides.")],
    why: Annotated[str, typer.Option(metavar="TEXT", help="For what reason.")],
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Override a run's verdict: stored with who, when and why; the verdict itself stays, and is shown with it."""
    from cbsr_qa.app import override_verdict

    done = override_verdict(run, outcome, by=by, why=why, database=database)
    if as_json:
        emit_json(done.document())
        return
    say(f"run          {done.override.run}")
    say(f"verdict      {done.override.words}")
    say(f"calibration  {done.about_calibration}")
    say(f"             cbsr-qa report {done.override.run}{again(database)} writes the report with it")
