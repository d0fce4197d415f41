"""The error that forces of a calibration are expected to have over the loads that matter, and what reduces it.

An error δ of the logarithm of the response is one of the force by δ (F + β A/α), from κ = exp(response) (α σ + β).
The loads that matter have every radius, angle and strain within bounds alike; their places are known. Beside the
map's own error each has the scatter of single loads and the noise of its readings, and all may share one factor.

The mean square of a map's error over the area is a random number: under each member of the map a weighted sum of
squared normals, here one χ² of the same mean and variance (Satterthwaite 1946, Biometrics Bulletin 2, 110). The upper
bound is a quantile of their mixture.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import gammainc

from cbsr_qa.calibration.sheet.learned_map import LearnedMap
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import GOLDEN_TURN, Indenter
from cbsr_qa.domain.sensor.sensor_type import QuasiStatic

#: Places at which the map's error is averaged, and strains of a load.
_PLACES: Final = 64
_STRAINS: Final = 32
#: Halvings of the interval that holds a quantile.
_HALVINGS: Final = 60


@dataclass(frozen=True, slots=True)
class LoadsThatMatter:
    """Loads of which forces shall be known.

    Parameters
    ----------
    radius_mm : largest distance from the centre; every radius up to it is as frequent.
    strains : lowest and highest strain; every strain between is as frequent.
    """

    radius_mm: float
    strains: tuple[float, float]

    def places_mm(self) -> Array:
        """Places (t, 2) spread evenly over radius and angle."""
        number = np.arange(_PLACES)
        radius, turn = self.radius_mm * (number + 0.5) / _PLACES, 2 * np.pi * GOLDEN_TURN * number
        return np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])

    def lever_N(self, force_per_strain_N: float, line: QuasiStatic, head: Indenter) -> float:
        """Error of force by that of the logarithm of the response: root mean square of F + β A/α [N]."""
        middles = (np.arange(_STRAINS) + 0.5) / _STRAINS
        strains = self.strains[0] + (self.strains[1] - self.strains[0]) * middles
        offset_N = line.intercept.value / line.slope.value * head.area_mm2 * 1e-3
        return float(np.sqrt(np.mean((force_per_strain_N * strains + offset_N) ** 2)))


@dataclass(frozen=True, slots=True)
class LoadErrors:
    """What a single load's force is wrong by, beside the map.

    Parameters
    ----------
    lever_N : error of force by that of the logarithm of the response, see :meth:`LoadsThatMatter.lever_N`.
    noise_N : standard error by the noise of the readings.
    shared : relative standard error that all forces have in common.
    """

    lever_N: float
    noise_N: float
    shared: float


@dataclass(frozen=True, slots=True)
class ForceError:
    """Error of force over the loads that matter, root mean square.

    Parameters
    ----------
    expected_N, upper_N : expected error, and its upper bound.
    floor_N : what would remain if the map were known: scatter of single loads, noise, and what all forces share.
    """

    expected_N: float
    upper_N: float
    floor_N: float


def expect_force_error(response: LearnedMap, places_mm: Array, errors: LoadErrors, confidence: float) -> ForceError:
    """Return the error of force that a map has over places (t, 2).

    Parameters
    ----------
    confidence : probability with which the error is below the upper bound.
    """
    means, _ = response.predict_members(places_mm)
    deviations = means - response.weights @ means
    covariances = response.covariance(places_mm, places_mm) + errors.shared**2
    count = len(places_mm)
    squares = np.trace(covariances, axis1=1, axis2=2) + (deviations**2).sum(axis=1)
    pulled = (deviations[:, None] @ covariances)[:, 0]
    spreads = 2 * (covariances**2).sum(axis=(1, 2)) + 4 * (pulled * deviations).sum(axis=1)
    member_mean, member_variance = squares / count, spreads / count**2
    upper = _find_quantile(response.weights, member_mean, member_variance, confidence)
    return ForceError(
        _total_N(float(response.weights @ member_mean), response.scatter, errors),
        _total_N(upper, response.scatter, errors),
        _total_N(errors.shared**2, response.scatter, errors),
    )


def expect_after_presses(
    response: LearnedMap, candidates_mm: Array, places_mm: Array, errors: LoadErrors, variance: float
) -> Array:
    """Return the expected error of force (n,) [N] over places (t, 2) after one more press at each candidate (n, 2).

    Parameters
    ----------
    variance : variance of the logarithm of the response that a press measures, by noise.
    """
    means, _ = response.predict_members(places_mm)
    between = ((means - response.weights @ means) ** 2).mean(axis=1)
    after = response.variance_after(candidates_mm, places_mm, variance).mean(axis=2)
    squares = response.weights @ (after + between[:, None]) + errors.shared**2
    return np.array([_total_N(square, response.scatter, errors) for square in squares.tolist()])


def predict_error_bound(
    covariances: Array, weights: Array, scatter: float, errors: LoadErrors, confidence: float
) -> float:
    """Return the upper bound of the error of force [N] of a map that is not yet known.

    Parameters
    ----------
    covariances : (m, t, t) of its logarithm over the loads that matter, of each member of a mixture.
    weights : (m,) of the members, with sum one.
    scatter : of single loads.
    """
    total, count = covariances + errors.shared**2, covariances.shape[1]
    member_mean = np.trace(total, axis1=1, axis2=2) / count
    member_variance = 2 * (total**2).sum(axis=(1, 2)) / count**2
    return _total_N(_find_quantile(weights, member_mean, member_variance, confidence), scatter, errors)


def _total_N(square: float, scatter: float, errors: LoadErrors) -> float:
    return float(np.hypot(errors.lever_N * np.sqrt(square + scatter**2), errors.noise_N))


def _find_quantile(weights: Array, mean: Array, variance: Array, confidence: float) -> float:
    """Quantile of a mixture of scaled χ² with these means and variances (m,), by bisection."""
    shape, scale = mean**2 / variance, variance / mean
    low, high = 0.0, float(mean.max())
    while weights @ gammainc(shape, high / scale) < confidence:
        high *= 2
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if weights @ gammainc(shape, middle / scale) < confidence:
            low = middle
        else:
            high = middle
    return high
