"""Correlation of successive values, and what it does to the limits of control charts.

Test: Bartels (1982), the rank version of von Neumann's ratio, R = Σ (r_i − r_(i+1))² / Σ (r_i − r̄)². Without
correlation R/4 has about a Beta(a, a) distribution, a = 5 n (n + 1)(n − 1)² / (2 (n − 2)(5 n² − 2 n − 9)) − ½.

With x_i − μ = φ (x_(i−1) − μ) + noise, moving ranges measure σ √(1 − φ) instead of σ, and an exponentially weighted
average with weight λ scatters by σ √(λ/(2 − λ) (1 + ψ)/(1 − ψ)), ψ = φ (1 − λ) (Montgomery, Introduction to
Statistical Quality Control, 10.4).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy import stats

from cbsr_qa.stats.samples import sample, subtract_mean

#: Smallest number of values that are tested.
FEWEST = 10
#: Largest correlation that is assumed: limits vanish at 1.
_LARGEST = 0.99


@dataclass(frozen=True, slots=True)
class SerialCorrelation:
    """Correlation of successive values.

    Parameters
    ----------
    coefficient : correlation φ of a value with the one before it, corrected for the bias of short series.
    p : one-sided, of no positive correlation.
    """

    coefficient: float
    p: float


def correlate_successive(values: Iterable[float], what: str = "values") -> SerialCorrelation:
    """Estimate and test the correlation of successive values.

    NumericsError for fewer than :data:`FEWEST` values, or missing ones.
    """
    array = sample(values, what, least=FEWEST)
    count, (_, deviations) = len(array), subtract_mean(array)
    squares = float(deviations @ deviations)
    if squares == 0:
        return SerialCorrelation(0.0, 1.0)
    raw = float(deviations[1:] @ deviations[:-1]) / squares
    # Marriott & Pope 1954: E(r) ≈ φ − (1 + 4 φ)/n.
    coefficient = min((raw * count + 1) / (count - 4), _LARGEST)
    ranks = stats.rankdata(array)
    ratio = float(np.sum(np.diff(ranks) ** 2) / np.sum((ranks - ranks.mean()) ** 2))
    shape = 5 * count * (count + 1) * (count - 1) ** 2 / (2 * (count - 2) * (5 * count**2 - 2 * count - 9)) - 0.5
    return SerialCorrelation(coefficient, float(stats.beta.cdf(min(ratio / 4, 1.0), shape, shape)))


def individuals_beyond(correlation: float, width: float = 3.0) -> float:
    """Return the share of undisturbed values beyond ± width σ, with σ from moving ranges."""
    return 2 * float(stats.norm.sf(width * sqrt(1 - correlation)))


def ewma_beyond(correlation: float, weight: float, width: float) -> float:
    """Return the share of undisturbed averages beyond their limits, with σ from moving ranges."""
    remembered = correlation * (1 - weight)
    return 2 * float(stats.norm.sf(width * sqrt((1 - correlation) * (1 - remembered) / (1 + remembered))))
