"""``cbsr-qa runs`` and ``cbsr-qa sensors``: what was tested."""

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, Database, Since, Until, to_day
from cbsr_qa.cli.output import note, say, show
from cbsr_qa.domain import RefusedError

if TYPE_CHECKING:
    from cbsr_qa.domain.results import CommandOutcome
    from cbsr_qa.store import Repository
    from cbsr_qa.studies.shift import ListRequest

_List = TypeVar("_List")
_STDOUT = Path("-")

_Today = Annotated[
    bool, typer.Option("--today", help="Runs that began today, by this computer's local time; not with --since.")
]
_Station = Annotated[list[str] | None, typer.Option(metavar="STATION", help="Of this station; may be repeated.")]
_Batch = Annotated[str | None, typer.Option(help="Of sensors of this batch.")]
_Operator = Annotated[list[str] | None, typer.Option(metavar="NAME", help="By this operator; may be repeated.")]
_Recipe = Annotated[str | None, typer.Option(help="Of the recipe of this name.")]
_Failed = Annotated[bool, typer.Option("--failed", help="Only what failed.")]
_Limit = Annotated[str, typer.Option(metavar="NAME", help="Only failures of this limit, e.g. centre_of_mass_error.")]
_Csv = Annotated[Path | None, typer.Option("--csv", help="CSV file to write; - prints it.")]


@command("runs", prints="cbsr_qa.studies.shift:RunList")
def runs(
    today: _Today = False,
    since: Since = None,
    until: Until = None,
    station: _Station = None,
    batch: _Batch = None,
    operator: _Operator = None,
    recipe: _Recipe = None,
    failed: _Failed = False,
    limit: _Limit = "",
    latest: Annotated[int | None, typer.Option(help="Only so many of the latest.")] = None,
    checks: Annotated[
        bool, typer.Option("--checks", help="Also runs of golden sensors that checked a station; never counted.")
    ] = False,
    csv: _Csv = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """List stored runs with their verdicts, yields and reasons for failure.

    An overridden verdict counts as it was overridden; aborted and broken runs have none. In a terminal the latest 50
    are listed, unless an option says which.
    """
    from cbsr_qa.studies.shift import LATEST_RUNS, list_runs, runs_csv, runs_outcome

    said_which = any([today, since, until, station, batch, operator, recipe, failed, limit])
    if latest is None and not (said_which or csv or as_json):
        latest = LATEST_RUNS
    request = _request(
        today,
        since,
        until,
        station,
        batch,
        operator,
        recipe,
        failed=failed,
        limit=limit,
        latest=latest,
        checks=checks,
    )
    _list(request, list_runs, runs_outcome, runs_csv, csv, database, as_json=as_json)


@command("sensors", prints="cbsr_qa.studies.shift:SensorList")
def sensors(
    today: _Today = False,
    since: Since = None,
    until: Until = None,
    station: _Station = None,
    batch: _Batch = None,
    operator: _Operator = None,
    recipe: _Recipe = None,
    failed: _Failed = False,
    limit: _Limit = "",
    latest: Annotated[int | None, typer.Option(help="Only so many of the last tested.")] = None,
    csv: _Csv = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """List tested sensors, each with the verdict of its last run that passed or failed.

    A sensor tested by two recipes is listed twice. With --failed or --limit, that last verdict must be the failure.
    """
    from cbsr_qa.studies.shift import list_sensors, sensors_csv, sensors_outcome

    request = _request(
        today, since, until, station, batch, operator, recipe, failed=failed, limit=limit, latest=latest
    )
    _list(request, list_sensors, sensors_outcome, sensors_csv, csv, database, as_json=as_json)


def _request(
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
    from cbsr_qa.domain.results import RunSelection
    from cbsr_qa.studies.shift import ListRequest, local_day

    if today and (since or until):
        raise RefusedError("--today with --since or --until", remedy="give one of them")
    begins, ends = local_day() if today else (None, None)
    selection = RunSelection(
        recipe=recipe,
        batch=batch,
        stations=tuple(station or ()),
        operators=tuple(operator or ()),
        since=to_day(since),
        until=to_day(until),
        checks=checks,
        from_moment=begins,
        before_moment=ends,
    )
    return ListRequest(selection, failed=failed, limit=limit, latest=latest)


def _list(
    request: "ListRequest",
    find: "Callable[[Repository, ListRequest], _List]",
    lay_out: "Callable[[_List], CommandOutcome[Any]]",
    as_csv: Callable[[_List], str],
    csv: Path | None,
    database: str | None,
    *,
    as_json: bool,
) -> None:
    from cbsr_qa.app import write_table
    from cbsr_qa.config import database_url
    from cbsr_qa.store import open_store

    if csv == _STDOUT and as_json:
        raise RefusedError("--csv - with --json", remedy="one of them is printed: name a file for the other")
    with open_store(database_url(database), create=False) as store:
        found = find(store, request)
    if csv == _STDOUT:
        say(as_csv(found).removesuffix("\n"))
        return
    if csv is not None:
        write_table(csv, as_csv(found))
        note(f"list         {csv}")
    show(lay_out(found), as_json=as_json)
