"""Validated samples and intervals, shared by all statistics; mean, deviation, autocorrelation, quantiles.

With d_i = x_i − m for m near the mean (subtraction of close numbers is exact),

    mean = m + Σd/n,    s² = (Σd² − (Σd)²/n) / (n − 1),    r₁ = Σ e_i e_(i+1) / Σ e_i²,  e = d − Σd/n

with sums rounded once (NIST StRD, univariate summary statistics; Chan, Golub & LeVeque 1983).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, fsum, isfinite, log, sqrt
from typing import Any

import numpy as np
from scipy import special

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array

#: Largest absolute value; the squares of larger ones, or their sums, overflow.
LARGEST = 1e150
#: Spread, relative to the largest magnitude, below which values differ by rounding only.
LEAST_SPREAD = 1e-13


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval.

    Parameters
    ----------
    low, high : ends of the interval, in the unit of the estimate; infinite where one side is open.
    confidence : share of samples whose interval holds the true value, between 0 and 1.
    """

    low: float
    high: float
    confidence: float

    def holds(self, value: float) -> bool:
        """Return whether a value lies inside, ends included."""
        return self.low <= value <= self.high

    def scale(self, factor: float, shift: float = 0.0) -> "Interval":
        """Return the interval of ``factor`` × value + ``shift``."""
        ends = sorted((factor * self.low + shift, factor * self.high + shift))
        return Interval(ends[0], ends[1], self.confidence)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """Serialise an interval to JSON as both ends, null for an open one."""
        from pydantic_core import core_schema as core  # there, and nowhere else

        end = core.nullable_schema(core.float_schema())
        written = core.plain_serializer_function_ser_schema(
            lambda interval: tuple(end if isfinite(end) else None for end in (interval.low, interval.high)),
            return_schema=core.tuple_schema([end, end]),
        )
        return core.is_instance_schema(cls, serialization=written)


@dataclass(frozen=True, slots=True)
class Estimate:
    """An estimate with its interval at a stated confidence, and the p value of zero."""

    value: float
    standard_error: float
    low: float
    high: float
    p: float

    @property
    def holds_zero(self) -> bool:
        """Whether zero lies inside the interval, ends included."""
        return self.low <= 0.0 <= self.high


def sample(values: Iterable[float], what: str, *, least: int = 1, spread: bool = False) -> Array:
    """Return validated values as an array (n,).

    Parameters
    ----------
    values : finite numbers below 1e150 in magnitude.
    what : whose they are, for messages.
    least : smallest number of values.
    spread : whether the values must differ.

    Raises
    ------
    NumericsError
        Too few values, missing or infinite ones, too large ones, or (if ``spread``) values that are all equal.
    """
    array = np.asarray(values if isinstance(values, np.ndarray) else list(values), dtype=float)
    if array.ndim != 1 or len(array) < least:
        shape_words = f"{len(array)} value{'s' * (len(array) != 1)}" if array.ndim == 1 else f"an array {array.shape}"
        raise NumericsError(f"{what}: {shape_words} instead of at least {least}")
    bad = np.flatnonzero(~np.isfinite(array))
    if len(bad):
        raise NumericsError(
            f"{what}: {len(bad)} of {len(array)} values are missing or infinite, the first at index {bad[0]}",
            remedy="leave those rows out, and report it",
        )
    if len(array) and float(np.abs(array).max()) > LARGEST:
        raise NumericsError(f"{what}: squares of values beyond {LARGEST:g} overflow", remedy="choose a larger unit")
    if spread and constant(array):
        raise NumericsError(f"{what}: all {len(array)} values are {array[0]:.6g}, so there is no variance")
    return array


def constant(array: Array) -> bool:
    """Say whether values differ by no more than rounding."""
    return bool(np.ptp(array) <= LEAST_SPREAD * np.abs(array).max())


