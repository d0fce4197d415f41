"""Families of distributions that quality software fits to values that are not normal, by maximum likelihood.

Each fits many samples at once, (draws, n), so that a bootstrap takes no loop. The deviation of normal and log-normal
values has n − 1 in its denominator. A threshold is where the product of spacings is largest (Cheng & Amin 1983): the
likelihood has no largest value there. Compared by Anderson and Darling's statistic and by AIC = 2 k − 2 ln L.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import special, stats

from cbsr_qa.domain.numbers import Array

_STEPS: Final = 12  #: of Newton's method, which doubles its digits with each
_LEAST_SHARE: Final = 1e-300
_LARGEST_LOG: Final = 690.0  #: its exponential is still finite
#: Distances of a threshold from the least value that are tried, in distances of the median from it.
_THRESHOLD_DISTANCES: Final = np.geomspace(1e-3, 30, 24)
_REFINEMENTS: Final = 8


class FittedFamily(ABC):
    """A family of distributions; parameters are (k, draws) arrays, values (draws, n)."""

    name: str
    parameter_names: tuple[str, ...]
    positive: bool  #: whether it has values above zero only

    @abstractmethod
    def fit(self, values: Array) -> Array:
        """Return the parameters, (k, draws), of samples (draws, n)."""

    @abstractmethod
    def quantile(self, parameters: Array, share: Any) -> Array:
        """Return the points below which shares lie: a number, or (draws, n) → the same shape."""

    @abstractmethod
    def share_below(self, parameters: Array, values: Any) -> Array:
        """Return the share below values: a number, or (draws, n) → the same shape."""

    @abstractmethod
    def log_density(self, parameters: Array, values: Array) -> Array:
        """Return the logarithm of the density, (draws, n)."""

    @abstractmethod
    def pivot(self, estimate: Array, drawn: Array) -> Array:
        """Return parameters that may be the true ones, (k, draws).

        ``estimate`` (k, 1) was fitted to the values, ``drawn`` (k, draws) to samples drawn from ``estimate``.
        """

    def anderson_darling(self, parameters: Array, values: Array) -> Array:
        """Return A² of samples, (draws,)."""
        count = values.shape[-1]
        below = self.share_below(parameters, np.sort(values, axis=-1))
        low, high = np.log(np.maximum(below, _LEAST_SHARE)), np.log(np.maximum(1 - below, _LEAST_SHARE))
        weights = (2 * np.arange(count) + 1) / count
        statistic: Array = -count - np.sum(weights * (low + high[..., ::-1]), axis=-1)
        return statistic

    def aic(self, parameters: Array, values: Array) -> Array:
        """Return Akaike's criterion of samples, (draws,)."""
        criterion: Array = 2 * len(self.parameter_names) - 2 * np.sum(self.log_density(parameters, values), axis=-1)
        return criterion


@dataclass(frozen=True)
class LocationScale(FittedFamily):
    """A distribution of x, or of log x, with any location and scale.

    Its intervals are generalised ones: (μ̂* − μ̂)/σ̂* and σ̂*/σ̂ of drawn samples do not depend on μ and σ (Krishnamoorthy
    & Mathew 2009), so an index of one limit has an exact interval; of normal values it is the noncentral t's.
    """

    name: str
    shape: Any  #: the distribution of ``scipy.stats``
    positive: bool = False
    parameter_names: tuple[str, ...] = ("location", "scale")

    def fit(self, values: Array) -> Array:
        on_scale = np.log(values) if self.positive else values
        if self.shape is stats.norm:
            return np.array([on_scale.mean(axis=-1), on_scale.std(axis=-1, ddof=1)])
        if self.shape is stats.logistic:
            return _fit_logistic(on_scale)
        if self.shape is stats.gumbel_l:
            return _fit_smallest(on_scale)
        location, scale = _fit_smallest(-on_scale)
        return np.array([-location, scale])

    def quantile(self, parameters: Array, share: Any) -> Array:
        location, scale = _align(parameters, share)
        point: Array = location + scale * self.shape.ppf(share)
        return np.exp(np.minimum(point, _LARGEST_LOG)) if self.positive else point

    def share_below(self, parameters: Array, values: Any) -> Array:
        location, scale = _align(parameters, values)
        return np.asarray(self.shape.cdf((self._on_scale(values) - location) / scale), dtype=float)

    def log_density(self, parameters: Array, values: Array) -> Array:
        location, scale = _align(parameters, values)
        on_scale = self._on_scale(values)
        log_density: Array = self.shape.logpdf((on_scale - location) / scale) - np.log(scale)
        return log_density - on_scale if self.positive else log_density

    def pivot(self, estimate: Array, drawn: Array) -> Array:
        (location, scale), (drawn_location, drawn_scale) = estimate, drawn
        return np.array([location - (drawn_location - location) / drawn_scale * scale, scale**2 / drawn_scale])

    def _on_scale(self, values: Any) -> Any:
        if not self.positive:
            return values
        with np.errstate(divide="ignore"):
            return np.log(np.maximum(values, 0.0))


