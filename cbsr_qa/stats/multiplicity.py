"""Many tests at once: p values adjusted so that a page of thirty metrics does not find one difference by chance.

Sources: Holm 1979 (family-wise error); Benjamini & Hochberg 1995 (false discovery rate of independent or positively
dependent tests). Both are the step-down or step-up procedure turned into adjusted values, capped at 1.
"""

from collections.abc import Sequence

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.samples import sample


def holm(p_values: Sequence[float]) -> Array:
    """Return Holm's adjusted values: max over j ≤ i of (m − j + 1) p_(j), in the order given.

    Parameters
    ----------
    p_values : (m,), of the tests that were made; leave out those that were refused.

    Returns
    -------
    (m,) ndarray

    Raises
    ------
    NumericsError
        A value is missing or not between 0 and 1.
    """
    values, order = _ordered(p_values)
    factors = np.arange(len(values), 0, -1)
    return _back(np.maximum.accumulate(factors * values[order]), order)


def benjamini_hochberg(p_values: Sequence[float]) -> Array:
    """Return Benjamini and Hochberg's adjusted values: min over j ≥ i of m p_(j) / j; see :func:`holm`."""
    values, order = _ordered(p_values)
    raised = len(values) / np.arange(1, len(values) + 1) * values[order]
    return _back(np.minimum.accumulate(raised[::-1])[::-1], order)


def _ordered(p_values: Sequence[float]) -> tuple[Array, "np.ndarray[tuple[int], np.dtype[np.intp]]"]:
    values = sample(p_values, "p values", least=0)
    outside = values[(values < 0) | (values > 1)]
    if len(outside):
        raise NumericsError(f"p values: {outside[0]:g} is not between 0 and 1")
    return values, np.argsort(values, kind="stable")


def _back(adjusted: Array, order: "np.ndarray[tuple[int], np.dtype[np.intp]]") -> Array:
    result = np.empty_like(adjusted)
    result[order] = np.minimum(adjusted, 1.0)
    return result
