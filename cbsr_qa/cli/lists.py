"""``cbsr-qa runs`` and ``cbsr-qa sensors``: what was tested."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, Database
from cbsr_qa.cli.output import note, say, show
from cbsr_qa.cli.selecting import Checks, Selecting
from cbsr_qa.domain.errors import RefusedError

if TYPE_CHECKING:
    from cbsr_qa.app.shift.lists import ListRequest
    from cbsr_qa.domain.results.report import CommandOutcome
    from cbsr_qa.store.repository import Repository

_List = TypeVar("_List")
_STDOUT = Path("-")

_Csv = Annotated[Path | None, typer.Option("--csv", help="CSV file to write; - prints it.")]


@command("runs", prints="cbsr_qa.app.shift.lists:RunList")
def runs(
    selecting: Selecting,
    latest: Annotated[int | None, typer.Option(help="Only the latest N.")] = None,
    checks: Checks = False,
    csv: _Csv = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """List stored runs with their verdicts, yields and reasons for failure.

    An overridden verdict counts as it was overridden; aborted and broken runs have none. In a terminal the latest 50
    are listed, unless an option says which. Exit code 1 if a listed run was altered since it was stored.
    """
    from cbsr_qa.app.shift.lists import LATEST_RUNS, list_runs
    from cbsr_qa.app.shift.report import runs_csv, runs_outcome

    if latest is None and not (selecting.is_given() or csv or as_json):
        latest = LATEST_RUNS
    request = selecting.request(latest=latest, checks=checks)
    _list(request, list_runs, runs_outcome, runs_csv, csv, database, as_json=as_json)


@command("sensors", prints="cbsr_qa.app.shift.lists:SensorList")
def sensors(
    selecting: Selecting,
    latest: Annotated[int | None, typer.Option(help="Only the last N tested.")] = None,
    csv: _Csv = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """List tested sensors, each with the verdict of its last run that passed or failed.

    A sensor tested by two recipes is listed twice. With --failed or --limit, that last verdict must be the failure.
    Exit code 1 if a listed run was altered since it was stored.
    """
    from cbsr_qa.app.shift.lists import list_sensors
    from cbsr_qa.app.shift.report import sensors_csv, sensors_outcome

    request = selecting.request(latest=latest)
    _list(request, list_sensors, sensors_outcome, sensors_csv, csv, database, as_json=as_json)


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
    from cbsr_qa.app.calibration.apply import write_table
    from cbsr_qa.config.paths import database_url
    from cbsr_qa.store.opening import open_store

    if csv == _STDOUT and as_json:
        raise RefusedError("--csv - with --json", remedy="one of them is printed: name a file for the other")
    with open_store(database_url(database), create=False) as store:
        listed = find(store, request)
    outcome = lay_out(listed)
    if csv == _STDOUT:
        say(as_csv(listed).removesuffix("\n"))
        for remark in outcome.page.remarks:
            note(remark)
        raise typer.Exit(outcome.exit_code)
    if csv is not None:
        write_table(csv, as_csv(listed))
        note(f"list         {csv}")
    raise typer.Exit(show(outcome, as_json=as_json))
