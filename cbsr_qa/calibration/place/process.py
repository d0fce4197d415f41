"""Gaussian process from features to places: an independent covariance and one that rotates with the sheet.

K(x, x') = v₁ k(|x − x'|₁) I + v₂ Σ_g k(|x − g x'|₂) R_g: the second part belongs to processes whose place rotates by
R_g when the features are those of a sheet rotated by g (Reisert & Burkhardt 2007, "Learning equivariant functions
with matrix valued kernels"). On a uniform sheet every press then informs about all symmetric ones; on a sheet without
that symmetry the marginal likelihood switches this part off.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import Bounds, minimize

from cbsr_qa.calibration.place.features import compute_squared_distances, matern, matern_and_slope
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.results.learned_place import PatternTurns, PlaceProcess, PlaceScales

_ITERATIONS: Final = 25  # L-BFGS steps; further ones gain less than 0.01 mm on left-out presses
_FURTHEST: Final = 12.0  # largest distance of a logarithm from its initial value
#: Weak log-normal priors: standard deviations of logarithms.
_SPREAD_OF_SCALES: Final = 1.0  # of single readings about their mean: prevents 192 scales from fitting 100 presses
_SPREAD_OF_LENGTH: Final = 1.4
_SPREAD_OF_TURNING: Final = 2.0
_SPREAD_OF_VARIANCE: Final = 3.0
_SPREAD_OF_NOISE: Final = 1.4
#: Squared distance, as a share of the largest, of presses that differ by rounding alone.
_ALIKE: Final = 1e-12
#: Number of correlations that are computed at once: few enough for the cache.
_AT_ONCE: Final = 2**16
#: Centre of the prior of the noise, relative to the variance of places.
_NOISE_SHARE: Final = 0.005


def locate(process: PlaceProcess, turns: PatternTurns, features: Array) -> Array:
    """Expected places (k, 2) of features (k, m), about the centre in the electrodes' axes."""
    scales = process.scales
    own_scale = np.sqrt(scales.own)
    correlation = matern(compute_squared_distances(features * own_scale, process.features * own_scale))
    places: Array = scales.own_variance * correlation @ process.weights
    turning_scale = np.sqrt(scales.turning)
    learned_features = process.features * turning_scale
    chunk = max(_AT_ONCE // (len(turns) * len(learned_features)), 1)
    for start in range(0, len(features), chunk):
        turned = features[start : start + chunk, turns.permuted] * (turns.signs * turning_scale)
        correlation = matern(compute_squared_distances(turned.reshape(-1, turned.shape[-1]), learned_features))
        by_turn = (correlation @ process.weights).reshape(-1, len(turns), 2)
        places[start : start + chunk] += scales.turning_variance * np.einsum("kgi,gji->kj", by_turn, turns.turns)
    return places


def condition_on_presses(
    scales: PlaceScales, turns: PatternTurns, features: Array, places_mm: Array
) -> tuple[PlaceProcess, Array]:
    """Return the process given presses (n, m) at places (n, 2), and the inverse of its covariance (2n, 2n)."""
    _, inverse = _invert(_covariance(scales, turns, features))
    weights = (inverse @ places_mm.ravel()).reshape(-1, 2)
    return PlaceProcess(scales, features, places_mm, weights), inverse


def leave_out(process: PlaceProcess, inverse: Array, blocks: Sequence[Indices]) -> Array:
    """Places (n, 2) of blocks of presses, each from all others in closed form (Rasmussen & Williams 2006, Eq. 5.12).

    Parameters
    ----------
    inverse : inverse of the covariance, which :func:`condition_on_presses` returns.

    Returns
    -------
    NaN for presses without block.
    """
    predicted = np.full(process.places_mm.shape, np.nan)
    for block in blocks:
        rows = (2 * block[:, None] + np.arange(2)).ravel()
        error = np.linalg.solve(inverse[np.ix_(rows, rows)], process.weights[block].ravel())
        predicted[block] = process.places_mm[block] - error.reshape(-1, 2)
    return predicted


def _covariance(scales: PlaceScales, turns: PatternTurns, features: Array) -> Array:
    count = len(features)
    own_features = features * np.sqrt(scales.own)
    covariance = np.zeros((count, 2, count, 2))
    correlation = scales.own_variance * matern(compute_squared_distances(own_features, own_features))
    covariance[:, 0, :, 0] = covariance[:, 1, :, 1] = correlation
    scaled = features * np.sqrt(scales.turning)
    for number, turn in enumerate(turns.turns):
        opposite = int(np.abs(turns.turns - turn.T).sum(axis=(1, 2)).argmin())
        if number > opposite:
            continue
        correlation = scales.turning_variance * matern(
            compute_squared_distances(turns.turn_back(scaled, number), scaled)
        )
        for row, column in np.ndindex(2, 2):
            covariance[:, row, :, column] += correlation * turn[row, column]
            if number < opposite:  # K(x, g⁻¹x') is K(gx, x'): the same, transposed
                covariance[:, row, :, column] += correlation.T * turn[column, row]
    full: Array = covariance.reshape(2 * count, 2 * count)
    full[np.diag_indices(2 * count)] += scales.noise_variance
    return full


def _invert(covariance: Array) -> tuple[Array, Array]:
    """Lower Cholesky factor and inverse of a covariance, which is overwritten. LinAlgError if it has none."""
    factor = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
    inverse, _ = dpotri(factor, lower=True)
    inverse += np.tril(inverse, -1).T
    return factor, inverse


def likely_scales(turns: PatternTurns, features: Array, places_mm: Array) -> PlaceScales:
    """Hyperparameters of maximum marginal likelihood times weak priors.

    Parameters
    ----------
    features, places_mm : (n, m) features and (n, 2) places about the centre, in the electrodes' frame.
    """
    likelihood = _Likelihood(turns, features, places_mm)
    start = likelihood.start()
    bounds = Bounds(start - _FURTHEST, start + _FURTHEST)
    best = minimize(likelihood, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _ITERATIONS})
    return likelihood.scales(best.x)


