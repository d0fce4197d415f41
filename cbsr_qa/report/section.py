"""The base of sections, and which of them a run's report has: those of its leading pages, and annexes.

A section without blocks is left out.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import ClassVar, Final, Self

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.plan import Recipe
from cbsr_qa.domain.results.findings import RecordingResult
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.results.report import Block, Section
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import failure
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import ReportSection
from cbsr_qa.system.copies import end_forked_copies

#: Sections of the leading pages of every run's report.
LEADING: Final = ("decision", "overview", "station-check", "traceability")
#: Largest number of paragraphs, tables and figures of one section; more are refused.
MOST_BLOCKS: Final = 1_000


class RunSection(ABC):
    """A section of a run's report; none of a recording's.

    ``leaf`` is the number of the leading page that it stands on: 1 decides, 2 shows, 3 traces; None in the annex.
    """

    title: ClassVar[str]
    leaf: ClassVar[int | None] = None

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where it has no block."""
        return _section(self.title, self.blocks(result), self.leaf) if isinstance(result, RunResult) else None

    @abstractmethod
    def blocks(self, result: RunResult) -> Iterable[Block]:
        """Return the content, in reading order."""


class ObservedSection(RunSection):
    """A section of the report of a run that was analysed."""

    def blocks(self, result: RunResult) -> Iterable[Block]:
        """Return the content, in reading order; nothing of a run without an observation."""
        return () if result.observation is None else self.run_blocks(result, result.observation)

    @abstractmethod
    def run_blocks(self, result: RunResult, run: RunObservation) -> Iterable[Block]:
        """Return the content, in reading order."""


class RecordingSection(ABC):
    """A section of a recording's report; none of a run's."""

    title: ClassVar[str]

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where it has no block."""
        return _section(self.title, self.blocks(result)) if isinstance(result, RecordingResult) else None

    @abstractmethod
    def blocks(self, result: RecordingResult) -> Iterable[Block]:
        """Return the content, in reading order."""


def limit_blocks(blocks: Iterable[Block]) -> tuple[Block, ...]:
    """Return the blocks of a section. RefusedError for more than :data:`MOST_BLOCKS`: a generator may never end."""
    content = tuple(islice(blocks, MOST_BLOCKS + 1))
    if len(content) > MOST_BLOCKS:
        raise RefusedError(f"it has more than {MOST_BLOCKS} blocks")
    return content


def _section(title: str, blocks: Iterable[Block], leaf: int | None = None) -> Section | None:
    content = limit_blocks(blocks)
    return Section(title, content, leaf=leaf) if content else None


@dataclass(frozen=True, slots=True)
class Annexes:
    """Annexes of a run's report.

    Parameters
    ----------
    names : names of sections; empty for every installed one, None for no annex.
    opened : whether they are open, so that they are printed.
    """

    names: tuple[str, ...] | None = ()
    opened: bool = False

    @classmethod
    def from_recipe(cls, recipe: Recipe, outcome: Outcome) -> Self:
        """Return the annexes that a recipe wants: of a sensor that passed only some, if it says so."""
        if outcome is Outcome.PASS and recipe.annexes_if_passed is not None:
            return cls(recipe.annexes_if_passed or None)
        return cls(recipe.sections)

    @classmethod
    def from_request(cls, names: Sequence[str], plugins: Plugins) -> Self:
        """Return the annexes that somebody asked for: ``all``, ``none``, or names of sections.

        RefusedError for another name.
        """
        if tuple(names) == ("none",):
            return cls(None)
        if tuple(names) == ("all",):
            return cls((), opened=True)
        installed = plugins.list_names(Kind.SECTION)
        if len(names) > 1 and (alone := [name for name in names if name in ("all", "none")]):
            raise RefusedError(f"--annex {alone[0]} is given beside others", remedy="leave the others out")
        if unknown := [name for name in names if name not in installed]:
            raise RefusedError(
                f"--annex {unknown[0]}: there is no such section",
                remedy=f"all, none, or some of {', '.join(installed)}",
            )
        return cls(tuple(names), opened=True)

    def list_sections(self, plugins: Plugins) -> tuple[str, ...]:
        """Return the sections of the whole report: those of the leading pages, then the annexes."""
        if self.names is None:
            return LEADING
        names = self.names or plugins.list_names(Kind.SECTION)
        return (*LEADING, *(name for name in names if name not in LEADING))


def load_sections(names: tuple[str, ...], plugins: Plugins) -> tuple[list[ReportSection], list[str]]:
    """Return the named sections (all installed ones if none are named), and a warning for each that failed to load.

    Built-in sections come first, in the order of their registration, then others by name.
    """
    sections: list[ReportSection] = []
    warnings: list[str] = []
    for name in names or plugins.list_names(Kind.SECTION):
        try:
            with end_forked_copies():
                sections.append(plugins.factory(Kind.SECTION, name)())
        except BaseException as error:  # noqa: BLE001 - a plugin's constructor may raise anything
            warnings.append(f"The report section {name} is left out: {failure(error)}")
    return sections, warnings
