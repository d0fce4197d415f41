"""How a run ended, and whether it has its result."""

from enum import StrEnum
from typing import Final, Self

#: Causes of a stop at once, as the detail of a run's end words them.
EMERGENCY: Final = "an emergency stop by {}"
SECOND_SIGNAL: Final = "a second signal"


class EndReason(StrEnum):
    """How a run ended, independent of its outcome."""

    RUNNING = "running"  #: not ended; incomplete if found after a power cut
    FINISHED = "finished"
    ABORTED = "aborted"  #: stopped by an operator or a signal
    BROKEN = "broken"  #: an instrument, a safety rule or a plugin stopped it


def was_emergency(detail: str) -> bool:
    """Whether the detail of a run's end tells of a stop at once, not in order."""
    return EMERGENCY.format("") in detail or SECOND_SIGNAL in detail


def name_stopper(detail: str) -> str:
    """Return who aborted a run, from the detail of its end; the rest of it is the step."""
    return detail.removeprefix("by ").partition(", ")[0].removesuffix(" (remote)")


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
