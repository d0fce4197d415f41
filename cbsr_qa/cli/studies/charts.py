"""``cbsr-qa charts``: control charts of a station, and the reference period they rest on."""

from collections.abc import Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import (
    AsJson,
    Database,
    OfParts,
    PageOutput,
    list_given_options,
    one_of,
    option_names,
    to_day,
)
from cbsr_qa.cli.output import check_page, show
from cbsr_qa.domain.errors import RefusedError

if TYPE_CHECKING:
    from cbsr_qa.domain.results.charts import ChartSettings

_DAY = ["%Y-%m-%d"]


@command("charts", prints="cbsr_qa.studies.charts.charts:Charts|cbsr_qa.studies.charts.listed:ListedCharts")
def charts(
    context: typer.Context,
    station: Annotated[
        str | None, typer.Option(help="Name of the station, as stored with its runs; without it, charts are listed.")
    ] = None,
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    part: OfParts = None,
    golden: Annotated[str, typer.Option(metavar="SERIAL", help="Chart this golden sensor, not production.")] = "",
    metric: Annotated[
        list[str] | None, typer.Option(metavar="METRIC", help="What to chart; may be repeated.")
    ] = None,
    by_location: Annotated[
        bool, typer.Option("--by-location", help="Set a new reference for each location.")
    ] = False,
    chart: Annotated[
        str | None, typer.Option(help="i-mr (default), xbar-r, ewma or cusum (of a new reference).")
    ] = None,
    subgroup: Annotated[int | None, typer.Option(help="Runs per point, with a new xbar-r (default 5).")] = None,
    rules: Annotated[
        str | None, typer.Option(help="Numbers of Nelson's tests, with a new i-mr or xbar-r (default 1,2).")
    ] = None,
    reference_from: Annotated[
        datetime | None, typer.Option(formats=_DAY, help="First day of a new reference period (UTC).")
    ] = None,
    reference_runs: Annotated[int | None, typer.Option(help="Store a new reference of this many runs.")] = None,
    reference_until: Annotated[
        datetime | None, typer.Option(formats=_DAY, help="Store a new reference up to the end of this day (UTC).")
    ] = None,
    retire: Annotated[
        str | None, typer.Option(metavar="CHART", help="Retire charts of this kind (i-mr, xbar-r, ewma or cusum).")
    ] = None,
    operator: Annotated[str, typer.Option(help="Who sets the new reference, or retires charts.")] = "",
    why: Annotated[str, typer.Option(help="The reason.")] = "",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show a new reference without storing it.")] = False,
    output: PageOutput = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Chart a station's metrics over its runs, against a reference period in which it was known to be in order.

    Without --station, list the stations that are charted. Exit code 1 if a chart signals.
    """
    if station is None:
        raise typer.Exit(_list_all(context, database=database, as_json=as_json))
    from cbsr_qa.config.serials import read_parts
    from cbsr_qa.domain.results.charts import ChartKind
    from cbsr_qa.studies.charts.charts import control_charts
    from cbsr_qa.studies.charts.report import charts_outcome
    from cbsr_qa.studies.charts.request import ChartsRequest, ReferencePeriod

    period = ReferencePeriod(to_day(reference_from), reference_runs, to_day(reference_until))
    new = period != ReferencePeriod(None, None, None)
    if not new:
        of_new = {"--chart": chart, "--subgroup": subgroup, "--rules": rules, "--by-location": by_location}
        who = {} if retire is not None else {"--operator": operator, "--why": why}
        _check_stored_holds(of_new | who | {"--dry-run": dry_run})
    request = ChartsRequest(
        station=station,
        recipe=recipe,
        parts=read_parts(part or ()),
        golden=golden or None,
        metrics=tuple(dict.fromkeys(metric or ())),
        by_location=by_location,
        settings=_settings(chart, subgroup, rules),
        period=period if new else None,
        dry_run=dry_run,
        retire=None if retire is None else one_of(ChartKind, retire, "--retire"),
        operator=operator,
        why=why,
    )
    check_page(output)  # before anything is computed or stored
    outcome = charts_outcome(control_charts(request, database=database))
    raise typer.Exit(show(outcome, output=output, as_json=as_json))


def _list_all(context: typer.Context, *, database: str | None, as_json: bool) -> int:
    from cbsr_qa.studies.charts.listed import list_charts

    if of_one_station := list_given_options(context) - {"database", "as_json"}:
        raise RefusedError(
            f"{option_names(sorted(of_one_station))} without --station",
            remedy="name the station; cbsr-qa charts lists those that are charted",
        )
    return show(list_charts(database=database), as_json=as_json)


def _check_stored_holds(of_new: Mapping[str, object]) -> None:
    """Refuse options of a new reference if none is set: they would silently change nothing."""
    given = [name for name, value in of_new.items() if value not in (None, "", False)]
    if given:
        raise RefusedError(
            f"{', '.join(given)} can only be given with a new reference period",
            remedy="leave them out, or set a new one by --reference-runs N or --reference-until DATE",
        )


def _settings(chart: str | None, subgroup: int | None, rules: str | None) -> "ChartSettings":
    from cbsr_qa.domain.results.charts import ChartKind, ChartSettings

    kind = one_of(ChartKind, chart or ChartKind.INDIVIDUALS, "--chart")
    if rules is not None and kind in (ChartKind.EWMA, ChartKind.CUSUM):
        raise RefusedError(
            f"--rules with --chart {kind}", remedy="Nelson's tests are of i-mr and xbar-r: leave it out"
        )
    try:
        numbers = tuple(sorted({int(part) for part in (rules or "1,2").split(",")}))
    except ValueError as error:
        raise RefusedError(f"--rules is {rules!r}", remedy="give numbers from 1 to 8, e.g. 1,2,5") from error
    default = 5 if kind is ChartKind.MEANS else 1
    return ChartSettings(kind, default if subgroup is None else subgroup, numbers)