@dataclass(frozen=True)
class Gamma(FittedFamily):
    """The gamma distribution. Its intervals reflect the logarithms of the drawn parameters about the estimates."""

    name: str = "gamma"
    positive: bool = True
    parameter_names: tuple[str, ...] = ("shape", "scale")

    def fit(self, values: Array) -> Array:
        mean = values.mean(axis=-1)
        excess = np.log(mean) - np.log(values).mean(axis=-1)
        shape = (3 - excess + np.sqrt((excess - 3) ** 2 + 24 * excess)) / (12 * excess)
        for _ in range(_STEPS):
            shape = shape - (np.log(shape) - special.psi(shape) - excess) / (1 / shape - special.polygamma(1, shape))
        return np.array([shape, mean / shape])

    def quantile(self, parameters: Array, share: Any) -> Array:
        shape, scale = _align(parameters, share)
        return np.asarray(scale * special.gammaincinv(shape, share), dtype=float)

    def share_below(self, parameters: Array, values: Any) -> Array:
        shape, scale = _align(parameters, values)
        return np.asarray(special.gammainc(shape, np.maximum(values, 0.0) / scale), dtype=float)

    def log_density(self, parameters: Array, values: Array) -> Array:
        shape, scale = _align(parameters, values)
        return np.asarray(stats.gamma.logpdf(values / scale, shape) - np.log(scale), dtype=float)

    def pivot(self, estimate: Array, drawn: Array) -> Array:
        reflected: Array = estimate**2 / drawn
        return reflected


@dataclass(frozen=True)
class Threshold(FittedFamily):
    """A family of log x, of values above a threshold that is not zero; intervals as of :class:`LocationScale`."""

    above: LocationScale
    positive: bool = False
    parameter_names: tuple[str, ...] = ("location", "scale", "threshold")

    @property
    def name(self) -> str:  # type: ignore[override]
        """Return the name that the trade uses."""
        return f"3-parameter-{self.above.name}"

    def fit(self, values: Array) -> Array:
        ordered = np.sort(values, axis=-1)
        least, unit = ordered[:, 0], np.median(ordered, axis=-1) - ordered[:, 0]

        def log_spacings(distance: Array) -> Array:
            above = ordered - (least - unit * distance)[:, None]
            share = self.above.share_below(self.above.fit(above), above)
            spacings = np.diff(share, axis=-1, prepend=0.0, append=1.0)
            product: Array = np.sum(np.log(np.maximum(spacings, _LEAST_SHARE ** (1 / 8))), axis=-1)
            return product

        tried = np.array([log_spacings(np.full(len(least), distance)) for distance in _THRESHOLD_DISTANCES])
        distance, best = _THRESHOLD_DISTANCES[np.argmax(tried, axis=0)], np.max(tried, axis=0)
        step = _THRESHOLD_DISTANCES[1] / _THRESHOLD_DISTANCES[0]
        for _ in range(_REFINEMENTS):
            step = np.sqrt(step)
            for factor in (1 / step, step):
                product = log_spacings(distance * factor)
                distance, best = np.where(product > best, distance * factor, distance), np.maximum(product, best)
        threshold = least - unit * distance
        return np.array([*self.above.fit(ordered - threshold[:, None]), threshold])

    def quantile(self, parameters: Array, share: Any) -> Array:
        point: Array = self.above.quantile(parameters[:2], share) + _align(parameters, share)[2]
        return point

    def share_below(self, parameters: Array, values: Any) -> Array:
        distances = np.atleast_2d(values) - parameters[2][:, None]
        share = self.above.share_below(parameters[:2], distances)
        return share if np.ndim(values) else share[:, 0]

    def log_density(self, parameters: Array, values: Array) -> Array:
        return self.above.log_density(parameters[:2], values - parameters[2][:, None])

    def pivot(self, estimate: Array, drawn: Array) -> Array:
        # Location and scale of the values: median, and its distance from the threshold.
        median, drawn_median = (self.quantile(parameters, 0.5) for parameters in (estimate, drawn))
        unit, drawn_unit = median - estimate[2], drawn_median - drawn[2]
        scale = estimate[1] ** 2 / drawn[1]
        new_unit = unit**2 / drawn_unit
        new_median = median - (drawn_median - median) / drawn_unit * unit
        middle = self.above.shape.ppf(0.5)
        return np.array([np.log(new_unit) - scale * middle, scale, new_median - new_unit])


