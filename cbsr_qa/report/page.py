"""The page of a command that has none of its own."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page

R = TypeVar("R")
Facts = Sequence[tuple[str, str]]


def answer(
    result: R,
    headline: str,
    reason: str = "",
    facts: Facts = (),
    printed: Facts = (),
    warnings: Sequence[str] = (),
) -> CommandOutcome[R]:
    """Return the outcome of a successful command without a separate page.

    Parameters
    ----------
    facts, printed : entries as in :class:`~cbsr_qa.domain.results.report.Page`.
    """
    page = Page("", "", Banner("pass", "✓", headline, reason), tuple(facts))
    return CommandOutcome(result, replace(page, printed=tuple(printed), warnings=tuple(warnings)))
