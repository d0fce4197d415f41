"""Shares of sensors that passed, with intervals.

Source: Wilson 1927 (score interval; its mean coverage is the stated one), as in NIST/SEMATECH e-Handbook 7.2.4.1.
"""

from dataclasses import dataclass
from math import sqrt

from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.samples import Interval, share


@dataclass(frozen=True, slots=True)
class Yield:
    """A share, between 0 and 1, of a number of sensors."""

    passed: int
    count: int
    value: float
    wilson: Interval


def passed_share(passed: int, count: int, *, confidence: float = 0.95) -> Yield:
    """Return the share that passed.

    Raises
    ------
    NumericsError
        Nothing was counted, or more passed than were counted.
    """
    share(confidence, "confidence")
    if count < 1 or not 0 <= passed <= count:
        raise NumericsError(f"yield: {passed} of {count} is no share", remedy="count at least one sensor")
    value = passed / count
    return Yield(passed, count, value, _wilson(passed, count, confidence))


def _wilson(passed: int, count: int, confidence: float) -> Interval:
    """(p̂ + z²/2n ± z √(p̂q̂/n + z²/4n²)) / (1 + z²/n)."""
    z, value = float(stats.norm.isf((1 - confidence) / 2)), passed / count
    centre = value + z**2 / (2 * count)
    half = z * sqrt(value * (1 - value) / count + z**2 / (4 * count**2))
    below = 0.0 if passed == 0 else (centre - half) / (1 + z**2 / count)
    above = 1.0 if passed == count else (centre + half) / (1 + z**2 / count)
    return Interval(below, above, confidence)
