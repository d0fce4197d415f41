"""Expected readings over the sheet, and the place that fits a frame of readings best.

Every reading is a smooth function of place: a function shared by all readings that are equal under rotations of the
sheet, from all rotated presses, plus a separate Gaussian process for the residual. Differences of left-out presses
from their templates give the covariance of the readings (shrunk as by Schäfer & Strimmer 2005).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from cbsr_qa.calibration.place.features import compute_squared_distances, matern
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_place import PatternTurns, PlaceTemplates

#: Power of the likelihood: the readings' errors have common causes that the covariance of a few presses does not
#: show. Chosen on left-out presses of both kinds of sheet; 0.1 to 0.3 are within 2 % of one another.
TEMPERING: Final = 0.2
#: Power of the determinant of a template's own uncertainty beside that.
_DETERMINANT: Final = 0.7
#: Places along a radius of the grid, and nodes of the shared functions.
_ALONG_RADIUS: Final = 16
_NODES_ALONG_RADIUS: Final = 5.5
#: Correlation lengths of readings that are tried, in radii of the pressed area.
_LENGTHS: Final = (0.35, 0.5, 0.65, 1.0)
_SHARED_LENGTH: Final = 0.65
_RATIOS: Final = np.exp(np.linspace(-5, 5, 21))  # ratios of noise to signal, as variances
_MARGIN: Final = 1.05
#: Standard deviation of the weights of places beside one, in spacings of the grid.
_SMOOTH: Final = 0.6
#: Number of presses that the prior of a shared part without offset counts as.
_TRUST: Final = 5
#: Number of times that missing readings are filled: the second time starts from the better places of the first.
_FILLINGS: Final = 2
NO_PRESS: Final[Indices] = np.arange(0)
#: Number of presses for lengths and ratios; all presses are used for the templates.
_FOR_LENGTHS: Final = 400


def match(templates: PlaceTemplates, features: Array) -> tuple[Array, Array, Array]:
    """Compare features (n, m) with templates.

    Returns
    -------
    Mean places (n, 2), their covariances (n, 2, 2), and the smallest squared misfit per reading (n,).
    """
    likely, squared = _posterior(templates, features)
    grid = templates.grid_mm
    mean = likely @ grid
    second = np.einsum("nk,ka,kb->nab", likely, grid, grid)
    return mean, second - mean[:, :, None] * mean[:, None, :], squared.min(axis=1) / features.shape[1]


def fill_missing(templates: PlaceTemplates, expected: Array, features: Array, missing: Mask) -> Array:
    """Features (n, m) whose missing ones are those expected where the others place the frame.

    ``expected`` (k, m): :func:`predict_features` of the templates.
    """
    if not len(features):
        return features
    for _ in range(_FILLINGS):
        estimated = _posterior(templates, features)[0] @ expected
        known_features = np.where(missing, 0.0, estimated)
        factor = (features * known_features).sum(axis=1) / np.maximum(
            (known_features**2).sum(axis=1), np.finfo(float).tiny
        )
        features = np.where(missing, factor[:, None] * estimated, features)
    return features


def _posterior(templates: PlaceTemplates, features: Array) -> tuple[Array, Array]:
    """Probabilities (n, k) of the places of the grid, and squared misfits."""
    certain = 1 / (1 + templates.uncertainty)
    squared = compute_squared_distances(features @ templates.whitening, templates.templates) * certain
    log = TEMPERING * 0.5 * (_DETERMINANT * features.shape[1] * np.log(certain) - squared)
    likely = np.exp(log - log.max(axis=1, keepdims=True))
    return likely / likely.sum(axis=1, keepdims=True), squared


def predict_features(templates: PlaceTemplates) -> Array:
    """Expected features (k, m) over the grid."""
    return solve_triangular(templates.whitening, templates.templates.T, trans="T", lower=True).T


def likeness(expected: Array, features: Array) -> Array:
    """Least-squares factor (n, k) of features (n, m) relative to expected features (k, m)."""
    times: Array = features @ expected.T / np.maximum((expected**2).sum(axis=1), np.finfo(float).tiny)
    return times


def interpolate_at_places(grid_mm: Array, values: Array, places_mm: Array) -> Array:
    """Values (n, k) over a grid at a place (n, 2) each: a mean with Gaussian weights."""
    spacing_mm = float(np.diff(np.unique(grid_mm[:, 0])).min())
    scaled_distance = compute_squared_distances(places_mm, grid_mm) / (2 * (_SMOOTH * spacing_mm) ** 2)
    weights = np.exp(scaled_distance.min(axis=1, keepdims=True) - scaled_distance)
    mean: Array = (weights * values).sum(axis=1) / weights.sum(axis=1)
    return mean


class TemplateLearning:
    """Learns templates from presses, from all of them or from all but some.

    One matrix of all presses is inverted once; block formulas leave presses out of it.

    Parameters
    ----------
    features, places_mm : (n, m) features and (n, 2) places of presses, about the centre in the electrodes' axes.
    radius_mm : radius of a circle that holds all places.
    """

    def __init__(self, turns: PatternTurns, features: Array, places_mm: Array, radius_mm: float) -> None:
        self._features = features
        self._grid = _disc(radius_mm * _MARGIN, radius_mm * _MARGIN / _ALONG_RADIUS)
        self._shared = _Shared(turns, features, places_mm, self._grid, radius_mm * _MARGIN)
        residual, _ = self._subtract_shared(NO_PRESS)
        residual_smoothness = smoothness(residual, places_mm, radius_mm)
        self._ratio = residual_smoothness.ratio
        self._inverse = np.linalg.inv(
            _covariance_between(places_mm, places_mm, residual_smoothness.length_mm)
            + residual_smoothness.ratio * np.eye(len(residual))
        )
        grid_covariance = _covariance_between(self._grid, places_mm, residual_smoothness.length_mm)
        self._near = grid_covariance @ self._inverse
        self._explained = np.einsum("kn,kn->k", self._near, grid_covariance)

    def leave_out_block(self, block: Indices, later: Array | None = None) -> PlaceTemplates:
        """Templates of all presses but those of a block; ``later`` (n, m): a standard deviation of drift to come."""
        residual, on_grid = self._subtract_shared(block)
        weights = self._inverse @ residual
        block_weights = self._near[:, block]
        block_solution = np.linalg.solve(
            self._inverse[np.ix_(block, block)], np.column_stack([weights[block], block_weights.T])
        )
        on_grid += self._near @ residual - block_weights @ block_solution[:, : residual.shape[1]]
        explained_variance = self._explained - np.einsum(
            "kb,bk->k", block_weights, block_solution[:, residual.shape[1] :]
        )
        errors = self._errors(block, weights)
        covariance = _shrunk_covariance(errors) + (0.0 if later is None else later.T @ later / len(later))
        whitening = np.linalg.cholesky(np.linalg.inv(covariance))
        uncertainty = np.maximum(1 - explained_variance, 0.0) / self._ratio
        return PlaceTemplates(self._grid, whitening, on_grid @ whitening, uncertainty)

    def misfits_left_out(self, block: Indices) -> Array:
        """Squared misfit per reading (b,) of each press of a block at its place, by templates of all others."""
        weights = self._inverse @ self._subtract_shared(block)[0]
        errors = np.linalg.solve(self._inverse[np.ix_(block, block)], weights[block])
        misfits: Array = ((errors @ self.leave_out_block(block).whitening) ** 2).mean(axis=1)
        return misfits

    def leave_out_each(self) -> tuple[Array, Array]:
        """Difference (n, m) of every press from the templates of all others, and those templates."""
        errors = self._errors(NO_PRESS, self._inverse @ self._subtract_shared(NO_PRESS)[0])
        return errors, self._features - errors

    def _subtract_shared(self, block: Indices) -> tuple[Array, Array]:
        """Features (n, m) less the shared part of all presses but a block, and that part on the grid."""
        at_presses, on_grid = self._shared.leave_out_block(block)
        residual = self._features - at_presses
        other_count = len(residual) - len(block)
        offset = (residual.sum(axis=0) - residual[block].sum(axis=0)) / (other_count + _TRUST)
        return residual - offset, on_grid + offset

    def _errors(self, block: Indices, weights: Array) -> Array:
        """Difference of each press outside a block from the templates of all others outside it."""
        other_presses = np.setdiff1d(np.arange(len(weights)), block)
        cross_precision = self._inverse[np.ix_(other_presses, block)]
        block_solution = np.linalg.solve(
            self._inverse[np.ix_(block, block)], np.column_stack([weights[block], cross_precision.T])
        )
        readings = weights.shape[1]
        precision = np.diag(self._inverse)[other_presses] - np.einsum(
            "ab,ba->a", cross_precision, block_solution[:, readings:]
        )
        errors: Array = (weights[other_presses] - cross_precision @ block_solution[:, :readings]) / precision[:, None]
        return errors


@dataclass(frozen=True, slots=True)
class Smoothness:
    """Length of the readings' own functions, and the ratio of noise to signal, as variances."""

    length_mm: float
    ratio: float


