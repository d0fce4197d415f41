"""Families of distributions that a lot of sensors may come from, each with any location and scale.

Beside the normal distribution: Student's t with 5 and 3 degrees of freedom (heavy tails), Gumbel's distribution of
largest and of smallest values (skewed; a Weibull quantity has a logarithm of the second), and a normal distribution
in which one value in ten scatters six times as much. Each is described at location 0 and scale 1.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import lgamma, log, pi
from typing import Final

import numpy as np
from scipy import integrate, optimize, special

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.worst_value import worst_of

_LARGEST_EXPONENT: Final = 500.0
_LARGEST_SCORE: Final = 12.0
_LEAST_SHARE: Final = 1e-300


class Family(ABC):
    """A distribution of location 0 and scale 1."""

    @abstractmethod
    def log_density(self, z: Array) -> Array:
        """Return the logarithm of the density at ``z``, any shape."""

    @abstractmethod
    def quantile(self, share: float) -> float:
        """Return the point below which this share lies."""

    @abstractmethod
    def distribution_function(self, z: Array) -> Array:
        """Return the share below ``z``, any shape."""

    def mirror(self) -> "Family":
        """Return the family of −z; itself if symmetric."""
        return self

    def normal_scores(self, z: Array) -> Array:
        """Map ``z`` to standard normal numbers of the same probability; keeps far tails finite."""
        scores = special.ndtri(self.distribution_function(z))
        return np.clip(scores, -_LARGEST_SCORE, _LARGEST_SCORE)

    @abstractmethod
    def moments(self) -> tuple[float, float]:
        """Return mean and standard deviation."""


@dataclass(frozen=True)
class LargestNormal(Family):
    """The largest of ``values`` independent normal numbers, with mean 0 and deviation 1; the normal one for 1."""

    values: int = 1

    def log_density(self, z: Array) -> Array:
        shape = worst_of(self.values)
        raw = shape.raw_mean + shape.raw_deviation * z
        constant = np.log(self.values * shape.raw_deviation / np.sqrt(2 * np.pi))
        log_density: Array = constant - 0.5 * raw**2
        if self.values > 1:
            log_density += (self.values - 1) * special.log_ndtr(raw)
        return log_density

    def quantile(self, share: float) -> float:
        return worst_of(self.values).quantile(share)

    def distribution_function(self, z: Array) -> Array:
        shape = worst_of(self.values)
        share: Array = special.ndtr(shape.raw_mean + shape.raw_deviation * z) ** self.values
        return share

    def normal_scores(self, z: Array) -> Array:
        return worst_of(self.values).normal_scores(z)

    def moments(self) -> tuple[float, float]:
        return 0.0, 1.0


@dataclass(frozen=True)
class Student(Family):
    """Student's t with some degrees of freedom, or the largest of several independent such values."""

    freedom: float
    values: int = 1

    def log_density(self, z: Array) -> Array:
        half = (self.freedom + 1) / 2
        constant = lgamma(half) - lgamma(self.freedom / 2) - 0.5 * log(self.freedom * pi) + log(self.values)
        log_density: Array = constant - half * np.log1p(np.square(z) / self.freedom)
        if self.values > 1:
            share = np.maximum(special.stdtr(self.freedom, z), _LEAST_SHARE)
            log_density += (self.values - 1) * np.log(share)
        return log_density

    def quantile(self, share: float) -> float:
        return float(special.stdtrit(self.freedom, share ** (1 / self.values)))

    def distribution_function(self, z: Array) -> Array:
        return np.asarray(special.stdtr(self.freedom, z) ** self.values, dtype=float)

    def moments(self) -> tuple[float, float]:
        if self.values == 1:
            return 0.0, float(np.sqrt(self.freedom / (self.freedom - 2)))

        def integrand(z: float, power: int) -> float:
            return z**power * float(np.exp(self.log_density(np.array(z))))

        first, second = (integrate.quad(integrand, -np.inf, np.inf, args=(power,))[0] for power in (1, 2))
        return float(first), float(np.sqrt(second - first**2))


@dataclass(frozen=True)
class Gumbel(Family):
    """Gumbel's distribution of largest values (``sign`` +1, skewed to the right) or of smallest ones (−1)."""

    sign: int

    def mirror(self) -> "Gumbel":
        return Gumbel(-self.sign)

    def log_density(self, z: Array) -> Array:
        y = self.sign * z
        log_density: Array = -y - np.exp(np.minimum(-y, _LARGEST_EXPONENT))
        return log_density

    def quantile(self, share: float) -> float:
        tail = share if self.sign > 0 else 1 - share
        return self.sign * float(-np.log(-np.log(tail)))

    def distribution_function(self, z: Array) -> Array:
        tail: Array = np.exp(-np.exp(np.minimum(-self.sign * z, _LARGEST_EXPONENT)))
        return tail if self.sign > 0 else 1 - tail

    def moments(self) -> tuple[float, float]:
        return self.sign * float(np.euler_gamma), float(np.pi / np.sqrt(6))


@dataclass(frozen=True)
class Contaminated(Family):
    """A normal distribution in which a share of the values scatters ``ratio`` times as much."""

    share: float
    ratio: float

    def log_density(self, z: Array) -> Array:
        narrow = np.log(1 - self.share) - 0.5 * z**2
        wide = np.log(self.share / self.ratio) - 0.5 * (z / self.ratio) ** 2
        log_density: Array = np.logaddexp(narrow, wide) - 0.5 * np.log(2 * np.pi)
        return log_density

    def quantile(self, share: float) -> float:
        far = self.ratio * abs(float(special.ndtri(share))) + 1
        return float(
            optimize.brentq(lambda z: float(self.distribution_function(np.array(z))) - share, -far, far, xtol=1e-12)
        )

    def distribution_function(self, z: Array) -> Array:
        share: Array = (1 - self.share) * special.ndtr(z) + self.share * special.ndtr(z / self.ratio)
        return share

    def moments(self) -> tuple[float, float]:
        return 0.0, float(np.sqrt(1 - self.share + self.share * self.ratio**2))
