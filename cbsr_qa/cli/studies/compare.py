"""``cbsr-qa compare``: what differs, and whether it is the material or the station.

The words of ``cbsr-qa compare``: sentences, then groups, then a table of differences, a hundred columns wide.
"""

import textwrap
from collections.abc import Iterator
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.output import emit_json, note, say
from cbsr_qa.config import printable

if TYPE_CHECKING:
    from cbsr_qa.stats import Yield
    from cbsr_qa.studies.compare import Comparison, Difference, Group


_DAY = ["%Y-%m-%d"]


def compare(
    by: Annotated[str, typer.Option(help="What tells groups apart: batch, material, station, software or period.")],
    groups: Annotated[
        str | None, typer.Option(metavar="A,B", help="Groups to compare, the reference first; by default all.")
    ] = None,
    metric: Annotated[list[str] | None, typer.Option(help="Only this metric; may be repeated.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    since: Annotated[datetime | None, typer.Option(formats=_DAY, help="Runs from this day on (UTC).")] = None,
    until: Annotated[datetime | None, typer.Option(formats=_DAY, help="Runs to the end of this day (UTC).")] = None,
    margin: Annotated[
        list[str] | None,
        typer.Option(metavar="METRIC=VALUE", help="Difference that does not matter, in the metric's unit."),
    ] = None,
    detect: Annotated[
        list[str] | None,
        typer.Option(metavar="METRIC=VALUE", help="Difference whose number of sensors is wanted (80 % power)."),
    ] = None,
    policy: Annotated[
        str, typer.Option(help="Run of a sensor that decides: first, last, or any that passed.")
    ] = "last",
    quarantine: Annotated[
        str, typer.Option(help="Sensors that could not be measured: apart from the yield, or failed.")
    ] = "apart",
    period: Annotated[
        str | None, typer.Option(help="Length of a period, for --by period: day, week, month (default) or year.")
    ] = None,
    adjust: Annotated[
        str, typer.Option(help="p values for many metrics: holm, benjamini-hochberg or none.")
    ] = "holm",
    output: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Compare stored runs of batches, materials, stations, software versions or periods in every metric.

    A batch's difference is told from its stations' where the runs allow it; where they do not, that is said. Exit
    code 3 if nothing could be compared.
    """
    from cbsr_qa.cli.options import one_of
    from cbsr_qa.domain import RefusedError
    from cbsr_qa.studies.compare import (
        Adjustment,
        By,
        Period,
        Policy,
        Quarantine,
        RunChoice,
        Terms,
        compare_groups,
        read_amounts,
        read_groups,
    )
    from cbsr_qa.system import RealClock

    word = one_of(By, by, "--by")
    if period is not None and word is not By.PERIOD:
        raise RefusedError(f"--period {period[:64]!r} says nothing of --by {word}", remedy="say --by period")
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
    )
    choice = RunChoice(recipe, _day(since), _day(until))
    if output is not None:
        from cbsr_qa.report import check_replaceable

        check_replaceable(output)  # before anything is worked out or stored
    made = compare_groups(choice, terms, database=database, now=RealClock().wall())
    if output is not None:
        from cbsr_qa.studies.compare import write_page

        write_page(made.found, output)
        note(f"page         {output}")
    if as_json:
        emit_json(made.document())
    else:
        for line in lines(made.found):
            say(line)
    raise typer.Exit(made.exit_code)


def _day(moment: datetime | None) -> date | None:
    return None if moment is None else moment.date()


WIDTH = 100
_DIFFERENCE = "  {:<38}{:>12}  {:<31}{:>8}  {}"
_GROUP = "  {:<28}{:>8}{:>6}  {:<26}{}"


def lines(found: "Comparison") -> Iterator[str]:
    """Lay out a comparison, one line after another."""
    from cbsr_qa.studies.compare import headline, rules, sentences

    yield printable(headline(found))
    for words in sentences(found):
        yield from _wrapped("- ", printable(words))
    yield ""
    yield from _groups(found)
    yield ""
    if any(metric.differences for metric in found.metrics):
        yield from _differences(found)
        yield ""
    for words in rules(found):
        yield from _wrapped("", words)


def _groups(found: "Comparison") -> Iterator[str]:
    yield _GROUP.format(found.terms.by.value, "sensors", "runs", "yield", "first-pass yield").rstrip()
    for group in found.groups:
        row = printable(group.name)[:27], group.sensors, group.runs, _share(group.passed), _share(group.first_pass)
        yield _GROUP.format(*row).rstrip()
        yield from _fate(group)


def _fate(group: "Group") -> Iterator[str]:
    if group.failures:
        said = ", ".join(f"{label} {count}" for label, count in group.failures[:4])
        rest = f" and {len(group.failures) - 4} more" if len(group.failures) > 4 else ""
        yield from _wrapped("      fails: ", printable(f"{said}{rest}"))
    if group.unmeasured:
        yield f"      not measured: {group.unmeasured}"


def _differences(found: "Comparison") -> Iterator[str]:
    for group in found.groups[1:]:
        yield printable(f"{group.name} − {found.reference}")
        yield _DIFFERENCE.format("metric", "difference", f"{100 * found.terms.confidence:g} % interval", "p", "model")
        for metric in found.metrics:
            label = printable(metric.figures.key.label)
            for one in metric.differences:
                if one.group == group.name:
                    yield from _difference(label, metric.figures.unit, one)


def _difference(label: str, unit: str, one: "Difference") -> Iterator[str]:
    from cbsr_qa.report import number, unit_shown
    from cbsr_qa.studies.compare import p_words

    if len(label) > 37:
        yield f"  {label}"
        label = ""
    if one.value is None or one.interval is None:
        yield _DIFFERENCE.format(label, "–", "refused", "", "").rstrip()
        return
    ends = f"{number(one.interval.low)} to {number(one.interval.high)} {unit_shown(unit)}"
    p_value = p_words(one.p_adjusted).removeprefix("p = ").removeprefix("p ")
    yield _DIFFERENCE.format(label, number(one.value), ends, p_value, one.model.partition(":")[0]).rstrip()


def _share(found: "Yield | None") -> str:
    if found is None:
        return "not judged"
    ends = f"{100 * found.wilson.low:.0f} to {100 * found.wilson.high:.0f}"
    return f"{100 * found.value:.1f} % ({ends} %)"


def _wrapped(label: str, words: str) -> list[str]:
    return textwrap.wrap(
        words, WIDTH, initial_indent=label, subsequent_indent=" " * len(label), break_on_hyphens=False
    )
