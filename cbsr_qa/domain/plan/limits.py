"""Limits of a recipe, and how they judge a value."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from cbsr_qa.domain.errors import RefusedError


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


#: Outcomes from worst to best: the overall outcome is the worst one met.
SEVERITY: tuple[Outcome, ...] = (
    Outcome.FAIL,
    Outcome.NOT_MEASURED,
    Outcome.MARGINAL,
    Outcome.PASS,
    Outcome.NOT_JUDGED,
)


def worst(outcomes: Iterable[Outcome]) -> Outcome:
    """Return the worst of some outcomes, NOT_JUDGED of none."""
    return min(outcomes, key=SEVERITY.index, default=Outcome.NOT_JUDGED)


class Bound(StrEnum):
    """Relation of a value to the quantity it stands for."""

    EXACT = "exact"
    LOWER = "lower"  #: the quantity is at least this: a settling time later than the window


@dataclass(frozen=True, slots=True)
class Limit:
    """Bounds of one measurement, both inclusive; None leaves a side unbounded.

    Parameters
    ----------
    measurement : name of the measurement it judges.
    unit : must equal the measurement's.
    lower, upper : bounds.
    marginal : width of the guard band inside each bound, in the same unit; a value in it passes marginally.
    phase : judges only measurements of this phase; empty for every phase.
    qualifier : judges only measurements with exactly this qualifier (empty: only those without one).
    version : version of the limits it belongs to, see ``LimitsVersion``; may be empty.
    """

    measurement: str
    unit: str
    lower: float | None
    upper: float | None
    marginal: float = 0.0
    phase: str = ""
    qualifier: str = ""
    version: str = ""

    def __post_init__(self) -> None:
        if self.lower is None and self.upper is None:
            raise RefusedError(f"limit of {self.measurement}: give lower, upper or both")
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            raise RefusedError(f"limit of {self.measurement}: lower {self.lower} is above upper {self.upper}")

    def judge(self, value: float | None, bound: Bound = Bound.EXACT) -> Outcome:
        """Judge a value; an undetermined value is NOT_MEASURED.

        A lower bound can fail an upper limit, but never meet it: the quantity itself may lie anywhere above.
        """
        if value is None:
            return Outcome.NOT_MEASURED
        if bound is Bound.LOWER:
            return self._judge_lower_bound(value)
        margin = self.margin(value)
        if margin < 0:
            return Outcome.FAIL
        return Outcome.MARGINAL if margin < self.marginal else Outcome.PASS

    def _judge_lower_bound(self, value: float) -> Outcome:
        if self.upper is not None:
            return Outcome.FAIL if value > self.upper else Outcome.NOT_MEASURED
        assert self.lower is not None
        if value < self.lower:
            return Outcome.NOT_MEASURED
        return Outcome.MARGINAL if value - self.lower < self.marginal else Outcome.PASS

    def margin(self, value: float) -> float:
        """Distance from the nearer bound, negative outside, in the limit's unit."""
        above = float("inf") if self.lower is None else value - self.lower
        below = float("inf") if self.upper is None else self.upper - value
        return min(above, below)


@dataclass(frozen=True, slots=True)
class LimitsVersion:
    """A named version of a recipe's limits.

    Parameters
    ----------
    version : its name; every limit that belongs to it carries it.
    date : ISO date it was made on.
    lot : golden lot that it was proposed from, in words; empty for limits set by hand.
    coverage_percent, confidence_percent : share of good sensors each limit holds, and how sure that is; None if not
        stated.
    rule : rule in words by which a value is judged against limit and guard band; empty if not stated.
    data_sha256 : digest of the measurements of the lot; empty without one.
    sealed : whether the limits were checked to be those that were proposed.
    """

    version: str
    date: str
    lot: str = ""
    coverage_percent: float | None = None
    confidence_percent: float | None = None
    rule: str = ""
    data_sha256: str = ""
    sealed: bool = False
