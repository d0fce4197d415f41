"""Variance components of repeated runs: between sensors, and within a sensor."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.intervals import factor_of_quantile, two_sided_factor
from cbsr_qa.stats.worst_value import skewness_ratio, worst_of

#: Smallest number of repeated runs that is used; fewer hardly determine how runs of one sensor differ: allowing for
#: their uncertainty would widen limits (by half for one repeat) more than the repeats help.
FEWEST_REPEATS = 4

_DRAWS = 20_000
_NODES = 257


@dataclass(frozen=True, slots=True)
class Components:
    """Expected value and spread of one run of one more sensor, in the model x = μ + sensor + run.

    Parameters
    ----------
    sensors : number of sensors.
    mean : mean of the sensors' means, each with equal weight however often it was run.
    between : variance of the sensors' means.
    within : variance between runs of one sensor; None if no sensor was run twice.
    repeats : degrees of freedom of ``within``.
    share : share of ``within`` that the sensors' means average away: 1 − 1/r̃, r̃ the harmonic mean of runs a sensor.
    """

    sensors: int
    mean: float
    between: float
    within: float | None
    repeats: int
    share: float

    @property
    def deviation(self) -> float:
        """Standard deviation of a single run of a single sensor."""
        return sqrt(self.between + self.share * (self.within or 0.0))

    def quantile_factor(self, coverage: float, confidence: float, values: int = 1) -> float:
        """Return k of mean + k deviation, below which this share of single runs of single sensors lies.

        Exact for one run per sensor and one value. Repeated runs use the generalised pivotal quantity of
        Krishnamoorthy & Mathew 2009, chapter 5 (unweighted means); confidence is then at least as stated.

        Parameters
        ----------
        coverage, confidence : shares between 0 and 1.
        values : number of normal values of which each number is the largest, see :mod:`cbsr_qa.stats.worst_value`.
        """
        quantile = worst_of(values).quantile(coverage)
        skewness_factor = skewness_ratio(coverage, confidence, values, self.sensors)
        if not self.repeats:
            return skewness_factor * factor_of_quantile(quantile, confidence, self.sensors, self.sensors - 1)
        offset, deviation = self._draws()
        return skewness_factor * float(np.quantile(offset + quantile * deviation, confidence)) / self.deviation

    def interval_factor(self, coverage: float, confidence: float) -> float:
        """Return k of mean ± k deviation, within which this share of single runs of single sensors lies.

        See :meth:`quantile_factor`; for one normal value per run.
        """
        if not self.repeats:
            return two_sided_factor(coverage, confidence, self.sensors, self.sensors - 1)
        offset, deviation = self._draws()
        away = np.abs(offset) / deviation
        nodes = np.linspace(0.0, float(away.max()), _NODES)  # smooth in between, and slow to compute for every draw
        half_widths = deviation * np.interp(away, nodes, np.sqrt(stats.ncx2.ppf(coverage, 1, nodes**2)))
        return float(np.quantile(half_widths, confidence)) / self.deviation

    def _draws(self) -> tuple[Array, Array]:
        """Fiducial draws of the mean's error and of the deviation; the seed is fixed, so that a lot has one limit."""
        random, freedom = np.random.default_rng(20090502), self.sensors - 1
        between_draws = freedom * self.between / random.chisquare(freedom, _DRAWS)
        within_draws = self.repeats * (self.within or 0.0) / random.chisquare(self.repeats, _DRAWS)
        offset = random.standard_normal(_DRAWS) * np.sqrt(between_draws / self.sensors)
        return offset, np.sqrt(between_draws + self.share * within_draws)


def telling_runs(runs: Sequence[Sequence[float]]) -> Sequence[Sequence[float]]:
    """Return the runs used in statistics: all, or the first of each sensor if few were repeated."""
    repeats = sum(len(values) - 1 for values in runs)
    return runs if repeats >= FEWEST_REPEATS else [values[:1] for values in runs]


def components(runs: Sequence[Sequence[float]]) -> Components:
    """Estimate mean and spread by unweighted means: sensors are the unit, not runs.

    Parameters
    ----------
    runs : one sequence of values per sensor, at least two sensors with at least one value each.
    """
    means = np.array([np.mean(values) for values in runs])
    sizes = np.array([len(values) for values in runs])
    repeats = int(sizes.sum() - len(means))
    squares = sum(float(np.sum((np.asarray(values) - mean) ** 2)) for values, mean in zip(runs, means, strict=True))
    return Components(
        sensors=len(means),
        mean=float(means.mean()),
        between=float(np.var(means, ddof=1)),
        within=squares / repeats if repeats else None,
        repeats=repeats,
        share=1 - float(np.mean(1 / sizes)),
    )
