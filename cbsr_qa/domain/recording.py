"""A recording somebody else's rig, or ours, wrote to a file."""

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from cbsr_qa.domain.electrodes import Electrodes
from cbsr_qa.domain.errors import RowProblem
from cbsr_qa.domain.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.loads import LoadRecord


class ScanKind(StrEnum):
    """What one frame of a recording covers."""

    FULL = "full"  #: every drive pair against every measure pair
    DRIVEN_PAIRS = "driven_pairs"  #: one row: the voltage across each pair while that pair is driven


@dataclass(frozen=True, slots=True)
class Recording:
    """The content of a recording, before any analysis.

    Parameters
    ----------
    path, format, dataset : where it came from; ``dataset`` is empty where a file holds only one.
    scan : what a frame covers. For ``DRIVEN_PAIRS`` blocks have shape (n, 1, pairs).
    frames : the complete frames; times count from the first, on the board's clock where there is one.
    reference : frames of the unloaded domain recorded apart (tank data); None where the recording holds its own.
    still : True for single or averaged images, whose times say nothing (no frame rate).
    magnitudes_only : readings are absolute values (the sign of the pattern's geometry is to be put back).
    samples : force and other channels; empty where none was recorded.
    loads : presses the recording itself documents (our own exports); empty where nobody said.
    problems : rows left out or noteworthy, by line.
    clock : which clock the times are from: ``"board"``, ``"computer"``, ``"station"`` (our own runs),
        ``"documented"`` (a rate the data's authors state; the file holds no times) or ``"none"``.
    layout : electrode numbering the format documents, or their places; None where it is unknown.
    sensor_type : name of the sensor type where the recording states it.
    notes : facts worth telling a reader, in words.
    frames_dropped : frames that are in the file but not whole; the ones cut by its beginning and end do not count.
    simulated : in words, what was simulated; empty where a real rig measured.
    """

    path: Path
    format: str
    dataset: str
    scan: ScanKind
    frames: FrameBlock
    reference: FrameBlock | None
    still: bool
    magnitudes_only: bool
    clock: str
    samples: tuple[SampleBlock, ...] = ()
    loads: tuple[LoadRecord, ...] = ()
    problems: tuple[RowProblem, ...] = ()
    layout: Electrodes | None = None
    sensor_type: str | None = None
    notes: tuple[str, ...] = field(default=())
    frames_dropped: int = 0
    simulated: tuple[str, ...] = ()

    @property
    def rows_rejected(self) -> int:
        """Number of rows whose numbers were left out."""
        return sum(problem.rejected for problem in self.problems)


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What a user may say about a recording.

    Parameters
    ----------
    dataset : one of several data sets in a file; None to take the only one.
    reference : a file (and data set within it) holding the unloaded domain. The analysis reads it, by that file's
        own format; a format only leaves out a reference it would find by itself.
    """

    dataset: str | None = None
    reference: tuple[Path, str | None] | None = None
