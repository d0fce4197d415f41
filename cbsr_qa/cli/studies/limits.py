"""``cbsr-qa limits``: limits and guard bands from a golden lot."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, Database, Since, Until, to_day
from cbsr_qa.cli.output import note, show

group("limits", "Propose limits from sensors known to be good.")


@command("limits propose", prints="cbsr_qa.studies.limits.propose:ProposedLimits")
def propose(
    serial: Annotated[
        list[str] | None, typer.Option(metavar="SERIAL", help="A sensor of the golden lot; may be repeated.")
    ] = None,
    serials: Annotated[Path | None, typer.Option(help="File with one serial number a line.")] = None,
    batch: Annotated[str | None, typer.Option(help="Runs of this batch.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    since: Since = None,
    until: Until = None,
    without: Annotated[
        list[str] | None, typer.Option(metavar="SERIAL", help="Leave this sensor out; may be repeated.")
    ] = None,
    measurement: Annotated[
        list[str] | None,
        typer.Option(metavar="METRIC", help="What to limit; may be repeated. By default what the recipe limits now."),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Limit everything that was measured.")] = False,
    coverage: Annotated[
        float, typer.Option(metavar="PERCENT", help="Share of good sensors that each limit accepts.")
    ] = 99.0,
    confidence: Annotated[float, typer.Option(metavar="PERCENT", help="Confidence in that share.")] = 95.0,
    guard_factor: Annotated[
        float,
        typer.Option(metavar="FACTOR", help="Width of the guard band, as a multiple of the expanded uncertainty."),
    ] = 1.0,
    distribution: Annotated[
        str,
        typer.Option(
            help="Distribution of values: normal, log-normal, heavy (tails of Student's t), any, or auto (all that"
            " the lot may come from)."
        ),
    ] = "auto",
    include_failed: Annotated[bool, typer.Option("--include-failed", help="Include runs that failed.")] = False,
    allow_mixed: Annotated[
        bool, typer.Option("--allow-mixed", help="Allow runs of several recipes or software versions.")
    ] = False,
    name: Annotated[str | None, typer.Option("--limits-version", help="Name of this version of limits.")] = None,
    output: Annotated[Path | None, typer.Option(help="TOML file to write; must not exist yet.")] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> None:
    """Propose limits and guard bands from stored runs of sensors known to be good, a golden lot."""
    from cbsr_qa.domain.results.fleet import RunSelection
    from cbsr_qa.studies.limits.golden_lot import LotChoice, read_serials
    from cbsr_qa.studies.limits.proposals import Terms
    from cbsr_qa.studies.limits.propose import propose_limits
    from cbsr_qa.studies.limits.report import limits_outcome
    from cbsr_qa.system.clock import RealClock

    named = (*(serial or ()), *(read_serials(serials) if serials else ()))
    choice = LotChoice(
        runs=RunSelection(
            serials=tuple(dict.fromkeys(named)),
            batch=batch,
            recipe=recipe,
            since=to_day(since),
            until=to_day(until),
        ),
        without=tuple(without or ()),
        include_failed=include_failed,
        allow_mixed=allow_mixed,
    )
    found = propose_limits(
        choice,
        Terms.from_words(coverage, confidence, guard_factor, distribution),
        names=tuple(measurement or ()),
        everything=everything,
        version=name,
        output=output,
        database=database,
        made=RealClock().wall().date(),
    )
    show(limits_outcome(found), as_json=as_json)
    if output is not None:
        note(f"{output}: {len(found.limits)} limits, version {found.version}")
