"""Law of the error of place against the number of presses, with a floor, and what it says of numbers not tried.

An error falls with the number of presses n, down to a floor that no number goes below: inexact labels, noise, what
the estimate cannot represent. Two laws describe this, error = a n^(−b) + c and error² = (a n^(−b))² + c². They differ
in how they reach the floor, which errors rarely tell, so that both count. Limits of a forecast are those of all laws
that fit about as well as the best (profile likelihood: Venzon & Moolgavkar 1988, doi:10.2307/2347496).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import f as fisher, t as student

from cbsr_qa.domain.numbers import Array, Mask

#: Least number of points: three parameters, and one point to contradict them.
MIN_POINTS: Final = 4
#: Probability of deviations as large as a law's own, below which no law fits.
_FITS: Final = 0.05
#: Standard deviation of real errors from the best law, as a share of the error: those of two real skins (table of
#: docs/explanation/place.md) deviate by 2 to 4 %.
_DEVIATION: Final = 0.03
#: Confidence of the limits.
_CONFIDENCE: Final = 0.95
#: Range of exponents b, and of the floor relative to the falling part at the largest number (the least is as good as
#: none).
_EXPONENTS: Final = (0.02, 2.0)
_FLOORS: Final = (1e-4, 1e3)
#: Number of exponents and floors that are tried, and how often the grid zooms in.
_TRIED: Final = (160, 120)
_REFINEMENTS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class LearningCurve:
    """Errors after growing numbers of presses.

    Parameters
    ----------
    numbers : (k,) presses, increasing.
    errors : (k,) mean errors.
    covariance : (k, k) covariance of their logarithms, by which they would differ with other presses.
    degrees : degrees of freedom of that covariance.
    """

    numbers: Array
    errors: Array
    covariance: Array
    degrees: float

    def from_number(self, first: int) -> "LearningCurve":
        """Leave out the points before one."""
        return LearningCurve(self.numbers[first:], self.errors[first:], self.covariance[first:, first:], self.degrees)


@dataclass(frozen=True, slots=True, eq=False)
class FittedLaws:
    """Laws that fit a curve: error = (x^(−pb) + r^p)^(1/p) s at x = n over the largest number, with p of 1 or 2.

    Parameters
    ----------
    largest : number of presses at x = 1.
    power : (m,) p of each law.
    exponent, floor : (m,) b and r.
    log_scale : (m,) logarithm of s that fits best.
    reach : (m,) largest distance from that at which the law still fits.
    best : index of the law that fits best.
    """

    largest: float
    power: Array
    exponent: Array
    floor: Array
    log_scale: Array
    reach: Array
    best: int

    def forecast_error(self, number: float) -> tuple[float, float, float]:
        """Return lower limit, best estimate and upper limit of the error after a number of presses."""
        logs = self.log_scale + _log_shape(number / self.largest, self.power, self.exponent, self.floor)
        low, high = float(np.min(logs - self.reach)), float(np.max(logs + self.reach))
        return math.exp(low), math.exp(float(logs[self.best])), math.exp(high)

    def forecast_number(self, error: float) -> tuple[float, float, float]:
        """Return lower limit, best estimate and upper limit of the presses that an error needs.

        Infinite where a law's floor is above that error.
        """
        low = self._numbers(error, self.log_scale - self.reach)
        high = self._numbers(error, self.log_scale + self.reach)
        best = self._numbers(error, self.log_scale)[self.best]
        return float(low.min()), float(best), float(high.max())

    def _numbers(self, error: float, log_scale: Array) -> Array:
        """Presses (m,) at which each law with a scale has an error."""
        with np.errstate(over="ignore"):
            falling = np.exp(self.power * (math.log(error) - log_scale)) - self.floor**self.power
        log_number = np.full(len(falling), np.inf)
        is_reached = falling > 0
        exponents = (self.power * self.exponent)[is_reached]
        log_number[is_reached] = -np.log(falling[is_reached]) / exponents
        with np.errstate(over="ignore"):
            return np.asarray(self.largest * np.exp(log_number), dtype=np.float64)


def fit_laws(curve: LearningCurve) -> FittedLaws | None:
    """Fit laws to a curve, from the smallest number from which one fits; None without one, or with too few points."""
    for first in range(len(curve.numbers) - MIN_POINTS + 1):
        if (laws := _fit(curve.from_number(first))) is not None:
            return laws
    return None


def _fit(curve: LearningCurve) -> FittedLaws | None:
    """Laws within the limits of confidence of the best; None if that does not fit."""
    inverse = np.linalg.inv(curve.covariance + _DEVIATION**2 * np.eye(len(curve.numbers)))
    weight = float(inverse.sum())
    places = curve.numbers / curve.numbers[-1]
    logs = np.log(curve.errors)

    def measure(power: float, exponents: Array, floors: Array) -> tuple[Array, Array]:
        """Misfit χ² and best log s of all laws with these exponents and floors, (exponents, floors)."""
        shapes = _log_shape(places, power, exponents[:, None, None], floors[:, None])
        residuals = logs - shapes
        log_scale = residuals @ inverse.sum(axis=0) / weight
        residuals = residuals - log_scale[..., None]
        return np.einsum("...i,ij,...j->...", residuals, inverse, residuals), log_scale

    allowed = float(student.ppf((1 + _CONFIDENCE) / 2, curve.degrees)) ** 2
    searched = [_search(lambda *tried, power=power: measure(power, *tried), allowed) for power in (1.0, 2.0)]
    least = min(float(misfits.min()) for misfits, *_ in searched)
    freedom = len(logs) - MIN_POINTS + 1
    if fisher.sf(least / freedom, freedom, curve.degrees) < _FITS:
        return None
    parts = []
    for power, (misfits, log_scale, exponents, floors) in zip((1.0, 2.0), searched, strict=True):
        fits = misfits <= least + allowed
        row, column = np.nonzero(fits)
        reach = np.sqrt((least + allowed - misfits[fits]) / weight)
        parts.append((np.full(len(row), power), exponents[row], floors[column], log_scale[fits], reach))
    powers, exponent, floor, log_scale, reach = (np.concatenate(column) for column in zip(*parts, strict=True))
    return FittedLaws(float(curve.numbers[-1]), powers, exponent, floor, log_scale, reach, int(np.argmax(reach)))


def _search(
    measure: Callable[[Array, Array], tuple[Array, Array]], allowed: float
) -> tuple[Array, Array, Array, Array]:
    """Return misfits and log s over a grid of exponents and floors that zooms in on what may fit."""
    exponents, floors = np.geomspace(*_EXPONENTS, _TRIED[0]), np.geomspace(*_FLOORS, _TRIED[1])
    for _ in range(_REFINEMENTS):
        misfits, _ = measure(exponents, floors)
        near = misfits <= misfits.min() + 2 * allowed
        exponents, floors = _zoom(exponents, near.any(axis=1)), _zoom(floors, near.any(axis=0))
    misfits, log_scale = measure(exponents, floors)
    return misfits, log_scale, exponents, floors


def _zoom(values: Array, near: Mask) -> Array:
    """Return as many values between those just outside of the near ones."""
    indices = np.flatnonzero(near)
    first, last = max(indices[0] - 1, 0), min(indices[-1] + 1, len(values) - 1)
    return np.geomspace(values[first], values[last], len(values))


def _log_shape(place: Array | float, power: Array | float, exponent: Array, floor: Array) -> Array:
    """Logarithm of (x^(−pb) + r^p)^(1/p)."""
    return np.asarray(np.log(np.power(place, -power * exponent) + floor**power) / power, dtype=np.float64)
