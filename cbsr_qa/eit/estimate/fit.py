"""Least-squares fit of one round load to each of many frames at once, by damped Gauss–Newton steps.

At d′ of 10 to 30 the sheet's sensitivity varies within the place's error, so that the Fisher matrix at the estimate
is too optimistic: its inverse is averaged over places one standard error to each side.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.eit.estimate.readings import MergedReadings
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads

#: Squared length of the last step in standard errors: a hundredth of one.
_MAX_SQUARED_MOVE: Final = 1e-4
_MAX_STEPS: Final = 30
_EASIER: Final = 0.1
_HARDER: Final = 8.0
_MAX_DAMPING: Final = 1e8
_AT_ONCE: Final = 128  # loads evaluated together, so that data stay in the processor's cache
_LEAST_CLEARANCE: Final = 0.02  # radii of the sheet: loads closer to an electrode or edge are not followed


@dataclass(frozen=True, slots=True, eq=False)
class Fits:
    """Fitted loads.

    Parameters
    ----------
    parameters : (n, 4) x [mm], y [mm], strength s [mm²], square q [mm²] (:mod:`cbsr_qa.eit.loads.round_load`).
    covariance : (n, 4, 4) inverse Fisher matrix at the estimate; rows and columns of given parameters are zero.
    residual : (n, rows) residuals in units of the noise.
    misfit : (n,) sum of its squares.
    empty_misfit : (n,) misfit without a load.
    steps : (n,) tried.
    converged : (n,) False where the last step was not small.
    held : (n,) mask of loads that would have grown into an electrode or over the edge; their square is at the bound.
    excess : (n,) increase of the square of those without the bound, to first order; else 0.
    """

    parameters: Array
    covariance: Array
    residual: Array
    misfit: Array
    empty_misfit: Array
    steps: Indices
    converged: Mask
    held: Mask
    excess: Array


class LoadFitter:
    """Fits loads to rows of unit noise."""

    def __init__(self, model: RoundLoadModel, readings: MergedReadings) -> None:
        self.model = model
        self.readings = readings

    def rows(self, parameters: Array) -> tuple[Array, Array]:
        """Rows (n, rows) of loads (n, 4), and their slopes (n, rows, 4)."""
        change, slope = [], []
        for first in range(0, len(parameters), _AT_ONCE):
            batch = parameters[first : first + _AT_ONCE]
            loaded = self.model.readings(RoundLoads(batch[:, :2], batch[:, 2], batch[:, 3]))
            change.append(self.readings.merge_frames(loaded.change))
            slope.append(self.readings.merge_frames(loaded.slope).swapaxes(1, 2))
        return np.concatenate(change), np.concatenate(slope)

    def fit(self, data: Array, start: Array, *, square: bool) -> Fits:
        """Fit data (n, rows) from parameters (n, 4); the square is fitted too, or stays as given."""
        run = _Run(self, data, start, square)
        for _ in range(_MAX_STEPS):
            if not run.active.any():
                break
            run.step()
        return run.result()

    def covariance(self, parameters: Array, *, square: bool) -> Array:
        """Inverse Fisher matrix (n, 4, 4) at loads (n, 4); zero for the square where it is not fitted."""
        _, slopes = self.rows(parameters)
        return _invert(slopes.swapaxes(1, 2) @ slopes, square=square)

    def limit_sizes(self, parameters: Array, *, square: bool) -> tuple[Array, Mask, Mask]:
        """Shrink loads whose size is fitted until they touch no electrode and no edge.

        Returns
        -------
        (n, 4) parameters; (n,) whether the square was cut; (n,) whether the load is on the sheet, clear of
        electrodes, and no stronger than a disc of that clearance can be.
        """
        least = _LEAST_CLEARANCE * self.model.surroundings.radius_mm
        clearance_mm = self.model.surroundings.clearance_mm(parameters[:, :2])
        limited = parameters.copy()
        if square:
            bound = np.maximum(clearance_mm, least) ** 2
            limited[:, 3] = np.clip(limited[:, 3], -bound, bound)
        possible_mask = (clearance_mm >= least) & (
            np.abs(limited[:, 2]) <= np.maximum(clearance_mm**2, np.abs(limited[:, 3]))
        )
        return limited, limited[:, 3] != parameters[:, 3], possible_mask


class _Run:
    def __init__(self, fitter: LoadFitter, data: Array, start: Array, square: bool) -> None:
        count = len(data)
        self.fitter, self.data, self.square = fitter, data, square
        self.free = np.tile([True, True, True, square], (count, 1))
        self.at, *_ = fitter.limit_sizes(start, square=square)
        rows, slopes = fitter.rows(self.at)
        self.residual = data - rows
        self.misfit = (self.residual**2).sum(axis=1)
        self.information = slopes.swapaxes(1, 2) @ slopes
        self.pull = np.einsum("nrp,nr->np", slopes, self.residual)
        self.damping = np.full(count, 1e-3)
        self.active = np.ones(count, dtype=np.bool_)
        self.converged = np.zeros(count, dtype=np.bool_)
        self.steps = np.zeros(count, dtype=np.int64)

    def step(self) -> None:
        active_loads = np.flatnonzero(self.active)
        move, gain = self._compute_moves(active_loads)
        aim, limited_mask, placed_mask = self.fitter.limit_sizes(self.at[active_loads] + move, square=self.square)
        newly_limited = limited_mask & self.free[active_loads, 3]
        self.free[active_loads[limited_mask], 3] = False
        self.steps[active_loads] += 1
        done_mask = (gain < _MAX_SQUARED_MOVE) & ~newly_limited & placed_mask
        done_loads = active_loads[done_mask]
        self.at[done_loads] = aim[done_mask]
        self.misfit[done_loads] -= gain[done_mask]
        self.active[done_loads] = False
        self.converged[done_loads] = True
        self._refuse(active_loads[~placed_mask])
        continuing_mask = placed_mask & ~done_mask
        if continuing_mask.any():
            self._try(active_loads[continuing_mask], aim[continuing_mask])

    def _compute_moves(self, which: Indices) -> tuple[Array, Array]:
        """Damped steps (k, 4), and their squared length in standard errors."""
        # Normal equations (k, 4, 4), (k, 4) of parameters scaled (k, 4) to unit diagonal; fixed ones do not move.
        free = self.free[which]
        normal, scale = _normal(self.information[which], free)
        pull = np.where(free, self.pull[which] / scale, 0)
        damped = normal + self.damping[which, None, None] * np.eye(4)
        move = np.linalg.solve(damped, pull[..., None])[..., 0]
        return move / scale, (move * pull).sum(axis=1)

    def _try(self, which: Indices, aim: Array) -> None:
        rows, slopes = self.fitter.rows(aim)
        residual = self.data[which] - rows
        misfit = (residual**2).sum(axis=1)
        better_mask = misfit < self.misfit[which]
        improved_loads = which[better_mask]
        self.at[improved_loads], self.misfit[improved_loads] = aim[better_mask], misfit[better_mask]
        self.residual[improved_loads] = residual[better_mask]
        slopes = slopes[better_mask]
        self.information[improved_loads] = slopes.swapaxes(1, 2) @ slopes
        self.pull[improved_loads] = np.einsum("nrp,nr->np", slopes, residual[better_mask])
        self.damping[improved_loads] *= _EASIER
        self._refuse(which[~better_mask])

    def _refuse(self, which: Indices) -> None:
        self.damping[which] *= _HARDER
        self.active[which[self.damping[which] > _MAX_DAMPING]] = False

    def result(self) -> Fits:
        """Fitted parameters, with covariances of all that could be fitted."""
        held_mask = self.square & ~self.free[:, 3]
        covariance = _invert(self.information, square=self.square)
        excess = np.where(held_mask, (covariance[:, 3] * self.pull).sum(axis=1), 0.0)
        empty = (self.data**2).sum(axis=1)
        return Fits(
            self.at,
            covariance,
            self.residual,
            self.misfit,
            empty,
            self.steps,
            self.converged,
            held_mask,
            np.maximum(excess, 0.0),
        )


def _normal(information: Array, free: Mask) -> tuple[Array, Array]:
    """Information (n, 4, 4) scaled to unit diagonal, with ones for fixed parameters, and the scale (n, 4)."""
    diagonal = np.diagonal(information, axis1=1, axis2=2)
    scale = np.sqrt(np.where(free & (diagonal > 0), diagonal, 1))
    both_free = free[:, :, None] & free[:, None]
    return np.where(both_free, information / (scale[:, :, None] * scale[:, None]), np.eye(4)), scale


def _invert(information: Array, *, square: bool) -> Array:
    free = np.tile([True, True, True, square], (len(information), 1))
    normal, scale = _normal(information, free)
    inverse = np.linalg.pinv(normal, hermitian=True) / (scale[:, :, None] * scale[:, None])
    covariance: Array = inverse * (free[:, :, None] & free[:, None])
    return covariance


#: d′ above which the sheet is uniform within the error of the place.
SURE: Final = 30.0
#: Variance of the place beyond the bound, times d′², as simulated at d′ = 10 to 20 (benchmarks/load_estimate.py).
_BEYOND: Final = 8.0


def spread_covariance(fitter: LoadFitter, fits: Fits, detectability: Array, *, square: bool) -> Array:
    """Average the covariance (n, 4, 4) over the places it allows, for loads of d′ (n,)."""
    covariance = fits.covariance
    place = covariance[:, :2, :2]
    size, axes = np.linalg.eigh(place)
    place_response = covariance[:, :, :2] @ np.linalg.inv(place)  # how the other unknowns vary with the place
    total = covariance.copy()
    for axis in range(2):
        step = np.sqrt(np.maximum(size[:, axis], 0))[:, None] * axes[:, :, axis]
        for side in (-1, 1):
            aim = fits.parameters + side * (place_response @ step[..., None])[..., 0]
            moved_parameters, _, placed_mask = fitter.limit_sizes(aim, square=square)
            moved_parameters[~placed_mask] = fits.parameters[~placed_mask]
            total += fitter.covariance(moved_parameters, square=square)
    mean = np.where(fits.held[:, None, None], covariance, total / 5)
    widening = np.sqrt(1 + _BEYOND / detectability**2)[:, None] ** np.array([1, 1, 0, 0])
    spread: Array = mean * widening[:, :, None] * widening[:, None]
    return spread
