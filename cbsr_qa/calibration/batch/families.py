"""Members of a batch's prior of one kind and length of correlation, and what loads of a sensor make of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.batch.loads import ROUNDING, SensorLoads, correlate_places
from cbsr_qa.domain.numbers import Array, Mask

#: Deviation of the level of a sensor that is not of the batch. Chosen by us.
_STRANGE_LEVEL: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Members of one kind and length of correlation.

    Parameters
    ----------
    weights : (m,) of all members, with sum one over all families.
    own, common, level, scatter : (m,) variances ϖ², ω², τ² and that of single loads.
    precision, pull : G (m, p, p), and q − G 1 μ (m, p).
    mean, mean_variance : (m,) of the level μ.
    """

    smooth: bool
    length_mm: float
    weights: Array
    own: Array
    common: Array
    level: Array
    scatter: Array
    precision: Array
    pull: Array
    mean: Array
    mean_variance: Array

    def correlate(self, one_mm: Array, other_mm: Array) -> Array:
        return correlate_places(one_mm, other_mm, self.length_mm, self.smooth)

    def expect(self, kernel: Array) -> Array:
        """Mean (m, n) of μ + c at places whose correlations with those of the batch are ``kernel`` (p, n)."""
        mean: Array = self.mean[:, None] + self.common[:, None] * (self.pull @ kernel)
        return mean

    def covary(self, one: Array, other: Array, mutual: Array) -> Array:
        """Prior covariance (m, n, k) of the sensor's map at places of kernels (p, n) and (p, k)."""
        common = self.common[:, None, None]
        by_level, other_by_level = self._weigh_level(one), self._weigh_level(other)
        known = common**2 * (one.T @ self.precision @ other)
        level = self.mean_variance[:, None, None] * by_level[:, :, None] * other_by_level[:, None, :]
        covariance: Array = (common + self.own[:, None, None]) * mutual - known + level + self.level[:, None, None]
        return covariance

    def vary(self, kernel: Array, mutual: Array) -> Array:
        """Prior variance (m, n), the diagonal of ``covary``."""
        common = self.common[:, None]
        known = common**2 * ((self.precision @ kernel) * kernel).sum(axis=1)
        level = self.mean_variance[:, None] * self._weigh_level(kernel) ** 2
        variance: Array = (common + self.own[:, None]) * mutual - known + level + self.level[:, None]
        return variance

    def _weigh_level(self, kernel: Array) -> Array:
        left: Array = 1 - self.common[:, None] * (self.precision.sum(axis=2) @ kernel)
        return left

    def select(self, which: Mask) -> "Family":
        names = ("own", "common", "level", "scatter", "precision", "pull", "mean", "mean_variance")
        return replace(self, weights=self.weights[which], **{name: getattr(self, name)[which] for name in names})

    def with_known_map(self) -> "Family":
        """The family if the common level and map were exactly known; only its covariances are meaningful."""
        return replace(self, common=0 * self.common, mean_variance=0 * self.mean_variance)

    def make_stranger(self) -> "Family":
        """The family of a sensor that has nothing in common with the batch but how its map varies."""
        return replace(
            self, own=self.own + self.common, common=0 * self.common, level=0 * self.level + _STRANGE_LEVEL**2
        )


@dataclass(frozen=True, slots=True, eq=False)
class ConditionedFamily:
    """A family after a sensor's loads.

    Parameters
    ----------
    root : (m, n, n) Cholesky factors of the loads' covariance.
    expected : (m, n) means of the loads.
    surprise : (m, n) what they differ by from those means, whitened.
    """

    family: Family
    root: Array
    expected: Array
    surprise: Array

    def log_likelihood(self, surprise: Array) -> Array:
        """Logarithm of the likelihood (m, …) of whitened values (m, n, …)."""
        squared: Array = (surprise**2).sum(axis=1)
        log_determinant = 2 * np.log(np.diagonal(self.root, axis1=1, axis2=2)).sum(axis=1)
        constant = log_determinant + surprise.shape[1] * np.log(2 * np.pi)
        likelihood: Array = -(squared + constant.reshape(-1, *[1] * (squared.ndim - 1))) / 2
        return likelihood


def condition_members(family: Family, batch_places_mm: Array, loads: SensorLoads) -> ConditionedFamily:
    """Condition each member on the loads of one sensor, exactly.

    Parameters
    ----------
    batch_places_mm : (p, 2) places of the batch.
    """
    kernel = family.correlate(batch_places_mm, loads.places_mm)
    covariance = family.covary(kernel, kernel, family.correlate(loads.places_mm, loads.places_mm))
    noise = loads.variance + family.scatter[:, None] + ROUNDING
    covariance += noise[:, :, None] * np.eye(len(loads.variance))
    if loads.bend is not None:
        covariance += loads.bend_stderr**2 * np.outer(loads.bend, loads.bend)
    root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    expected = family.expect(kernel)
    surprise = np.linalg.solve(root, (loads.log_response - expected)[:, :, None])[:, :, 0]
    return ConditionedFamily(family, root, expected, np.asarray(surprise, dtype=np.float64))


def mix_members(weights: Array, means: Sequence[Array], variances: Sequence[Array]) -> tuple[Array, Array]:
    """Mean and variance (n,) of a mixture of members (m, n)."""
    all_means = np.concatenate(means)
    mean: Array = weights @ all_means
    variance: Array = weights @ (np.concatenate(variances) + (all_means - mean) ** 2)
    return mean, np.maximum(variance, 0.0)
