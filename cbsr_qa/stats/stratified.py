"""Shift of two groups that are compared within strata only, e.g. at each station, without assuming normality.

What a stratum adds to its values, alike for both groups, cancels: it need not be known. With U_s the number of pairs
of stratum s in which the first group's value, less Δ, exceeds the second's (ties half), N_s = n_s + m_s,

    T(Δ) = Σ (U_s − n_s m_s/2) / (N_s + 1),   var T = Σ n_s m_s / (12 (N_s + 1))

(van Elteren 1960; Lehmann, Nonparametrics, section 3.3). The shift is the Δ at which T, which falls with Δ, passes
zero (Hodges & Lehmann 1963); its interval holds the Δ with |T| below the normal quantile. Ties lower the variance;
that is not allowed for, so that the interval is then too wide.
"""

from collections.abc import Callable, Sequence
from itertools import count
from math import sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.robust import Shift, shift
from cbsr_qa.stats.samples import Interval, constant, share

#: Width at which a shift is found, relative to that of all differences.
_PRECISION = 1e-13


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
    """Return where T ceases to be above a level, and where it begins to be below; they differ on a step at it."""
    left, right = float(np.nextafter(low, -np.inf)), float(np.nextafter(high, np.inf))
    return (
        _narrow(lambda difference: _statistic(strata, difference) - level, left, right, counts_equal=False)[1],
        _narrow(lambda difference: _statistic(strata, difference) - level, left, right, counts_equal=True)[0],
    )


def _narrow(
    excess: Callable[[float], float], left: float, right: float, *, counts_equal: bool
) -> tuple[float, float]:
    """Narrow down where a falling function ceases to be positive (or zero); interpolates and bisects in turn."""
    left_excess, right_excess = excess(left), excess(right)
    least_width = _PRECISION * (right - left)
    for step in count():
        share = left_excess / (left_excess - right_excess) if step % 2 and left_excess > right_excess else 0.5
        middle = left + min(max(share, 0.01), 0.99) * (right - left)
        if right - left <= least_width or not left < middle < right:
            return left, right
        middle_excess = excess(middle)
        if middle_excess > 0 or (counts_equal and middle_excess == 0):
            left, left_excess = middle, middle_excess
        else:
            right, right_excess = middle, middle_excess
    raise AssertionError("count() does not end")
