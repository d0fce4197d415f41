"""One printed number held against one of ours, by the rule that what is printed allows."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.published import Comparison, Kind, Ours, Printed, Rule
from cbsr_qa.imaging.overlap_bands import overlap_grade
from cbsr_qa.stats.agreement import deviations_agree, ranges_of, within_deviation, within_digits


def compared(
    group: str,
    name: str,
    unit: str,
    kind: Kind,
    rule: Rule,
    printed: Printed,
    ours: Ours,
    beside: tuple[Ours, ...] = (),
    *,
    why: str = "",
    printed_count: int = 0,
) -> Comparison:
    """Compare by a rule.

    Parameters
    ----------
    why : the reason given where the two do not agree.
    printed_count : values behind a printed deviation, for ``Rule.SCATTER``.

    Returns
    -------
    A comparison whose ``agrees`` is None where we have no value, or only a lower bound that does not decide.
    """
    agrees, bands, note = None, ("", ""), ""
    if ours.value is None:
        note = f"not measured: {ours.of}"
    elif rule is Rule.RANGE:
        agrees, note = _in_ranges(ours, ours.value, printed)
    else:
        assert printed.value is not None
        agrees, bands = _judged(rule, printed, printed.value, ours, ours.value, printed_count)
    reason = note if agrees or agrees is None else f"{note}; {why}" if note else why
    return Comparison(group, name, unit, kind, rule, printed, ours, beside, agrees, bands, reason)


def not_compared(group: str, name: str, unit: str, printed: Printed, ours: Ours, why: str) -> Comparison:
    """Show a number beside a printed one that means something else, and say why."""
    return Comparison(group, name, unit, Kind.OUTCOME, Rule.NONE, printed, ours, reason=why)


def mean_of_deviations(sheet: str, errors: NDArray[np.float64]) -> Ours:
    """Return the standard deviation of some errors with its own standard error, which is that of normal values."""
    deviation, count = float(errors.std(ddof=1)), len(errors)
    of = f"standard error of the deviation of {count} presses; bias {float(errors.mean()):+.2f} N"
    return Ours(sheet, deviation, deviation / np.sqrt(2 * (count - 1)), of, count)


def _judged(
    rule: Rule, printed: Printed, value: float, ours: Ours, our_value: float, printed_count: int
) -> tuple[bool, tuple[str, str]]:
    if rule is Rule.DEVIATION:
        return within_deviation(our_value, value, printed.deviation or 0.0), ("", "")
    if rule is Rule.BAND:
        bands = overlap_grade(value, 1.0), overlap_grade(our_value, 1.0)  # the paper's bands know no size
        return bands[0] == bands[1], bands
    if rule is Rule.SCATTER:
        return deviations_agree(our_value, ours.count, value, printed_count), ("", "")
    return within_digits(our_value, value, printed.half_digit, ours.uncertainty or 0.0), ("", "")


def _in_ranges(ours: Ours, value: float, printed: Printed) -> tuple[bool | None, str]:
    if ours.at_least and value <= max(high for _, _, high in printed.ranges):
        return None, "a lower bound: not all loads had settled"
    inside = () if ours.at_least else ranges_of(value, printed.ranges, ours.uncertainty or 0.0)
    if len(inside) == len(printed.ranges):
        return True, ""
    return (True, f"inside the range of {inside[0]} only") if inside else (False, "")
