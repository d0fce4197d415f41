"""Two groups without assuming normality: shift of medians, rank tests, probability of superiority.

Mann & Whitney 1947 with Hodges & Lehmann's 1963 shift, the median of all x_i − y_j, and its interval from ordered
differences (Hollander & Wolfe 1999, sections 4.1 to 4.3); both assume that the distributions differ only by a shift.
Brunner & Munzel 2000 do not, and test P(x < y) + ½ P(x = y).

Ordered differences x_i − y_j of large groups are found without computing all of them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.samples import Interval, constant, sample, share

IntArray = NDArray[np.intp]

_MOST_MADE = 1_000_000
_FEW_MADE = 50_000


def differences_of_rank(x: Array, y: Array, ranks: Sequence[int]) -> list[float]:
    """Return the differences of the given ranks.

    Parameters
    ----------
    x : (n,) ndarray
    y : (m,) ndarray
    ranks : 1 for the smallest of n m differences.

    Notes
    -----
    From a million pairs on, differences up to a value are counted by binary search in the sorted groups, and the
    value is narrowed down by interpolation and bisection until the few that remain can be computed. The rounded sum
    value + y, as used in counting, decides on which side of the value a difference lies.
    """
    if len(x) * len(y) <= _MOST_MADE:
        return _order_statistics(np.subtract.outer(x, y).ravel(), ranks)
    x, y = np.sort(x), np.sort(y)
    return [_select_by_counting(x, y, rank) for rank in ranks]


def _order_statistics(values: Array, ranks: Sequence[int]) -> list[float]:
    places = [rank - 1 for rank in ranks]
    ordered = np.partition(values, sorted(set(places)))
    return [float(ordered[place]) for place in places]


def _select_by_counting(x: Array, y: Array, rank: int) -> float:
    """Narrow down a rank: ``below`` differences are up to ``low``, and ``upto`` ≥ rank up to ``high``."""
    low, high = np.nextafter(x[0] - y[-1], -np.inf), x[-1] - y[0]
    low_counts, high_counts = np.zeros(len(y), dtype=np.intp), np.full(len(y), len(x), dtype=np.intp)
    bisect = False
    while (count_between := int((high_counts - low_counts).sum())) > _FEW_MADE:
        count_below = int(low_counts.sum())
        share = 0.5 if bisect else min(max((rank - count_below) / count_between, 0.01), 0.99)
        middle = low + share * (high - low)
        if not low < middle < high:
            return float(high)
        counts = np.searchsorted(x, y + middle, side="right")
        bisect = not bisect
        if int(counts.sum()) >= rank:
            high, high_counts = middle, counts
        else:
            low, low_counts = middle, counts
    return _order_statistics(_differences_between(x, y, low_counts, high_counts), [rank - int(low_counts.sum())])[0]


def _differences_between(x: Array, y: Array, first: IntArray, last: IntArray) -> Array:
    """Differences of each y and the sorted x from ``first`` up to ``last``."""
    counts = last - first
    y_indices = np.repeat(np.arange(len(y)), counts)
    place = np.arange(len(y_indices)) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first, counts)
    differences: Array = x[place] - y[y_indices]
    return differences


#: Largest number of pairs for which the distribution of U is counted, without ties; beyond, it is normal to 3 digits.
MOST_COUNTED = 2500


@dataclass(frozen=True, slots=True)
class Shift:
    """How far one group lies above the other.

    Parameters
    ----------
    value : Hodges–Lehmann estimate of first − second, in the values' unit.
    interval : None where the groups are too small for the confidence.
    statistic : U, number of pairs in which the first exceeds the second (ties half).
    p_value : two-sided, of Mann & Whitney's test.
    exact : whether the distribution of U was counted; else normal with corrections for ties and continuity.
    """

    value: float
    interval: Interval | None
    statistic: float
    p_value: float
    exact: bool


@dataclass(frozen=True, slots=True)
class RelativeEffect:
    """P(first < second) + ½ P(equal), its interval (cut at 0 and 1), and Brunner & Munzel's test of ½."""

    value: float
    interval: Interval
    statistic: float
    freedom: float
    p_value: float


