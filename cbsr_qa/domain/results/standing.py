"""What has come of a run."""

from enum import StrEnum
from typing import Self

from cbsr_qa.domain.results.measurement import EndReason


class ResultState(StrEnum):
    """What has come of a run: of its last session, and of the analysis after it."""

    OPEN = "open"  #: under way, or cut off
    STOPPED = "stopped"  #: aborted or broken
    MISSING = "result missing"  #: finished, and not analysed since; resuming it computes the result
    STORED = "result stored"

    @classmethod
    def of(cls, end: EndReason, *, analysed: bool) -> Self:
        """Return the state of a run.

        Parameters
        ----------
        end : of its last session.
        analysed : whether an analysis was stored after that session.
        """
        if end is EndReason.RUNNING:
            return cls.OPEN
        if end is not EndReason.FINISHED:
            return cls.STOPPED
        return cls.STORED if analysed else cls.MISSING
