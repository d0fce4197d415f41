"""Both estimates of a place mixed, with a covariance whose regions have the stated coverage on left-out presses."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import Bounds, minimize
from scipy.special import fdtri, gammaincinv

from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.results.learned_place import PlaceMixture

#: Nominal coverage of the regions.
LEVELS: Final = (0.68, 0.95)
_FOLDS: Final = 5
#: Prior share, and the number of presses that the prior counts as.
_PRIOR_SHARE: Final = 0.4
_PRIOR_PRESSES: Final = 10.0
#: Limit of errors in the share, in units of their median; spiky frames have larger ones.
_LARGE: Final = 3.0
#: Largest distance of the logarithm of a weight from its initial value: beyond, covariances of rank one have no
#: inverse in floats.
_FURTHEST: Final = 10.0


def mix_places(mixture: PlaceMixture, first: Array, second: Array, second_covariance: Array) -> tuple[Array, Array]:
    """Mix places (n, 2) and (n, 2); returns places (n, 2) and covariances Σ (n, 2, 2)."""
    difference = second - first
    return first + mixture.share * difference, _covariance(mixture.spread, difference, second_covariance)


def learn_mixture(
    first: Array,
    second: Array,
    second_covariance: Array,
    places_mm: Array,
    visits: Indices,
    levels: Sequence[float] = LEVELS,
) -> PlaceMixture:
    """Learn a mixture from both estimates (n, 2) of left-out presses, and their places (n, 2).

    Its quantiles, one per level, come from every press under a mixture of those at other places, so that no place
    judges itself; ``visits`` (n,) has one number per place.
    """
    columns = first, second, second_covariance, places_mm
    ratio, numbers = np.empty(len(places_mm)), np.unique(visits, return_inverse=True)[1]
    for number in range(min(_FOLDS, int(numbers.max()) + 1)):
        held_out_mask = numbers % _FOLDS == number
        share, spread = _fit_mixture(*(column[np.logical_not(held_out_mask)] for column in columns))
        mixture = PlaceMixture(share, spread, np.zeros(len(LEVELS)))
        mixed_mm, covariance = mix_places(
            mixture, first[held_out_mask], second[held_out_mask], second_covariance[held_out_mask]
        )
        ratio[held_out_mask] = mahalanobis(places_mm[held_out_mask] - mixed_mm, covariance)
    share, spread = _fit_mixture(*columns)
    return PlaceMixture(share, spread, np.array([quantile(ratio, level, visits) for level in levels]))


def _fit_mixture(first: Array, second: Array, second_covariance: Array, places_mm: Array) -> tuple[float, Array]:
    share, difference = _share(first, second, places_mm), second - first
    return share, _spread(places_mm - first - share * difference, difference, second_covariance)


def mahalanobis(error: Array, covariance: Array) -> Array:
    """Return dᵀΣ⁻¹d (n,) of errors (n, 2) with covariances (n, 2, 2)."""
    squares: Array = np.einsum("na,nab,nb->n", error, _invert(covariance)[0], error)
    return squares


def quantile(ratio: Array, level: float, visits: Indices | None = None) -> float:
    """Quantile of dᵀΣ⁻¹d that covers the next press at a new place with the probability ``level``.

    Split conformal (Lei et al. 2018, Eq. 3), between order statistics. With too few places for that level, from the
    mean by Fisher's F with 2 and 2n degrees of freedom, as for normal errors with a variance estimated from n places.

    Parameters
    ----------
    ratio : (k,) squared errors dᵀΣ⁻¹d of left-out presses.
    visits : (k,) one number per place, by default one press each. Every place counts as one, since its presses err
        alike (Lee, Barber & Willett 2025, hierarchical conformal prediction).
    """
    place_index = np.unique(np.arange(len(ratio)) if visits is None else visits, return_inverse=True)[1]
    presses = np.bincount(place_index)
    weight = 1 / (len(presses) * presses[place_index])
    if level * (len(presses) + 1) <= len(presses) - 0.5:
        order = np.argsort(ratio)
        return float(np.interp(level * (1 + 1 / len(presses)), np.cumsum(weight[order]), ratio[order]))
    return max(float(weight @ ratio * fdtri(2, 2 * len(presses), level)), float(ratio.max()))


def widen_for_few_presses(count: int) -> Array:
    """Factors (2,) by which regions of normal errors grow if few presses determine their variance."""
    levels = np.array(LEVELS)
    # Quantiles of F, and of chi-squared per degree of freedom. Loading scipy.stats for them would slow every run.
    return np.asarray(fdtri(2, 2 * count, levels) / gammaincinv(1, levels))


def _share(first: Array, second: Array, places_mm: Array) -> float:
    difference_mm, error = second - first, places_mm - first
    size = np.linalg.norm(error - 0.5 * difference_mm, axis=1)
    limit = _LARGE * float(np.median(size))
    weight = 1 / np.maximum(1.0, size / max(limit, np.finfo(float).tiny)) ** 2
    power = weight * (difference_mm**2).sum(axis=1)
    prior = _PRIOR_PRESSES * float(np.median(power))
    share = ((weight[:, None] * difference_mm * error).sum() + prior * _PRIOR_SHARE) / max(
        power.sum() + prior, np.finfo(float).tiny
    )
    return float(np.clip(share, 0.0, 1.0))


def _spread(error: Array, apart: Array, second_covariance: Array) -> Array:
    """Weights (3,) of largest normal likelihood, in logarithms about a weak prior."""
    unit_covariances = np.stack([_covariance(each, apart, second_covariance) for each in np.eye(3)])
    start = np.full(3, np.log(0.3))
    start[1] = np.log(max(float(np.median((error**2).sum(axis=1))), 1e-6) / 4)

    def surprise(logs: Array) -> tuple[float, Array]:
        weights = np.exp(logs)
        inverse, determinant = _invert(np.tensordot(weights, unit_covariances, axes=1))
        turned = np.einsum("nab,nb->na", inverse, error)
        value = np.einsum("na,na->", turned, error) + np.log(determinant).sum()
        slope = np.einsum("knab,nab->k", unit_covariances, inverse - turned[:, :, None] * turned[:, None, :])
        deviation = logs - start
        return float(value + 0.1 * deviation @ deviation), weights * slope + 0.2 * deviation

    bounds = Bounds(start - _FURTHEST, start + _FURTHEST)
    return np.exp(minimize(surprise, start, jac=True, method="L-BFGS-B", bounds=bounds).x)


def _invert(covariance: Array) -> tuple[Array, Array]:
    """Inverses (n, 2, 2) and determinants (n,) of covariances (n, 2, 2)."""
    determinant = covariance[:, 0, 0] * covariance[:, 1, 1] - covariance[:, 0, 1] ** 2
    adjugate = covariance[:, ::-1, ::-1] * [[1, -1], [-1, 1]]
    return adjugate / determinant[:, None, None], determinant


def _covariance(spread: Array, apart: Array, second_covariance: Array) -> Array:
    outer = apart[:, :, None] * apart[:, None, :]
    covariance: Array = spread[0] * second_covariance + spread[1] * np.eye(2) + spread[2] * outer
    return covariance
