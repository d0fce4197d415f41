"""How things end: outcomes of measurements, verdicts, and end reasons of runs."""

from collections.abc import Iterable
from enum import StrEnum


class Outcome(StrEnum):
    """Outcome of one limit, or of a whole run."""

    PASS = "pass"
    MARGINAL = "marginal"  #: within the limit, but inside its guard band
    FAIL = "fail"
    NOT_MEASURED = "not measured"  #: the quantity could not be determined; never a pass
    NOT_JUDGED = "not judged"  #: no limit was set for it

    @property
    def exit_code(self) -> int:
        """Exit code of a run with this outcome: 0 passed (also marginally), 1 failed, 3 not measured."""
        return {Outcome.FAIL: 1, Outcome.NOT_MEASURED: 3}.get(self, 0)


#: From worst to best: the overall outcome is the worst one met.
SEVERITY: tuple[Outcome, ...] = (
    Outcome.FAIL,
    Outcome.NOT_MEASURED,
    Outcome.MARGINAL,
    Outcome.PASS,
    Outcome.NOT_JUDGED,
)


def worst(outcomes: Iterable[Outcome]) -> Outcome:
    """Return the worst of some outcomes; NOT_JUDGED where there are none."""
    return min(outcomes, key=SEVERITY.index, default=Outcome.NOT_JUDGED)


class EndReason(StrEnum):
    """How a run ended, whatever its outcome."""

    RUNNING = "running"  #: begun and not ended: found again after a power cut, it is incomplete
    FINISHED = "finished"
    ABORTED = "aborted"  #: somebody stopped it
    BROKEN = "broken"  #: an instrument, a safety rule or a plugin stopped it
