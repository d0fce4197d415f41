"""Prediction intervals: where one further value of the same population lies, with a stated confidence.

Source: Hahn & Meeker, Statistical Intervals (1991), section 4.7: mean ± t s √(1 + 1/n), exact for normal values.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from cbsr_qa.domain.errors import NumericsError

#: With fewer a spread of two values stands for everything: no interval is given.
FEWEST_VALUES = 3


@dataclass(frozen=True, slots=True)
class Prediction:
    """Where one further value lies.

    Parameters
    ----------
    count, mean, deviation : of the values so far; the deviation is of one value, with n − 1.
    low, high : the interval.
    """

    count: int
    mean: float
    deviation: float
    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Whether a value lies in the interval; both ends do."""
        return self.low <= value <= self.high


def predicted(values: Sequence[float], *, confidence: float) -> Prediction:
    """Predict one further value of the population that some values are from.

    Parameters
    ----------
    values : independent, of one normal population; at least three.
    confidence : with which the interval holds the further value, between 0 and 1.

    Raises
    ------
    NumericsError
        If there are fewer than three, one is not finite, or the confidence is no share.
    """
    given = np.asarray(values, dtype=np.float64)
    if len(given) < FEWEST_VALUES:
        raise NumericsError(
            f"{len(given)} values predict nothing", remedy=f"wait until there are {FEWEST_VALUES} or more"
        )
    if not np.isfinite(given).all():
        raise NumericsError("a value is not a finite number")
    if not 0 < confidence < 1:
        raise NumericsError(f"a confidence of {confidence:g} is none", remedy="it lies between 0 and 1")
    count, mean = len(given), float(given.mean())
    deviation = float(given.std(ddof=1))
    reach = float(stats.t.ppf((1 + confidence) / 2, count - 1)) * deviation * float(np.sqrt(1 + 1 / count))
    return Prediction(count, mean, deviation, mean - reach, mean + reach)
