"""Comparison of the paper's numbers with simulated ones: rules of agreement."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import hypot, sqrt

import numpy as np

from cbsr_qa.domain.numbers import Array, finite_numbers
from cbsr_qa.eit.imaging.shape import overlap_grade


class Rule(StrEnum):
    """Criterion for agreement with a printed number."""

    DEVIATION = "within one printed deviation"
    DIGITS = "within the printed digits and two of our standard deviations"
    RANGE = "inside a printed range, give or take our standard error"
    BAND = "in the same band"
    SCATTER = "deviations within two of their standard errors"
    NONE = "not compared"


class ValueOrigin(StrEnum):
    """Origin of our number."""

    INPUT = "input"  #: the simulation is given it, and measures it back
    OUTCOME = "outcome"  #: it follows from the simulation


@dataclass(frozen=True, slots=True)
class PrintedRange:
    """A printed range, and where it is printed."""

    where: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Printed:
    """Printed numbers of one quantity: a value with a deviation, or ranges alone.

    Parameters
    ----------
    half_digit : half a unit of the last printed digit.
    """

    value: float | None = None
    deviation: float | None = None
    half_digit: float = 0.0
    ranges: tuple[PrintedRange, ...] = ()
    band: str | None = None


@dataclass(frozen=True, slots=True)
class Ours:
    """The same quantity of a simulated sensor (``"uniform"``, ``"bench"`` or ``"strip"``).

    Parameters
    ----------
    value : None if undetermined, for the reason ``uncertainty_is``.
    count : number of values behind it.
    at_least : the value is a lower bound.
    """

    simulated_on: str
    value: float | None
    uncertainty: float | None = None
    uncertainty_is: str = ""
    count: int = 0
    at_least: bool = False
    band: str | None = None


@dataclass(frozen=True, slots=True)
class ComparedRow:
    """One printed number and ours.

    Parameters
    ----------
    beside : further simulated numbers, for display only.
    agrees : None if the two are not compared, or cannot be.
    reason : reason for a difference, or a remark.
    """

    group: str
    name: str
    unit: str
    kind: ValueOrigin
    rule: Rule
    paper: Printed
    ours: Ours
    beside: tuple[Ours, ...] = ()
    agrees: bool | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class ComparedTable:
    """All rows of one printed table or figure; ``agreeing`` of the ``compared`` ones agree."""

    title: str
    notes: tuple[str, ...]
    agreeing: int
    compared: int
    rows: tuple[ComparedRow, ...]


def make_table(title: str, notes: tuple[str, ...], rows: Iterable[ComparedRow]) -> ComparedTable:
    """Count how many rows agree."""
    rows = tuple(rows)
    judged = [row.agrees for row in rows if row.agrees is not None]
    return ComparedTable(title, notes, sum(judged), len(judged), rows)


def within_digits(value: float, printed: float, half_digit: float, uncertainty: float) -> bool:
    """Return whether a value is within half a printed digit and two of our standard deviations of a printed one."""
    return abs(value - printed) <= half_digit + 2 * uncertainty


def deviations_agree(ours: float, count: int, printed: float, printed_count: int) -> bool:
    """Return whether two standard deviations are within two standard errors of their difference.

    The standard error of a deviation s of n ≥ 2 normal values is s / √(2 (n − 1)).

    NumericsError if a deviation is not finite.
    """
    finite_numbers([ours, printed], "deviations")
    errors = ours / sqrt(2 * (count - 1)), printed / sqrt(2 * (printed_count - 1))
    return abs(ours - printed) <= 2 * hypot(*errors)


def compare_value(
    group: str,
    name: str,
    unit: str,
    kind: ValueOrigin,
    rule: Rule,
    paper: Printed,
    simulated: Sequence[Ours],
    *,
    why: str = "",
    printed_count: int = 0,
) -> ComparedRow:
    """Compare the first of our values by a rule; the others are only shown.

    ``agrees`` is None where we have no value, or only a lower bound that does not decide.

    Parameters
    ----------
    why : reason given for a disagreement.
    printed_count : values behind a printed deviation, for ``Rule.SCATTER``.
    """
    our_value, *other_values = simulated
    agrees, note, printed, value = None, "", paper.value, our_value.value
    if value is None:
        note = f"not measured: {our_value.uncertainty_is}"
    elif rule is Rule.RANGE:
        agrees, note = _match_ranges(our_value, value, paper)
    else:
        assert printed is not None
        if rule is Rule.BAND:  # the paper's bands do not depend on size
            paper = replace(paper, band=overlap_grade(printed, 1.0))
            our_value = replace(our_value, band=overlap_grade(value, 1.0))
        agrees = _agree(rule, paper, printed, our_value, value, printed_count)
    reason = note if agrees or agrees is None else f"{note}; {why}" if note else why
    return ComparedRow(group, name, unit, kind, rule, paper, our_value, tuple(other_values), agrees, reason)


def show_beside(group: str, name: str, unit: str, paper: Printed, ours: Ours, why: str) -> ComparedRow:
    """Show a number beside a printed one with another meaning, and explain."""
    return ComparedRow(group, name, unit, ValueOrigin.OUTCOME, Rule.NONE, paper, ours, reason=why)


def mean_of_deviations(sheet: str, errors: Array) -> Ours:
    """Return the standard deviation of some errors with its standard error for normal values."""
    deviation, count = float(errors.std(ddof=1)), len(errors)
    meaning = f"standard error of the deviation of {count} presses; bias {float(errors.mean()):+.2f} N"
    return Ours(sheet, deviation, deviation / np.sqrt(2 * (count - 1)), meaning, count)


def _agree(rule: Rule, paper: Printed, printed: float, ours: Ours, value: float, printed_count: int) -> bool:
    if rule is Rule.DEVIATION:
        return abs(value - printed) <= (paper.deviation or 0.0)
    if rule is Rule.BAND:
        return paper.band == ours.band
    if rule is Rule.SCATTER:
        return deviations_agree(value, ours.count, printed, printed_count)
    return within_digits(value, printed, paper.half_digit, ours.uncertainty or 0.0)


def _match_ranges(ours: Ours, value: float, paper: Printed) -> tuple[bool | None, str]:
    """Whether a value is in any printed range, within its uncertainty, and in which."""
    if ours.at_least and value <= max(printed.high for printed in paper.ranges):
        return None, "a lower bound: not all loads had settled"
    slack = ours.uncertainty or 0.0
    range_names = [] if ours.at_least else [r.where for r in paper.ranges if r.low - slack <= value <= r.high + slack]
    if len(range_names) == len(paper.ranges):
        return True, ""
    return (True, f"inside the range of {range_names[0]} only") if range_names else (False, "")
