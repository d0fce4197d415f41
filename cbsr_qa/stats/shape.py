"""Which distribution a lot may be taken for, and which of its values lie far out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.worst_value import worst_of

#: Modified z-score beyond which a value is named an outlier (Iglewicz & Hoaglin 1993).
FAR_OUT = 3.5
_NORMAL_MAD = 0.6745  #: median absolute deviation of a standard normal number
_MOST_TESTED = 2500  #: the test's p-value is trustworthy up to 5000 values


@dataclass(frozen=True, slots=True)
class Fit:
    """Whether values may come from a distribution.

    Parameters
    ----------
    p_value : of the Shapiro–Wilk test.
    refuted : whether it is below the level asked for.
    """

    p_value: float
    refuted: bool


def fits_worst_of(values: Array, count: int, level: float) -> Fit:
    """Test whether values may be the largest of ``count`` normal ones each (plain normal ones for 1).

    Parameters
    ----------
    values : (n,) ndarray, n ≥ 3, not all equal.
    level : probability of refuting it where it is true.

    Notes
    -----
    Mean and deviation are fitted, the values turned into normal scores of the fitted distribution, and these given
    to Shapiro and Wilk's test, which does not depend on mean and scale.
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
