"""Groups whose sensors scatter differently: V = σ²I + τ_g²11ᵀ for the runs of a sensor of group g.

**Test.** Brown and Forsythe (1974): an analysis of variance of the distances of sensors' mean residuals from their
group's median, which neither a skew distribution nor single outliers disturb much.

**If it is shown**, σ² is that of the runs of one sensor, and σ²/n + τ_g² of a group is the mean square of its
sensors' mean residuals over the share of the degrees of freedom that the effects leave. The variance of a contrast
is a sum over groups, and over the part within sensors, with Welch and Satterthwaite's degrees of freedom v²/Σ
v_g²/f_g. Where no sensor has two runs, σ² is part of τ_g².
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossings import Crossing, IntArray, SparseArray
from cbsr_qa.stats.mixed_model.model import Fit, Model, Scatter
from cbsr_qa.stats.mixed_model.reml import random_effect_sums

#: Significance level of the test of equal scatter.
LEVEL = 0.01
#: Least number of sensors of a group from which its scatter is estimated.
_MIN_SENSORS = 3
#: Number of times that variances and effects are estimated from each other.
_ITERATIONS = 3
#: Least variance of a group relative to the mean of all: identical sensors would have infinite weight.
_MIN_RELATIVE_VARIANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class GroupVariances:
    """Basis of the degrees of freedom of contrasts of groups that scatter differently.

    Parameters
    ----------
    shares : (g + 1, p, p) parts of the effects' covariance, from the scatter of each group and, last, within sensors.
    freedoms : (g + 1,) degrees of freedom of the variance behind each part.
    """

    shares: Array
    freedoms: Array

    def freedom(self, contrast: Array) -> float:
        """Return Welch and Satterthwaite's degrees of freedom of one contrast (p,)."""
        variances = np.einsum("i,gij,j->g", contrast, self.shares, contrast)
        return float(variances.sum() ** 2 / np.sum(variances**2 / self.freedoms))


def fit_scatter(alike: Fit, values: Array) -> Fit:
    """Return the fit with a variance of sensors for each group; the same fit if the test does not show a difference.

    Parameters
    ----------
    alike : fit with the same scatter in all groups.
    values : (N,) of the runs of ``alike.design``.
    """
    if scatter_p_value(alike, values) >= LEVEL:
        return alike
    residuals = values - alike.design.columns() @ alike.effects[alike.design.independent_columns()]
    scale = float(np.abs(residuals).max())
    changes = np.zeros(int(alike.design.independent_columns().sum()))
    for _ in range(_ITERATIONS):
        scatter = _estimate_variances(alike, residuals / scale - alike.design.columns() @ changes)
        shares = scatter_products(alike.design, alike.design.columns(), residuals / scale, scatter)
        products = shares.sum(axis=0)
        covariance = np.asarray(np.linalg.inv(products[:-1, :-1]), dtype=np.float64)
        changes = covariance @ products[:-1, -1]
    effects = alike.effects.copy()
    effects[alike.design.independent_columns()] += scale * changes
    return replace(
        alike,
        effects=effects,
        covariance=scale**2 * covariance,
        small=GroupVariances(covariance @ shares[:, :-1, :-1] @ covariance, _count_freedoms(alike.design)),
        scatter=scatter.scale(scale),
    )


def scatter_p_value(alike: Fit, values: Array) -> float:
    """Return Brown and Forsythe's p value of equal scatter of sensors.

    1 if fewer than two groups have enough sensors, or no group's distances from its median differ.
    """
    residuals = values - alike.design.columns() @ alike.effects[alike.design.independent_columns()]
    means, _, group = _average_by_sensor(alike.design, residuals)
    distances = [
        np.abs(means[group == index] - np.median(means[group == index]))
        for index in range(len(alike.design.groups))
        if np.sum(group == index) >= _MIN_SENSORS
    ]
    if len(distances) < 2 or all(np.ptp(distance) == 0 for distance in distances):
        return 1.0
    return float(stats.f_oneway(*distances).pvalue)


def scatter_products(design: Crossing, columns: SparseArray, response: Array, scatter: Scatter) -> Array:
    """Return [X y]ᵀV⁻¹[X y] as parts (g + 1, p + 1, p + 1): between the sensors of each group, and within sensors.

    Parameters
    ----------
    columns : (N, p) sparse array, X.
    response : (N,) y.
    """
    width = columns.shape[1] + 1
    parts = np.zeros((len(design.groups) + 1, width, width))
    run_variance = scatter.run_deviation**2
    for index, sensor_deviation in enumerate(scatter.sensor_deviations.tolist()):
        members = np.flatnonzero(design.group == index)
        sensor = np.unique(design.sensor[members], return_inverse=True)[1].astype(np.intp)
        sums = random_effect_sums(columns[members], response[members], sensor)
        weights = sums.sizes / (run_variance + sums.sizes * sensor_deviation**2)
        parts[index] = np.tensordot(weights, sums.between, axes=1)
        if run_variance:
            parts[-1] += sums.within / run_variance
    return parts


def _average_by_sensor(design: Crossing, residuals: Array) -> tuple[Array, IntArray, IntArray]:
    """Return the mean residual of each sensor in each group, its number of runs, and its group."""
    keys, place = np.unique(design.group * len(design.sensors) + design.sensor, return_inverse=True)
    counts = np.bincount(place)
    means: Array = np.bincount(place, residuals) / counts
    return means, counts, (keys // len(design.sensors)).astype(np.intp)


def _estimate_variances(alike: Fit, residuals: Array) -> Scatter:
    """Estimate the variances from residuals (N,) of the current effects; small groups get the mean of the others."""
    design = alike.design
    means, counts, group = _average_by_sensor(design, residuals)
    run_variance = 0.0
    if alike.model is Model.MIXED:
        sums = random_effect_sums(design.columns(), residuals, design.sensor)
        run_variance = sums.within_rest() / (sums.runs - sums.total_sensors - sums.within_rank())
    kept_share = max(1 - int(design.independent_columns().sum()) / len(means), 1 / len(means))
    variances = np.full(len(design.groups), np.nan)
    for index in range(len(design.groups)):
        members = group == index
        if np.sum(members) >= _MIN_SENSORS:
            mean_square = float(np.mean(means[members] ** 2)) / kept_share
            variances[index] = mean_square - run_variance * float(np.mean(1 / counts[members]))
    typical = max(float(np.nanmean(variances)), _MIN_RELATIVE_VARIANCE)
    variances[np.isnan(variances)] = typical
    return Scatter(sqrt(run_variance), np.sqrt(np.maximum(variances, _MIN_RELATIVE_VARIANCE * typical)))


def _count_freedoms(design: Crossing) -> Array:
    """Return the degrees of freedom (g + 1,) of the variance of each group's sensors, and of runs of one sensor."""
    sensors = np.array([len(np.unique(design.sensor[design.group == index])) for index in range(len(design.groups))])
    kept_share = 1 - int(design.independent_columns().sum()) / int(sensors.sum())
    within = len(design.group) - len(design.sensors)
    freedoms: Array = np.maximum(np.append(sensors * kept_share, within), 1.0)
    return freedoms
