"""Difference of two group means, with tests of difference and equivalence; p values of many tests.

Welch 1947 (deviations may differ; ν by Welch–Satterthwaite), which ignores stations:

    Δ = x̄₁ − x̄₂,  SE² = s₁²/n₁ + s₂²/n₂,  ν = SE⁴ / (Σ (s_g²/n_g)² / (n_g − 1)).

Two one-sided tests (Schuirmann 1987) show that a difference Δ is negligible if both Δ ≤ −m and Δ ≥ m are rejected at
level α; equivalently, if the 1 − 2α interval lies within ± m.

Holm 1979 (family-wise error); Benjamini & Hochberg 1995 (false discovery rate), as adjusted values, capped at 1.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite, lgamma, log, sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.intervals import Judged, noncentrality
from cbsr_qa.stats.samples import LEAST_SPREAD, Interval, Summary, sample, share, summary


@dataclass(frozen=True, slots=True)
class Equivalence:
    """Result of two one-sided tests.

    Parameters
    ----------
    margin : m, in the difference's unit.
    p_value : the larger of both tests'.
    interval : interval with confidence 1 − 2α.
    equivalent : whether p ≤ α.
    """

    margin: float
    p_value: float
    interval: Interval
    equivalent: bool


@dataclass(frozen=True, slots=True)
class Contrast(Judged):
    """An estimate whose error over its standard error has Student's t distribution.

    Parameters
    ----------
    value, standard_error : estimate and its standard error, in the same unit; the error is above 0.
    freedom : degrees of freedom, above 0, need not be whole.
    """

    value: float
    standard_error: float
    freedom: float

    def p_value(self) -> float:
        """Return the two-sided p value of zero."""
        return float(2 * stats.t.sf(abs(self.statistic()), self.freedom))

    def _half(self, tail: float) -> float:
        return float(stats.t.isf(tail, self.freedom)) * self.standard_error

    def equivalence(self, margin: float, *, level: float = 0.05) -> Equivalence:
        """Test whether the true value lies within ± ``margin``.

        Raises
        ------
        NumericsError
            The margin is not a positive number, or the level is not between 0 and 0.5.
        """
        if not (margin > 0 and isfinite(margin)):
            raise NumericsError(f"equivalence: margin is {margin:g}; it must be positive")
        if not 0 < level < 0.5:
            raise NumericsError(f"equivalence: level is {level:g}; it must lie between 0 and 0.5")
        worst = max(
            float(stats.t.sf(self.statistic(-margin), self.freedom)),
            float(stats.t.cdf(self.statistic(margin), self.freedom)),
        )
        return Equivalence(margin, worst, self.interval(1 - 2 * level), worst <= level)


def make_contrast(value: float, standard_error: float, freedom: float, what: str) -> Contrast:
    """Return a contrast; NumericsError without a positive finite standard error or degrees of freedom."""
    if not (isfinite(value) and 0 < standard_error < inf and freedom > 0):
        raise NumericsError(
            f"{what}: {value:g} with a standard error of {standard_error:g} on {freedom:g} degrees of freedom "
            "cannot be judged"
        )
    return Contrast(value, standard_error, freedom)


@dataclass(frozen=True, slots=True)
class EffectSize:
    """Hedges' g = J d, with d = Δ/s_p, and an interval of the true δ = (μ₁ − μ₂)/σ; numbers without unit."""

    value: float
    interval: Interval


def welch(first: Iterable[float], second: Iterable[float], names: tuple[str, str] = ("first", "second")) -> Contrast:
    """Return the difference first − second with unequal deviations (Welch).

    Parameters
    ----------
    first, second : values of independent sensors, at least two each, in one unit.
    names : names of the groups, for messages.

    Raises
    ------
    NumericsError
        A group of one, missing values, or no variance in either group.
    """
    first_summary, second_summary = _summarise_both(first, second, names)
    variances = [(_deviation(group) ** 2 / group.count, group.count - 1) for group in (first_summary, second_summary)]
    variance = sum(group_variance for group_variance, _ in variances)
    # Relative to the whole, so that squares of tiny variances do not vanish.
    freedom = 1 / sum((group_variance / variance) ** 2 / free for group_variance, free in variances)
    return make_contrast(first_summary.mean - second_summary.mean, sqrt(variance), freedom, _title(names))


