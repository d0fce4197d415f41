"""The words of ``cbsr-qa stability``: a table by area that fits a page of a hundred columns."""

import math
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

from cbsr_qa.stability.case import Ending

if TYPE_CHECKING:
    from cbsr_qa.app.stability import Stability
    from cbsr_qa.stability.case import CaseResult

WIDTH = 100
_NAME, _NUMBER = 48, 12


def lines(found: "Stability") -> Iterator[str]:
    """Lay out every case, one line after another; what is refused or broken has its reason below."""
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