def smoothness(rest: Array, places_mm: Array, radius_mm: float) -> Smoothness:
    """Length and ratio of maximum marginal likelihood, with each reading's variance.

    Parameters
    ----------
    rest, places_mm : (n, m) features without their shared part, and (n, 2).
    """
    sample = np.unique(np.linspace(0, len(rest) - 1, min(len(rest), _FOR_LENGTHS)).astype(np.int64))
    rest, places_mm = rest[sample], places_mm[sample]
    best = (-np.inf, Smoothness(radius_mm, 1.0))
    for length in radius_mm * np.array(_LENGTHS):
        eigenvalues, vectors = np.linalg.eigh(_covariance_between(places_mm, places_mm, length))
        squared = (vectors.T @ rest) ** 2
        for ratio in _RATIOS:
            spread = np.maximum(eigenvalues, 0) + ratio
            variance = np.maximum((squared / spread[:, None]).mean(axis=0), np.finfo(float).tiny)
            likelihood = -len(rest) * np.log(variance).sum() - len(variance) * np.log(spread).sum()
            best = max(best, (float(likelihood), Smoothness(float(length), float(ratio))), key=lambda pair: pair[0])
    return best[1]


class _Shared:
    """The functions that readings of one orbit share: Gaussian processes on few nodes, of presses in every turn.

    Parameters
    ----------
    grid_mm : (k, 2) places that they are wanted at, beside those of the presses.
    radius_mm : radius of a circle that holds all places.
    """

    def __init__(
        self, turns: PatternTurns, features: Array, places_mm: Array, grid_mm: Array, radius_mm: float
    ) -> None:
        nodes = _Nodes(radius_mm)
        orbit = turns.orbits()
        first_readings = np.array([int(np.flatnonzero(orbit == number)[0]) for number in range(int(orbit.max()) + 1)])
        # The turn that maps the first reading of an orbit to each reading.
        turn_by_reading = np.zeros(len(orbit), dtype=np.int64)
        self._sign = np.empty(len(orbit))
        for number in reversed(range(len(turns))):
            turned_readings = turns.permuted[number][first_readings]
            turn_by_reading[turned_readings], self._sign[turned_readings] = (
                number,
                turns.signs[number][first_readings],
            )
        self._values = np.stack(
            [turns.turn_forth(features, number)[:, first_readings] for number in range(len(turns))]
        )
        self._basis = np.stack([nodes.basis(places_mm @ turn.T) for turn in turns.turns])
        self._sums = self._sum_moments(np.arange(len(places_mm)))
        self._made = [
            (readings, orbit[readings], nodes.basis(places_mm @ turn), nodes.basis(grid_mm @ turn))
            for number, turn in enumerate(turns.turns)
            if len(readings := np.flatnonzero(turn_by_reading == number))
        ]

    def leave_out_block(self, block: Indices) -> tuple[Array, Array]:
        """Features at the presses (n, m) and on the grid (k, m), learned from all presses but those of a block."""
        squares, projections, basis, total, values = (
            of_all - of_block for of_all, of_block in zip(self._sums, self._sum_moments(block), strict=True)
        )
        presses = self._basis.shape[1] - len(block)
        count = presses * len(self._basis)  # each press once in every turn
        mean = values / count
        weights = _ridge(squares, projections - np.outer(basis, mean), total - count * mean**2, count, presses)
        at_presses, on_grid = (np.empty((len(place_basis), len(self._sign))) for place_basis in self._made[0][2:])
        for readings, orbit, press_basis, grid_basis in self._made:
            at_presses[:, readings] = press_basis @ weights[:, orbit] + mean[orbit]
            on_grid[:, readings] = grid_basis @ weights[:, orbit] + mean[orbit]
        return at_presses * self._sign, on_grid * self._sign

    def _sum_moments(self, block: Indices) -> tuple[Array, ...]:
        """Moments of a block's basis functions and values, in every turn."""
        basis = self._basis[:, block].reshape(-1, self._basis.shape[-1])
        values = self._values[:, block].reshape(-1, self._values.shape[-1])
        squares = (values**2).sum(axis=0)
        return basis.T @ basis, basis.T @ values, basis.sum(axis=0), squares, values.sum(axis=0)


