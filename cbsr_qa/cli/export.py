"""``cbsr-qa export``: a stored run as a recording that ``analyse`` reads."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.output import emit_json, say


def export(
    run: Annotated[str, typer.Argument(help="A run, or a serial number for its latest run.")],
    to: Annotated[Path, typer.Option("--to", help="File to write; must not exist yet.")],
    phase: Annotated[str | None, typer.Option(help="Only this phase.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Write the frames, force and presses of a stored run to one HDF5 recording."""
    from cbsr_qa.app.export_run import export_run

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
