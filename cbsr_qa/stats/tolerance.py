"""Tolerance limits: bounds that hold a stated share of a population with a stated confidence.

Sources: NIST/SEMATECH e-Handbook 7.2.6.3 (normal, one-sided by the noncentral t), Krishnamoorthy & Mathew 2009,
chapters 2 (two-sided, exact) and 8 (order statistics), Wilks 1941. Factors take the number of values behind the mean
and the degrees of freedom of the standard deviation apart; of a plain sample of n they are n and n − 1.
"""

from functools import lru_cache
from math import ceil, log, sqrt

import numpy as np
from scipy import optimize, stats

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_FAR = 8.5  #: standard deviations beyond which a normal density is nothing


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
        return _held(k, coverage, mean_size, freedom) - confidence

    start = float(stats.norm.ppf((1 + coverage) / 2))
    low, high = start * 0.5, start * 2
    while shortfall(high) < 0:
        low, high = high, 2 * high
    return float(optimize.brentq(shortfall, low, high, xtol=1e-9))


def _held(k: float, coverage: float, mean_size: float, freedom: float) -> float:
    """Probability that mean ± k s holds the share: E over the mean's error z/√n of P(χ²_f ≥ f r(z)² / k²)."""
    z = 0.5 * _FAR * (_NODES + 1)
    radius2 = stats.ncx2.ppf(coverage, 1, z**2 / mean_size)
    held = stats.chi2.sf(freedom * radius2 / k**2, freedom)
    return float(_FAR * np.sum(_WEIGHTS * stats.norm.pdf(z) * held))


def spacings_outside(count: int, coverage: float, confidence: float) -> int:
    """Return how many spacings between ordered values may lie outside a distribution-free tolerance interval.

    With r of them the bound is the r-th value from the end; shared between both ends for two bounds. 0 where
    ``count`` values are too few even for their extremes.
    """
    outside = int(stats.binom.ppf(1 - confidence, count, 1 - coverage))
    while outside and stats.binom.cdf(outside - 1, count, 1 - coverage) > 1 - confidence:
        outside -= 1
    while stats.binom.cdf(outside, count, 1 - coverage) <= 1 - confidence:
        outside += 1
    return outside


def count_needed(coverage: float, confidence: float, sides: int) -> int:
    """Return how many values make their extremes a tolerance interval whatever the distribution.

    Parameters
    ----------
    sides : 1 or 2 bounds.
    """
    fewer = ceil(log(1 - confidence) / log(coverage) - 1e-9)
    if spacings_outside(fewer, coverage, confidence) >= sides:
        return fewer
    count = 2 * fewer
    while spacings_outside(count, coverage, confidence) < sides:
        fewer, count = count, 2 * count
    while count - fewer > 1:
        middle = (count + fewer) // 2
        enough = spacings_outside(middle, coverage, confidence) >= sides
        fewer, count = (fewer, middle) if enough else (middle, count)
    return count
