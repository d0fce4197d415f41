"""Variance ratio θ = σ²_sensor/σ² by restricted maximum likelihood, all other parameters profiled out.

With A = XᵀH⁻¹X, R = rᵀH⁻¹r (r the generalised least-squares residuals) and f = N − p, minus twice the restricted log
likelihood (lme4's REML criterion) is

    ℓ(θ) = Σ log(1 + n θ) + log|A| + f (1 + log(2πR/f)).

The interval holds the θ ≥ 0 for which ℓ exceeds its minimum by no more than χ² of one degree of freedom (Patterson &
Thompson 1971; Bates et al. 2015; Pinheiro & Bates 2000, section 2.4).

A sensor's n runs have the covariance σ²(I + θ 11ᵀ), whose inverse is I − 11ᵀ/n + (1/(1 + nθ)) 11ᵀ/n over σ². So for
Z = [X y] and H = V/σ²,

    ZᵀH⁻¹Z = W + Σ_n n h_n B_n,   h_n = 1/(1 + nθ),

with W the cross-products of deviations from the sensors' means and B_n those of the means of sensors with n runs: no
digits are lost at any θ.

Small samples (Kenward & Roger 1997, sections 2 and 3): with V = σ²(I + θZZᵀ), Φ = (XᵀV⁻¹X)⁻¹, the covariance W of the
two variances' estimates, P_i = −XᵀV⁻¹V_iV⁻¹X and Q_ij = XᵀV⁻¹V_iV⁻¹V_jV⁻¹X,

    Φ_A = Φ + 2 Φ {Σ_ij W_ij (Q_ij − P_i Φ P_j)} Φ,

all in units of σ²; a contrast has Satterthwaite's degrees of freedom.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import log, pi

import numpy as np
from scipy import optimize, sparse, stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossings import IntArray, SparseArray
from cbsr_qa.stats.samples import Interval


@dataclass(frozen=True, slots=True, eq=False)
class RandomEffectSums:
    """Sums over sensors, Z having p columns of X and the response as the last.

    Parameters
    ----------
    runs : N.
    sizes : (m,) distinct numbers n of runs a sensor.
    sensors : (m,) number of sensors with so many runs.
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
        """Return the between part Σ_n n^(1 + times) h_n^power B_n, without W: (…, p + 1, p + 1) for θ of any shape.

        ``times``: number of factors ZZᵀ, the sensors' covariance, in the product.
        """
        h = 1 / (1 + np.multiply.outer(np.asarray(ratio, dtype=float), self.sizes))
        return np.tensordot(h**power * self.sizes ** (1 + times), self.between, axes=1)

    def trace(self, ratio: float, power: int, times: int) -> float:
        """Return Σ_n q_n n^times h_n^power, the between part of a trace of powers of H⁻¹ and ZZᵀ."""
        h = 1 / (1 + ratio * self.sizes)
        return float(np.sum(self.sensors * self.sizes**times * h**power))

    @property
    def total_sensors(self) -> int:
        """Number of sensors q."""
        return int(self.sensors.sum())

    def within_rank(self) -> int:
        """Return how many effects in X vary between runs of one sensor."""
        inner, _ = self._within_sensors()
        largest = float(np.diagonal(inner).max(initial=0.0))
        return int(np.linalg.matrix_rank(inner, tol=1e-9 * largest, hermitian=True)) if len(inner) else 0

    def within_rest(self) -> float:
        """Return the residual sum of squares within sensors, for any effects between them."""
        inner, right = self._within_sensors()
        fitted = float(right @ np.linalg.pinv(inner, hermitian=True) @ right) if len(inner) else 0.0
        return float(self.within[-1, -1]) - fitted

    def _within_sensors(self) -> tuple[Array, Array]:
        """W of the columns of X that differ within some sensor, with themselves and with y; the others' are zero."""
        moving = np.flatnonzero(np.diagonal(self.within)[:-1] > 0)
        return self.within[np.ix_(moving, moving)], self.within[moving, -1]


