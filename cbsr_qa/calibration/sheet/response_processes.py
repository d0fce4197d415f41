"""Gaussian processes of a sheet's response, for a grid of their hyperparameters at once.

Each has a mean of unknown coefficients, which is integrated out, and a marginal likelihood (Rasmussen & Williams
2006, 2.7 and 5.2).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cbsr_qa.domain.numbers import Array

#: Relative deviations of the response over the sheet.
_DEVIATIONS: Final = np.array([0.01, 0.02, 0.035, 0.06, 0.1, 0.15, 0.22, 0.32, 0.45])
#: Scale of the prior of the scatter (exponential), and of the deviation (half Cauchy): typical repeatability of
#: presses, and typical variation of moulded sheets. Chosen by us.
USUAL_SCATTER: Final = 0.02
USUAL_DEVIATION: Final = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class CombinedLoads:
    """Loads at p places, combined (exactly) if pressed at the same place.

    Parameters
    ----------
    root_weight : (p,) square root of the loads' summed weights 1/variance.
    scaled : (p, k + 1) weighted means of the mean's k columns and of the values, times ``root_weight``.
    within : (k + 1, k + 1) weighted products of the deviations from those means.
    log_variance : sum over the loads.
    known : (k, k) prior precision of the mean's coefficients.
    """

    root_weight: Array
    scaled: Array
    within: Array
    log_variance: float
    known: Array


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """The process with one choice of its hyperparameters.

    Parameters
    ----------
    smooth : True for a Gaussian covariance; False for Matérn 5/2.
    root_weight : (p,) root of the weight of each place, the same as in the data.
    root : (p, p) Cholesky factor of one plus the process's covariance times the weights.
    data, drift : (p,), (p, k) data and columns of the mean, weighted and solved with ``root``.
    mean, mean_root : (k,) coefficients of the mean and the Cholesky factor (k, k) of their precision.
    """

    smooth: bool
    length_mm: float
    deviation: float
    scatter: float
    root_weight: Array
    root: Array
    data: Array
    drift: Array
    mean: Array
    mean_root: Array

    def solve_kernel(self, kernel: Array) -> Array:
        return solve_triangular(self.root, self.root_weight[:, None] * kernel, lower=True)


@dataclass(frozen=True, slots=True, eq=False)
class ProcessFamily:
    """Processes of one kind and length: d deviations by s scatters of them.

    Parameters
    ----------
    scatter, root_weight : (s,) scatters and (s, p) root weights of the members.
    root, solved, mean, mean_root : (d, s, ...) matrices of the members, ``solved`` being ``drift`` and ``data`` side
        by side.
    score : (d, s) logarithms of the members' weights: marginal likelihood times prior.
    """

    smooth: bool
    length_mm: float
    scatter: Array
    root_weight: Array
    root: Array
    solved: Array
    mean: Array
    mean_root: Array
    score: Array

    def member(self, d: int, s: int) -> Process:
        solved = self.solved[d, s]
        hyperparameters = (
            self.smooth,
            self.length_mm,
            float(_DEVIATIONS[d]),
            float(self.scatter[s]),
            self.root_weight[s],
        )
        return Process(
            *hyperparameters, self.root[d, s], solved[:, -1], solved[:, :-1], self.mean[d, s], self.mean_root[d, s]
        )


def predict_processes(members: Sequence[Process], kernel: Array) -> tuple[Array, Array]:
    """Means and variances (m, n) of members with one kernel (p, n), at once, as a map may have hundreds of them."""
    whitened_kernel, spread = _whiten(members, kernel)
    data, drift, mean = (
        np.array([getattr(member, name) for member in members]) for name in ("data", "drift", "mean")
    )
    centred_data = data - (drift @ mean[:, :, None])[..., 0]
    means = mean[:, :1] + (centred_data[:, None] @ whitened_kernel)[:, 0]
    prior = np.array([member.deviation for member in members])[:, None] ** 2
    return means, prior - (whitened_kernel**2).sum(axis=1) + (spread**2).sum(axis=1)


def covary_processes(members: Sequence[Process], kernels: tuple[Array, Array], mutual: Array) -> Array:
    """Posterior covariances (m, n, t) of members with one kernel, of n places with t others.

    Parameters
    ----------
    kernels : (p, n) and (p, t) correlations of the loads' places with both.
    mutual : (n, t) correlations of both.
    """
    (whitened, spread), (whitened_other, spread_other) = (_whiten(members, kernel) for kernel in kernels)
    prior = np.array([member.deviation for member in members])[:, None, None] ** 2
    covariance: Array = (
        prior * mutual - np.swapaxes(whitened, 1, 2) @ whitened_other + np.swapaxes(spread, 1, 2) @ spread_other
    )
    return covariance


def _whiten(members: Sequence[Process], kernel: Array) -> tuple[Array, Array]:
    """Kernel (m, p, n) and the mean's columns there less what the loads say of them (m, k, n), solved."""
    deviation, root_weight, root, drift, mean_root = (
        np.array([getattr(member, name) for member in members])
        for name in ("deviation", "root_weight", "root", "drift", "mean_root")
    )
    prior = deviation[:, None] ** 2
    whitened_kernel = np.linalg.solve(root, prior[:, None] * root_weight[:, :, None] * kernel)
    mean_residual = -np.swapaxes(drift, 1, 2) @ whitened_kernel
    mean_residual[:, 0] += 1
    return whitened_kernel, np.linalg.solve(mean_root, mean_residual)


