"""``cbsr-qa stability``: the numerically hard cases, each against truth.

The words of ``cbsr-qa stability``: a table by area that fits a page of a hundred columns.
"""

import math
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.output import Counting, emit_json, note, say

if TYPE_CHECKING:
    from cbsr_qa.studies.hard_cases import CaseResult, Stability


def stability(
    area: Annotated[list[str] | None, typer.Option(help="Only cases of this area; repeatable.")] = None,
    only: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this case; repeatable.")] = None,
    output: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Run the numerically hard cases: error against truth, its bound and the condition met, or the named refusal.

    Exit code 1 if a bound is broken.
    """
    from cbsr_qa.studies.hard_cases import examine_cases

    with Counting("cases") as counting:
        counting.stage("numerically hard cases")
        found = examine_cases(areas=tuple(area or ()), names=tuple(only or ()), progress=counting.count)
    if output is not None:
        found.write(output)
        note(f"page         {output}")
    if as_json:
        emit_json(found.document())
    else:
        for line in lines(found):
            say(line)
    raise typer.Exit(found.exit_code)


WIDTH = 100
_NAME, _NUMBER = 48, 12


def lines(found: "Stability") -> Iterator[str]:
    """Lay out every case, one line after another; what is refused or broken has its reason below."""
    from cbsr_qa.studies.hard_cases import Ending

    area = ""
    for result in found.results:
        if result.case.area != area:
            area = result.case.area
            yield f"{area:<{_NAME + 2}}{'error':<{_NUMBER}}{'bound':<{_NUMBER}}{'condition':<{_NUMBER}}outcome"
        yield from _case(result)
    counts = found.counts
    yield (
        f"{len(found.results)} cases: {counts[Ending.OK]} within their bound, {counts[Ending.REFUSED]} refused by"
        f" name, {counts[Ending.BROKEN]} broken"
    )


def _case(result: "CaseResult") -> Iterator[str]:
    from cbsr_qa.studies.hard_cases import Ending

    answer = result.answer
    error, bound, condition = ("",) * 3
    if answer is not None:
        error, bound = (f"{value:.1e}" if math.isfinite(value) else "–" for value in (answer.error, answer.bound))
        condition = "" if answer.condition is None else f"{answer.condition:.1e}"
    name = f"  {result.case.name}"
    yield f"{name:<{_NAME + 2}}{error:<{_NUMBER}}{bound:<{_NUMBER}}{condition:<{_NUMBER}}{result.outcome}"
    if answer is not None and answer.unit != "1":
        yield f"    in {answer.unit}"
    if result.outcome is not Ending.OK:
        words = f"{result.reason}; {result.remedy}" if result.remedy else result.reason
        yield from textwrap.wrap(words, WIDTH, initial_indent="    ", subsequent_indent="    ")