def _align(parameters: Array, values: Any) -> Array:
    """Return parameters (k, draws) as (k, draws, 1) beside values (draws, n)."""
    return parameters[..., None] if np.ndim(values) else parameters


def _fit_smallest(values: Array) -> Array:
    """Fit the distribution of smallest values: Σ y e^{cy}/Σ e^{cy} − 1/c = ȳ for the reciprocal c of its scale."""
    mean, deviation = values.mean(axis=-1), values.std(axis=-1)
    y = (values - mean[..., None]) / deviation[..., None]
    largest = y.max(axis=-1)[..., None]
    c = np.full(mean.shape, np.pi / np.sqrt(6))
    for _ in range(_STEPS):
        weights = np.exp(c[..., None] * (y - largest))
        weights /= weights.sum(axis=-1)[..., None]
        first = np.sum(weights * y, axis=-1)
        slope = np.sum(weights * y**2, axis=-1) - first**2 + 1 / c**2
        c = np.maximum(c - (first - 1 / c) / slope, c / 2)
    level = largest[..., 0] + np.log(np.mean(np.exp(c[..., None] * (y - largest)), axis=-1)) / c
    return np.array([mean + deviation * level, deviation / c])


def _fit_logistic(values: Array) -> Array:
    """Fit the logistic distribution: Σ t = 0 and Σ z t = n with t = tanh(z/2), z = (y − μ)/s."""
    location, log_scale = np.median(values, axis=-1), np.log(values.std(axis=-1) * np.sqrt(3) / np.pi)
    for _ in range(_STEPS):
        scale = np.exp(log_scale)
        z = (values - location[..., None]) / scale[..., None]
        t = np.tanh(z / 2)
        slope = (1 - t**2) / 2
        level, width = t.mean(axis=-1), (z * t).mean(axis=-1) - 1
        a, b, d = slope.mean(axis=-1), (slope * z).mean(axis=-1), (slope * z**2).mean(axis=-1)
        c = level + b
        d = width + 1 + d
        determinant = a * d - b * c
        location = location + scale * (d * level - b * width) / determinant
        log_scale = log_scale + np.clip((a * width - c * level) / determinant, -1.0, 1.0)
    return np.array([location, np.exp(log_scale)])


_LOG_NORMAL: Final = LocationScale("log-normal", stats.norm, positive=True)
_WEIBULL: Final = LocationScale("weibull", stats.gumbel_l, positive=True)
#: Families with two parameters, of which the best may be chosen.
COMPARED: Final[tuple[FittedFamily, ...]] = (
    LocationScale("normal", stats.norm),
    _LOG_NORMAL,
    _WEIBULL,
    Gamma(),
    LocationScale("log-logistic", stats.logistic, positive=True),
    LocationScale("logistic", stats.logistic),
    LocationScale("largest-extreme-value", stats.gumbel_r),
    LocationScale("smallest-extreme-value", stats.gumbel_l),
)
#: All families, by name. Those with a threshold are for those who know that there is one.
FAMILIES: Final[dict[str, FittedFamily]] = {
    family.name: family for family in (*COMPARED, Threshold(_LOG_NORMAL), Threshold(_WEIBULL))
}