class _Nodes:
    """Functions of place that have covariances with few nodes alone."""

    def __init__(self, radius_mm: float) -> None:
        spacing_mm = radius_mm / _NODES_ALONG_RADIUS
        self._nodes_mm = _disc(radius_mm + 1.2 * spacing_mm, spacing_mm)
        self._length_mm = _SHARED_LENGTH * radius_mm
        covariance = _covariance_between(self._nodes_mm, self._nodes_mm, self._length_mm)
        self._factor = cholesky(covariance + 1e-6 * np.eye(len(covariance)), lower=True)

    def basis(self, places_mm: Array) -> Array:
        """Values (n, nodes) at places (n, 2) of functions that are independent of one another, of variance one."""
        covariance = _covariance_between(self._nodes_mm, places_mm, self._length_mm)
        return solve_triangular(self._factor, covariance, lower=True, check_finite=False).T


def _ridge(squares: Array, along: Array, total: Array, count: int, presses: int) -> Array:
    """Weights (functions, orbits) of largest marginal likelihood over one ratio of noise to signal.

    Each press counts once in that, however many turns it stands for.

    Parameters
    ----------
    squares, along, total : BᵀB, BᵀV and the column sums of V² of the basis B and ``count`` values V of each orbit.
    """
    eigenvalues, vectors = np.linalg.eigh(squares)
    eigenvalues = np.maximum(eigenvalues, 0)
    along = vectors.T @ along
    best = (-np.inf, vectors)
    for ratio in _RATIOS * presses:
        variance = (total - (along**2 / (eigenvalues + ratio)[:, None]).sum(axis=0)) / count
        variance = np.maximum(variance, np.finfo(float).tiny)
        likelihood = -count * np.log(variance).sum() - np.log1p(eigenvalues / ratio).sum()
        if likelihood > best[0]:
            best = (float(likelihood), vectors @ (along / (eigenvalues + ratio)[:, None]))
    return best[1]


