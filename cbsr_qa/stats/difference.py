"""Difference of the means of two groups, and its size in deviations.

Welch 1947 (deviations may differ; ν by Welch–Satterthwaite) and Student's pooled test:

    Δ = x̄₁ − x̄₂,  SE² = s₁²/n₁ + s₂²/n₂,  ν = SE⁴ / (Σ (s_g²/n_g)² / (n_g − 1));  pooled: SE² = s_p² (1/n₁ + 1/n₂).

Neither knows of stations: groups measured on different stations are compared by :mod:`cbsr_qa.stats.mixed_model`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import exp, lgamma, log, sqrt

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.contrast import Contrast, checked
from cbsr_qa.stats.noncentral import noncentrality
from cbsr_qa.stats.samples import LEAST_SPREAD, Interval, sample, share
from cbsr_qa.stats.univariate import Summary, summary


@dataclass(frozen=True, slots=True)
class EffectSize:
    """Hedges' g = J d, with d = Δ/s_p, and an interval of the true δ = (μ₁ − μ₂)/σ; numbers without unit."""

    value: float
    interval: Interval


def welch(first: Iterable[float], second: Iterable[float], names: tuple[str, str] = ("first", "second")) -> Contrast:
    """Return the difference first − second where deviations may differ.

    Parameters
    ----------
    first, second : values of independent sensors, at least two each, in one unit.
    names : of the groups, for messages.

    Raises
    ------
    NumericsError
        A group of one, missing values, or no variance in either group.
    """
    one, two = _both(first, second, names)
    parts = [(_deviation(group) ** 2 / group.count, group.count - 1) for group in (one, two)]
    variance = sum(part for part, _ in parts)
    # Relative to the whole, so that squares of tiny variances do not vanish.
    freedom = 1 / sum((part / variance) ** 2 / free for part, free in parts)
    return checked(one.mean - two.mean, sqrt(variance), freedom, _title(names))


def pooled(first: Iterable[float], second: Iterable[float], names: tuple[str, str] = ("first", "second")) -> Contrast:
    """Return the difference first − second where both groups have the same deviation; see :func:`welch`.

    Raises
    ------
    NumericsError
        Fewer than two values each, missing values, or no variance in either group.
    """
    one, two = _both(first, second, names)
    error = pooled_deviation(one, two) * sqrt(1 / one.count + 1 / two.count)
    return checked(one.mean - two.mean, error, one.count + two.count - 2, _title(names))


def hedges(
    first: Iterable[float],
    second: Iterable[float],
    *,
    confidence: float = 0.95,
    names: tuple[str, str] = ("first", "second"),
) -> EffectSize:
    """Return Hedges' g of first − second.

    Notes
    -----
    J = Γ(ν/2) / (√(ν/2) Γ((ν − 1)/2)), which makes g unbiased (Hedges 1981). The interval inverts the noncentral t of
    the pooled statistic (Steiger & Fouladi 1997): exact for normal values of equal deviation, and about δ itself, so
    that it needs no J.

    Raises
    ------
    NumericsError
        As :func:`pooled`.
    """
    one, two = _both(first, second, names)
    share(confidence, "confidence")
    freedom, tail = one.count + two.count - 2, (1 - confidence) / 2
    root = sqrt(one.count * two.count / (one.count + two.count))
    size = (one.mean - two.mean) / pooled_deviation(one, two)
    low, high = (noncentrality(size * root, freedom, below) / root for below in (1 - tail, tail))
    return EffectSize(unbiasing(freedom) * size, Interval(low, high, confidence))


def unbiasing(freedom: float) -> float:
    """Return J of this many degrees of freedom, at least 2."""
    return exp(lgamma(freedom / 2) - lgamma((freedom - 1) / 2) - 0.5 * log(freedom / 2))


def pooled_deviation(one: Summary, two: Summary) -> float:
    """Return s_p = √(Σ (n_g − 1) s_g² / (n₁ + n₂ − 2))."""
    squares = sum((group.count - 1) * _deviation(group) ** 2 for group in (one, two))
    return sqrt(squares / (one.count + two.count - 2))


def _both(first: Iterable[float], second: Iterable[float], names: tuple[str, str]) -> tuple[Summary, Summary]:
    arrays = [sample(values, name, least=2) for values, name in zip((first, second), names, strict=True)]
    one, two = (summary(array, name) for array, name in zip(arrays, names, strict=True))
    largest = max(abs(one.mean), abs(two.mean))
    if max(_deviation(one), _deviation(two)) <= LEAST_SPREAD * largest:
        raise NumericsError(
            f"{_title(names)}: values do not differ within either group, which leaves no variance to judge "
            f"{one.mean - two.mean:.6g} by"
        )
    return one, two


def _deviation(group: Summary) -> float:
    return group.deviation or 0.0


def _title(names: tuple[str, str]) -> str:
    return f"{names[0]} − {names[1]}"
