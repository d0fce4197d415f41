"""Mean, deviation, lag-1 autocorrelation and quantiles of one sample, to the digits that double precision allows.

With d_i = x_i − m for m near the mean (subtraction of close numbers is exact),

    mean = m + Σd/n,    s² = (Σd² − (Σd)²/n) / (n − 1),    r₁ = Σ e_i e_(i+1) / Σ e_i²,  e = d − Σd/n

with sums that are rounded once (:func:`math.fsum`). Sources: NIST Statistical Reference Datasets, univariate summary
statistics (definitions and certified values); Chan, Golub & LeVeque 1983 for the corrected two-pass sum.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, fsum, log, sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.samples import Interval, constant, sample, share


@dataclass(frozen=True, slots=True)
class Summary:
    """What one sample says at first.

    Parameters
    ----------
    count : n, at least 1.
    mean : in the values' unit.
    deviation : s with n − 1, in the values' unit; None for one value, 0 for equal ones.
    autocorrelation : r₁ of values in their order; None where they do not differ or are fewer than three.
    """

    count: int
    mean: float
    deviation: float | None
    autocorrelation: float | None

    @property
    def standard_error(self) -> float | None:
        """S/√n, of values that are independent; None for one value."""
        return None if self.deviation is None else self.deviation / sqrt(self.count)


@dataclass(frozen=True, slots=True)
class Quantile:
    """A quantile and what the sample leaves open about it.

    Parameters
    ----------
    share : of the population below it.
    value : by linear interpolation between ordered values (Hyndman & Fan 1996, type 7, as numpy and R).
    interval : from two ordered values, whatever the distribution; None where the sample is too small for it.
    needed : number of values from which there is an interval.
    """

    share: float
    value: float
    interval: Interval | None
    needed: int


def summary(values: Iterable[float], what: str = "values") -> Summary:
    """Return mean, deviation and lag-1 autocorrelation.

    Parameters
    ----------
    values : in the order they were measured in.
    what : whose they are, for messages.

    Raises
    ------
    NumericsError
        No values, or missing, infinite or too large ones.
    """
    array = sample(values, what)
    mean, rest = centred(array)
    if len(array) == 1:
        return Summary(1, mean, None, None)
    if constant(array):
        return Summary(len(array), mean, 0.0, None)
    scale = float(np.abs(rest).max())  # neither tiny nor huge deviations lose their squares
    unit = rest / scale
    squares = fsum(unit**2)
    deviation = scale * sqrt(squares / (len(array) - 1))
    lagged = fsum(unit[1:] * unit[:-1]) / squares if len(array) > 2 else None
    return Summary(len(array), mean, deviation, lagged)


def centred(array: Array) -> tuple[float, Array]:
    """Return the mean and the deviations from it, the mean's own rounding taken out of them.

    Parameters
    ----------
    array : (n,) ndarray, n ≥ 1.

    Returns
    -------
    mean, (n,) ndarray
    """
    near = fsum(array) / len(array)
    away = array - near
    correction = fsum(away) / len(array)
    return near + correction, away - correction


def quantile(values: Iterable[float], below: float, *, confidence: float = 0.95, what: str = "values") -> Quantile:
    """Return a quantile with an interval that holds whatever the distribution.

    Parameters
    ----------
    below : share of the population below the quantile.
    confidence : of the interval; what it reaches is at least this.

    Notes
    -----
    The interval is (x_(l), x_(u)): x_(k) lies above the quantile with probability P(B < k), B binomial with n and the
    share, and each end may miss with (1 − confidence)/2 at most (Conover 1999, section 3.2).

    Raises
    ------
    NumericsError
        No values, missing ones, or shares that are none.
    """
    array = np.sort(sample(values, what))
    share(below, "share below a quantile"), share(confidence, "confidence")
    count, tail = len(array), (1 - confidence) / 2
    lower = _largest_rank(count, below, tail)
    upper = count + 1 - _largest_rank(count, 1 - below, tail)
    fits = lower >= 1 and upper <= count
    interval = Interval(float(array[lower - 1]), float(array[upper - 1]), confidence) if fits else None
    return Quantile(below, float(np.quantile(array, below)), interval, _needed(below, tail))


@lru_cache(maxsize=1024)  # many metrics have as many values each
def _largest_rank(count: int, below: float, tail: float) -> int:
    """Largest rank k with P(x_(k) > quantile) = P(B ≤ k − 1) ≤ tail; 0 where there is none."""
    rank = int(stats.binom.ppf(tail, count, below))
    while rank and stats.binom.cdf(rank - 1, count, below) > tail:
        rank -= 1
    while stats.binom.cdf(rank, count, below) <= tail:
        rank += 1
    return rank


def _needed(below: float, tail: float) -> int:
    """Values whose smallest and largest enclose the quantile: the rarer side's share of missing ones^n ≤ tail."""
    rarer = min(below, 1 - below)
    count = ceil(log(tail) / log(1 - rarer))
    if count > 10**12:
        raise NumericsError(f"share below a quantile: {below:g} is too near to 0 or 1 for any sample")
    return count
