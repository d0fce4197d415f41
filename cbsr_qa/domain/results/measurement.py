"""Measurements, limits, and the verdict that follows.

How things end: outcomes of measurements, verdicts, and end reasons of runs.

Which version of its limits a recipe judges by, and where they come from.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, Self

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import check_encodable, with_type
from cbsr_qa.domain.plan.limits import Bound, Limit, Outcome, margin_to, worst
from cbsr_qa.domain.results.dimensions import Dimensions

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
    qualifier : text that tells it from its siblings, e.g. ``"mask 85 %"``; typed: ``dimensions``.
    how : method, or the reason of a refusal with its remedy.
    bound : whether the value is the quantity or only a lower bound of it.
    load : index of the load within its phase, as in ``LoadRecord``; None if not about one.
        With ``phase`` it tells apart loads of one label and trial at several strains.
    strain : strain of that load, as a fraction.
    limit, outcome : set by :meth:`judge`.
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
                raise self._refuse(field, text, "text")
        for field, number in (("value", self.value), ("uncertainty", self.uncertainty)):
            try:
                finite = number is None or bool(abs(number) < float("inf"))
            except (TypeError, ValueError):  # a plugin's own type
                raise self._refuse(field, number, "a number") from None
            if not finite:
                raise RefusedError(f"measurement {self.name}: {number} is not a finite number")
        check_encodable(f"measurement {self.name!r}", *texts.values())

    def _refuse(self, field: str, found: object, allowed: str) -> RefusedError:
        name = self.name if isinstance(self.name, str) else with_type(self.name)
        return RefusedError(f"measurement {name}: {field} is {with_type(found)}, not {allowed}")

    def judge(self, limit: Limit) -> Self:
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
        return Dimensions.from_qualifier(self.qualifier)

    @property
    def limit_key(self) -> tuple[str, str, str]:
        """Name, phase and qualifier: what limits and failure codes name it by."""
        return self.name, self.phase, self.qualifier

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
    return Verdict(outcome, _reason(rank_judged(judged, outcome)[0], outcome, len(judged)))


def rank_judged(measurements: Iterable[Measurement], outcome: Outcome) -> list[Measurement]:
    """Return the judged measurements of an outcome, the one furthest beyond its limit first."""
    judged = (m for m in measurements if m.limit is not None and m.outcome is outcome)
    return sorted(judged, key=relative_margin)


def explain_verdict(verdict: Verdict, measurements: tuple[Measurement, ...]) -> str:
    """Return the reason of a verdict for people; of a failed run also how many limits fail."""
    judged = [m for m in measurements if m.limit is not None]
    failed = sum(m.outcome is Outcome.FAIL for m in judged)
    if verdict.outcome is not Outcome.FAIL or len(judged) < 2:
        return verdict.reason
    return f"{failed} of {len(judged)} limits fail{'; worst' if failed > 1 else 's'}: {verdict.reason}"


def relative_margin(measurement: Measurement) -> float:
    """Return the margin of a measurement to its limit, comparable between limits; minus infinity without one."""
    limit = measurement.limit
    return -float("inf") if limit is None else margin_to(measurement.value, limit.lower, limit.upper)


def describe_judgement(measurement: Measurement) -> str:
    """Return the value of a judged measurement and its limit in words, or why there is no value."""
    limit = measurement.limit
    assert limit is not None
    if measurement.value is None:
        return f"{measurement.label} could not be measured: {measurement.how}"
    bounds = [f"at least {_number(limit.lower)}"] if limit.lower is not None else []
    bounds += [f"at most {_number(limit.upper)}"] if limit.upper is not None else []
    least = "at least " if measurement.bound is Bound.LOWER else ""
    value_words = (
        f"{measurement.label} is {least}{_number(measurement.value)} {_format_unit(measurement.unit)}".rstrip()
    )
    allowed = f"allowed: {' and '.join(bounds)} {_format_unit(limit.unit)}".rstrip()
    return f"{value_words} ({allowed})"


def _reason(measurement: Measurement, outcome: Outcome, judged: int) -> str:
    judgement = describe_judgement(measurement)
    if outcome is not Outcome.PASS:
        return judgement
    opening = "the only limit is met" if judged == 1 else f"all {judged} limits are met; the closest"
    return f"{opening}: {judgement}"


def _number(value: float) -> str:
    """Format to four digits; powers of ten only instead of many zeros."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def _format_unit(unit: str) -> str:
    return "" if unit == "1" else unit