def hedges(
    first: Iterable[float],
    second: Iterable[float],
    *,
    confidence: float = 0.95,
    names: tuple[str, str] = ("first", "second"),
) -> EffectSize:
    """Return Hedges' g of first − second.

    J = Γ(ν/2) / (√(ν/2) Γ((ν − 1)/2)) makes g unbiased (Hedges 1981). The interval of δ inverts the noncentral t of
    the pooled statistic (Steiger & Fouladi 1997).

    Raises
    ------
    NumericsError
        A group of one, missing values, or no variance in either group.
    """
    first_summary, second_summary = _summarise_both(first, second, names)
    share(confidence, "confidence")
    freedom, tail = first_summary.count + second_summary.count - 2, (1 - confidence) / 2
    root = sqrt(first_summary.count * second_summary.count / (first_summary.count + second_summary.count))
    size = (first_summary.mean - second_summary.mean) / pool_deviations(first_summary, second_summary)
    low, high = (noncentrality(size * root, freedom, probability) / root for probability in (1 - tail, tail))
    return EffectSize(unbiasing(freedom) * size, Interval(low, high, confidence))


def unbiasing(freedom: float) -> float:
    """Return J for this many degrees of freedom, at least 2."""
    return exp(lgamma(freedom / 2) - lgamma((freedom - 1) / 2) - 0.5 * log(freedom / 2))


def pool_deviations(first: Summary, two: Summary) -> float:
    """Return s_p = √(Σ (n_g − 1) s_g² / (n₁ + n₂ − 2))."""
    squares = sum((group.count - 1) * _deviation(group) ** 2 for group in (first, two))
    return sqrt(squares / (first.count + two.count - 2))


def _summarise_both(
    first: Iterable[float], second: Iterable[float], names: tuple[str, str]
) -> tuple[Summary, Summary]:
    arrays = [sample(values, name, least=2) for values, name in zip((first, second), names, strict=True)]
    first_summary, second_summary = (summary(array, name) for array, name in zip(arrays, names, strict=True))
    largest = max(abs(first_summary.mean), abs(second_summary.mean))
    if max(_deviation(first_summary), _deviation(second_summary)) <= LEAST_SPREAD * largest:
        raise NumericsError(
            f"{_title(names)}: values do not differ within either group: there is no variance to judge "
            f"{first_summary.mean - second_summary.mean:.6g} against"
        )
    return first_summary, second_summary


def _deviation(group: Summary) -> float:
    return group.deviation or 0.0


def _title(names: tuple[str, str]) -> str:
    return f"{names[0]} − {names[1]}"


def holm(p_values: Sequence[float]) -> Array:
    """Return Holm's adjusted values (m,) of p values (m,): max over j ≤ i of (m − j + 1) p_(j), in the order given.

    Raises
    ------
    NumericsError
        A value is missing or not between 0 and 1.
    """
    values = _shares(p_values)
    order, adjusted = np.argsort(values, kind="stable"), np.empty_like(values)
    factors = np.arange(len(values), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * values[order]), 1.0)
    return adjusted


def benjamini_hochberg(p_values: Sequence[float]) -> Array:
    """Return Benjamini and Hochberg's adjusted values: min over j ≥ i of m p_(j) / j; see :func:`holm`."""
    return np.asarray(stats.false_discovery_control(_shares(p_values)), dtype=np.float64)


def _shares(p_values: Sequence[float]) -> Array:
    values = sample(p_values, "p values", least=0)
    outside = values[(values < 0) | (values > 1)]
    if len(outside):
        raise NumericsError(f"p values: {outside[0]:g} is not between 0 and 1")
    return values
