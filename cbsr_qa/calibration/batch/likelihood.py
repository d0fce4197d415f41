"""Marginal likelihood of a batch's loads for many choices of the hyperparameters at once.

The logarithm of the response of sensor s at place x is y = μ + m_s + c(x) + d_s(x) + b β_s + ε: a common level and
map, a level and a map of its own, a wrong intercept, noise. c and d_s are Gaussian processes of one correlation k and
the variances ω², ϖ²; m_s ~ N(0, τ²); μ is flat. Given c at the p places of the batch the sensors are independent,
so that the covariance of all loads is never formed: the precision of c gets a term from each sensor, A_s⁻¹ with A_s =
ϖ² K_s + V_s + τ² 1 1ᵀ + β² b bᵀ. In the eigenvectors of V^−½ K V^−½ it is diagonal for every ϖ; the last two terms
are rank-one updates (Sherman-Morrison).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Final

import numpy as np

from cbsr_qa.calibration.batch.loads import BatchLoads
from cbsr_qa.domain.numbers import Array, Indices

#: Largest number of matrix elements that are held at once.
_MOST_ELEMENTS: Final = 4_000_000
#: Least eigenvalue of a matrix of weights, scaled to a unit diagonal, that is not rounding.
_LEAST_VALUE: Final = 1e-15
#: Number of kinds, lengths and scatters whose rows are held.
_MOST_KINDS: Final = 128


@dataclass(frozen=True, slots=True, order=True)
class Hyperparameters:
    """One choice of them.

    Parameters
    ----------
    smooth : True for a Gaussian covariance; False for Matérn 3/2.
    scatter : relative scatter of single loads beyond their noise.
    own, common : deviations ϖ and ω of the maps of single sensors, and of the map they have in common.
    level : deviation τ of the sensors' levels.
    """

    smooth: bool
    length_mm: float
    scatter: float
    own: float
    common: float
    level: float

    @property
    def kind(self) -> tuple[bool, float, float]:
        """Kind and length of the correlation, and scatter: what choices share whose loads are turned alike."""
        return self.smooth, self.length_mm, self.scatter

    @property
    def rho(self) -> float:
        """Share of the variance of maps that two sensors have in common."""
        return self.common**2 / (self.common**2 + self.own**2)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """The batch's loads for one correlation and scatter, whitened and turned into the eigenvectors of each sensor.

    Parameters
    ----------
    values : (N,) eigenvalues of all sensors.
    columns : (N, r + 3) basis of the common map, ones, bend and values.
    begins : (S,) first row of each sensor.
    within : (S, 3, 3) products of deviations of loads from the mean of their place.
    bend_variance : (S,) prior variances.
    log_variance : sum over all loads.
    """

    values: Array
    columns: Array
    begins: Indices
    within: Array
    bend_variance: Array
    log_variance: float


class BatchLikelihood:
    """Likelihood of the loads of a batch."""

    def __init__(self, loads: BatchLoads) -> None:
        self.loads = loads
        self._rows = lru_cache(maxsize=_MOST_KINDS)(self._turn)

    def compute(self, choices: Sequence[Hyperparameters]) -> Array:
        """Logarithm of the marginal likelihood of every choice, (m,), the level μ integrated out."""
        result = np.empty(len(choices))
        order = sorted(range(len(choices)), key=lambda number: choices[number])
        for kind, group in groupby(order, key=lambda number: choices[number].kind):
            rows, numbers = self._rows(*kind), list(group)
            size = max(1, _MOST_ELEMENTS // max(rows.columns.size, rows.columns.shape[1] ** 2))
            for first in range(0, len(numbers), size):
                chunk = numbers[first : first + size]
                result[chunk] = _score(rows, [choices[number] for number in chunk])
        count = sum(len(sensor.log_response) for sensor in self.loads.sensors)
        result -= (count - 1) / 2 * np.log(2 * np.pi)
        return result

    def compute_precision(self, choices: Sequence[Hyperparameters]) -> tuple[Array, Array]:
        """What the loads say about the common map, by choices of one kind, length and scatter.

        Returns
        -------
        G (m, p, p) and q (m, p): with k the correlations of any places with those of the batch, and the level known
        and zero, the common map has the mean ω² k q and the covariance ω² k(x, x') − ω⁴ k G kᵀ.
        """
        p, common = len(self.loads.places_mm), np.array([choice.common for choice in choices])[:, None, None]
        _, products = _gather(self._turn(*choices[0].kind, np.eye(p)), choices)
        weight, pull = products[:, :p, :p], products[:, :p, p + 1]
        # G = R (I + ω² Rᵀ K R)⁻¹ Rᵀ with R Rᵀ the loads' weight: nothing cancels where they say all there is to know.
        size = np.sqrt(np.diagonal(weight, axis1=1, axis2=2))
        values, vectors = np.linalg.eigh(weight / (size[:, :, None] * size[:, None, :]))
        values = np.sqrt(np.maximum(values, _LEAST_VALUE))
        root = size[:, :, None] * vectors * values[:, None, :]
        seen = (np.swapaxes(vectors, 1, 2) @ (pull / size)[:, :, None]) / values[:, :, None]
        inner = np.eye(p) + common**2 * np.swapaxes(root, 1, 2) @ self.loads.factor(*choices[0].kind[:2])[0] @ root
        solved = root @ np.linalg.solve(inner, np.concatenate([np.swapaxes(root, 1, 2), seen], axis=2))
        return solved[:, :, :-1], solved[:, :, -1]

    def _turn(self, smooth: bool, length_mm: float, scatter: float, basis: Array | None = None) -> _Rows:
        """Whiten and turn the rows of a basis (p, r) of the common map, L by default, at each sensor's places."""
        loads = self.loads
        alike, root = loads.factor(smooth, length_mm)
        basis = root if basis is None else basis
        values, columns, combined = [], [], loads.combine(scatter)
        for group, which in zip(combined, loads.which, strict=True):
            weighted = group.root_weight[:, None] * alike[np.ix_(which, which)] * group.root_weight
            own_values, vectors = np.linalg.eigh(weighted)
            values.append(np.maximum(own_values, 0.0))
            columns.append(vectors.T @ np.column_stack([group.root_weight[:, None] * basis[which], group.scaled]))
        lengths = [len(which) for which in loads.which]
        return _Rows(
            np.concatenate(values),
            np.concatenate(columns),
            np.cumsum([0, *lengths[:-1]]),
            np.array([group.within for group in combined]),
            np.array([0.0 if sensor.bend is None else sensor.bend_stderr**2 for sensor in loads.sensors]),
            sum(group.log_variance for group in combined),
        )


def _gather(rows: _Rows, choices: Sequence[Hyperparameters]) -> tuple[Array, Array]:
    """Log determinants (m,) of the sensors' covariances, and products (m, r + 2, r + 2) of basis, ones and values."""
    owns, which_own = np.unique([choice.own for choice in choices], return_inverse=True)
    diagonal = 1 + owns[:, None] ** 2 * rows.values
    weighted = rows.columns / diagonal[:, :, None]
    products = (np.swapaxes(weighted, 1, 2) @ rows.columns)[which_own]
    products[:, -3:, -3:] += rows.within.sum(axis=0)
    by_ones, by_bend = (
        np.add.reduceat(weighted * rows.columns[:, -which, None], rows.begins, axis=1) for which in (3, 2)
    )
    by_bend[:, :, -3:] += rows.within[:, 1]
    by_ones, by_bend = by_ones[which_own], by_bend[which_own]
    level_variance = np.array([choice.level**2 for choice in choices])[:, None]
    log_determinant = (np.log(diagonal).sum(axis=1) + rows.log_variance)[which_own]
    level_gain = 1 + level_variance * by_ones[:, :, -3]
    share = level_variance / level_gain
    by_bend = by_bend - (share * by_bend[:, :, -3])[:, :, None] * by_ones
    bend_gain = 1 + rows.bend_variance * by_bend[:, :, -2]
    products -= np.swapaxes(by_ones, 1, 2) @ (share[:, :, None] * by_ones)
    products -= np.swapaxes(by_bend, 1, 2) @ ((rows.bend_variance / bend_gain)[:, :, None] * by_bend)
    log_determinant += np.log(level_gain).sum(axis=1) + np.log(bend_gain).sum(axis=1)
    kept = np.r_[: products.shape[1] - 2, products.shape[1] - 1]
    return log_determinant, products[:, kept[:, None], kept]


def _score(rows: _Rows, choices: Sequence[Hyperparameters]) -> Array:
    log_determinant, products = _gather(rows, choices)
    common = np.array([choice.common for choice in choices])[:, None, None]
    inner = np.eye(products.shape[1] - 2) + common**2 * products[:, :-2, :-2]
    root = np.linalg.cholesky(inner)
    pull = np.linalg.solve(root, common * products[:, :-2, -2:])
    left = products[:, -2:, -2:] - np.swapaxes(pull, 1, 2) @ pull
    misfit = left[:, 1, 1] - left[:, 0, 1] ** 2 / left[:, 0, 0]
    log_determinant += 2 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) + np.log(left[:, 0, 0])
    score: Array = -(misfit + log_determinant) / 2
    return score
