"""How a run ended, and whether it has its result."""

from enum import StrEnum
from typing import Self


class EndReason(StrEnum):
    """How a run ended, independent of its outcome."""

    RUNNING = "running"  #: not ended; incomplete if found after a power cut
    FINISHED = "finished"
    ABORTED = "aborted"  #: stopped by an operator or a signal
    BROKEN = "broken"  #: an instrument, a safety rule or a plugin stopped it


class ResultState(StrEnum):
    """State of a run: of its last session, and of the analysis after it."""

    OPEN = "open"  #: under way, or cut off
    STOPPED = "stopped"  #: aborted or broken
    MISSING = "result missing"  #: finished, and not analysed since; resuming it computes the result
    STORED = "result stored"

    @classmethod
    def from_end(cls, end: EndReason, *, analysed: bool) -> Self:
        """Return the state of a run.

        Parameters
        ----------
        end : end of its last session.
        analysed : whether an analysis was stored after that session.
        """
        if end is EndReason.RUNNING:
            return cls.OPEN
        if end is not EndReason.FINISHED:
            return cls.STOPPED
        return cls.STORED if analysed else cls.MISSING
