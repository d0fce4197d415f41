"""Limits of a recipe, how they judge a value, and the codes of what fails."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.gate import GateCheck


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
        return _margin(value, self.lower, self.upper)


def _margin(value: float, lower: float | None, upper: float | None) -> float:
    above = float("inf") if lower is None else value - lower
    below = float("inf") if upper is None else upper - value
    return min(above, below)


def margin_to(value: float | None, lower: float | None, upper: float | None) -> float:
    """Distance from the nearer bound over the larger bound's size: the smallest is closest to failing.

    Without a value, minus infinity.
    """
    if value is None:
        return -float("inf")
    size = max((abs(bound) for bound in (lower, upper) if bound is not None), default=1.0)
    return _margin(value, lower, upper) / (size or 1.0)


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


#: Ends of a run, and all rules besides limits, that a recipe may give a failure code: those of the gate refuse a run.
_CODED_ENDS: Final = ("aborted", "broken")
CODED_RULES: Final = (str(Outcome.NOT_MEASURED), *_CODED_ENDS, *map(str, GateCheck))


@dataclass(frozen=True, slots=True)
class FailureCode:
    """What a line calls a failure, and what it does with the sensor.

    Parameters
    ----------
    code : e.g. ``"E12"``.
    text : the failure in the line's words.
    disposition : what is done with the sensor: ``"scrap"``, ``"rework: check pin"``; may be empty.
    causes : limits and rules with this code, as recipes write them; of a run those that gave it.
    disposition_again : what is done instead if the sensor fails with the code once more; empty for the same.
    failed_before : earlier runs of the sensor and recipe that failed with the code; 0 where no run is meant.
    """

    code: str
    text: str
    disposition: str = ""
    causes: tuple[str, ...] = ()
    disposition_again: str = ""
    failed_before: int = 0

    def __str__(self) -> str:
        return self.code

    @property
    def words(self) -> str:
        return f"{self.code} {self.text}" + (f": {self.todo}" if self.todo else "")

    @property
    def todo(self) -> str:
        """What is done with the sensor, after all its failures with the code; empty where the recipe does not say."""
        if not self.failed_before:
            return self.disposition
        disposition = self.disposition_again or self.disposition
        return disposition and f"{disposition} (it has failed {self.failed_before + 1} times with {self.code})"


def choose_disposition(codes: Iterable[FailureCode]) -> str:
    """Return what is done with a sensor that has several codes; empty where the recipe does not say.

    What a repeated failure asks for counts first: a retest was the answer to the one before.
    """
    told = [code for code in codes if code.todo]
    repeated = [code for code in told if code.failed_before and code.disposition_again]
    return next((code.todo for code in (*repeated, *told)), "")


def name_limit(measurement: str, *details: str) -> str:
    """Name a limit as recipes and JSON write it: ``"centre_of_mass_error (nine locations)"``.

    Parameters
    ----------
    details : phase, qualifier, location; empty ones are left out.
    """
    detail = ", ".join(filter(None, details))
    return f"{measurement} ({detail})" if detail else measurement


def read_failure_codes(table: Mapping[str, Mapping[str, Any]]) -> tuple[FailureCode, ...]:
    """Return the codes of a recipe's checked table ``[failure_codes]``, each once."""
    codes: dict[str, FailureCode] = {}
    for cause, entry in sorted(table.items()):
        code = codes.get(entry["code"]) or FailureCode(
            entry["code"],
            entry["text"],
            entry.get("disposition", ""),
            disposition_again=entry.get("disposition_again", ""),
        )
        codes[code.code] = replace(code, causes=(*code.causes, cause))
    return tuple(codes.values())


def select_failure_codes(
    codes: Iterable[FailureCode],
    outcome: Outcome | None,
    end: str,
    failed: Iterable[tuple[str, str, str]],
    before: Iterable[str] = (),
) -> tuple[FailureCode, ...]:
    """Return the codes of what a run failed, each once with the causes that gave it; none of a run that passed.

    Parameters
    ----------
    codes : all that its recipe gives.
    outcome, end : outcome of its analysis, whether overridden or not, and how it ended.
    failed : measurement, phase and qualifier of what is outside its limit, in the order of the codes.
    before : codes of earlier failures of the sensor and recipe, as often as each was given.
    """
    times_by_code = Counter(before)
    code_by_cause = {cause: code for code in codes for cause in code.causes}
    given: dict[str, FailureCode] = {}
    for names in _list_causes(outcome, end, failed) if code_by_cause else ():
        cause = next((name for name in names if name in code_by_cause), None)
        if cause is not None:
            code = code_by_cause[cause]
            earlier = given[code.code].causes if code.code in given else ()
            causes = tuple(dict.fromkeys((*earlier, cause)))
            given[code.code] = replace(code, causes=causes, failed_before=times_by_code[code.code])
    return tuple(given.values())


def _list_causes(
    outcome: Outcome | None, end: str, failed: Iterable[tuple[str, str, str]]
) -> Iterator[tuple[str, ...]]:
    """Yield for each failure of a run the names under which a recipe may give its code, the narrowest first.

    A limit may be named with less than it states: a code of ``noise_floor`` holds in every phase.
    """
    if outcome is Outcome.FAIL:
        for measurement, phase, qualifier in failed:
            details = (phase, qualifier), ("", qualifier), (phase, ""), ("", "")
            yield tuple(name_limit(measurement, *pair) for pair in details)
    elif end in _CODED_ENDS:
        yield end, str(Outcome.NOT_MEASURED)
    elif outcome is Outcome.NOT_MEASURED:
        yield (str(outcome),)
