"""Shift of two groups that are compared within strata only, e.g. at each station, without assuming normality.

What a stratum adds to its values, alike for both groups, cancels: it need not be known. With U_s the number of pairs
of stratum s in which the first group's value, less Δ, exceeds the second's (ties half), N_s = n_s + m_s,

    T(Δ) = Σ (U_s − n_s m_s/2) / (N_s + 1),   var T = Σ n_s m_s / (12 (N_s + 1))

(van Elteren 1960; Lehmann, Nonparametrics, section 3.3). The shift is the Δ at which T, which falls with Δ, passes
zero (Hodges & Lehmann 1963); its interval holds the Δ with |T| below the normal quantile. Ties lower the variance;
that is not allowed for, so that the interval is then too wide.
"""

from collections.abc import Sequence
from itertools import count
from math import sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.robust import Shift, shift
from cbsr_qa.stats.samples import Interval, constant, share


def shift_within(
    strata: Sequence[tuple[Array, Array]],
    *,
    confidence: float = 0.95,
    names: tuple[str, str] = ("first", "second"),
) -> Shift:
    """Return the shift first − second within strata.

    Parameters
    ----------
    strata : values of independent sensors of both groups, (n_s,) and (m_s,), in one unit. Strata without values of
        both are left out; a single one left is judged as by :func:`cbsr_qa.stats.robust.shift`.

    Raises
    ------
    NumericsError
        No stratum with values of both groups, missing values, or values that are equal within all strata.
    """
    share(confidence, "confidence")
    telling = [(np.sort(first), np.sort(second)) for first, second in strata if len(first) and len(second)]
    if not telling:
        raise NumericsError(f"{names[0]} − {names[1]}: they have no stratum in common")
    if len(telling) == 1:
        return shift(*telling[0], confidence=confidence, names=names)
    if all(constant(np.concatenate(stratum)) for stratum in telling):
        raise NumericsError(f"{names[0]} − {names[1]}: values do not differ within strata, so they cannot be ranked")
    sizes = [(len(first), len(second)) for first, second in telling]
    deviation = sqrt(sum(n * m / (12 * (n + m + 1)) for n, m in sizes))
    low = min(float(first[0] - second[-1]) for first, second in telling)
    high = max(float(first[-1] - second[0]) for first, second in telling)
    statistic = _statistic(telling, 0.0)
    reach = float(stats.norm.isf((1 - confidence) / 2)) * deviation
    interval = None
    if _statistic(telling, np.nextafter(low, -np.inf)) > reach:
        interval = Interval(
            _crossing(telling, reach, low, high)[0], _crossing(telling, -reach, low, high)[1], confidence
        )
    ends = _crossing(telling, 0.0, low, high)
    p_value = float(2 * stats.norm.sf(abs(statistic) / deviation))
    return Shift(0.5 * (ends[0] + ends[1]), interval, statistic, p_value, exact=False)


def _statistic(strata: Sequence[tuple[Array, Array]], difference: float) -> float:
    """T of a difference, of sorted values."""
    total = 0.0
    for first, second in strata:
        below = np.searchsorted(second, first - difference, side="left")
        upto = np.searchsorted(second, first - difference, side="right")
        pairs = 0.5 * float(below.sum() + upto.sum())
        total += (pairs - len(first) * len(second) / 2) / (len(first) + len(second) + 1)
    return total


def _crossing(strata: Sequence[tuple[Array, Array]], level: float, low: float, high: float) -> tuple[float, float]:
    """Return where T ceases to be above a level, and where it begins to be below: differences of two values."""
    left, right = float(np.nextafter(low, -np.inf)), float(np.nextafter(high, np.inf))
    return (
        _nearest_difference(strata, _narrow(strata, level, left, right, counts_equal=False)),
        _nearest_difference(strata, _narrow(strata, level, left, right, counts_equal=True)),
    )


def _narrow(
    strata: Sequence[tuple[Array, Array]], level: float, left: float, right: float, *, counts_equal: bool
) -> float:
    """Return where T, which falls, ceases to be above a level, or at it if that counts, to rounding.

    Interpolates and bisects in turn, between neighbouring powers of two first: single values may be far away.
    """
    left_excess, right_excess = (_statistic(strata, end) - level for end in (left, right))
    for step in count():
        share = left_excess / (left_excess - right_excess) if step % 2 and left_excess > right_excess else 0.5
        middle = left + min(max(share, 0.01), 0.99) * (right - left)
        if step % 4 == 0 and left < 0 < right:
            middle = 0.0
        elif step % 4 == 2 and min(abs(left), abs(right)) * 16 < max(abs(left), abs(right)):
            smaller, larger = sorted((left, right), key=abs)
            middle = 0.5 * larger if smaller == 0 or smaller * larger < 0 else smaller * sqrt(larger / smaller)
        if not left < middle < right:
            return 0.5 * (left + right) if np.nextafter(left, right) < right else right
        excess = _statistic(strata, middle) - level
        if excess > 0 or (counts_equal and excess == 0):
            left, left_excess = middle, excess
        else:
            right, right_excess = middle, excess
    raise AssertionError("count() does not end")


def _nearest_difference(strata: Sequence[tuple[Array, Array]], value: float) -> float:
    """Return the difference of two values of one stratum that is nearest to a value."""
    nearest = np.inf
    for first, second in strata:
        place = np.searchsorted(second, first - value)
        for neighbour in (np.maximum(place - 1, 0), np.minimum(place, len(second) - 1)):
            differences = first - second[neighbour]
            candidate = differences[np.argmin(np.abs(differences - value))]
            nearest = min(nearest, float(candidate), key=lambda one: abs(one - value))
    return nearest
