"""Measurements, limits, and the verdict that follows.

How things end: outcomes of measurements, verdicts, and end reasons of runs.

Which version of its limits a recipe judges by, and where they come from.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final, Self

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import check_encodable, with_type
from cbsr_qa.domain.results.dimensions import Dimensions


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
    """Return the worst of some outcomes, NOT_JUDGED of none."""
    return min(outcomes, key=SEVERITY.index, default=Outcome.NOT_JUDGED)


class EndReason(StrEnum):
    """How a run ended, independent of its outcome."""

    RUNNING = "running"  #: not ended; incomplete if found after a power cut
    FINISHED = "finished"
    ABORTED = "aborted"  #: stopped by an operator or a signal
    BROKEN = "broken"  #: an instrument, a safety rule or a plugin stopped it


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
    version : of the limits it belongs to, see :class:`~cbsr_qa.domain.results.LimitsVersion`; may be empty.
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


_TEXTS: Final = ("name", "unit", "phase", "location", "qualifier", "how")


@dataclass(frozen=True, slots=True)
class Measurement:
    """A named number with its unit, or the reason for a missing one.

    Parameters
    ----------
    name : e.g. ``"centre_of_mass_error"``.
    value : None if it could not be determined; ``how`` then gives the reason. Never NaN.
    unit : ``"1"`` for pure numbers.
    uncertainty : one standard deviation, same unit; None if not stated.
    phase : the phase it was measured in; empty for the whole run.
    location : label of the load; empty if not about one.
    trial : 0-based; None if not about one.
    qualifier : what else tells it from its siblings, e.g. ``"mask 85 %"``; typed: ``dimensions``.
    how : method, or the reason of a refusal with its remedy.
    bound : whether the value is the quantity or only a lower bound of it.
    load : index of the load within its phase, as in :class:`~cbsr_qa.domain.run.LoadRecord`; None if not about one.
        With ``phase`` it tells apart loads of one label and trial at several strains.
    strain : of that load, as a fraction.
    limit, outcome : set by :meth:`judged`.
    """

    name: str
    value: float | None
    unit: str
    uncertainty: float | None = None
    phase: str = ""
    location: str = ""
    trial: int | None = None
    qualifier: str = ""
    how: str = ""
    bound: Bound = Bound.EXACT
    load: int | None = None
    strain: float | None = None
    limit: Limit | None = None
    outcome: Outcome = Outcome.NOT_JUDGED

    def __post_init__(self) -> None:
        texts = {field: getattr(self, field) for field in _TEXTS}
        for field, text in texts.items():
            if not isinstance(text, str):
                raise self._wrong(field, text, "text")
        for field, number in (("value", self.value), ("uncertainty", self.uncertainty)):
            try:
                finite = number is None or bool(abs(number) < float("inf"))
            except (TypeError, ValueError):  # a plugin's own type
                raise self._wrong(field, number, "a number") from None
            if not finite:
                raise RefusedError(f"measurement {self.name}: {number} is not a finite number")
        check_encodable(f"measurement {self.name!r}", *texts.values())

    def _wrong(self, field: str, found: object, allowed: str) -> RefusedError:
        name = self.name if isinstance(self.name, str) else with_type(self.name)
        return RefusedError(f"measurement {name}: {field} is {with_type(found)}, not {allowed}")

    def judged(self, limit: Limit) -> Self:
        """Return this measurement with a limit and its outcome.

        Raises
        ------
        RefusedError
            If the units differ: a limit in mm does not judge a value in µm.
        """
        if limit.unit != self.unit:
            raise RefusedError(
                f"limit of {self.name} is in {limit.unit}, the measurement in {self.unit}",
                remedy="give the limit in the measurement's unit",
            )
        return replace(self, limit=limit, outcome=limit.judge(self.value, self.bound))

    @property
    def dimensions(self) -> Dimensions:
        """The qualifier as typed dimensions."""
        return Dimensions.of(self.qualifier)

    @property
    def label(self) -> str:
        parts = [self.location, f"trial {self.trial + 1}" if self.trial else "", self.qualifier]
        detail = ", ".join(part for part in parts if part)
        name = metric_words(self.name)
        return f"{name} ({detail})" if detail else name


def metric_words(name: str) -> str:
    """Write the name of a measurement as words."""
    return name.replace("_sd", " standard deviation").replace("_", " ").replace("snr", "SNR")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Outcome of a run and the reason that decided it."""

    outcome: Outcome
    reason: str


def decide(measurements: tuple[Measurement, ...]) -> Verdict:
    """Decide a finished run from its judged measurements.

    The worst outcome wins; among equals the one furthest beyond its limit, relative to the limit's size.
    """
    outcome = worst(m.outcome for m in measurements)
    judged = [m for m in measurements if m.limit is not None]
    if not judged:
        return Verdict(Outcome.NOT_JUDGED, "the recipe sets no limit")
    deciding = min((m for m in judged if m.outcome is outcome), key=relative_margin)
    return Verdict(outcome, _reason(deciding, outcome, len(judged)))


def explained(verdict: Verdict, measurements: tuple[Measurement, ...]) -> str:
    """Return the reason of a verdict for people; of a failed run also how many limits fail."""
    judged = [m for m in measurements if m.limit is not None]
    failed = sum(m.outcome is Outcome.FAIL for m in judged)
    if verdict.outcome is not Outcome.FAIL or len(judged) < 2:
        return verdict.reason
    return f"{failed} of {len(judged)} limits fail{'; worst' if failed > 1 else 's'}: {verdict.reason}"


def relative_margin(measurement: Measurement) -> float:
    """Distance from the nearer bound over the limit's size: the smallest is closest to failing."""
    limit = measurement.limit
    if limit is None or measurement.value is None:
        return -float("inf")
    size = max(abs(bound) for bound in (limit.lower, limit.upper) if bound is not None)
    return limit.margin(measurement.value) / (size or 1.0)


def judged_words(measurement: Measurement) -> str:
    """Return the value of a judged measurement and its limit in words, or why there is no value."""
    limit = measurement.limit
    assert limit is not None
    if measurement.value is None:
        return f"{measurement.label} could not be measured: {measurement.how}"
    bounds = [f"at least {_number(limit.lower)}"] if limit.lower is not None else []
    bounds += [f"at most {_number(limit.upper)}"] if limit.upper is not None else []
    least = "at least " if measurement.bound is Bound.LOWER else ""
    said = f"{measurement.label} is {least}{_number(measurement.value)} {_shown(measurement.unit)}".rstrip()
    allowed = f"allowed: {' and '.join(bounds)} {_shown(limit.unit)}".rstrip()
    return f"{said} ({allowed})"


def _reason(measurement: Measurement, outcome: Outcome, judged: int) -> str:
    words = judged_words(measurement)
    if outcome is not Outcome.PASS:
        return words
    met = "the only limit is met" if judged == 1 else f"all {judged} limits are met; the closest"
    return f"{met}: {words}"


def _number(value: float) -> str:
    """Format to four digits; powers of ten only instead of many zeros."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def _shown(unit: str) -> str:
    return "" if unit == "1" else unit


@dataclass(frozen=True, slots=True)
class LimitsVersion:
    """A named version of a recipe's limits.

    Parameters
    ----------
    version : its name; every limit that belongs to it carries it.
    date : ISO date it was made on.
    lot : in words, the golden lot it was proposed from; empty for limits set by hand.
    coverage_percent, confidence_percent : share of good sensors each limit holds, and how sure that is; None if not
        stated.
    rule : in words, how a value is judged against limit and guard band; empty if not stated.
    data_sha256 : of the measurements of the lot; empty without one.
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
