"""A test of normality that says whether it has enough values to mean something."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array

#: Values that mostly show whether they are normal: Shapiro and Wilk's test (5 %) finds log-normal values of shape 0.5
#: in 92 % of samples of 50, in 73 % of 30, in 23 % of 10.
ENOUGH_VALUES: Final = 50
LEVEL: Final = 0.05
_FEWEST_VALUES: Final = 3
_MOST_VALUES: Final = 2500  #: the p value is trustworthy up to 5000 values


@dataclass(frozen=True, slots=True)
class Normality:
    """Test of normality by Shapiro and Wilk.

    Parameters
    ----------
    p_value : of normal values.
    refuted : whether it is below 0.05.
    telling : whether there are enough values for a test that does not refute to mean something.
    """

    p_value: float
    refuted: bool
    telling: bool


def check_normality(values: Array) -> Normality | None:
    """Test whether values (n,) are normal; None for fewer than three."""
    if len(values) < _FEWEST_VALUES:
        return None
    thinned = np.sort(values)[:: -(-len(values) // _MOST_VALUES)]
    p_value = float(stats.shapiro(thinned).pvalue)
    return Normality(p_value, p_value < LEVEL, len(values) >= ENOUGH_VALUES)