def random_effect_sums(matrix: SparseArray, response: Array, sensor: IntArray) -> RandomEffectSums:
    """Return the sums.

    Parameters
    ----------
    matrix : (N, p) sparse array, X: ones and zeros.
    response : (N,) y.
    sensor : (N,) index of each run's sensor, 0 … q − 1 without gaps.
    """
    counts = np.bincount(sensor)
    runs, sensors = len(sensor), len(counts)
    member = sparse.coo_array((np.ones(runs), (np.arange(runs), sensor)), shape=(runs, sensors)).tocsr()
    shares = sparse.diags_array(1 / counts)
    means, mean = (shares @ (member.T @ matrix)).tocsr(), np.bincount(sensor, response) / counts
    within_products = _cross((matrix - member @ means).tocsr(), response - mean[sensor])
    sizes, place = np.unique(counts, return_inverse=True)
    sensors_by_size = [np.flatnonzero(place == index) for index in range(len(sizes))]
    between_products = np.stack([_cross(means[members], mean[members]) for members in sensors_by_size])
    return RandomEffectSums(
        runs, sizes.astype(float), np.bincount(place).astype(float), within_products, between_products
    )


def _cross(matrix: SparseArray, response: Array) -> Array:
    """[X y]ᵀ[X y] of a sparse X."""
    right = np.asarray(matrix.T @ response, dtype=np.float64)
    products = np.empty((len(right) + 1, len(right) + 1))
    products[:-1, :-1] = (matrix.T @ matrix).toarray()
    products[-1, :-1] = products[:-1, -1] = right
    products[-1, -1] = response @ response
    return products


#: Values of θ tried before the minimum is refined; the likelihood may have two minima.
_GRID = np.concatenate([[0.0], np.logspace(-7, 12, 77)])
_FARTHEST = 1e14
_CONFIDENCE = 0.95
_MAX_ELEMENTS = 2_000_000


@dataclass(frozen=True, slots=True)
class Ratio:
    """θ, its profile interval, the criterion there, and σ² of the sums' response."""

    value: float
    interval: Interval
    criterion: float
    variance: float


