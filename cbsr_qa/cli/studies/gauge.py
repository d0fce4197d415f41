"""``cbsr-qa gauge``: how much of the variation of stored runs is the gauge's."""

from pathlib import Path
from typing import Annotated, Final

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import (
    AsJson,
    Database,
    OfParts,
    PageOutput,
    Since,
    Until,
    list_given_options,
    option_names,
    to_day,
)
from cbsr_qa.cli.output import check_page, show

#: Options allowed with a study's file, which states the others.
_BESIDE_STUDY: Final = {"study", "output", "database", "as_json"}


@command("gauge", prints="cbsr_qa.studies.gauge.study:GaugeStudy")
def gauge(
    context: typer.Context,
    study: Annotated[
        Path | None, typer.Argument(metavar="STUDY.toml", help="File that describes the study, instead of options.")
    ] = None,
    serials: Annotated[str | None, typer.Option(metavar="S1,S2,…", help="Sensors of the study.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    part: OfParts = None,
    stations: Annotated[str | None, typer.Option(metavar="A,B,…", help="Runs on these stations.")] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(metavar="METRIC", help="What to study; may be repeated. By default what the recipe limits."),
    ] = None,
    by_location: Annotated[
        bool, typer.Option("--by-location", help="One study per location, not of their mean.")
    ] = False,
    appraiser: Annotated[str, typer.Option(help="What is compared: station or operator.")] = "station",
    since: Since = None,
    until: Until = None,
    largest_balanced: Annotated[
        bool,
        typer.Option(
            "--largest-balanced", help="If some sensors were not tested everywhere, use the largest complete part."
        ),
    ] = False,
    nested: Annotated[
        str | None,
        typer.Option(
            metavar="PART",
            help="Each station or operator has its own parts: sensor, or batch if the test destroys sensors.",
        ),
    ] = None,
    reference: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SERIAL.METRIC=VALUE±U UNIT",
            help="True value of a golden sensor, or a TOML file; may be repeated.",
        ),
    ] = None,
    confidence: Annotated[
        float, typer.Option(metavar="PERCENT", help="Confidence level of intervals, above 50 and below 100.")
    ] = 95.0,
    output: PageOutput = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Gauge R&R of stored runs: every sensor on every station (or by every operator), more than once; or nested.

    Describe the study (sensors, stations, metrics, tolerances, days) in STUDY.toml or by options.
    """
    from cbsr_qa.config.serials import read_parts
    from cbsr_qa.domain.results.fleet import RunSelection
    from cbsr_qa.studies.gauge.references import references_of
    from cbsr_qa.studies.gauge.report import gauge_outcome
    from cbsr_qa.studies.gauge.request import GaugeRequest, MetricWanted, read_study
    from cbsr_qa.studies.gauge.study import gauge as studied

    check_page(output)
    if study is not None:
        _check_alone(context, study)
        request = read_study(study)
    else:
        request = GaugeRequest(
            runs=RunSelection(
                serials=_names(serials),
                recipe=recipe,
                stations=_names(stations),
                since=to_day(since),
                until=to_day(until),
                parts=read_parts(part or ()),
            ),
            metrics=tuple(map(MetricWanted, dict.fromkeys(metric or ()))),
            by_location=by_location,
            appraiser=appraiser,
            largest_balanced=largest_balanced,
            nested=nested,
            references=references_of(reference or ()),
            confidence=confidence / 100,
        )
    show(gauge_outcome(studied(request, database=database)), output=output, as_json=as_json)


def _check_alone(context: typer.Context, study: Path) -> None:
    """Refuse options that would override a study's file, whose digest identifies the study.

    Raises
    ------
    typer.BadParameter
        Naming them.
    """
    given = list_given_options(context) - _BESIDE_STUDY
    if given:
        named = option_names(name for name in context.params if name in given)
        raise typer.BadParameter(
            f"{study} defines the study: {named} cannot be given together with it; change the file instead"
            " (--output, --database and --json can)"
        )


def _names(listed: str | None) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part.strip() for part in (listed or "").split(",") if part.strip()))
