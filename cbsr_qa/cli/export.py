"""``cbsr-qa export``: stored runs as files that other programs read."""

from dataclasses import fields
from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, Database, list_given_options
from cbsr_qa.cli.output import announce, show
from cbsr_qa.cli.selecting import EVERY_RUN, Checks, Selecting

#: Parameters that select runs.
_SELECTING = {"latest", "checks", *(field.name for field in fields(Selecting))}


@command("export", prints="cbsr_qa.app.export.export:Exported")
def export(
    context: typer.Context,
    to: Annotated[Path, typer.Option("--to", help="File to write; its ending determines the format.")],
    run: Annotated[
        str | None,
        typer.Argument(help="Run, or a serial number for the latest run of that sensor; without it, selected runs."),
    ] = None,
    format_: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="csv or parquet (.parquet), a table of runs or measurements; junit (.xml), outcomes;"
            " recording (.h5), netcdf (.nc) or eidors (.mat), the frames of RUN. By default that of the suffix.",
        ),
    ] = None,
    table: Annotated[
        str | None,
        typer.Option(metavar="runs|measurements", help="What a row of a table is; by default a run."),
    ] = None,
    phase: Annotated[str | None, typer.Option(help="Frames of this phase only.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
    selecting: Selecting = EVERY_RUN,
    latest: Annotated[int | None, typer.Option(help="Only the latest N.")] = None,
    checks: Checks = False,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Write stored runs to a file that other programs read: tables, frames, or outcomes.

    Tables and outcomes are of RUN, or of the runs that the options select, as cbsr-qa runs lists them. For example:
    cbsr-qa export --table measurements --batch 42 --to measurements.parquet

    A run that was altered since it was stored is marked in a table (exit code 1), and in no other file: they are
    refused, and nothing is written (exit code 2).
    """
    from cbsr_qa.app.export.export import ExportRequest, export_data

    selects = bool(_SELECTING & list_given_options(context))
    selected = selecting.request(latest=latest, checks=checks) if selects else None
    request = ExportRequest(to, run, selected, format_, table, phase, force)
    raise typer.Exit(show(export_data(request, database=database, tell=announce), as_json=as_json))
