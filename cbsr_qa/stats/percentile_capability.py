"""Capability of values that need not be normal: percentiles in place of 3 σ.

ISO 22514-2 compares the room to each limit with the distance of the 99.865 % and the 0.135 % point from the median
x₅₀, which for normal values is 3 σ:

    Ppk = min((U − x₅₀)/(x₉₉.₈₆₅ − x₅₀), (x₅₀ − L)/(x₅₀ − x₀.₁₃₅)).

Some thousand values would show those points. With fewer they are those of the families of
:mod:`cbsr_qa.stats.averaged_bound`, each counting by how well it explains the values. The interval is right if one of
them is; for normal values it is about that of the noncentral t.
"""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.averaged_bound import average
from cbsr_qa.stats.normality import LEVEL
from cbsr_qa.stats.process_capability import Index

FEWEST_VALUES: Final = 10
SHARES: Final = (0.00135, 0.5, 0.99865)  #: of the points that are compared with the limits
_MOST_VALUES: Final = 1000  #: more are thinned; they would take long and say little more
_LARGEST_LOG: Final = 690.0  #: its exponential is still finite
_METHOD: Final = "percentiles of the families that may explain the values"


def pool_subgroups(groups: Sequence[Iterable[float]]) -> Array | str:
    """Return the values of all subgroups, (n,), or the reason why they have no percentiles of one process."""
    arrays = [np.asarray(list(group), dtype=float) for group in groups]
    values = np.concatenate(arrays)
    if len(values) < FEWEST_VALUES:
        return f"percentiles need {FEWEST_VALUES} values; there are {len(values)}"
    if not np.median(np.abs(values - np.median(values))):
        return "more than half of the values are the same"
    if len(arrays) > 1 and len(values) > len(arrays):
        p_value = float(stats.f_oneway(*arrays).pvalue)
        if p_value < LEVEL:
            return f"subgroups differ (p = {p_value:.2g}): percentiles need values of one process"
    return values


def percentile_index(
    groups: Sequence[Iterable[float]], *, lower: float | None, upper: float | None, confidence: float
) -> Index | str:
    """Return Ppk by percentiles of values in subgroups, or the reason for none.

    Parameters
    ----------
    groups : values of each subgroup, in the unit of the limits.
    lower, upper : limits; at least one.
    """
    values = pool_subgroups(groups)
    if isinstance(values, str):
        return values
    indices, weights = _weigh_indices(values, lower, upper)
    order = np.argsort(indices)
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    tail = (1 - confidence) / 2
    median, low, high = np.interp((0.5, tail, 1 - tail), below, indices[order])
    return Index(float(median), float(low), float(high), _METHOD)


def percentile_index_of_extremes(
    least: Sequence[Iterable[float]],
    greatest: Sequence[Iterable[float]],
    *,
    lower: float,
    upper: float,
    confidence: float,
) -> Index | str:
    """Return the lesser index of runs of several values: of least and ``lower``, or greatest and ``upper``.

    The interval is joint (Bonferroni); see :func:`percentile_index`.
    """
    side_confidence = 1 - (1 - confidence) / 2
    low = percentile_index(least, lower=lower, upper=None, confidence=side_confidence)
    high = percentile_index(greatest, lower=None, upper=upper, confidence=side_confidence)
    if isinstance(low, str) or isinstance(high, str):
        return low if isinstance(low, str) else str(high)
    value, low_end, high_end = (
        min(ends) for ends in ((low.value, high.value), (low.low, high.low), (low.high, high.high))
    )
    return Index(value, low_end, high_end, f"{_METHOD}, both sides, Bonferroni")


def _weigh_indices(values: Array, lower: float | None, upper: float | None) -> tuple[Array, Array]:
    """Return the index at each node of each family's posterior, and the nodes' weights, (N,) each."""
    thinned = np.sort(values)[:: -(-len(values) // _MOST_VALUES)]
    indices, weights = [], []
    for member, locations, scales, shares in average(thinned, +1, positive=thinned[0] > 0).nodes():
        low, middle, high = (locations + scales * member.posterior.family.quantile(share) for share in SHARES)
        if member.logarithmic:
            low, middle, high = (np.exp(np.minimum(end, _LARGEST_LOG)) for end in (low, middle, high))
        rooms = [(upper - middle) / (high - middle)] if upper is not None else []
        rooms += [(middle - lower) / (middle - low)] if lower is not None else []
        indices.append(np.minimum.reduce(rooms))
        weights.append(shares)
    return np.concatenate(indices), np.concatenate(weights)
