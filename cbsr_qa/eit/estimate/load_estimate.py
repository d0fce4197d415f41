"""Maximum-likelihood estimate of place and strength of a round load, with uncertainties.

Weighted least squares on the readings' changes, started from an image, is unbiased and as precise as the Cramér–Rao
bound allows. A place known to no better than a third of the radius, or a radius whose standard error is above a third
of it, is not reported. The rules compare standard errors with the *expected* radius: a rule on the estimate itself
would cause selection bias.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, floor, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtr, ndtri

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.goodness import LEAST_EXPLAINED, deviates_from_model, share_explained
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.load_estimates import Estimated, LoadEstimate, LoadFinding
from cbsr_qa.eit.estimate.fit import SURE, Fits, LoadFitter, spread_covariance
from cbsr_qa.eit.estimate.readings import MergedReadings
from cbsr_qa.eit.loads.round_load import RoundLoadModel

#: Least decrease of the squared residuals for a load to be detected. Noise alone reaches it in fewer than 2 of 10 000
#: frames (measured with 20 000, anywhere on the sheet, of any size).
DETECTED_GAIN: Final = 27.0
#: A frame whose best place on the grid explains less of the squares does not explain 27 beside it.
_HOPELESS_GAIN: Final = 10.0
#: d′ from which a place is reported: in 97 of 100 frames at d′ = 10, in 3 at d′ = 6.
LEAST_DETECTABILITY: Final = 8.0
#: Largest standard error of place and radius over the expected radius.
_SHARE: Final = 1 / 3
#: Standard errors scatter as the strength does: margin of the bound.
_SPARE: Final = 1.15
#: Least probability of a misfit that is not attributed to the model.
_IMPROBABLE: Final = 1e-3
_COVERED: Final = 0.6827  # coverage of one standard deviation to each side
_SMALL: Final = 0.6  # largest initial radius of a load, over its clearance
_AT_ONCE: Final = 64
_GRID: Final = 0.08  # spacing of the matched filter's places, in radii of the sheet


@dataclass(frozen=True, slots=True, eq=False)
class LoadFits:
    """Fits of n frames with derived quantities, as arrays.

    Parameters
    ----------
    fits : parameters, covariance (inflated where the misfit is the model's fault), misfits.
    finding : (n,) indices into :class:`~cbsr_qa.domain.readings.load_estimates.LoadFinding`'s order.
    detectability : (n,) d′.
    place_stderr_mm : (n,) root mean square over two axes.
    has_radius : (n,) mask of loads whose radius is determined.
    inflation, probability : (n,) inflation by the misfit, and its probability.
    explained, explained_unweighted : (n,) shares of the signal, weighed by its noise and not.
    """

    fits: Fits
    finding: Indices
    detectability: Array
    place_stderr_mm: Array
    has_radius: Mask
    inflation: Array
    probability: Array
    explained: Array
    explained_unweighted: Array


class LoadEstimator:
    """Estimates loads of one sensor.

    Parameters
    ----------
    model : readings of the sheet under a round load, at unit sheet conductance.
    readings : used readings, with their noise.
    expected_radius_mm : radius of the load: reference for resolving places and radii, and start of a fit.
    known : True if the load has exactly that radius, so that it is not estimated.
    """

    def __init__(
        self, model: RoundLoadModel, readings: MergedReadings, *, expected_radius_mm: float, known: bool
    ) -> None:
        if not 0 < expected_radius_mm < model.surroundings.radius_mm:
            raise NumericsError(f"a load of radius {expected_radius_mm} mm does not fit on the sheet")
        self.model = model
        self.readings = readings
        self.expected_radius_mm = expected_radius_mm
        self.known = known
        self._fitter = LoadFitter(model, readings)
        self._places, weak = _weak_loads(model, expected_radius_mm)
        self._patterns, self._size = _filters(readings.merge_frames(weak))

    def estimate(self, changes: Array, *, start_mm: Array | None = None) -> tuple[LoadEstimate, ...]:
        """Estimate one load in each frame.

        Parameters
        ----------
        changes : (n, m) changes of the used readings, at unit current and unit sheet conductance [V/A·S].
        start_mm : (n, 2) starting places, such as the blobs' centres of mass.

        Raises
        ------
        NumericsError
            If a reading is not finite or their number is wrong.
        """
        fitted = self.fit(changes, start_mm=start_mm)
        return tuple(self._estimate(fitted, number) for number in range(len(changes)))

    def fit(self, changes: Array, *, start_mm: Array | None = None) -> LoadFits:
        """Estimate as :meth:`estimate` does, as arrays."""
        changes = np.asarray(changes, dtype=np.float64)
        if changes.ndim != 2 or changes.shape[1] != int(self.readings.used.sum()):
            raise NumericsError(
                f"changes of shape {changes.shape} do not match the {int(self.readings.used.sum())} used readings"
            )
        if not np.isfinite(changes).all():
            raise NumericsError("a reading is not a finite number", remedy="leave its channel out of the readings")
        data = self.readings.merge_changes(changes)
        start, gain = self._start(data, start_mm)
        empty, count = (data**2).sum(axis=1), len(data)
        no = np.zeros(count, dtype=np.bool_)
        covariance, steps = np.zeros((count, 4, 4)), np.zeros(count, dtype=np.int64)
        fits = Fits(start, covariance, data.copy(), empty - gain, empty, steps, no, no, np.zeros(count))
        hopeful = np.flatnonzero(gain > _HOPELESS_GAIN)
        if hopeful.size:
            fitted = self._fitter.fit(data[hopeful], start[hopeful], square=False)
            fits = _with(fits, hopeful, fitted)
        if not self.known:
            fits = self._fit_sizes(data, fits)
        return self._judge(data, fits)

    def _start(self, data: Array, start_mm: Array | None) -> tuple[Array, Array]:
        """Better start of the given place and the best of the grid, (n, 4), and its explained share, (n,)."""
        match = data @ self._patterns.T
        best, frame_indices = np.abs(match).argmax(axis=1), np.arange(len(data))
        matched = match[frame_indices, best]
        place, strength = self._places[best], matched / self._size[best]
        if start_mm is not None:
            given_mm = np.asarray(start_mm, dtype=np.float64)
            clear_mask = (
                self.model.surroundings.clearance_mm(given_mm) > _GRID * self.model.surroundings.radius_mm / 2
            )
            given_mm = np.where(clear_mask[:, None], given_mm, place)
            patterns, size = _filters(
                self.readings.merge_frames(_weak_changes(self.model, given_mm, self.expected_radius_mm))
            )
            given_match = (data * patterns).sum(axis=1)
            better_mask = np.abs(given_match) > np.abs(matched)
            place = np.where(better_mask[:, None], given_mm, place)
            strength, matched = (
                np.where(better_mask, given_match / size, strength),
                np.where(better_mask, given_match, matched),
            )
        return np.column_stack([place, strength, np.full(len(data), self.expected_radius_mm**2)]), matched**2

    def _fit_sizes(self, data: Array, fits: Fits) -> Fits:
        detected_frames = np.flatnonzero(fits.empty_misfit - fits.misfit > DETECTED_GAIN)
        if not detected_frames.size:
            return fits
        sized_fits = self._fitter.fit(data[detected_frames], fits.parameters[detected_frames], square=True)
        return _with(fits, detected_frames, sized_fits)

    def _judge(self, data: Array, fits: Fits) -> LoadFits:
        unknowns = 3 if self.known else 4
        freedom = len(self.readings.weight) - unknowns
        probability = chdtrc(freedom, fits.misfit)
        inflation = np.where(probability < _IMPROBABLE, fits.misfit / freedom, 1.0)
        gain = (fits.empty_misfit - fits.misfit) / inflation
        detectability = np.sqrt(np.maximum(gain - unknowns, 0))
        explained_squares = fits.empty_misfit - fits.misfit
        unlike_mask = deviates_from_model(explained_squares, fits.misfit, freedom)
        seen_mask = (gain >= DETECTED_GAIN) & (detectability >= LEAST_DETECTABILITY) & fits.converged & ~unlike_mask
        covariance = self._covariance(fits, np.flatnonzero(seen_mask), detectability) * inflation[:, None, None]
        place = np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2)
        located_mask = seen_mask & (place <= _SHARE * _SPARE * self.expected_radius_mm)
        finding = np.where(unlike_mask, 3, np.where(gain < DETECTED_GAIN, 1, np.where(located_mask, 0, 2)))
        fits = replace(fits, covariance=covariance)
        has_radius = located_mask & (
            self._radius_stderr(fits, located_mask) <= _SHARE * _SPARE * self.expected_radius_mm
        )
        # Share (n,) of the readings' squares, each weighing alike, that the fits explain.
        variance = self.readings.weight**-2.0
        residual_squares = fits.residual**2 @ variance
        share_of_squares = share_explained(
            data**2 @ variance - residual_squares, residual_squares, float(variance.sum())
        )
        shares = share_explained(explained_squares, fits.misfit, freedom), share_of_squares
        return LoadFits(fits, finding, detectability, place, has_radius, inflation, probability, *shares)

    def _covariance(self, fits: Fits, seen: Indices, detectability: Array) -> Array:
        unsure = seen[detectability[seen] < SURE]
        if not unsure.size:
            return fits.covariance
        unsure_fits = Fits(*(getattr(fits, name)[unsure] for name in Fits.__slots__))
        spread = spread_covariance(self._fitter, unsure_fits, detectability[unsure], square=not self.known)
        return _replace_rows(fits.covariance, unsure, spread)

    def _radius_stderr(self, fits: Fits, located: Mask) -> Array:
        """Standard error of the radius at its expected value, (n,) [mm]; infinite without one."""
        stderr = np.full(len(located), np.inf)
        located_frames = np.flatnonzero(located)
        if self.known or not located_frames.size:
            return stderr
        expected_parameters = fits.parameters[located_frames].copy()
        expected_parameters[:, 3] = self.expected_radius_mm**2
        expected_parameters, *_ = self._fitter.limit_sizes(expected_parameters, square=True)
        variance = self._fitter.covariance(expected_parameters, square=True)[:, 3, 3]
        stderr[located_frames] = np.sqrt(variance) / (2 * self.expected_radius_mm)
        return stderr

    def _estimate(self, fitted: LoadFits, number: int) -> LoadEstimate:
        finding = tuple(LoadFinding)[fitted.finding[number]]
        is_located = finding is LoadFinding.LOCATED
        fits = fitted.fits
        covariance = fits.covariance[number]
        x_mm, y_mm, strength, square = fits.parameters[number].tolist()
        errors = np.sqrt(np.diag(covariance)).tolist()
        freedom = len(self.readings.weight) - (3 if self.known else 4)
        return LoadEstimate(
            finding=finding,
            why="" if is_located else self._why(finding, fitted, number),
            detectability=float(fitted.detectability[number]),
            place_mm=(x_mm, y_mm) if is_located else None,
            place_covariance_mm2=covariance[:2, :2].copy() if is_located else None,
            area_contrast_mm2=area_contrast(strength, errors[2]) if is_located else None,
            contrast=contrast_of(strength / square, errors[2] / square) if is_located and self.known else None,
            radius_mm=radius_of(square, errors[3], float(fits.excess[number])) if fitted.has_radius[number] else None,
            no_radius="" if fitted.has_radius[number] else self._why_no_radius(is_located, errors[3]),
            misfit=float(fits.misfit[number] / freedom),
            misfit_probability=float(fitted.probability[number]),
            inflation=float(fitted.inflation[number]),
            explained=float(fitted.explained[number]),
            explained_unweighted=float(fitted.explained_unweighted[number]),
            steps=int(fits.steps[number]),
        )

    def _why(self, finding: LoadFinding, fitted: LoadFits, number: int) -> str:
        if finding is LoadFinding.NOT_AS_MODELLED:
            return (
                f"one round load on the modelled sheet explains {fitted.explained[number]:.0%} of the readings'"
                f" signal; {LEAST_EXPLAINED:.0%} is needed: the sheet is not what the sensor type describes, or"
                " something else presses it"
            )
        if finding is LoadFinding.NOT_DETECTED:
            return "no load stands out of the noise of the readings"
        detectability, place = float(fitted.detectability[number]), float(fitted.place_stderr_mm[number])
        if not fitted.fits.converged[number]:
            return "the fit of a round load did not converge: there is more than one load, or none"
        allowed = _SHARE * self.expected_radius_mm
        factor = max(10 / max(detectability, 1e-3), place / allowed)
        return (
            f"a load is there (d′ {detectability:.1f}), but its position is uncertain by {place:.2g} mm;"
            f" averaging {ceil(factor**2)} times as many frames would resolve it"
        )

    def _why_no_radius(self, located: bool, square_error: float) -> str:
        if self.known:
            return "the radius was given"
        if not located:
            return "the load was not located"
        needed = sqrt(square_error / (2 * _SHARE))
        return f"at this place and strength a radius is resolved from {needed:.2g} mm up"


@lru_cache(maxsize=16)
def _weak_loads(model: RoundLoadModel, radius_mm: float) -> tuple[Array, Array]:
    """Places (p, 2) all over the sheet, and the response to a weak load of unit strength (p, drives, measures)."""
    spacing_mm = _GRID * model.surroundings.radius_mm
    left, right, bottom, top = model.surroundings.extent_mm
    axes = (
        np.arange(ceil(low / spacing_mm), floor(high / spacing_mm) + 1) * spacing_mm
        for low, high in ((left, right), (bottom, top))
    )
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    places = places[model.surroundings.clearance_mm(places) > spacing_mm / 2]
    return places, _weak_changes(model, places, radius_mm)


def _weak_changes(model: RoundLoadModel, places_mm: Array, radius_mm: float) -> Array:
    """Response to weak loads, smaller near an electrode."""
    clearance_mm = np.maximum(model.surroundings.clearance_mm(places_mm), 0.0)
    radius = np.minimum(radius_mm, _SMALL * clearance_mm)
    changes = np.empty((len(places_mm), *model.pattern.shape))
    order = np.argsort(-clearance_mm, kind="stable")  # places of similar clearance need similar numbers of terms
    for first in range(0, len(order), _AT_ONCE):
        batch = order[first : first + _AT_ONCE]
        changes[batch] = model.weak(places_mm[batch], radius[batch])
    return changes


def _filters(rows: Array) -> tuple[Array, Array]:
    """Rows (p, rows) scaled to unit length, and their lengths (p,)."""
    size: Array = np.maximum(np.linalg.norm(rows, axis=1), np.finfo(float).tiny)
    return rows / size[:, None], size


def area_contrast(strength_mm2: float, stderr_mm2: float) -> Estimated:
    """Area × contrast 2π s of a strength s, with contrast relative to the mean of both conductances [mm²]."""
    value, error = 2 * np.pi * strength_mm2, 2 * np.pi * stderr_mm2
    return Estimated(value, error, value - error, value + error)


def contrast_of(reflection: float, stderr: float) -> Estimated:
    """Contrast κ = 2μ/(1 − μ) of μ = (γ_i − γ)/(γ_i + γ), limited to values that leave a positive conductance."""
    low, value, high = (
        2 * mu / (1 - mu) for mu in np.clip([reflection - stderr, reflection, reflection + stderr], -1, 0.98)
    )
    return Estimated(float(value), float(2 * stderr / (1 - min(reflection, 0.98)) ** 2), float(low), float(high))


def radius_of(square_mm2: float, stderr_mm2: float, excess_mm2: float = 0.0) -> Estimated:
    """Radius Re √(q + iσ) of an estimate q ± σ of its square: never negative, and free of bias to second order.

    ``excess_mm2``: increase of the square without its bound; the interval then ends there.
    """
    value = sqrt((square_mm2 + sqrt(square_mm2**2 + stderr_mm2**2)) / 2)
    below, above = square_mm2 - stderr_mm2, square_mm2 + stderr_mm2
    if excess_mm2 > 0:
        outside = (1 - _COVERED) * ndtr(-excess_mm2 / stderr_mm2)
        below, above = square_mm2 + excess_mm2 + stderr_mm2 * float(ndtri(outside)), square_mm2
    return Estimated(value, stderr_mm2 / (2 * value), sqrt(max(below, 0.0)), max(sqrt(max(above, 0.0)), value))


def _with(fits: Fits, which: Indices, new: Fits) -> Fits:
    return Fits(*(_replace_rows(getattr(fits, name), which, getattr(new, name)) for name in Fits.__slots__))


def _replace_rows(values: NDArray, which: Indices, new: NDArray) -> NDArray:  # type: ignore[type-arg]
    changed = values.copy()
    changed[which] = new
    return changed
