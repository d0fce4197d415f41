"""Readings that must be equal by reciprocity, folded into one.

Drive a pair and measure another, or the other way round: the readings, and their sensitivities, are the same
(Geselowitz 1971). With noise variances v the weighted mean Σ(y/v)/Σ(1/v), of variance 1/Σ(1/v), says everything about
the image that the readings say (a sufficient statistic), so a linear problem of 208 readings is one of 104 and its
solution is the same to rounding. What the readings differ by says how large their noise is.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.patterns import DrivePattern
from cbsr_qa.domain.reconstruction import ImagingProblem

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SAME = 1e-6  # references of readings that are folded agree at least so well, relative to the largest


@dataclass(frozen=True, slots=True, eq=False)
class ReadingFold:
    """Which of m readings are the same, as g groups.

    Parameters
    ----------
    group : (m,) int64, 0 to g − 1, in the order of first readings.
    first : (g,) int64, first reading of each group.
    sign : (m,) float64, +1 or −1 against the first reading of the group.
    weight : (m,) float64, sign times share in the mean; magnitudes sum to one in each group.
    variance : (g,) float64 of the means, relative as the problem's.
    """

    group: Indices
    first: Indices
    sign: Array
    weight: Array
    variance: Array

    @classmethod
    def of(cls, problem: ImagingProblem) -> Self:
        """Fold a problem's readings; none where its own reference contradicts reciprocity."""
        group, first, sign = _groups(problem.sensor_type.pattern, problem.used)
        reference = problem.reference
        apart = np.abs(reference - sign * reference[first][group])
        if apart.max(initial=0.0) > _SAME * np.abs(reference).max():
            group = first = np.arange(len(reference))
            sign = np.ones(len(reference))
        variance = np.ones(len(reference)) if problem.noise_variance is None else problem.noise_variance
        information = np.bincount(group, 1 / variance)
        return cls(group, first, sign, sign / variance / information[group], 1 / information)

    def rows(self, jacobian: Array) -> Array:
        """Jacobian (g, e) of the folded readings."""
        rows: Array = jacobian[self.first]
        return rows

    def fold(self, readings: Array) -> Array:
        """Weighted means (n, g) of readings (n, m)."""
        folded = np.zeros((len(readings), len(self.first)))
        np.add.at(folded.T, self.group, (readings * self.weight).T)
        return folded

    def unfold(self, matrix: Array) -> Array:
        """Matrix (k, m) that takes all readings, of one (k, g) that takes their means."""
        whole: Array = matrix[:, self.group]
        whole *= self.weight
        return whole

    def noise(self, readings: Array) -> tuple[float, int]:
        """Mean variance of readings (n, m) for unit relative variance, from what reciprocal ones differ by.

        Returns
        -------
        The estimate and its degrees of freedom, 0 where no readings are folded.
        """
        freedom = len(readings) * (len(self.group) - len(self.first))
        if not freedom:
            return 0.0, 0
        size = np.bincount(self.group)
        informed = np.abs(self.weight) / self.variance[self.group]  # 1/v of every reading
        left = readings - self.fold(readings)[:, self.group] * self.sign
        repeated = size[self.group] > 1
        return float((left[:, repeated] ** 2 @ informed[repeated]).sum() / freedom), freedom


def _groups(pattern: DrivePattern, used: NDArray[np.bool_]) -> tuple[Indices, Indices, Array]:
    """Group, first reading of each group, and sign of every used reading against it."""
    names, signs = (table[used] for table in pattern.reading_groups())
    _, at, group = np.unique(names, return_index=True, return_inverse=True)
    order = np.argsort(at)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    first, group = at[order], rank[group]
    relative: Array = np.asarray(signs * signs[first][group], dtype=np.float64)
    return group.astype(np.int64), first.astype(np.int64), relative
