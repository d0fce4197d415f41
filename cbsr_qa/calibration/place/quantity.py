"""Force or depth of a press from the strength of its change and its found place.

The strength of a press is its change over the template at its place, by least squares. y is the quantity or, where
all presses are positive, its logarithm; u is the logarithm of the strength. Both are centred, y in units of its
spread. y is a Gaussian process of the covariance

    c (1 + u u') + v₁ k(|r − r'|/l) + v₂ k(|p − p'|/l) + v₃ k(|u − u'|),

with a place p at the distance r from the centre, k Matérn's of smoothness 5/2 and noise of the variance s₁ + s₂
exp(−2u): a straight line of any slope, variation of the response with the place, symmetric about the centre or not,
and a bend. Hyperparameters maximise the marginal likelihood. Places are those found for left-out presses, with the
same uncertainty as later ones. Errors of presses left out with all others at their place, in closed form, give the
width of intervals. If they are no smaller than those of guessing the median, every press is given the median. A drift
of gains adds to y, one of offsets adds in proportion to exp(−u): presses are brought to the last one as features are
(:mod:`cbsr_qa.calibration.place.drift`).
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.optimize import Bounds, minimize
from scipy.special import stdtrit

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.place.drift import Session, find_drift
from cbsr_qa.calibration.place.features import compute_squared_distances, matern
from cbsr_qa.calibration.place.held_out import evenly, mean_by_place
from cbsr_qa.calibration.place.mixture import LEVELS
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_quantity import LearnedQuantity, QuantityScales

#: Number of presses that are kept, and of those for hyperparameters: the modelled function is smooth.
_MAX_KEPT_PRESSES: Final = 400
_FOR_SCALES: Final = 150
_ITERATIONS: Final = 30  # L-BFGS
#: Variance of the line, in units of the spread: any line is likely.
_LINE: Final = 30.0
#: Log-normal priors of ring, relief, curve, noise, weak noise and length: medians, the last in radii of what is
#: pressed, and standard deviations of the logarithms.
_MEDIANS: Final = np.array([1.0, 0.2, 0.05, 0.01, 0.01, 0.5])
_DEVIATIONS: Final = np.array([2.0, 2.0, 2.0, 3.0, 3.0, 0.7])
_FURTHEST: Final = 4.0  # largest distance from a median, in those deviations
#: Standard deviations that hold 68 and 95 % of a normal distribution: how far lost readings may move a value.
_NORMAL: Final = np.array([0.9945, 1.9600])
#: Frames with one of these flags have no press to measure.
_NO_PRESS: Final = int(Flag.NOT_DETECTED | Flag.UNREADABLE)
#: Variance of the noise, in units of the spread, by which strength and place no longer count.
_UNTOLD: Final = 1e8
#: Term of the diagonal, in units of the spread, that keeps covariances of noiseless presses invertible.
_LEAST_NOISE: Final = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Quantities:
    """A quantity of n presses.

    Parameters
    ----------
    values : (n,) values in the learned unit; NaN in frames flagged NOT_DETECTED or UNREADABLE.
    within_68, within_95 : (n, 2) lowest and highest of the interval of that probability; NaN where the value is.
    below, above : (n,) masks of values beyond all learned presses. Its intervals then reach back to them, and as
        far the other way, as the slope of the continuation is unknown.
    """

    values: Array
    within_68: Array
    within_95: Array
    below: Mask
    above: Mask


def widen_intervals(quantity: Quantities, stderr: Array) -> Quantities:
    """Return a quantity whose intervals also hold an independent normal error of standard deviation (n,).

    The distance of each end from the value and the error's own combine as squares; an end that was not negative stays
    so.
    """

    def widen(within: Array, times: float) -> Array:
        reach = np.hypot(within - quantity.values[:, None], times * stderr[:, None])
        ends: Array = quantity.values[:, None] + np.array([-1.0, 1.0]) * reach
        return np.where(within >= 0, np.maximum(ends, 0.0), ends)

    inner_times, outer_times = _NORMAL
    return replace(
        quantity,
        within_68=widen(quantity.within_68, inner_times),
        within_95=widen(quantity.within_95, outer_times),
    )


class QuantityEstimator:
    """Estimates a quantity of located presses.

    Parameters
    ----------
    learned : the quantity.
    """

    def __init__(self, learned: LearnedQuantity) -> None:
        self._learned, self._process = learned, _Process.from_learned(learned)

    def __call__(self, places: Places) -> Quantities:
        """Return the quantity of presses at places."""
        pressed_mask = (places.flags & _NO_PRESS) == 0
        log_strength_error = np.broadcast_to(places.unsure, pressed_mask.shape)[pressed_mask]
        estimates = self._estimate_presses(
            places.strength[pressed_mask], places.place_mm[pressed_mask], log_strength_error
        )
        values, within_68, within_95 = (
            _spread_rows(pressed_mask, column, np.nan)
            for column in (estimates.values, estimates.within_68, estimates.within_95)
        )
        below, above = (_spread_rows(pressed_mask, column, False) for column in (estimates.below, estimates.above))
        return Quantities(values, within_68, within_95, below, above)

    def _estimate_presses(self, strength: Array, place_mm: Array, unsure: Array) -> Quantities:
        process = self._process
        y, stderr = process.predict(strength, place_mm)
        smallest, largest = process.y.min(), process.y.max()
        excess = np.maximum(np.maximum(smallest - y, y - largest), 0.0)
        lost_change = process.change(strength, place_mm, unsure)
        drift_change = process.later(strength, self._learned.drift, self._learned.weak_drift)
        half_widths = (
            np.hypot(
                self._learned.quantiles[:, None] * stderr, _NORMAL[:, None] * np.hypot(lost_change, drift_change)
            )
            + excess
        )
        inner, outer = (
            process.unscale(np.stack([y - half_width, y + half_width], axis=1)) for half_width in half_widths
        )
        return Quantities(process.unscale(y), inner, outer, below=y < smallest, above=y > largest)


def learn_quantity(
    values: Array,
    strength: Array,
    places_mm: Array,
    centre_mm: Array,
    *,
    visits: Indices | None = None,
    session: Session | None = None,
    drifts: bool = False,
) -> LearnedQuantity:
    """Learn a quantity from its values (n,) for presses.

    Parameters
    ----------
    strength, places_mm : (n,) strength and (n, 2) place found for each press when it was left out.
    centre_mm : (2,) centre of the sheet in the frame of the presses.
    visits : (n,) number of the place, the same for presses at one place; by default all are at different places.
    session : times when they were made; without it no drift is searched for.
    drifts : True if other features of the presses are known to drift.
    """
    recheck_count = 0 if session is None else session.late
    kept_presses = np.append(
        evenly(len(values) - recheck_count, _MAX_KEPT_PRESSES - recheck_count),
        np.arange(len(values) - recheck_count, len(values)),
    )
    values = values[kept_presses]
    visits = (
        np.arange(len(kept_presses)) if visits is None else np.unique(visits[kept_presses], return_inverse=True)[1]
    )
    data = _Data(bool((values > 0).all()), centre_mm, strength[kept_presses], places_mm[kept_presses], values)
    errors = _leave_out_places(data, visits)
    drift = None
    if session is not None:
        weakness = np.median(data.strength) / data.strength
        drift = find_drift(errors[:, None], weakness[:, None], session.select(kept_presses), certain=drifts)
    later_drift = (0.0, 0.0)
    if drift is not None:
        drift_size = np.sqrt(drift.variances * (errors**2).mean())
        later_drift = float(drift_size[0]), float(drift_size[1] / np.sqrt((weakness**2).mean()))
        process = _Process(_fit_scales(data, np.arange(len(kept_presses))), data)
        data = replace(data, values=process.unscale(process.y + drift.since[:, 0]))
        errors = _leave_out_places(data, visits)
    scales = _fit_scales(data, np.arange(len(kept_presses)))
    process = _Process(scales, data)
    if np.abs(guess_errors := _guess_errors(process.y, visits)).mean() <= np.abs(errors).mean():
        errors, scales = guess_errors, replace(scales, ring=0.0, relief=0.0, curve=0.0, noise=_UNTOLD, weak_noise=0.0)
        process = _Process(scales, data)
    stderr = process.leave_out(visits)[1]
    main_presses = np.arange(len(kept_presses) - recheck_count)
    ratio, absolute_error = (
        (np.abs(errors) / stderr)[main_presses],
        np.abs(data.values - process.unscale(process.y - errors))[main_presses],
    )
    error, error_stderr = mean_by_place(absolute_error, visits[main_presses])
    return LearnedQuantity(
        data.logarithmic,
        scales,
        data.centre_mm,
        data.strength,
        data.places_mm,
        data.values,
        quantiles=np.array([_quantile(ratio, level) for level in LEVELS]),
        error=error,
        error_stderr=error_stderr,
        covered=_measure_coverage(ratio, visits[main_presses]),
        drift=later_drift[0],
        weak_drift=later_drift[1],
    )


def is_untold(learned: LearnedQuantity) -> bool:
    """Whether the readings told the quantity no better than guessing does: each press is given the median."""
    return learned.scales.noise >= _UNTOLD


def _guess_errors(y: Array, visits: Indices) -> Array:
    """Errors (n,) of the median of the presses at other places."""
    errors = np.empty(len(y))
    for visit in np.unique(visits):
        errors[visits == visit] = y[visits == visit] - np.median(y[visits != visit])
    return errors


def _leave_out_places(data: "_Data", visits: Indices) -> Array:
    """Errors (n,) of presses left out with all at their place, with hyperparameters of half of the other places."""
    errors = np.empty(len(visits))
    for half in (0, 1):
        half_presses = np.flatnonzero(visits % 2 == half)
        process = _Process(_fit_scales(data, np.flatnonzero(visits % 2 != half)), data)
        errors[half_presses] = process.leave_out(visits)[0][half_presses]
    return errors


def _measure_coverage(ratio: Array, visits: Indices) -> Array:
    """Share of errors within the quantiles of the other half of the places, (levels,); ratio in standard errors."""
    half_mask = visits % 2 == 1
    shares = [
        [
            (ratio[tested_mask] <= _quantile(ratio[~tested_mask], level)).mean()
            for tested_mask in (half_mask, ~half_mask)
        ]
        for level in LEVELS
    ]
    return np.array([np.mean(halves) for halves in shares])


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """Presses as in :class:`~cbsr_qa.domain.results.learned_quantity.LearnedQuantity`."""

    logarithmic: bool
    centre_mm: Array
    strength: Array
    places_mm: Array
    values: Array

    def select(self, presses: Indices) -> "_Data":
        return replace(
            self, strength=self.strength[presses], places_mm=self.places_mm[presses], values=self.values[presses]
        )


class _Process:
    """Gaussian process given presses, see :class:`~cbsr_qa.domain.results.learned_quantity.LearnedQuantity`."""

    def __init__(self, scales: QuantityScales, data: _Data) -> None:
        self._scales, self._logarithmic, self._centre_mm = scales, data.logarithmic, data.centre_mm
        self._log_strength = float(np.log(np.median(data.strength)))
        transformed = np.log(data.values) if data.logarithmic else data.values
        self._middle, self._spread = float(np.median(transformed)), float(transformed.std())
        self.y: Array = (transformed - self._middle) / self._spread
        self._u, self._about = self._scale(data.strength, data.places_mm)
        covariance = _covariance(scales, self._u, self._about, self._u, self._about)
        covariance[np.diag_indices(len(self.y))] += _noise(scales, self._u)
        factor = cholesky(covariance, lower=True, check_finite=False)
        self._inverse: Array = cho_solve((factor, True), np.eye(len(factor)), check_finite=False)
        self._weights: Array = self._inverse @ self.y
        self.log_likelihood = -0.5 * float(self.y @ self._weights) - float(np.log(np.diag(factor)).sum())

    @classmethod
    def from_learned(cls, learned: LearnedQuantity) -> "_Process":
        data = learned.logarithmic, learned.centre_mm, learned.strength, learned.places_mm, learned.values
        return cls(learned.scales, _Data(*data))

    def predict(self, strength: Array, places_mm: Array) -> tuple[Array, Array]:
        """Scaled values (k,) and their standard errors."""
        u, centred = self._scale(strength, places_mm)
        covariance = _covariance(self._scales, u, centred, self._u, self._about)
        prior_variance = _LINE * (1 + u**2) + self._scales.ring + self._scales.relief + self._scales.curve
        explained_variance = np.einsum("kn,kn->k", covariance @ self._inverse, covariance)
        return covariance @ self._weights, np.sqrt(
            np.maximum(prior_variance - explained_variance, 0.0) + _noise(self._scales, u)
        )

    def change(self, strength: Array, places_mm: Array, deviation: Array | float) -> Array:
        """Change (k,) of scaled values by a standard deviation of the logarithm of the strength."""
        if not np.any(deviation):
            return np.zeros(len(strength))
        above, below = (self.predict(strength * np.exp(way * deviation), places_mm)[0] for way in (1, -1))
        return np.asarray(above - below) / 2

    def later(self, strength: Array, drift: float, weak_drift: float) -> Array:
        """Standard deviation (k,) of what drift may add to scaled values."""
        weak = np.exp(self._log_strength) / np.maximum(strength, np.finfo(float).tiny)
        added: Array = np.hypot(drift, weak_drift * weak)
        return added

    def leave_out(self, visits: Indices) -> tuple[Array, Array]:
        """Errors (n,) of presses estimated from those of other visits (n,), and stated ones.

        Rasmussen & Williams 2006, Eq. 5.12, for blocks.
        """
        errors, stderr = np.empty(len(visits)), np.empty(len(visits))
        for visit in np.unique(visits):
            block = np.flatnonzero(visits == visit)
            covariance = np.linalg.inv(self._inverse[np.ix_(block, block)])
            errors[block], stderr[block] = covariance @ self._weights[block], np.sqrt(np.diag(covariance))
        return errors, stderr

    def unscale(self, y: Array) -> Array:
        transformed: Array = self._middle + self._spread * y
        return np.exp(transformed) if self._logarithmic else transformed

    def _scale(self, strength: Array, places_mm: Array) -> tuple[Array, Array]:
        least = np.finfo(float).tiny
        return np.log(np.maximum(strength, least)) - self._log_strength, places_mm - self._centre_mm


def _spread_rows(rows: Mask, values: Any, other: float) -> Any:
    """Values in chosen rows (n,), and another value in the rest."""
    filled = np.full((len(rows), *values.shape[1:]), other, dtype=values.dtype)
    filled[rows] = values
    return filled


def _covariance(scales: QuantityScales, u: Array, about: Array, v: Array, others: Array) -> Array:
    r, s = np.linalg.norm(about, axis=1), np.linalg.norm(others, axis=1)
    covariance: Array = _LINE * (1 + np.outer(u, v)) + scales.curve * matern((u[:, None] - v) ** 2)
    covariance += scales.ring * matern((r[:, None] - s) ** 2 / scales.length_mm**2)
    covariance += scales.relief * matern(compute_squared_distances(about, others) / scales.length_mm**2)
    return covariance


def _noise(scales: QuantityScales, u: Array) -> Array:
    return _LEAST_NOISE + scales.noise + scales.weak_noise * np.exp(-2 * u)


def _fit_scales(data: _Data, presses: Indices) -> QuantityScales:
    """Hyperparameters from some presses, by maximum marginal likelihood times priors."""
    sample = data.select(presses[evenly(len(presses), _FOR_SCALES)])
    start = np.log(_MEDIANS)
    start[-1] += np.log(np.linalg.norm(data.places_mm - data.centre_mm, axis=1).max())

    def surprise(logs: Array) -> float:
        process = _Process(QuantityScales(*np.exp(logs).tolist()), sample)
        return 0.5 * float((((logs - start) / _DEVIATIONS) ** 2).sum()) - process.log_likelihood

    bounds = Bounds(start - _FURTHEST * _DEVIATIONS, start + _FURTHEST * _DEVIATIONS)
    best = minimize(surprise, start, method="L-BFGS-B", bounds=bounds, options={"maxiter": _ITERATIONS})
    return QuantityScales(*np.exp(best.x).tolist())


def _quantile(ratio: Array, level: float) -> float:
    """Quantile of errors in stated standard errors that covers the next press with the probability ``level``.

    Split conformal (Lei et al. 2018, Eq. 3), between order statistics; with too few presses for that, Student's t.
    """
    rank = level * (len(ratio) + 1) - 1
    if rank <= len(ratio) - 1.5:
        return float(np.interp(max(rank, 0.0), np.arange(len(ratio)), np.sort(ratio)))
    normal = float(np.sqrt((ratio**2).mean()) * stdtrit(len(ratio), (1 + level) / 2))
    return max(normal, float(ratio.max()))
