"""Which distributions a lot may come from: tests of the shape of worst values, and values far from the others."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.worst_value import worst_of

#: Modified z-score above which values are named as outliers (Iglewicz & Hoaglin 1993).
FAR_OUT = 3.5
_NORMAL_MAD = 0.6745  #: median absolute deviation of a standard normal number
_MOST_TESTED = 2500  #: the test's p-value is trustworthy up to 5000 values


class Distribution(StrEnum):
    """Assumed distribution of single values."""

    NORMAL = "normal"
    LOG_NORMAL = "log-normal"
    ANY = "any (order statistics)"
    SEVERAL = "several (average of families)"
    HEAVY = "heavy-tailed (Student, 3 degrees of freedom)"


@dataclass(frozen=True, slots=True)
class Fit:
    """Goodness of fit of a distribution.

    Parameters
    ----------
    p_value : p value of the Shapiro–Wilk test.
    refuted : whether the p value is below the requested level.
    distribution : distribution of single values.
    """

    p_value: float
    refuted: bool
    distribution: Distribution = Distribution.NORMAL


def fits_worst_of(values: Array, count: int, level: float) -> Fit:
    """Test whether values (n,), n ≥ 3, may be the largest of ``count`` normal ones each (plain ones for 1).

    Values are turned into normal scores of the fitted distribution, and given to Shapiro and Wilk's test.
    """
    standard = (values - values.mean()) / values.std(ddof=1)
    scores = np.sort(worst_of(count).normal_scores(standard))
    thinned = scores[:: -(-len(scores) // _MOST_TESTED)]
    p_value = float(stats.shapiro(thinned).pvalue)
    return Fit(p_value, p_value < level)


def far_out(values: Sequence[float]) -> tuple[int, ...]:
    """Return the indices of values whose modified z-score 0.6745 |x − median| / MAD exceeds 3.5."""
    array = np.asarray(values, dtype=float)
    away = np.abs(array - np.median(array))
    spread = float(np.median(away))
    if not spread:
        return ()
    return tuple(int(index) for index in np.flatnonzero(_NORMAL_MAD * away / spread > FAR_OUT))
