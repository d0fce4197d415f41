"""``cbsr-qa reanalyse``: a changed analysis over many stored runs."""

from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, Database, PageOutput, Since, Until, to_day
from cbsr_qa.cli.output import check_page, note, show


@command("reanalyse", prints="cbsr_qa.app.reanalyse.report:Reanalysed")
def reanalyse(
    recipe: Annotated[
        str | None, typer.Option(metavar="FILE|NAME", help="Recipe to analyse by; by default each run's own.")
    ] = None,
    of_recipe: Annotated[
        str | None, typer.Option(metavar="NAME", help="Runs that were made by the recipe of this name.")
    ] = None,
    since: Since = None,
    until: Until = None,
    serial: Annotated[
        list[str] | None, typer.Option(metavar="SERIAL", help="Runs of this sensor; repeatable.")
    ] = None,
    station: Annotated[
        list[str] | None, typer.Option(metavar="STATION", help="Runs at this station; may be repeated.")
    ] = None,
    batch: Annotated[str | None, typer.Option(help="Runs of sensors of this batch.")] = None,
    checks: Annotated[
        bool, typer.Option("--checks", help="Also runs of golden sensors that checked a station.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this computer; by default one for each processor.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Dask scheduler whose workers compute instead.")
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Compute again what is stored already.")] = False,
    adopt: Annotated[
        bool, typer.Option("--adopt", help="Make the results the valid analyses; needs --by and --why.")
    ] = False,
    by: Annotated[str, typer.Option(metavar="NAME", help="Who adopts them.")] = "",
    why: Annotated[str, typer.Option(metavar="TEXT", help="Reason for adopting them.")] = "",
    output: PageOutput = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Analyse stored runs again with a changed recipe or this version, and show which verdicts and values change.

    Results are stored on trial, beside the valid analyses, which stay valid unless --adopt is given. The same command
    computes only what is not stored yet. Exit code 3 if no run could be analysed.
    """
    from cbsr_qa.app.reanalyse.reanalysis import reanalyse
    from cbsr_qa.app.reanalyse.report import reanalysis_outcome
    from cbsr_qa.app.reanalyse.request import ReanalyseRequest
    from cbsr_qa.domain.results.fleet import RunSelection

    selection = RunSelection(
        serials=tuple(serial or ()),
        recipe=of_recipe,
        batch=batch,
        stations=tuple(station or ()),
        since=to_day(since),
        until=to_day(until),
        checks=checks,
    )
    request = ReanalyseRequest(
        selection,
        recipe=recipe,
        workers=workers,
        scheduler=scheduler,
        adopt=adopt,
        by=by,
        why=why,
        fresh=fresh,
        database=database,
    )
    check_page(output)  # before anything is computed
    raise typer.Exit(show(reanalysis_outcome(reanalyse(request, tell=note)), output=output, as_json=as_json))
