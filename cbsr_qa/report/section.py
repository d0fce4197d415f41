"""What sections have in common: which results they are about, and that they are left out where they have no block."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from itertools import islice
from typing import ClassVar, Final

from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.readings import RecordingResult
from cbsr_qa.domain.results import Block, RunObservation, RunResult, Section

#: More paragraphs, tables and figures of one section are refused.
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
        return () if result.observation is None else self.observed(result, result.observation)

    @abstractmethod
    def observed(self, result: RunResult, run: RunObservation) -> Iterable[Block]:
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


def limited_blocks(blocks: Iterable[Block]) -> tuple[Block, ...]:
    """Return the blocks of a section. RefusedError for more than :data:`MOST_BLOCKS`: a generator may never end."""
    content = tuple(islice(blocks, MOST_BLOCKS + 1))
    if len(content) > MOST_BLOCKS:
        raise RefusedError(f"it has more than {MOST_BLOCKS} blocks")
    return content


def _section(title: str, blocks: Iterable[Block]) -> Section | None:
    content = limited_blocks(blocks)
    return Section(title, content) if content else None