def _shrunk_covariance(errors: Array) -> Array:
    """Covariance (m, m) of errors (n, m), its correlations shrunk towards zero (Schäfer & Strimmer 2005)."""
    count, readings = errors.shape
    deviation = np.sqrt((errors**2).mean(axis=0))
    deviation = np.maximum(deviation, 1e-6 * deviation.max(initial=np.finfo(float).tiny))
    scaled = errors / deviation
    correlation = scaled.T @ scaled / count
    variance = ((scaled**2).T @ scaled**2 / count - correlation**2) / count
    off_diagonal = np.logical_not(np.eye(readings, dtype=bool))
    squared = max(float((correlation[off_diagonal] ** 2).sum()), np.finfo(float).tiny)
    shrinkage = min(max(float(variance[off_diagonal].sum()) / squared, 0.01), 1.0)
    shrunk = (1 - shrinkage) * correlation + shrinkage * np.eye(readings)
    covariance: Array = shrunk * np.outer(deviation, deviation)
    return covariance


def _covariance_between(a: Array, b: Array, length_mm: float) -> Array:
    return matern(compute_squared_distances(a, b) / length_mm**2)


def _disc(radius_mm: float, spacing_mm: float) -> Array:
    """Places (k, 2) on a square lattice within a radius."""
    axis_mm = np.arange(np.floor(radius_mm / spacing_mm) + 1) * spacing_mm
    axis_mm = np.concatenate([-axis_mm[:0:-1], axis_mm])
    places: Array = np.stack(np.meshgrid(axis_mm, axis_mm), axis=-1).reshape(-1, 2)
    inside_mm: Array = places[np.linalg.norm(places, axis=1) <= radius_mm * (1 + 1e-9)]
    return inside_mm
