"""What a model with a random sensor needs of its data: cross-products within sensors and between their means.

A sensor's n runs have the covariance σ²(I + θ 11ᵀ), whose inverse is I − 11ᵀ/n + (1/(1 + nθ)) 11ᵀ/n over σ². So for
Z = [X y] and H = V/σ²,

    ZᵀH⁻¹Z = W + Σ_n n h_n B_n,   h_n = 1/(1 + nθ),

with W the cross-products of deviations from the sensors' means and B_n those of the means of sensors with n runs: the
sensor effect is eliminated, and whatever the number of sensors one evaluation costs a few p × p matrices. Nothing is
subtracted, so that no digits are lost at any θ.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossing import IntArray, SparseArray


@dataclass(frozen=True, slots=True, eq=False)
class SensorSums:
    """Sums over sensors, Z having p columns of X and the response as the last.

    Parameters
    ----------
    runs : N.
    sizes : (m,) distinct numbers n of runs a sensor.
    sensors : (m,) how many sensors have as many.
    within : (p + 1, p + 1), W.
    between : (m, p + 1, p + 1), B_n.
    """

    runs: int
    sizes: Array
    sensors: Array
    within: Array
    between: Array

    @property
    def columns(self) -> int:
        """Return p."""
        return len(self.within) - 1

    def products(self, ratio: Array | float, power: int = 1, times: int = 0) -> Array:
        """Return the between part Σ_n n^(1 + times) h_n^power B_n, without W.

        Parameters
        ----------
        ratio : θ, any shape.
        power : of h.
        times : how often ZZᵀ, the sensors' covariance, stands in the product.

        Returns
        -------
        (…, p + 1, p + 1) ndarray
        """
        h = 1 / (1 + np.multiply.outer(np.asarray(ratio, dtype=float), self.sizes))
        summed: Array = np.tensordot(h**power * self.sizes ** (1 + times), self.between, axes=1)
        return summed

    def trace(self, ratio: float, power: int, times: int) -> float:
        """Return Σ_n q_n n^times h_n^power, the between part of a trace of powers of H⁻¹ and ZZᵀ."""
        h = 1 / (1 + ratio * self.sizes)
        return float(np.sum(self.sensors * self.sizes**times * h**power))

    @property
    def total_sensors(self) -> int:
        """Number of sensors q."""
        return int(self.sensors.sum())

    def within_rank(self) -> int:
        """Return how many of the effects in X differ between runs of one sensor."""
        inner, _ = self._within_sensors()
        largest = float(np.diagonal(inner).max(initial=0.0))
        return int(np.linalg.matrix_rank(inner, tol=1e-9 * largest, hermitian=True)) if len(inner) else 0

    def within_rest(self) -> float:
        """Return the sum of squares that runs of one sensor leave, whatever the effects between them."""
        inner, right = self._within_sensors()
        fitted = float(right @ np.linalg.pinv(inner, hermitian=True) @ right) if len(inner) else 0.0
        return float(self.within[-1, -1]) - fitted

    def _within_sensors(self) -> tuple[Array, Array]:
        """W of the columns of X that differ within some sensor, with themselves and with y; the others' are zero."""
        moving = np.flatnonzero(np.diagonal(self.within)[:-1] > 0)
        return self.within[np.ix_(moving, moving)], self.within[moving, -1]


def sensor_sums(matrix: SparseArray, response: Array, sensor: IntArray) -> SensorSums:
    """Return the sums.

    Parameters
    ----------
    matrix : (N, p) sparse array, X: ones and zeros, so that what does not differ within a sensor gives exact zeros.
    response : (N,) ndarray, y.
    sensor : (N,) index of each run's sensor, 0 … q − 1 without gaps.
    """
    counts = np.bincount(sensor)
    runs, sensors = len(sensor), len(counts)
    member = sparse.coo_array((np.ones(runs), (np.arange(runs), sensor)), shape=(runs, sensors)).tocsr()
    shares = sparse.diags_array(1 / counts)
    means, mean = (shares @ (member.T @ matrix)).tocsr(), np.bincount(sensor, response) / counts
    within = _cross((matrix - member @ means).tocsr(), response - mean[sensor])
    sizes, place = np.unique(counts, return_inverse=True)
    alike = [np.flatnonzero(place == index) for index in range(len(sizes))]
    between = np.stack([_cross(means[those], mean[those]) for those in alike])
    return SensorSums(runs, sizes.astype(float), np.bincount(place).astype(float), within, between)


def _cross(matrix: SparseArray, response: Array) -> Array:
    """[X y]ᵀ[X y] of a sparse X."""
    right = np.asarray(matrix.T @ response, dtype=np.float64)
    whole = np.empty((len(right) + 1, len(right) + 1))
    whole[:-1, :-1] = (matrix.T @ matrix).toarray()
    whole[-1, :-1] = whole[:-1, -1] = right
    whole[-1, -1] = response @ response
    return whole
