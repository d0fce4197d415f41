"""Options that select runs, of all commands that list or export them."""

from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.options import to_day

if TYPE_CHECKING:
    from cbsr_qa.studies.shift import ListRequest

Today = Annotated[
    bool, typer.Option("--today", help="Runs that began today, by this computer's local time; not with --since.")
]
Station = Annotated[list[str] | None, typer.Option(metavar="STATION", help="Runs at this station; may be repeated.")]
Batch = Annotated[str | None, typer.Option(help="Runs of sensors of this batch.")]
Operator = Annotated[list[str] | None, typer.Option(metavar="NAME", help="Runs by this operator; may be repeated.")]
Recipe = Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")]
Failed = Annotated[bool, typer.Option("--failed", help="Only what failed.")]
Limit = Annotated[str, typer.Option(metavar="NAME", help="Only failures of this limit, e.g. centre_of_mass_error.")]
Checks = Annotated[
    bool, typer.Option("--checks", help="Also runs of golden sensors that checked a station; never counted.")
]


def list_request(
    today: bool,
    since: datetime | None,
    until: datetime | None,
    station: list[str] | None,
    batch: str | None,
    operator: list[str] | None,
    recipe: str | None,
    *,
    failed: bool,
    limit: str,
    latest: int | None,
    checks: bool = False,
) -> "ListRequest":
    """Return which runs the options select. RefusedError if two of them exclude each other."""
    from cbsr_qa.studies.shift import list_request as request

    return request(
        today=today,
        since=to_day(since),
        until=to_day(until),
        failed=failed,
        limit=limit,
        latest=latest,
        checks=checks,
        recipe=recipe,
        batch=batch,
        stations=tuple(station or ()),
        operators=tuple(operator or ()),
    )
