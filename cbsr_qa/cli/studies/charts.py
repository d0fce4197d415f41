"""``cbsr-qa charts``: control charts of a station, and the reference period they rest on.

The words of ``cbsr-qa charts``: how the station stands, then each chart.
"""

import textwrap
from collections.abc import Iterator, Mapping
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.output import emit_json, note, say
from cbsr_qa.config import printable
from cbsr_qa.domain import RefusedError

if TYPE_CHECKING:
    from cbsr_qa.domain.run import ChartKind, ChartSettings
    from cbsr_qa.studies.charts import Charts


_DAY = ["%Y-%m-%d"]


def charts(
    station: Annotated[str, typer.Option(help="Name of the station, as stored with its runs.")],
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    golden: Annotated[str, typer.Option(metavar="SERIAL", help="Chart this golden sensor, not production.")] = "",
    metric: Annotated[list[str] | None, typer.Option(help="What to chart; may be repeated.")] = None,
    by_location: Annotated[bool, typer.Option("--by-location", help="A new reference a location.")] = False,
    chart: Annotated[
        str | None, typer.Option(help="i-mr (default), xbar-r, ewma or cusum (of a new reference).")
    ] = None,
    subgroup: Annotated[int | None, typer.Option(help="Runs a point, with a new xbar-r (default 5).")] = None,
    rules: Annotated[
        str | None, typer.Option(help="Numbers of Nelson's tests, with a new i-mr or xbar-r (default 1,2).")
    ] = None,
    reference_from: Annotated[
        datetime | None, typer.Option(formats=_DAY, help="First day of a new reference period (UTC).")
    ] = None,
    reference_runs: Annotated[int | None, typer.Option(help="Store a new reference of so many runs.")] = None,
    reference_until: Annotated[
        datetime | None, typer.Option(formats=_DAY, help="Store a new reference up to the end of this day (UTC).")
    ] = None,
    retire: Annotated[
        str | None, typer.Option(metavar="CHART", help="Retire charts of this kind (i-mr, xbar-r, ewma or cusum).")
    ] = None,
    operator: Annotated[str, typer.Option(help="Who sets the new reference, or retires charts.")] = "",
    why: Annotated[str, typer.Option(help="Why.")] = "",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show a new reference without storing it.")] = False,
    output: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Chart a station's metrics over its runs, against a reference period in which it was known to be well.

    Exit code 1 if a chart signals.
    """
    from cbsr_qa.studies.charts import ChartsRequest, ReferencePeriod, Retirement, control_charts

    period = None
    if reference_runs is not None or reference_until is not None or reference_from is not None:
        period = ReferencePeriod(
            _day(reference_from), reference_runs, _day(reference_until), operator, why, stored=not dry_run
        )
    else:
        of_new = {"--chart": chart, "--subgroup": subgroup, "--rules": rules, "--by-location": by_location}
        who = {} if retire is not None else {"--operator": operator, "--why": why}
        _check_stored_holds(of_new | who | {"--dry-run": dry_run})
    request = ChartsRequest(
        station=station,
        recipe=recipe,
        golden=golden,
        metrics=tuple(dict.fromkeys(metric or ())),
        by_location=by_location,
        settings=_settings(chart, subgroup, rules),
        period=period,
        retirement=None if retire is None else Retirement(_kind("--retire", retire), operator, why),
    )
    if output is not None:
        from cbsr_qa.report import check_replaceable

        check_replaceable(output)  # before anything is worked out or stored
    found = control_charts(request, database=database)
    if output is not None:
        from cbsr_qa.report import write_report
        from cbsr_qa.studies.charts import charts_html

        write_report(output, charts_html(found))
        note(f"page         {output}")
    if as_json:
        from cbsr_qa.studies.charts import charts_document

        emit_json(charts_document(found))
    else:
        for line in lines(found):
            say(line)
    raise typer.Exit(1 if found.signals else 0)


def _check_stored_holds(of_new: Mapping[str, object]) -> None:
    """Refuse options of a new reference where none is set: they would change nothing, and look as if they did."""
    given = [name for name, value in of_new.items() if value not in (None, "", False)]
    if given:
        raise RefusedError(
            f"{', '.join(given)} without a new reference period: stored references say how they are charted",
            remedy="leave them out, or set a new one by --reference-runs N or --reference-until DATE",
        )


def _settings(chart: str | None, subgroup: int | None, rules: str | None) -> "ChartSettings":
    from cbsr_qa.domain.run import ChartKind, ChartSettings

    kind = _kind("--chart", chart or str(ChartKind.INDIVIDUALS))
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


def _kind(option: str, given: str) -> "ChartKind":
    from cbsr_qa.domain.run import ChartKind

    kinds = [str(kind) for kind in ChartKind]
    if given not in kinds:
        raise RefusedError(f"{option} is {given!r}", remedy=f"allowed: {', '.join(kinds)}")
    return ChartKind(given)


def _day(moment: datetime | None) -> date | None:
    return None if moment is None else moment.date()


WIDTH = 100


def lines(found: "Charts") -> Iterator[str]:
    """Lay the charts out, one line after another."""
    from cbsr_qa.report import plural
    from cbsr_qa.studies.charts import chart_words

    request = found.request
    of = f"golden sensor {request.golden}" if request.golden else "production"
    simulated = " (SIMULATED)" if found.simulated else ""
    yield printable(
        f"station  {request.station}: {plural(found.runs, 'run')} of {of}, recipe {found.recipe}{simulated}"
    )
    signals = found.signals
    charted = sum(one.reference is not None for one in found.charts)
    state = (
        f"OUT OF CONTROL: a signal stands on {len(signals)} of {plural(charted, 'chart')}"
        if signals
        else f"in control on {plural(charted, 'chart')}"
    )
    yield f"state    {state}"
    if found.stored:
        yield f"stored   {plural(charted, 'reference')}"
    for words in found.notes:
        yield from _wrapped("note     ", printable(words))
    for one in found.charts:
        yield ""
        yield printable(one.label)
        for words in chart_words(one):
            yield from _wrapped("    ", printable(words))


def _wrapped(start: str, text: str) -> Iterator[str]:
    indent = " " * len(start) if start.strip() else f"{start}  "
    yield from textwrap.wrap(
        text, WIDTH, initial_indent=start, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
