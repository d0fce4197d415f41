"""Recording formats and sections of reports."""

from pathlib import Path
from typing import Protocol, runtime_checkable

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.recording import ReadOptions, Recording
from cbsr_qa.domain.report import RunResult, Section
from cbsr_qa.domain.scene import Transcript


class RecordingFormat(Protocol):
    """Reads one family of files."""

    def recognises(self, path: Path, head: bytes) -> bool:
        """Tell from the name and the first 4096 bytes whether this is such a file."""
        ...

    def datasets(self, path: Path) -> tuple[str, ...]:
        """Name the data sets of a file that can hold several; empty for a file that is one."""
        ...

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read it whole. RecordingError if nothing in it can be used; single bad rows are problems, not errors."""
        ...


@runtime_checkable
class RecordingWriter(Protocol):
    """What a :class:`RecordingFormat` has besides where simulated scenes can be written in it."""

    def write(self, path: Path, recording: Recording, transcript: Transcript) -> tuple[str, ...]:
        """Write a file as this format's rig would have, and return what it cannot say, in words.

        Parameters
        ----------
        recording : all frames, also those of which rows are lost.
        transcript : which rows are lost, and where a board dumps its log.

        Raises
        ------
        RefusedError
            If the format cannot hold such a recording, or the file exists already.
        """
        ...


class ReportSection(Protocol):
    """Writes one section of the report."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section, or None where the result has nothing for it."""
        ...
