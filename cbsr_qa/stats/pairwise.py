"""Ordered differences x_i − y_j of two groups, without making all of them where they are many."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array

IntArray = NDArray[np.intp]

_MOST_MADE = 1_000_000
_FEW_MADE = 50_000


def ordered_differences(x: Array, y: Array, ranks: Sequence[int]) -> list[float]:
    """Return the differences of the given ranks.

    Parameters
    ----------
    x : (n,) ndarray
    y : (m,) ndarray
    ranks : 1 for the smallest of n m differences.

    Notes
    -----
    A million and more are not made: how many are up to a value is counted by binary search in the sorted groups, and
    the value is closed in on by interpolation and bisection until those few that are left can be made. What they
    round to when they are counted, value + y, decides on which side of it they are.
    """
    if len(x) * len(y) <= _MOST_MADE:
        return _of_ranks(np.subtract.outer(x, y).ravel(), ranks)
    x, y = np.sort(x), np.sort(y)
    return [_by_counting(x, y, rank) for rank in ranks]


def _of_ranks(values: Array, ranks: Sequence[int]) -> list[float]:
    places = [rank - 1 for rank in ranks]
    ordered = np.partition(values, sorted(set(places)))
    return [float(ordered[place]) for place in places]


def _by_counting(x: Array, y: Array, rank: int) -> float:
    """Close in on a rank: ``below`` differences are up to ``low``, and ``upto`` ≥ rank up to ``high``."""
    low, high = np.nextafter(x[0] - y[-1], -np.inf), x[-1] - y[0]
    first, last = np.zeros(len(y), dtype=np.intp), np.full(len(y), len(x), dtype=np.intp)
    bisect = False
    while (between := int((last - first).sum())) > _FEW_MADE:
        below = int(first.sum())
        share = 0.5 if bisect else min(max((rank - below) / between, 0.01), 0.99)
        middle = low + share * (high - low)
        if not low < middle < high:
            return float(high)
        counts = np.searchsorted(x, y + middle, side="right")
        bisect = not bisect
        if int(counts.sum()) >= rank:
            high, last = middle, counts
        else:
            low, first = middle, counts
    return _of_ranks(_between(x, y, first, last), [rank - int(first.sum())])[0]


def _between(x: Array, y: Array, first: IntArray, last: IntArray) -> Array:
    """Differences of each y and the sorted x from ``first`` up to ``last``."""
    many = last - first
    which = np.repeat(np.arange(len(y)), many)
    place = np.arange(len(which)) - np.repeat(np.cumsum(many) - many, many) + np.repeat(first, many)
    differences: Array = x[place] - y[which]
    return differences
