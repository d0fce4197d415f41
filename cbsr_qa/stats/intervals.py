"""Exact intervals: noncentral t, tolerance and prediction limits, and estimates with an uncertain reference.

Uncertain reference: half width = √((t(ν) s)² + (z u)²), where s is the standard error of the readings on ν degrees of
freedom and u the standard uncertainty of the reference. Effective degrees of freedom (GUM G.4) would let a stated
uncertainty narrow intervals of few readings; here u always widens them, and coverage is at least as stated.

Tolerance limits: NIST/SEMATECH e-Handbook 7.2.6.3 (normal, one-sided by the noncentral t), Krishnamoorthy & Mathew
2009, chapters 2 (two-sided, exact) and 8 (order statistics), Wilks 1941. The number of values behind the mean and the
degrees of freedom of the standard deviation are separate arguments; for a plain sample of n they are n and n − 1.

Prediction intervals: Hahn & Meeker 1991, section 4.7: mean ± t s √(1 + 1/n), exact for normal values.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, exp, hypot, isnan, log, sqrt
from typing import Final

import numpy as np
from scipy import optimize, special, stats
from scipy.optimize import brentq

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.samples import Estimate, Interval, largest_rank, sample, share, smallest

#: Value above which the normal part of a noncentral t is negligible beside its χ part (1e-8), and its series no
#: longer converges.
_LARGE = 1e4
_TAIL: Final = 1e-16  #: share of χ² beyond each end of the integral
_NODES: Final = 400
_MOST_NEEDED: Final = 10**12


def noncentrality(t: float, freedom: float, below: float) -> float:
    """Return δ for which a noncentral t of ν ``freedom`` lies below ``t`` with this probability.

    T = (Z + δ)/√(χ²_ν/ν). For |t| > 10⁴, Z is left out.
    """
    if t < 0:
        return -noncentrality(-t, freedom, 1 - below)  # the mirrored tail keeps its digits
    if t > _LARGE:
        return t * sqrt(float(stats.chi2.isf(below, freedom)) / freedom)

    def excess(delta: float) -> float:
        share = float(special.nctdtr(freedom, delta, t))
        return (integrate_noncentral_t(t, freedom, delta) if isnan(share) else share) - below

    step = 5 + t
    low, high = t - step, t + step
    while excess(low) < 0:
        low -= step
    while excess(high) > 0:
        high += step
    return float(optimize.brentq(excess, low, high, xtol=1e-10, rtol=1e-12))


def integrate_noncentral_t(t: float, freedom: float, delta: float) -> float:
    """Return P(T ≤ t) by integrating Φ(t s − δ) over s = √(χ²/ν).

    It is slower than scipy's series, which gives no number for some large ν and |δ|.
    """
    ends = np.sqrt(np.array([stats.chi2.ppf(_TAIL, freedom), stats.chi2.isf(_TAIL, freedom)]) / freedom)
    nodes, weights = _legendre()
    half_width = 0.5 * (ends[1] - ends[0])
    s = ends[0] + half_width * (1 + nodes)
    density = 2 * freedom * s * stats.chi2.pdf(freedom * s**2, freedom)
    return float(np.sum(half_width * weights * density * special.ndtr(t * s - delta)))


@lru_cache(maxsize=1)
def _legendre() -> tuple[Array, Array]:
    nodes, weights = special.roots_legendre(_NODES)
    return nodes, weights


_NODES_TOLERANCE, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_FAR = 8.5  #: standard deviations beyond which a normal density is negligible


def one_sided_factor(coverage: float, confidence: float, mean_size: float, freedom: float) -> float:
    """Return k of the bound mean + k s (or mean − k s) of a normal population; exact.

    Parameters
    ----------
    coverage, confidence : shares between 0 and 1.
    mean_size : the variance of the mean is the population's over this.
    freedom : degrees of freedom of s.
    """
    quantile = float(stats.norm.ppf(coverage))
    return factor_of_quantile(quantile, confidence, mean_size, freedom)


def factor_of_quantile(quantile: float, confidence: float, mean_size: float, freedom: float) -> float:
    """Return k of a bound beyond ``quantile`` standard deviations from the mean; exact for a normal sample."""
    root = sqrt(mean_size)
    return float(stats.nct.ppf(confidence, freedom, quantile * root)) / root


@lru_cache(maxsize=64)
def two_sided_factor(coverage: float, confidence: float, mean_size: float, freedom: float) -> float:
    """Return k of mean ± k s that holds the middle of a normal population; exact, by quadrature over the mean.

    See :func:`one_sided_factor` for the parameters.
    """

    def shortfall(k: float) -> float:
        return _content_probability(k, coverage, mean_size, freedom) - confidence

    start = float(stats.norm.ppf((1 + coverage) / 2))
    low, high = start * 0.5, start * 2
    while shortfall(high) < 0:
        low, high = high, 2 * high
    return float(optimize.brentq(shortfall, low, high, xtol=1e-9))


def _content_probability(k: float, coverage: float, mean_size: float, freedom: float) -> float:
    """Probability that mean ± k s holds the share: E over the mean's error z/√n of P(χ²_f ≥ f r(z)² / k²)."""
    z = 0.5 * _FAR * (_NODES_TOLERANCE + 1)
    radius2 = stats.ncx2.ppf(coverage, 1, z**2 / mean_size)
    chance = stats.chi2.sf(freedom * radius2 / k**2, freedom)
    return float(_FAR * np.sum(_WEIGHTS * stats.norm.pdf(z) * chance))