def list_edge_hyperparameters(scales: PlaceScales, features: Array, places_mm: Array) -> list[str]:
    """Hyperparameters at the edge of their search range, in words.

    One part, one reading or the noise may vanish: that is not an edge.
    """
    begin = start_scales(features, places_mm)
    sizes = {
        "variance of the places": (
            scales.own_variance + scales.turning_variance, begin.own_variance + begin.turning_variance
        ),
        "noise": (max(scales.noise_variance, begin.noise_variance), begin.noise_variance),
        "length of the features": (np.exp(np.log(scales.own).mean()), np.exp(np.log(begin.own).mean())),
    }  # fmt: skip
    return [name for name, (found, start) in sizes.items() if abs(np.log(found / start)) > 0.9 * _FURTHEST]


def start_scales(features: Array, places_mm: Array) -> PlaceScales:
    """Initial hyperparameters of a search for the likeliest: all readings have one length, the median distance."""
    squared_distances = compute_squared_distances(features, features)[np.tri(len(features), k=-1, dtype=np.bool_).T]
    different = squared_distances[squared_distances > _ALIKE * squared_distances.max()]
    scale = np.full(features.shape[1], 1 / float(np.median(different)) if len(different) else 1.0)
    variance = float(np.mean(places_mm**2))
    return PlaceScales(variance, variance, _NOISE_SHARE * variance, scale, scale)


def frames_likelihoods(
    scales: PlaceScales, turns: PatternTurns, features: Array, places_mm: Array, axes: Array, centre_stderr_mm: float
) -> tuple[Array, Array]:
    """Logarithms (a,) of the likelihood of presses in several axes of the electrodes, and the centres in them.

    Parameters
    ----------
    places_mm : (n, 2) about a centre with the error ``centre_stderr_mm`` along each axis.
    axes : (a, 2, 2) orthogonal.

    Returns
    -------
    The logarithms, with the centre's prior, and the likeliest centres (a, 2) in the frame of ``places_mm``.
    """
    factor = cholesky(_covariance(scales, turns, features), lower=True, check_finite=False)
    likelihoods, centres = np.empty(len(axes)), np.empty((len(axes), 2))
    for number, frame_axes in enumerate(axes):
        columns = np.column_stack([(places_mm @ frame_axes.T).ravel(), np.tile(frame_axes, (len(places_mm), 1))])
        white = solve_triangular(factor, columns, lower=True, check_finite=False)
        precision = white[:, 1:].T @ white[:, 1:] + np.eye(2) / centre_stderr_mm**2
        projections = white[:, 1:].T @ white[:, 0]
        centres[number] = np.linalg.solve(precision, projections)
        likelihoods[number] = -0.5 * (white[:, 0] @ white[:, 0] - projections @ centres[number])
    return likelihoods - np.log(np.diag(factor)).sum(), centres