def combine_loads(which: NDArray[np.intp], columns: Array, variance: Array, known: Array) -> CombinedLoads:
    """Combine loads of one place: their weighted mean, and the deviations from it, centred before squaring.

    Several observations at a place equal one with the summed weight, except for their scatter about their mean; with
    it likelihoods and predictions are those of all loads, at the cost of the places.
    """
    weight = 1 / variance
    total = np.bincount(which, weight)
    means = np.column_stack([np.bincount(which, weight * column) / total for column in columns.T])
    residual = (columns - means[which]) * np.sqrt(weight)[:, None]
    root_weight = np.sqrt(total)
    return CombinedLoads(
        root_weight, means * root_weight[:, None], residual.T @ residual, float(np.log(variance).sum()), known
    )


def condition_family(data: dict[float, CombinedLoads], alike: Array, smooth: bool, length_mm: float) -> ProcessFamily:
    """Processes of correlations (p, p), the mean integrated out."""
    scatter = np.array(list(data))
    root_weight = np.array([group.root_weight for group in data.values()])
    weighted = root_weight[:, :, None] * alike * root_weight[:, None, :]
    scaled = np.array([group.scaled for group in data.values()])
    # No eigenvalue below one: nearly coinciding places, and loads without noise, do no harm.
    root, solved = _solve(np.eye(len(alike)) + _DEVIATIONS[:, None, None, None] ** 2 * weighted, scaled)
    products = np.swapaxes(solved, -1, -2) @ solved + np.array([group.within for group in data.values()])
    prior_precision = next(iter(data.values())).known
    mean_root = np.linalg.cholesky(products[..., :-1, :-1] + prior_precision)
    pull = np.linalg.solve(mean_root, products[..., :-1, -1:])
    mean = np.linalg.solve(np.swapaxes(mean_root, -1, -2), pull)[..., 0]
    misfit = products[..., -1, -1] - (pull**2).sum(axis=(-1, -2))
    determinants = (
        np.array([group.log_variance for group in data.values()]) / 2 + _log_root(root) + _log_root(mean_root)
    )
    # The grid is even in the logarithm of the deviation, so its density includes the deviation as a factor.
    prior = np.log(_DEVIATIONS) - np.log1p((_DEVIATIONS / USUAL_DEVIATION) ** 2)
    score = -misfit / 2 - determinants + prior[:, None] - scatter / USUAL_SCATTER
    return ProcessFamily(smooth, length_mm, scatter, root_weight, root, solved, mean, mean_root, score)


def _solve(matrices: Array, right: Array) -> tuple[Array, Array]:
    """Cholesky factors L of (..., p, p) matrices of no eigenvalue below one, and L⁻¹ B for B (..., p, k)."""
    p, k = right.shape[-2:]
    augmented = np.zeros((*matrices.shape[:-2], p + k, p + k))
    augmented[..., :p, :p] = matrices
    augmented[..., p:, :p] = np.swapaxes(right, -1, -2)
    below = np.arange(p, p + k)
    augmented[..., below, below] = 1 + 2 * (right**2).sum(axis=(-1, -2))[..., None]
    root = np.linalg.cholesky(augmented)  # only the lower half is read
    return root[..., :p, :p], np.swapaxes(root[..., p:, :p], -1, -2)


def _log_root(roots: Array) -> Array:
    logs: Array = np.log(np.diagonal(roots, axis1=-2, axis2=-1)).sum(axis=-1)
    return logs


def compute_covariance(one_mm: Array, other_mm: Array, length_mm: float, smooth: bool) -> Array:
    """Covariance (p, n) of places (p, 2) and (n, 2), of unit deviation: Gaussian if smooth, else Matérn 5/2."""
    distance = measure_distances(one_mm, other_mm) / length_mm
    if smooth:
        gaussian: Array = np.exp(-(distance**2) / 2)
        return gaussian
    scaled_distance = np.sqrt(5) * distance
    matern: Array = (1 + scaled_distance + scaled_distance**2 / 3) * np.exp(-scaled_distance)
    return matern


def measure_distances(one_mm: Array, other_mm: Array) -> Array:
    """Distances (p, n) of places (p, 2) from places (n, 2)."""
    distances: Array = np.sqrt(((one_mm[:, None] - other_mm[None]) ** 2).sum(axis=2))
    return distances
