"""``cbsr-qa compare``: what differs, and whether it is the material or the station."""

from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, Database, OfParts, PageOutput, Since, Until
from cbsr_qa.cli.output import check_page, show


@command("compare", prints="cbsr_qa.studies.compare.comparison:Comparison")
def compare(
    by: Annotated[str, typer.Option(help="What the groups are: batch, material, station, software or period.")],
    groups: Annotated[
        str | None, typer.Option(metavar="A,B", help="Groups to compare, the reference first; by default all.")
    ] = None,
    metric: Annotated[
        list[str] | None, typer.Option(metavar="METRIC", help="Only this metric; may be repeated.")
    ] = None,
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    part: OfParts = None,
    since: Since = None,
    until: Until = None,
    margin: Annotated[
        list[str] | None,
        typer.Option(
            metavar="METRIC=VALUE",
            help="Test whether groups are alike within this difference, in the metric's unit; repeatable.",
        ),
    ] = None,
    detect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="METRIC=VALUE",
            help="Say how many sensors it takes to find a difference of this size (80 % power); repeatable.",
        ),
    ] = None,
    distribution: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[METRIC=]NAME",
            help="Fit this distribution, or the best, for the capability of values that are not normal; repeatable.",
        ),
    ] = None,
    policy: Annotated[
        str, typer.Option(help="Which run of a sensor decides: first, last, or any that passed.")
    ] = "last",
    quarantine: Annotated[
        str, typer.Option(help="How sensors that could not be measured count: apart (not in the yield) or failed.")
    ] = "apart",
    period: Annotated[
        str | None, typer.Option(help="Length of a period, for --by period: day, week, month (default) or year.")
    ] = None,
    adjust: Annotated[
        str, typer.Option(help="How p values are adjusted for many metrics: holm, benjamini-hochberg or none.")
    ] = "holm",
    output: PageOutput = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Compare stored runs of batches, materials, stations, software versions or periods in every metric.

    Differences between batches are separated from those between stations where the runs allow it. Exit code 3 if
    nothing could be compared.
    """
    from cbsr_qa.cli.options import one_of, to_day
    from cbsr_qa.config.serials import read_parts
    from cbsr_qa.domain.errors import RefusedError
    from cbsr_qa.domain.results.fleet import RunSelection
    from cbsr_qa.studies.compare.comparison import compare_groups
    from cbsr_qa.studies.compare.report import compare_outcome
    from cbsr_qa.studies.compare.terms import (
        Adjustment,
        By,
        Period,
        Policy,
        Quarantine,
        Terms,
        read_amounts,
        read_distributions,
        read_groups,
    )
    from cbsr_qa.system.clock import RealClock

    word = one_of(By, by, "--by")
    if period is not None and word is not By.PERIOD:
        raise RefusedError(f"--period {period[:64]!r} has no meaning for --by {word}", remedy="use --by period")
    if database is not None and not database.strip():
        raise RefusedError("--database is empty", remedy="leave it out for the usual database, or name one")
    terms = Terms(
        by=word,
        groups=read_groups(groups),
        names=tuple(dict.fromkeys(metric or ())),
        policy=one_of(Policy, policy, "--policy"),
        quarantine=one_of(Quarantine, quarantine, "--quarantine"),
        period=one_of(Period, period or Period.MONTH, "--period"),
        adjustment=one_of(Adjustment, adjust, "--adjust"),
        margins=read_amounts(margin or (), "--margin"),
        detect=read_amounts(detect or (), "--detect"),
        distributions=read_distributions(distribution or ()),
    )
    parts = read_parts(part or ())
    selection = RunSelection(recipe=recipe, since=to_day(since), until=to_day(until), parts=parts)
    check_page(output)  # before anything is computed
    comparison = compare_groups(selection, terms, database=database, now=RealClock().wall())
    raise typer.Exit(show(compare_outcome(comparison), output=output, as_json=as_json))
