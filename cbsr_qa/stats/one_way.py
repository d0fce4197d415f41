"""Analysis of variance of groups: whether their means are alike.

    SSB = Σ n_g (x̄_g − x̄)²,  SSW = Σ Σ (x − x̄_g)²,  F = (SSB/(k − 1)) / (SSW/(N − k))

Source: NIST Statistical Reference Datasets, one-way analysis of variance (definitions and certified values).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import fsum, sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.samples import constant, sample
from cbsr_qa.stats.univariate import centred


@dataclass(frozen=True, slots=True)
class OneWay:
    """Table of a one-way analysis of variance; squares in the square of the values' unit."""

    between: float
    within: float
    freedom_between: int
    freedom_within: int
    statistic: float
    p_value: float

    @property
    def share_between(self) -> float:
        """R² = SSB / (SSB + SSW)."""
        return self.between / (self.between + self.within)

    @property
    def residual_deviation(self) -> float:
        """√(SSW / (N − k)), in the values' unit."""
        return sqrt(self.within / self.freedom_within)


def one_way(groups: Sequence[Iterable[float]], names: Sequence[str] = ()) -> OneWay:
    """Return the analysis of variance of at least two groups.

    Parameters
    ----------
    groups : values of each group, at least one each and two in one of them.
    names : of the groups, for messages.

    Raises
    ------
    NumericsError
        One group, an empty one, no repeats, missing values, or groups that differ within by rounding at most.
    """
    if len(groups) < 2:
        raise NumericsError(f"analysis of variance: {len(groups)} group instead of at least 2")
    labels = names or [f"group {index + 1}" for index in range(len(groups))]
    arrays = [sample(values, name) for values, name in zip(groups, labels, strict=True)]
    count = sum(map(len, arrays))
    if count == len(arrays):
        raise NumericsError("analysis of variance: every group has one value, which leaves no variance within them")
    grand, _ = centred(np.concatenate(arrays))
    parts = [centred(array - grand) for array in arrays]
    between = fsum(len(rest) * mean**2 for mean, rest in parts)
    within = fsum(square for _, rest in parts for square in rest**2)
    # Group by group: a sum of squares against a common threshold calls many small groups' true spread rounding.
    if all(constant(array) for array in arrays) or not within:
        raise NumericsError(
            "analysis of variance: values within the groups differ by rounding at most, which leaves no variance"
        )
    free = len(arrays) - 1, count - len(arrays)
    statistic = (between / free[0]) / (within / free[1])
    return OneWay(between, within, *free, statistic, float(stats.f.sf(statistic, *free)))
