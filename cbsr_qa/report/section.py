"""The base of sections: the results they are about, and the rule that a section without blocks is left out."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from itertools import islice
from typing import ClassVar, Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.findings import RecordingResult
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.results.report import Block, Section
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import failure
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import ReportSection
from cbsr_qa.system.copies import come_back_once

#: Largest number of paragraphs, tables and figures of one section; more are refused.
MOST_BLOCKS: Final = 1_000


class RunSection(ABC):
    """A section of a run's report; none of a recording's."""

    title: ClassVar[str]

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None where it has no block."""
        return _section(self.title, self.blocks(result)) if isinstance(result, RunResult) else None

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


def _section(title: str, blocks: Iterable[Block]) -> Section | None:
    content = limit_blocks(blocks)
    return Section(title, content) if content else None


def report_sections(names: tuple[str, ...], plugins: Plugins) -> tuple[list[ReportSection], list[str]]:
    """Return the named sections (all installed ones if none are named), and a warning for each that failed to load.

    Built-in sections come first, in the order of their registration, then others by name.
    """
    sections: list[ReportSection] = []
    warnings: list[str] = []
    for name in names or plugins.list_names(Kind.SECTION):
        try:
            with come_back_once():
                sections.append(plugins.factory(Kind.SECTION, name)())
        except BaseException as error:  # noqa: BLE001 - a plugin's constructor may raise anything
            warnings.append(f"The report section {name} is left out: {failure(error)}")
    return sections, warnings
