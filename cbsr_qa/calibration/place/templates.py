"""Expected readings over the sheet, and the place that fits a frame of readings best.

Every reading is a smooth function of place: a function shared by all readings that are equal under rotations of the
sheet, from all rotated presses, plus a separate Gaussian process for the residual. Differences of left-out presses
from their templates give the covariance of the readings (shrunk as by Schäfer & Strimmer 2005).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from cbsr_qa.calibration.place.drift import find_drift
from cbsr_qa.calibration.place.features import matern, squared_distances
from cbsr_qa.domain import Array, Indices
from cbsr_qa.domain.results import PatternTurns, PlaceTemplates

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
_RATIOS: Final = np.exp(np.linspace(-5, 5, 21))  # of noise to signal, as variances
_MARGIN: Final = 1.05
#: Standard deviation of the weights of places beside one, in spacings of the grid.
_SMOOTH: Final = 0.6
#: Presses for lengths and ratios; all presses are used for the templates.
_FOR_LENGTHS: Final = 400


def match(templates: PlaceTemplates, features: Array) -> tuple[Array, Array, Array]:
    """Compare features (n, m) with templates.

    Returns
    -------
    Mean places (n, 2), their covariances (n, 2, 2), and the smallest squared misfit per reading (n,).
    """
    certain = 1 / (1 + templates.uncertainty)
    squared = squared_distances(features @ templates.whitening, templates.templates) * certain
    readings = features.shape[1]
    log = TEMPERING * 0.5 * (_DETERMINANT * readings * np.log(certain) - squared)
    likely = np.exp(log - log.max(axis=1, keepdims=True))
    likely /= likely.sum(axis=1, keepdims=True)
    grid = templates.grid_mm
    mean = likely @ grid
    second = np.einsum("nk,ka,kb->nab", likely, grid, grid)
    return mean, second - mean[:, :, None] * mean[:, None, :], squared.min(axis=1) / readings


def expected_features(templates: PlaceTemplates) -> Array:
    """Expected features (k, m) over the grid."""
    expected: Array = solve_triangular(templates.whitening, templates.templates.T, trans="T", lower=True).T
    return expected


def likeness(expected: Array, features: Array) -> Array:
    """Least-squares factor (n, k) of features (n, m) relative to expected features (k, m)."""
    times: Array = features @ expected.T / np.maximum((expected**2).sum(axis=1), np.finfo(float).tiny)
    return times


def at_places(grid_mm: Array, values: Array, places_mm: Array) -> Array:
    """Values (n, k) over a grid at a place (n, 2) each: a mean with Gaussian weights."""
    spacing_mm = float(np.diff(np.unique(grid_mm[:, 0])).min())
    apart = squared_distances(places_mm, grid_mm) / (2 * (_SMOOTH * spacing_mm) ** 2)
    near = np.exp(apart.min(axis=1, keepdims=True) - apart)
    mean: Array = (near * values).sum(axis=1) / near.sum(axis=1)
    return mean


def learn_templates(
    turns: PatternTurns, features: Array, places_mm: Array, radius_mm: float, time: Array
) -> tuple[PlaceTemplates, Array]:
    """Learn the templates of presses (n, m) at places (n, 2), about the centre in the electrodes' axes.

    Parameters
    ----------
    radius_mm : that all places are within.
    time : (n,) of the presses, from −½ to ½ over the session.

    Returns
    -------
    Templates, and one standard deviation of the drift (n, m) that the presses' features may show later.
    """
    shared = _Shared.learn(turns, features, places_mm, radius_mm * _MARGIN)
    grid = _disc(radius_mm * _MARGIN, radius_mm * _MARGIN / _ALONG_RADIUS)
    rest = features - shared.at(places_mm)
    offset = rest.sum(axis=0) / (len(rest) + 5)  # five presses' worth of weight on the shared part
    rest = rest - offset
    own = smoothness(rest, places_mm, radius_mm)
    inverse = np.linalg.inv(_between(places_mm, places_mm, own.length_mm) + own.ratio * np.eye(len(rest)))
    weights = inverse @ rest
    errors = weights / np.diag(inverse)[:, None]
    near = _between(grid, places_mm, own.length_mm)
    uncertainty = np.maximum(1 - np.einsum("kn,kn->k", near @ inverse, near), 0.0) / own.ratio
    later = find_drift(errors, features - errors, time).later(features - errors)
    covariance = _shrunk_covariance(errors) + later.T @ later / len(later)
    whitening = np.linalg.cholesky(np.linalg.inv(covariance))
    templates = shared.at(grid) + offset + near @ weights
    return PlaceTemplates(grid, whitening, templates @ whitening, uncertainty), later


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
    some = np.unique(np.linspace(0, len(rest) - 1, min(len(rest), _FOR_LENGTHS)).astype(np.int64))
    rest, places_mm = rest[some], places_mm[some]
    best = (-np.inf, Smoothness(radius_mm, 1.0))
    for length in radius_mm * np.array(_LENGTHS):
        eigenvalues, vectors = np.linalg.eigh(_between(places_mm, places_mm, length))
        squared = (vectors.T @ rest) ** 2
        for ratio in _RATIOS:
            spread = np.maximum(eigenvalues, 0) + ratio
            variance = np.maximum((squared / spread[:, None]).mean(axis=0), np.finfo(float).tiny)
            likelihood = -len(rest) * np.log(variance).sum() - len(variance) * np.log(spread).sum()
            best = max(best, (float(likelihood), Smoothness(float(length), float(ratio))), key=lambda pair: pair[0])
    return best[1]


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """Functions shared by the readings of an orbit: Gaussian processes on few nodes."""

    turns: PatternTurns
    nodes_mm: Array
    length_mm: float
    weights: Array  # (nodes, orbits) of the covariances with the nodes
    mean: Array  # (orbits,)
    of: Indices  # (m,) orbit of each reading
    by: Indices  # (m,) rotation from the first reading of the orbit to that reading

    @classmethod
    def learn(cls, turns: PatternTurns, features: Array, places_mm: Array, radius_mm: float) -> "_Shared":
        apart = radius_mm / _NODES_ALONG_RADIUS
        nodes = _disc(radius_mm + 1.2 * apart, apart)
        length = _SHARED_LENGTH * radius_mm
        factor = cholesky(_between(nodes, nodes, length) + 1e-6 * np.eye(len(nodes)), lower=True)
        orbit = turns.orbits()
        first = np.array([int(np.flatnonzero(orbit == number)[0]) for number in range(int(orbit.max()) + 1)])
        by = np.zeros(len(orbit), dtype=np.int64)
        for number in reversed(range(len(turns))):
            by[turns.permuted[number][first]] = number
        places = np.concatenate([places_mm @ turn.T for turn in turns.turns])
        values = np.concatenate([turns.forth(features, number)[:, first] for number in range(len(turns))])
        mean = values.mean(axis=0)
        basis = solve_triangular(factor, _between(places, nodes, length).T, lower=True).T
        weights = solve_triangular(factor.T, _ridge(basis, values - mean, len(features)), lower=False)
        return cls(turns, nodes, length, weights, mean, orbit, by)

    def at(self, places_mm: Array) -> Array:
        """Features (k, m) at places (k, 2)."""
        features = np.empty((len(places_mm), len(self.of)))
        for number, turn in enumerate(self.turns.turns):
            readings = np.flatnonzero(self.by == number)
            if not len(readings):
                continue
            values = _between(places_mm @ turn, self.nodes_mm, self.length_mm) @ self.weights + self.mean
            features[:, readings] = values[:, self.of[readings]] * self._signs(number, readings)
        return features

    def _signs(self, number: int, readings: Indices) -> Array:
        sign = np.empty(len(self.of))
        sign[self.turns.permuted[number]] = self.turns.signs[number]
        return sign[readings]


def _ridge(basis: Array, values: Array, presses: int) -> Array:
    """Weights (nodes, orbits) of largest marginal likelihood over one ratio of noise to signal.

    Each press counts once in that, for any number of rotations.
    """
    eigenvalues, vectors = np.linalg.eigh(basis.T @ basis)
    eigenvalues = np.maximum(eigenvalues, 0)
    along = vectors.T @ (basis.T @ values)
    total, count = (values**2).sum(axis=0), len(values)
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
    apart = np.logical_not(np.eye(readings, dtype=bool))
    squared = max(float((correlation[apart] ** 2).sum()), np.finfo(float).tiny)
    shrinkage = min(max(float(variance[apart].sum()) / squared, 0.01), 1.0)
    shrunk = (1 - shrinkage) * correlation + shrinkage * np.eye(readings)
    covariance: Array = shrunk * np.outer(deviation, deviation)
    return covariance


def _between(a: Array, b: Array, length_mm: float) -> Array:
    return matern(squared_distances(a, b) / length_mm**2)


def _disc(radius_mm: float, spacing_mm: float) -> Array:
    """Places (k, 2) on a square lattice within a radius."""
    along = np.arange(np.floor(radius_mm / spacing_mm) + 1) * spacing_mm
    along = np.concatenate([-along[:0:-1], along])
    places: Array = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    inside: Array = places[np.linalg.norm(places, axis=1) <= radius_mm * (1 + 1e-9)]
    return inside