def spacings_outside(count: int, coverage: float, confidence: float) -> int:
    """Return how many spacings between ordered values may lie outside a distribution-free tolerance interval.

    Shared between both ends for two bounds; 0 if even the extremes of ``count`` values do not suffice.
    """
    return largest_rank(count, 1 - coverage, 1 - confidence)


def count_needed(coverage: float, confidence: float, sides: int) -> int:
    """Return the number of values whose extremes are a distribution-free tolerance interval of 1 or 2 sides."""

    def enough(count: int) -> bool:
        return spacings_outside(count, coverage, confidence) >= sides

    fewer = ceil(log(1 - confidence) / log(coverage) - 1e-9)
    beyond = f"a coverage of {coverage:g} needs more than {_MOST_NEEDED:g} values"
    return fewer if enough(fewer) else smallest(enough, fewer, _MOST_NEEDED, beyond)


#: Smallest number of values for an interval: two values alone would have to determine the spread.
FEWEST_VALUES = 3


@dataclass(frozen=True, slots=True)
class Prediction:
    """Prediction interval of one further value.

    Parameters
    ----------
    count, mean, deviation : number, mean and deviation (with n − 1) of the values so far.
    low, high : the interval.
    """

    count: int
    mean: float
    deviation: float
    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Whether a value lies in the interval, ends included."""
        return self.low <= value <= self.high


def predict(values: Sequence[float], *, confidence: float) -> Prediction:
    """Predict one further value of the normal population of a sample of at least three independent values.

    NumericsError if there are fewer than three, one is not finite, or the confidence is not between 0 and 1.
    """
    array = sample(values, "values to predict the next from", least=FEWEST_VALUES)
    share(confidence, "confidence")
    count, mean = len(array), float(array.mean())
    deviation = float(array.std(ddof=1))
    half_width = float(stats.t.ppf((1 + confidence) / 2, count - 1)) * deviation * float(np.sqrt(1 + 1 / count))
    return Prediction(count, mean, deviation, mean - half_width, mean + half_width)


#: Smallest tail with a finite quantile; smaller tails are zero.
_LEAST_TAIL = 1e-300


class Judged(ABC):
    """An estimate with a standard error; subclasses give the half width."""

    __slots__ = ()

    value: float
    standard_error: float

    @abstractmethod
    def p_value(self) -> float:
        """Return the two-sided p value of zero."""

    @abstractmethod
    def _half(self, tail: float) -> float:
        """Half width that leaves this probability on each side."""

    def statistic(self, null: float = 0.0) -> float:
        """Return the distance of the estimate above ``null`` in standard errors."""
        return (self.value - null) / self.standard_error

    def interval(self, confidence: float = 0.95) -> Interval:
        """Return value ± half width.

        Raises
        ------
        NumericsError
            The confidence is not between 0 and 1.
        """
        share(confidence, "confidence")
        half_width = self._half((1 - confidence) / 2)
        return Interval(self.value - half_width, self.value + half_width, confidence)

    def estimate(self, confidence: float = 0.95) -> Estimate:
        """Return the fields for documents."""
        interval = self.interval(confidence)
        return Estimate(self.value, self.standard_error, interval.low, interval.high, self.p_value())


@dataclass(frozen=True, slots=True)
class Referenced(Judged):
    """An estimate with one estimated and one known standard error.

    Parameters
    ----------
    value : estimate; the other attributes are in its unit.
    scatter : standard error of the readings, above 0.
    freedom : its degrees of freedom, above 0.
    known : contribution of the references' standard uncertainties, at least 0; 0 gives Student's t interval.
    """

    value: float
    scatter: float
    freedom: float
    known: float = 0.0

    @property
    def standard_error(self) -> float:  # type: ignore[override]
        return hypot(self.scatter, self.known)

    def p_value(self) -> float:
        """Return the two-sided p value of zero: 1 − the confidence of the interval that just reaches it."""
        away = abs(self.value)
        # t is wider than z: the p value lies between those of t with the scatter alone and with both errors.
        low = float(stats.t.sf(away / self.scatter, self.freedom))
        high = float(stats.t.sf(away / self.standard_error, self.freedom))
        if self.known == 0 or high - low <= 1e-12 * high:
            return 2 * high
        low = max(low / 2, _LEAST_TAIL)
        if high <= low or self._half(low) <= away:
            return 0.0
        tail = brentq(lambda logarithm: self._half(exp(logarithm)) - away, log(low), log(min(2 * high, 0.5)))
        return 2 * exp(tail)

    def _half(self, tail: float) -> float:
        estimated = float(stats.t.isf(tail, self.freedom)) * self.scatter
        return hypot(estimated, float(stats.norm.isf(tail)) * self.known)
