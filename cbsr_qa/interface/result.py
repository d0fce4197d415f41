"""Results as notebooks and scripts see them."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from cbsr_qa.domain.errors import CbsrError

__all__ = ["CbsrError", "Progress", "Result", "quiet"]

if TYPE_CHECKING:
    from cbsr_qa.domain.results.report import CommandOutcome

R = TypeVar("R")

#: Receives what is being done, in words: ``print`` will do.
Progress = Callable[[str], None]


def quiet(words: str) -> None:
    """Show nothing."""


class Result(Generic[R]):
    """What a command of ``cbsr-qa`` results in: ``repr`` is its text, a notebook shows its page."""

    def __init__(self, outcome: "CommandOutcome[R]") -> None:
        self._known = outcome

    @property
    def _outcome(self) -> "CommandOutcome[R]":
        return self._known

    @property
    def result(self) -> R:
        """The dataclass whose fields are the keys of the command's JSON document."""
        return self._outcome.result

    def to_dict(self) -> dict[str, Any]:
        """Return the document that ``--json`` prints."""
        from cbsr_qa.report.document import json_document

        return json_document(self.result)

    def __repr__(self) -> str:
        from cbsr_qa.report.terminal import terminal_lines

        return "\n".join(terminal_lines(self._outcome.page, self._outcome.sections))

    def _repr_html_(self) -> str:
        from cbsr_qa.report.render import render_fragment

        return render_fragment(self._outcome.page, self._outcome.sections)

    def save(self, path: str | Path) -> None:
        """Write the page to an HTML file. RefusedError if something else than a page is there."""
        from cbsr_qa.report.render import render_sections, write_report

        write_report(Path(path), render_sections(self._outcome.page, self._outcome.sections))
