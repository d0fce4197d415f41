"""The words of ``cbsr-qa station check``: its lines by whom they are about, and what to do."""

import textwrap
from collections.abc import Iterator
from typing import Final

from cbsr_qa.domain.station_check import CheckOutcome, CheckResult, StationCheck
from cbsr_qa.report.numbers import quantity

_WIDTH: Final = 100
_NAME, _OUTCOME, _VALUE = 28, 10, 14
_INDENT: Final = " " * (_NAME + 4)


def lines(check: StationCheck) -> Iterator[str]:
    """Lay out a check, one line after another; what is not well has its remedy below."""
    failed, warned = (len(check.lines(outcome)) for outcome in (CheckOutcome.FAILED, CheckOutcome.WARNING))
    subject = ""
    for line in check.results:
        if line.subject != subject:
            subject = line.subject
            yield subject
        yield from _line(line)
    yield f"{str(check.outcome).upper()}: {failed} failed, {warned} warnings, {len(check.results)} lines"


def _line(line: CheckResult) -> Iterator[str]:
    value = "" if line.value is None else quantity(line.value, line.unit)
    allowed = f"allowed: {line.allowed}" if line.allowed else ""
    first = f"  {line.name:<{_NAME}}  {line.outcome!s:<{_OUTCOME}}  {value:<{_VALUE}}"
    fits = len(first) + len(allowed) + 4 <= _WIDTH
    yield f"{first}  ({allowed})" if allowed and fits else first.rstrip()
    for words in ("" if fits else allowed, line.said, f"what to do: {line.remedy}" if line.remedy else ""):
        # Names of stations and addresses stay whole, so that they can be copied.
        yield from textwrap.wrap(
            words, _WIDTH, initial_indent=_INDENT, subsequent_indent=_INDENT, break_on_hyphens=False
        )
