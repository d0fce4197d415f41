"""Ordered differences x_i − y_j of two groups, without making all of them where they are many."""

from collections.abc import Sequence

import numpy as np

from cbsr_qa.stats.worst_value import FloatArray

_MOST_MADE = 1_000_000


def ordered_differences(x: FloatArray, y: FloatArray, ranks: Sequence[int]) -> list[float]:
    """Return the differences of the given ranks.

    Parameters
    ----------
    x : (n,) ndarray
    y : (m,) ndarray
    ranks : 1 for the smallest of n m differences.

    Notes
    -----
    A million and more are not made: the number of them up to a value is counted by binary search in the sorted
    groups, and the value found by bisection, to the rounding of its endpoints.
    """
    if len(x) * len(y) <= _MOST_MADE:
        places = [rank - 1 for rank in ranks]
        ordered = np.partition(np.subtract.outer(x, y).ravel(), sorted(set(places)))
        return [float(ordered[place]) for place in places]
    x, y = np.sort(x), np.sort(y)
    return [_by_counting(x, y, rank) for rank in ranks]


def _by_counting(x: FloatArray, y: FloatArray, rank: int) -> float:
    low, high = float(x[0] - y[-1]), float(x[-1] - y[0])
    while True:
        middle = low + 0.5 * (high - low)
        if middle in (low, high):
            return high
        enough = int(np.searchsorted(x, y + middle, side="right").sum()) >= rank
        low, high = (low, middle) if enough else (middle, high)