def shift(
    first: Iterable[float],
    second: Iterable[float],
    *,
    confidence: float = 0.95,
    names: tuple[str, str] = ("first", "second"),
) -> Shift:
    """Return the shift first − second.

    Parameters
    ----------
    first, second : values of independent sensors, at least one each, in one unit.

    Raises
    ------
    NumericsError
        An empty group, missing values, or values that are all equal.
    """
    share(confidence, "confidence")
    x, y = (sample(values, name) for values, name in zip((first, second), names, strict=True))
    pooled = np.concatenate([x, y])
    if constant(pooled):
        raise NumericsError(f"{names[0]} − {names[1]}: all values are {pooled[0]:.6g}, so they cannot be ranked")
    ranks, pairs = stats.rankdata(pooled), len(x) * len(y)
    statistic = float(ranks[: len(x)].sum()) - len(x) * (len(x) + 1) / 2
    exact = pairs <= MOST_COUNTED and len(np.unique(pooled)) == len(pooled)
    # The interval's lower end is the difference of rank C: the largest with P(U ≤ C − 1) ≤ α/2.
    if exact:
        shares = _shares_up_to(len(x), len(y))
        p_value = float(min(2 * shares[int(min(statistic, pairs - statistic))], 1.0))
        rank = int(np.searchsorted(shares, (1 - confidence) / 2, side="right"))
    else:
        # U is nearly normal, of the variance n₁n₂/12 (N + 1 − Σ(t³ − t)/(N(N − 1))), t the sizes of ties.
        ties, count = np.unique(pooled, return_counts=True)[1].astype(float), len(pooled)
        lost = float(np.sum(ties**3 - ties)) / (count * (count - 1))
        deviation = sqrt(pairs / 12 * (count + 1 - lost))
        p_value = float(2 * stats.norm.sf(max(abs(statistic - pairs / 2) - 0.5, 0.0) / deviation))
        rank = int(np.floor(pairs / 2 - float(stats.norm.isf((1 - confidence) / 2)) * deviation))
    interval = None
    if rank >= 1:
        low, high = differences_of_rank(x, y, (rank, pairs + 1 - rank))
        interval = Interval(low, high, confidence)
    middle = differences_of_rank(x, y, ((pairs + 1) // 2, pairs // 2 + 1))
    return Shift(0.5 * (middle[0] + middle[1]), interval, statistic, p_value, exact)


def brunner_munzel(
    first: Iterable[float],
    second: Iterable[float],
    *,
    confidence: float = 0.95,
    names: tuple[str, str] = ("first", "second"),
) -> RelativeEffect:
    """Return the relative effect of two groups whose distributions may have any shapes.

    Raises
    ------
    NumericsError
        Fewer than two values each, missing ones, or groups that do not overlap (the test then has no variance).
    """
    share(confidence, "confidence")
    x, y = (sample(values, name, least=2) for values, name in zip((first, second), names, strict=True))
    pooled_ranks = stats.rankdata(np.concatenate([x, y]))
    ranks = pooled_ranks[: len(x)], pooled_ranks[len(x) :]
    value = float(ranks[1].mean() - ranks[0].mean()) / (len(x) + len(y)) + 0.5
    # Placements: how many of the other group each value exceeds.
    placements = [rank - stats.rankdata(group) for rank, group in zip(ranks, (x, y), strict=True)]
    variances = [
        float(np.var(placed, ddof=1)) / (other**2 * len(placed))
        for placed, other in zip(placements, (len(y), len(x)), strict=True)
    ]
    variance = sum(variances)
    if not variance:
        raise NumericsError(
            f"{names[0]} and {names[1]}: the groups do not overlap, so Brunner–Munzel's test has no variance",
            remedy="use the Mann–Whitney test",
        )
    freedom = 1 / sum(
        (group_variance / variance) ** 2 / (len(g) - 1) for group_variance, g in zip(variances, (x, y), strict=True)
    )
    error, statistic = sqrt(variance), (value - 0.5) / sqrt(variance)
    half_width = float(stats.t.isf((1 - confidence) / 2, freedom)) * error
    interval = Interval(max(value - half_width, 0.0), min(value + half_width, 1.0), confidence)
    return RelativeEffect(value, interval, statistic, freedom, float(2 * stats.t.sf(abs(statistic), freedom)))


@lru_cache(maxsize=64)
def _shares_up_to(first: int, second: int) -> Array:
    """P(U ≤ u) for u = 0 … n₁n₂, without ties: coefficients of the Gaussian binomial ∏ (1 − q^(n₂+i))/(1 − q^i)."""
    counts = np.zeros(first * second + 1)
    counts[0] = 1.0
    for i in range(1, first + 1):
        step = second + i
        counts[step:] = counts[step:] - counts[: len(counts) - step] if step < len(counts) else counts[step:]
        for start in range(i):
            counts[start::i] = np.cumsum(counts[start::i])
    shares: Array = np.cumsum(counts) / counts.sum()
    return shares