class _Likelihood:
    """Minus the logarithm of marginal likelihood times priors, and its gradient, by logarithms of the scales."""

    def __init__(self, turns: PatternTurns, features: Array, places_mm: Array) -> None:
        self._features, self._y, self._begin = features, places_mm.ravel(), start_scales(features, places_mm)
        self._turns = turns.turns.reshape(-1, 4)
        self._orbit = turns.orbits()
        self._readings, self._orbits = features.shape[1], int(self._orbit.max()) + 1
        # Squared distances (orbits, n n g) in each orbit's readings, from every press to every press in every turn.
        turned_features = np.stack([turns.turn_forth(features, number) for number in range(len(turns))], axis=1)
        turned_features = turned_features.reshape(-1, self._readings)
        self._apart = np.empty((self._orbits, len(features) * len(turned_features)))
        for number, distances in enumerate(self._apart):
            among = self._orbit == number
            distances[:] = compute_squared_distances(features[:, among], turned_features[:, among]).ravel()

    def start(self) -> Array:
        """Initial logarithms of a search."""
        begin = self._begin
        variances = np.log([begin.own_variance, begin.turning_variance, begin.noise_variance])
        return np.concatenate([variances, np.log(begin.own), np.log(begin.turning[: self._orbits])])

    def scales(self, logs: Array) -> PlaceScales:
        """Scales from their logarithms: three variances, the readings', and the orbits'."""
        own_variance, turning, noise = np.exp(logs[:3]).tolist()
        own_scales = np.exp(logs[3 : 3 + self._readings])
        return PlaceScales(own_variance, turning, noise, own_scales, np.exp(logs[3 + self._readings :])[self._orbit])

    def __call__(self, logs: Array) -> tuple[float, Array]:
        scales = self.scales(logs)
        gradient = np.zeros_like(logs)
        own_features = self._features * np.sqrt(scales.own)
        count, by_orbit = len(own_features), np.exp(logs[3 + self._readings :])
        own_correlation, own_slope = matern_and_slope(compute_squared_distances(own_features, own_features))
        turned_correlation, turned_slope = matern_and_slope(by_orbit @ self._apart)
        try:
            factor, inverse = _invert(
                self._covariance(scales, own_correlation, turned_correlation.reshape(count * count, -1))
            )
        except np.linalg.LinAlgError:
            return 1e10, gradient
        weights = inverse @ self._y
        value = -0.5 * float(weights @ self._y) - float(np.log(np.diag(factor)).sum())
        slope = 0.5 * (np.outer(weights, weights) - inverse)
        blocks = slope.reshape(count, 2, count, 2)
        own_gradient = scales.own_variance * (blocks[:, 0, :, 0] + blocks[:, 1, :, 1])
        turn_gradient = (
            blocks.transpose(0, 2, 1, 3).reshape(-1, 4) @ (scales.turning_variance * self._turns.T)
        ).ravel()
        gradient[:3] = (
            (own_gradient * own_correlation).sum(),
            turn_gradient @ turned_correlation,
            scales.noise_variance * np.trace(slope),
        )
        gradient[3 : 3 + self._readings] = scales.own * self._differentiate_by_scale(own_gradient * own_slope)
        gradient[3 + self._readings :] = by_orbit * (self._apart @ (turn_gradient * turned_slope))
        prior, prior_slope = self._prior(logs)
        return -(value + prior), -(gradient + prior_slope)

    def _covariance(self, scales: PlaceScales, near: Array, turned: Array) -> Array:
        count = len(near)
        covariance = (turned @ (scales.turning_variance * self._turns)).reshape(count, count, 2, 2)
        covariance = np.ascontiguousarray(covariance.transpose(0, 2, 1, 3))
        covariance[:, 0, :, 0] += scales.own_variance * near
        covariance[:, 1, :, 1] += scales.own_variance * near
        full: Array = covariance.reshape(2 * count, 2 * count)
        full[np.diag_indices(2 * count)] += scales.noise_variance
        return full

    def _differentiate_by_scale(self, slope: Array) -> Array:
        """Σᵢⱼ slopeᵢⱼ (xᵢ − xⱼ)² for every reading, of a symmetric slope."""
        derivative: Array = slope.sum(axis=1) @ self._features**2 - np.einsum(
            "nm,nm->m", self._features, slope @ self._features
        )
        return 2 * derivative

    def _prior(self, logs: Array) -> tuple[float, Array]:
        own_logs, gradient = logs[3 : 3 + self._readings], np.zeros_like(logs)
        moved = logs - self.start()
        deviation = own_logs - own_logs.mean()
        variances, length, scales = moved[:3], moved[3 : 3 + self._readings].mean(), moved[3 + self._readings :]
        spread = np.array([_SPREAD_OF_VARIANCE, _SPREAD_OF_VARIANCE, _SPREAD_OF_NOISE])
        gradient[:3] = -variances / spread**2
        gradient[3 : 3 + self._readings] = (
            -deviation / _SPREAD_OF_SCALES**2 - length / _SPREAD_OF_LENGTH**2 / self._readings
        )
        gradient[3 + self._readings :] = -scales / _SPREAD_OF_TURNING**2
        value = (deviation @ deviation) / _SPREAD_OF_SCALES**2 + length**2 / _SPREAD_OF_LENGTH**2
        value += scales @ scales / _SPREAD_OF_TURNING**2 + ((variances / spread) ** 2).sum()
        return -0.5 * float(value), gradient