def share(value: float, what: str) -> float:
    """Return a confidence, level or power; NumericsError if it is not between 0 and 1."""
    if not 0 < value < 1:
        raise NumericsError(f"{what} is {value:g}; it must lie between 0 and 1, both excluded")
    return value


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary statistics of one sample.

    Parameters
    ----------
    count : n, at least 1.
    mean : mean in the values' unit.
    deviation : s with n − 1, in the values' unit; None for one value, 0 for equal ones.
    autocorrelation : r₁ of values in their order; None for equal values or fewer than three.
    """

    count: int
    mean: float
    deviation: float | None
    autocorrelation: float | None

    @property
    def standard_error(self) -> float | None:
        """S/√n for independent values; None for one value."""
        return None if self.deviation is None else self.deviation / sqrt(self.count)


@dataclass(frozen=True, slots=True)
class Quantile:
    """A quantile with a distribution-free interval.

    Parameters
    ----------
    share : share of the population below the quantile.
    value : estimate by linear interpolation between ordered values (Hyndman & Fan 1996, type 7, as numpy and R).
    interval : interval between two ordered values, for any distribution; None where the sample is too small for it.
    needed : number of values needed for an interval.
    """

    share: float
    value: float
    interval: Interval | None
    needed: int


def summary(values: Iterable[float], what: str = "values") -> Summary:
    """Return mean, deviation and lag-1 autocorrelation of values in the order they were measured in.

    Raises
    ------
    NumericsError
        No values, or missing, infinite or too large ones.
    """
    array = sample(values, what)
    mean, deviations = subtract_mean(array)
    if len(array) == 1:
        return Summary(1, mean, None, None)
    if constant(array):
        return Summary(len(array), mean, 0.0, None)
    scale = float(np.abs(deviations).max())  # neither tiny nor huge deviations lose their squares
    unit = deviations / scale
    squares = fsum(unit**2)
    deviation = scale * sqrt(squares / (len(array) - 1))
    lagged = fsum(unit[1:] * unit[:-1]) / squares if len(array) > 2 else None
    return Summary(len(array), mean, deviation, lagged)


def subtract_mean(array: Array) -> tuple[float, Array]:
    """Return the mean of (n,) values and the deviations from it, corrected for the mean's rounding."""
    approximate_mean = fsum(array) / len(array)
    deviations = array - approximate_mean
    correction = fsum(deviations) / len(array)
    return approximate_mean + correction, deviations - correction


def quantile(values: Iterable[float], below: float, *, confidence: float = 0.95, what: str = "values") -> Quantile:
    """Return a quantile with a distribution-free interval (x_(l), x_(u)) (Conover 1999, section 3.2).

    x_(k) lies above the quantile with probability P(B < k), B binomial with n and the share, and each end misses with
    probability (1 − confidence)/2 at most.

    Raises
    ------
    NumericsError
        No values, missing ones, or a share that is not between 0 and 1.
    """
    array = np.sort(sample(values, what))
    share(below, "share below a quantile"), share(confidence, "confidence")
    count, tail = len(array), (1 - confidence) / 2
    lower = largest_rank(count, below, tail)
    upper = count + 1 - largest_rank(count, 1 - below, tail)
    fits = lower >= 1 and upper <= count
    interval = Interval(float(array[lower - 1]), float(array[upper - 1]), confidence) if fits else None
    return Quantile(below, float(np.quantile(array, below)), interval, _values_needed(below, tail))


@lru_cache(maxsize=1024)  # many metrics have equally many values
def largest_rank(count: int, below: float, tail: float) -> int:
    """Return the largest rank k with P(x_(k) > quantile) = P(B ≤ k − 1) ≤ tail; 0 if none."""

    def most(rank: int) -> float:  # P(B ≤ rank), also for 10¹² values
        return 1.0 if rank >= count else float(special.betaincc(rank + 1, count - rank, below))

    rank = int(max(np.nan_to_num(special.bdtrik(tail, count, below)), 0.0))  # approximate; the sum decides
    while rank and most(rank - 1) > tail:
        rank -= 1
    while most(rank) <= tail:
        rank += 1
    return rank


def _values_needed(below: float, tail: float) -> int:
    """Values needed for smallest and largest to enclose the quantile: (larger side's share)^n ≤ tail."""
    rarer = min(below, 1 - below)
    count = ceil(log(tail) / log(1 - rarer))
    if count > 10**12:
        raise NumericsError(f"share below a quantile: {below:g} is too close to 0 or 1 for any sample size")
    return count


def smallest(enough: Callable[[int], bool], above: int, most: int, beyond: str) -> int:
    """Return the smallest sufficient count above an insufficient one, by doubling and bisection.

    NumericsError with the message ``beyond`` if more than ``most`` would be needed.
    """
    insufficient, count = above, 2 * above
    while not enough(count):
        insufficient, count = count, 2 * count
        if count > most:
            raise NumericsError(beyond)
    while count - insufficient > 1:
        middle = (count + insufficient) // 2
        insufficient, count = (insufficient, middle) if enough(middle) else (middle, count)
    return count
