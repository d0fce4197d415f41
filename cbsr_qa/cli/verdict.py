"""``cbsr-qa verdict``: decisions of people about verdicts."""

from typing import Annotated

import typer

from cbsr_qa.cli.output import again, emit_json, say

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
    from cbsr_qa.app.override import override_verdict

    done = override_verdict(run, outcome, by=by, why=why, database=database)
    if as_json:
        emit_json(done.document())
        return
    say(f"run          {done.override.run}")
    say(f"verdict      {done.override.words}")
    say(f"calibration  {done.about_calibration}")
    say(f"             cbsr-qa report {done.override.run}{again(database)} writes the report with it")