@dataclass(frozen=True, slots=True, eq=False)
class Likelihood:
    """Profile criterion of θ; see the module."""

    sums: RandomEffectSums

    @property
    def freedom(self) -> int:
        """Return f = N − p."""
        return self.sums.runs - self.sums.columns

    def criterion(self, ratio: Array) -> Array:
        """Return ℓ of θ, (k,) → (k,)."""
        count = len(ratio)
        # θ are tried in blocks: hundreds of groups at once would exhaust the memory.
        block_count = max(1, min(count, count * self.sums.within.size // _MAX_ELEMENTS))
        log_blocks = []
        for block in np.array_split(ratio, block_count):
            factor = np.linalg.cholesky(self.sums.within + self.sums.products(block))
            log_blocks.append(np.log(np.diagonal(factor, axis1=-2, axis2=-1)))
        logs = np.concatenate(log_blocks)  # of the Cholesky factor's diagonal: of A, and √R last
        spread = np.log1p(np.multiply.outer(ratio, self.sums.sizes)) @ self.sums.sensors
        determinant = 2 * logs[:, :-1].sum(axis=1)
        f = self.freedom
        value: Array = spread + determinant + f * (1 + log(2 * pi / f) + 2 * logs[:, -1])
        return value

    def slope(self, ratio: float) -> float:
        """Return dℓ/dθ = Σ n h − tr(A⁻¹ XᵀH⁻¹ZZᵀH⁻¹X) − f rᵀH⁻¹ZZᵀH⁻¹r / R."""
        products = self.sums.within + self.sums.products(ratio)
        product_slopes = self.sums.products(ratio, 2, 1)
        effects = np.linalg.solve(products[:-1, :-1], products[:-1, -1])
        residual_factors = np.append(-effects, 1.0)
        solved_slopes = np.linalg.solve(products[:-1, :-1], product_slopes[:-1, :-1])
        trace = float(np.trace(solved_slopes))
        squares = float(residual_factors @ products @ residual_factors)
        return (
            self.sums.trace(ratio, 1, 1)
            - trace
            - self.freedom * float(residual_factors @ product_slopes @ residual_factors) / squares
        )

    def variance(self, ratio: float) -> float:
        """Return σ² = R/f."""
        products = self.sums.within + self.sums.products(ratio)
        return float(np.linalg.cholesky(products)[-1, -1]) ** 2 / self.freedom


def variance_ratio(sums: RandomEffectSums) -> Ratio:
    """Return the θ that minimises the criterion, with its 95 % interval; 0 if ℓ rises from there on.

    NumericsError if runs of one sensor differ so little that the ratio has no bound.
    """
    likelihood = Likelihood(sums)
    values = likelihood.criterion(_GRID)
    best = int(np.argmin(values))
    if best == len(_GRID) - 1:
        raise NumericsError("sensor variance: runs of one sensor hardly differ, so its ratio to theirs is unbounded")
    low, high = float(_GRID[max(best - 1, 0)]), float(_GRID[best + 1])
    value = _root(likelihood.slope, low, high)
    least = float(likelihood.criterion(np.array([value]))[0])
    return Ratio(value, _interval(likelihood, value, least), least, likelihood.variance(value))


def _root(slope: Callable[[float], float], low: float, high: float) -> float:
    if slope(low) >= 0:  # at low = 0: the likelihood falls from there on
        return low
    if slope(high) <= 0:
        return high
    return float(optimize.brentq(slope, low, high, xtol=1e-15, rtol=1e-14))


def _interval(likelihood: Likelihood, value: float, least: float) -> Interval:
    allowed = least + float(stats.chi2.ppf(_CONFIDENCE, 1))

    def excess(ratio: float) -> float:
        return float(likelihood.criterion(np.array([ratio]))[0]) - allowed

    low = 0.0 if value == 0.0 or excess(0.0) <= 0 else float(optimize.brentq(excess, 0.0, value, rtol=1e-10))
    high = max(2 * value, 0.1)
    while excess(high) < 0:
        high *= 4
        if high > _FARTHEST:
            raise NumericsError("sensor variance: the likelihood puts no upper bound on it")
    return Interval(low, float(optimize.brentq(excess, value, high, rtol=1e-10)), _CONFIDENCE)


@dataclass(frozen=True, slots=True, eq=False)
class SmallSample:
    """Covariances of p fixed effects over σ², and the terms of their degrees of freedom.

    Parameters
    ----------
    plain, adjusted : (p, p) ndarrays, Φ/σ² and Φ_A/σ².
    slopes : (2, p, p) ndarray, P of run and sensor variance.
    variances : (2, 2) ndarray, W/σ⁴.
    """

    plain: Array
    adjusted: Array
    slopes: Array
    variances: Array

    def freedom(self, contrast: Array) -> float:
        """Return the degrees of freedom of one contrast, (p,) → number: 2 / Σ W_ij t_i t_j, t_i = lᵀΦP_iΦl / lᵀΦl."""
        row = self.plain @ contrast
        traces = np.array([row @ slope @ row for slope in self.slopes]) / float(contrast @ row)
        return 2 / float(traces @ self.variances @ traces)


def small_sample(sums: RandomEffectSums, ratio: float) -> SmallSample:
    """Return the covariances at a ratio of variances θ ≥ 0."""
    inner = sums.within[:-1, :-1]

    def random_products(power: int, times: int) -> Array:
        return sums.products(ratio, power, times)[:-1, :-1]

    plain_covariance = np.asarray(np.linalg.inv(inner + random_products(1, 0)), dtype=np.float64)
    slopes: Array = -np.stack([inner + random_products(2, 0), random_products(2, 1)])
    mixed = random_products(3, 1)
    curves: Array = np.array([[inner + random_products(3, 0), mixed], [mixed, random_products(3, 2)]])
    variances = np.asarray(
        np.linalg.inv(_information(sums, ratio, plain_covariance, slopes, curves)), dtype=np.float64
    )
    squares = (slopes @ plain_covariance)[:, None] @ slopes
    lost = np.einsum("ij,ijkl->kl", variances, curves - squares)
    adjusted = plain_covariance + 2 * plain_covariance @ lost @ plain_covariance
    return SmallSample(plain_covariance, 0.5 * (adjusted + adjusted.T), slopes, variances)


def _information(sums: RandomEffectSums, ratio: float, plain: Array, slopes: Array, curves: Array) -> Array:
    """Expected restricted information ½ [tr(V⁻¹V_iV⁻¹V_j) − 2 tr(ΦQ_ij) + tr(ΦP_iΦP_j)] of both variances."""
    within_freedom = sums.runs - sums.total_sensors
    traces = np.array(
        [
            [within_freedom + sums.trace(ratio, 2, 0), sums.trace(ratio, 2, 1)],
            [sums.trace(ratio, 2, 1), sums.trace(ratio, 2, 2)],
        ]
    )
    turned = [plain @ slope for slope in slopes]
    crossed = np.array([[np.sum(one * two.T) for two in turned] for one in turned])
    fitted = np.einsum("ab,ijba->ij", plain, curves)
    information: Array = 0.5 * (traces - 2 * fitted + crossed)
    return information
