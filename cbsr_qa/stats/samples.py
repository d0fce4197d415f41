"""What every statistic takes and gives: checked samples, and intervals."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array

#: Beyond it squares and their sums are no numbers.
LARGEST = 1e150
#: Spread, relative to the largest magnitude, below which values differ by rounding only.
LEAST_SPREAD = 1e-13


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval.

    Parameters
    ----------
    low, high : in the unit of what it is about; infinite where one side is open.
    confidence : share of samples whose interval holds the true value, between 0 and 1.
    """

    low: float
    high: float
    confidence: float

    def holds(self, value: float) -> bool:
        """Say whether a value lies inside, ends included."""
        return self.low <= value <= self.high

    def scaled(self, factor: float, shift: float = 0.0) -> "Interval":
        """Return the interval of ``factor`` × value + ``shift``."""
        ends = sorted((factor * self.low + shift, factor * self.high + shift))
        return Interval(ends[0], ends[1], self.confidence)


def sample(values: Iterable[float], what: str, *, least: int = 1, spread: bool = False) -> Array:
    """Return values as an array that statistics can be made of.

    Parameters
    ----------
    values : finite numbers below 1e150 in magnitude.
    what : whose they are, for messages.
    least : fewest values that will do.
    spread : whether they must differ.

    Returns
    -------
    (n,) ndarray

    Raises
    ------
    NumericsError
        Too few values, missing or infinite ones, too large ones, or (where asked for) none that differ.
    """
    array = np.asarray(values if isinstance(values, np.ndarray) else list(values), dtype=float)
    if array.ndim != 1 or len(array) < least:
        found = f"{len(array)} value{'s' * (len(array) != 1)}" if array.ndim == 1 else f"an array {array.shape}"
        raise NumericsError(f"{what}: {found} instead of at least {least}")
    bad = np.flatnonzero(~np.isfinite(array))
    if len(bad):
        raise NumericsError(
            f"{what}: {len(bad)} of {len(array)} values are missing or infinite, the first at index {bad[0]}",
            remedy="leave those rows out, and say that they are",
        )
    if len(array) and float(np.abs(array).max()) > LARGEST:
        raise NumericsError(f"{what}: values beyond {LARGEST:g} have no squares", remedy="choose a larger unit")
    if spread and constant(array):
        raise NumericsError(f"{what}: all {len(array)} values are {array[0]:.6g}, which leaves no variance")
    return array


def constant(array: Array) -> bool:
    """Say whether values differ by no more than rounding."""
    return bool(np.ptp(array) <= LEAST_SPREAD * np.abs(array).max())


def share(value: float, what: str) -> float:
    """Return a confidence, level or power, which must lie between 0 and 1.

    Raises
    ------
    NumericsError
        It does not.
    """
    if not 0 < value < 1:
        raise NumericsError(f"{what} is {value:g}; allowed are numbers between 0 and 1, both excluded")
    return value
