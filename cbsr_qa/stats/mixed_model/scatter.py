"""Groups whose sensors scatter differently: V_g = s_g²σ²(I + θ11ᵀ) for the sensors of group g.

**Test.** Brown and Forsythe (1974): an analysis of variance of the distances of sensors' mean residuals from their
group's median, which neither a skew distribution nor single outliers disturb much.

**If it is shown**, runs of a group are weighted by 1/s_g, with s_g² the mean square of its sensors' residuals over
the share of the degrees of freedom that the effects leave. The variance of a contrast is then a sum v = Σ v_g over
groups, with Welch and Satterthwaite's degrees of freedom, v² / Σ v_g²/f_g.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy import sparse, stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossings import IntArray
from cbsr_qa.stats.mixed_model.model import Fit, Model
from cbsr_qa.stats.mixed_model.reml import random_effect_sums, small_sample, variance_ratio

#: Level of the test.
LEVEL = 0.01
#: Fewest sensors of a group that tell how its sensors scatter.
_FEWEST_SENSORS = 3
#: Rounds of weights and effects.
_ROUNDS = 3
#: Least deviation of a group relative to the others: sensors that read the same would weigh without bound.
_LEAST_DEVIATION = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class GroupVariances:
    """Basis of the degrees of freedom of contrasts of groups that scatter differently.

    Parameters
    ----------
    shares : (g, p, p) covariance of the effects over σ², by the group whose scatter it comes from.
    freedoms : (g,) degrees of freedom of the groups' variances.
    """

    shares: Array
    freedoms: Array

    def freedom(self, contrast: Array) -> float:
        """Return Welch and Satterthwaite's degrees of freedom of one contrast (p,)."""
        variances = np.einsum("i,gij,j->g", contrast, self.shares, contrast)
        return float(variances.sum() ** 2 / np.sum(variances**2 / self.freedoms))


def fit_scatter(alike: Fit, values: Array) -> Fit:
    """Return the fit with a deviation of each group; the same fit where the test does not show that they differ.

    Parameters
    ----------
    alike : fit that takes groups to scatter alike.
    values : (N,) of the runs of ``alike.design``.
    """
    if scatter_p_value(alike, values) >= LEVEL:
        return alike
    weighted = alike
    for _ in range(_ROUNDS):
        weighted = _fit_weighted(alike, values, _deviations(weighted, values))
    return weighted


def scatter_p_value(alike: Fit, values: Array) -> float:
    """Return Brown and Forsythe's p value of equal scatter of sensors; 1 where fewer than two groups tell."""
    means, group = _sensor_residuals(alike, values)
    distances = [np.abs(of_group - np.median(of_group)) for of_group in _by_group(means, group, alike)]
    telling = [distance for distance in distances if len(distance) >= _FEWEST_SENSORS]
    if len(telling) < 2 or all(np.ptp(distance) == 0 for distance in telling):
        return 1.0
    return float(stats.f_oneway(*telling).pvalue)


def _sensor_residuals(fitted: Fit, values: Array) -> tuple[Array, IntArray]:
    """Mean residual of each sensor in each group, and its group."""
    design = fitted.design
    residuals = values - design.columns() @ fitted.effects[design.independent_columns()]
    keys = design.group * len(design.sensors) + design.sensor
    unique_keys, place = np.unique(keys, return_inverse=True)
    means: Array = np.bincount(place, residuals) / np.bincount(place)
    return means, (unique_keys // len(design.sensors)).astype(np.intp)


def _by_group(means: Array, group: IntArray, fitted: Fit) -> list[Array]:
    return [means[group == index] for index in range(len(fitted.design.groups))]


def _deviations(fitted: Fit, values: Array) -> Array:
    """Return s of each group relative to their root mean square; that of small groups is taken as 1."""
    means, group = _sensor_residuals(fitted, values)
    effects = int(fitted.design.independent_columns().sum())
    kept_share = max(1 - effects / len(means), 1 / len(means))
    squares = np.array(
        [
            float(np.mean(of_group**2)) / kept_share if len(of_group) >= _FEWEST_SENSORS else np.nan
            for of_group in _by_group(means, group, fitted)
        ]
    )
    relative = np.sqrt(squares / np.nanmean(squares))
    return np.where(np.isnan(relative), 1.0, np.maximum(relative, _LEAST_DEVIATION))


def _fit_weighted(alike: Fit, values: Array, deviations: Array) -> Fit:
    """Fit by generalised least squares with the groups' deviations (g,) relative to σ."""
    design = alike.design
    residuals = values - design.columns() @ alike.effects[design.independent_columns()]
    scale = float(np.abs(residuals).max())
    weights = 1 / deviations[design.group]
    columns = (sparse.diags_array(weights) @ design.columns()).tocsr()
    response = weights * residuals / scale
    sums = random_effect_sums(columns, response, design.sensor)
    is_mixed = alike.model is Model.MIXED
    ratio = variance_ratio(sums).value if is_mixed else 0.0
    products = sums.within + sums.products(ratio)
    inverse = np.asarray(np.linalg.inv(products[:-1, :-1]), dtype=np.float64)
    inner = inverse @ products[:-1, -1]
    variance = scale**2 * float(products[-1, -1] - products[:-1, -1] @ inner) / (sums.runs - sums.columns)
    effects = alike.effects.copy()
    effects[design.independent_columns()] += scale * inner
    shares = []
    for index in range(len(design.groups)):
        is_member = design.group == index
        sensor = np.unique(design.sensor[is_member], return_inverse=True)[1].astype(np.intp)
        part = random_effect_sums(columns[np.flatnonzero(is_member)], response[is_member], sensor)
        shares.append(inverse @ (part.within + part.products(ratio))[:-1, :-1] @ inverse)
    sensors = np.array([len(np.unique(design.sensor[design.group == index])) for index in range(len(design.groups))])
    freedoms = np.maximum(sensors * (1 - sums.columns / sensors.sum()), 1.0)
    covariance = small_sample(sums, ratio).adjusted if is_mixed else inverse
    deviation = sqrt(variance)
    return replace(
        alike,
        effects=effects,
        run_deviation=deviation,
        sensor_deviation=deviation * sqrt(ratio) if is_mixed else None,
        covariance=variance * covariance,
        small=GroupVariances(np.stack(shares), freedoms),
        scatter=deviations,
    )
