"""``cbsr-qa gauge``: how much of the variation of stored runs is the gauge's.

The words of ``cbsr-qa gauge``: a table a metric, with sentences below it.
"""

import textwrap
from collections.abc import Iterable, Iterator
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cbsr_qa.cli.output import emit_json, note, say
from cbsr_qa.config import printable

if TYPE_CHECKING:
    from cbsr_qa.studies.gauge import AgainstReferences, Gauge, MetricGauge


_DAY = ["%Y-%m-%d"]


#: What goes beside a study's file: it says all the rest.
_BESIDE_STUDY: Final = {"study", "output", "database", "as_json"}


def gauge(
    context: typer.Context,
    study: Annotated[
        Path | None, typer.Argument(metavar="STUDY.toml", help="File that says what is studied, instead of options.")
    ] = None,
    serials: Annotated[str | None, typer.Option(metavar="S1,S2,…", help="Sensors of the study.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    stations: Annotated[str | None, typer.Option(metavar="A,B,…", help="Runs on these stations.")] = None,
    metric: Annotated[
        list[str] | None, typer.Option(help="What to study; may be repeated. By default what the recipe limits.")
    ] = None,
    by_location: Annotated[
        bool, typer.Option("--by-location", help="One study a location, not of their mean.")
    ] = False,
    appraiser: Annotated[str, typer.Option(help="Who measures: station or operator.")] = "station",
    since: Annotated[datetime | None, typer.Option(formats=_DAY, help="Runs from this day on (UTC).")] = None,
    until: Annotated[datetime | None, typer.Option(formats=_DAY, help="Runs to the end of this day (UTC).")] = None,
    largest_balanced: Annotated[
        bool, typer.Option("--largest-balanced", help="Of an incomplete crossing, take the largest whole part.")
    ] = False,
    reference: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SERIAL.METRIC=VALUE±U UNIT",
            help="What a golden sensor truly is, or a TOML file; may be repeated.",
        ),
    ] = None,
    confidence: Annotated[float, typer.Option(help="Of intervals, in per cent, above 50 and below 100.")] = 95.0,
    output: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Gauge R&R of stored runs: every sensor on every station (or by every operator), more than once.

    STUDY.toml names sensors, stations, metrics, tolerances and days; or options do.
    """
    from cbsr_qa.studies.gauge import GaugeRequest, MetricWanted, gauge as studied, read_study, references_of

    if output is not None:
        from cbsr_qa.report import check_replaceable

        check_replaceable(output)  # before anything is worked out
    if study is not None:
        _check_alone(context, study)
        request = read_study(study)
    else:
        request = GaugeRequest(
            serials=_names(serials),
            recipe=recipe,
            stations=_names(stations),
            since=_day(since),
            until=_day(until),
            metrics=tuple(map(MetricWanted, dict.fromkeys(metric or ()))),
            by_location=by_location,
            appraiser=appraiser,
            largest_balanced=largest_balanced,
            references=references_of(reference or ()),
            confidence=confidence / 100,
        )
    found = studied(request, database=database)
    if output is not None:
        from cbsr_qa.report import write_report
        from cbsr_qa.studies.gauge import gauge_html

        write_report(output, gauge_html(found))
        note(f"page         {output}")
    if as_json:
        from cbsr_qa.studies.gauge import gauge_document

        emit_json(gauge_document(found))
        return
    for line in lines(found):
        say(line)


def _check_alone(context: typer.Context, study: Path) -> None:
    """Refuse options that say something else than a study's file: what was studied is what its digest stands for.

    Raises
    ------
    typer.BadParameter
        Naming them.
    """
    # A source is an enumeration of click's, which typer brings a copy of: told apart by name.
    sources = {name: context.get_parameter_source(name) for name in context.params if name not in _BESIDE_STUDY}
    given = [name for name, source in sources.items() if source is not None and source.name != "DEFAULT"]
    if given:
        named = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise typer.BadParameter(
            f"{study} says what is studied: {named} cannot be given beside it, change it there"
            " (--output, --database and --json can)"
        )


def _names(said: str | None) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part.strip() for part in (said or "").split(",") if part.strip()))


def _day(moment: datetime | None) -> date | None:
    return None if moment is None else moment.date()


WIDTH = 100
_PARTS = (
    ("repeatability", "repeatability"),
    ("reproducibility", "reproducibility"),
    ("gauge", "gauge (R&R)"),
    ("sensor", "sensors"),
    ("total", "total"),
)


def lines(found: "Gauge") -> Iterator[str]:
    """Lay a study out, one line after another."""
    from cbsr_qa.studies.gauge import source_words, study_words

    if found.request.source is not None:
        yield from _wrapped("file     ", printable(source_words(found.request.source)))
    yield from _wrapped("study    ", printable(study_words(found)))
    for words in found.notes:
        yield from _wrapped("note     ", printable(words))
    for one in found.metrics:
        yield ""
        unit = "" if one.series.unit == "1" else f", {one.series.unit}"
        yield printable(f"{one.series.key.label}{unit}")
        yield from _metric(one, found.request.appraiser, found.request.confidence)


def _metric(one: "MetricGauge", appraiser: str, confidence: float) -> Iterator[str]:
    from cbsr_qa.studies.gauge import metric_words

    if one.anova is not None and one.ranges is not None:
        yield from _columns(_components(one, confidence))
    for words in metric_words(one, appraiser, confidence):
        yield from _wrapped("    ", printable(words))
    if one.against is not None:
        yield from _against(one.against, appraiser, confidence)


def _components(one: "MetricGauge", confidence: float) -> Iterator[tuple[str, ...]]:
    from cbsr_qa.report import number
    from cbsr_qa.studies.gauge import deviation_words, percent

    assert one.anova is not None
    assert one.ranges is not None
    yield "", "deviation", f"{100 * confidence:g} % interval", "variance", "study", "tolerance", "by ranges"
    variation, by_range = one.anova.variation, one.ranges.variation
    for name, shown in _PARTS:
        part = getattr(variation, name)
        tolerance = variation.percent_tolerance(part)
        yield (
            shown,
            number(part.deviation, 4),
            deviation_words(part),
            percent(variation.percent_contribution(part)),
            percent(variation.percent_study(part)),
            "–" if tolerance is None else percent(tolerance),
            number(getattr(by_range, name).deviation, 4),
        )


def _columns(rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    """Lay rows out in columns as wide as what stands in them."""
    table = list(rows)
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for first, *rest in table:
        cells = (f"{cell:>{width}}" for cell, width in zip(rest, widths[1:], strict=True))
        yield f"  {first:<{widths[0]}}  {'  '.join(cells)}"


def _against(found: "AgainstReferences", appraiser: str, confidence: float) -> Iterator[str]:
    from cbsr_qa.studies.gauge import reference_words

    for words in reference_words(found, appraiser, confidence):
        yield from _wrapped("    ", printable(words))


def _wrapped(start: str, text: str) -> Iterator[str]:
    indent = " " * len(start) if start.strip() else f"{start}  "
    yield from textwrap.wrap(
        text, WIDTH, initial_indent=start, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
