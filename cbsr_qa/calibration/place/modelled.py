"""Place of a touch by the modelled sheet, and the explained share of the readings. In use it needs numpy alone."""

from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.place.mixture import LEVELS, quantile
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.goodness import ALLOWANCE, deviates_from_model
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_place import ModelledPlace
from cbsr_qa.domain.results.press_calibration import SheetRegistration

#: Exponent of signed powers of readings and templates before comparison: of 0.3 to 1 it has the smallest errors of
#: place on a sheet with spikes, and hardly any loss on one without.
_COMPRESSION: Final = 0.7
#: Equivalent number of independent readings of a press: residuals of a template are not noise but differences between
#: the sheet and its model, which are similar in many readings.
_INDEPENDENT: Final = 7.0
_MOST_ALIKE: Final = 0.9999
#: Number of parameters of a press: place and strength.
_UNKNOWNS: Final = 3
#: Number of parameters of a pose, fitted to two coordinates per press.
_POSE: Final = 4


class ModelledEstimator:
    """Locates touches by the modelled sheet, as it was registered.

    Parameters
    ----------
    model : templates of the sheet.
    registration : pose of the sheet in the frame of the presses.
    """

    def __init__(self, model: ModelledPlace, registration: SheetRegistration) -> None:
        self._model, self._registration = model, registration
        self._answers: Mask = np.asarray(model.templates.any(axis=0))
        self._templates: Array = model.templates[:, self._answers].astype(np.float64)
        self._bank = unit_rows(self._templates)

    @property
    def error_mm(self) -> float:
        """Root mean square distance of the presses that registered the sheet from where it places them.

        Times √(n / (n − 2)) for n presses, because the pose was fitted to them.
        """
        return float(np.sqrt(2 * self._model.variance_mm2))

    def __call__(self, changes: Array) -> Places:
        """Locate the touches of changes (n, m) of the calibrated readings, in their unit.

        Returns
        -------
        Places; ``misfit`` is the model's residual beyond noise over the allowed one, and places are flagged if it is
        exceeded, or the registration is not trusted.

        Raises
        ------
        CalibrationError
            If the number of readings differs.
        """
        if changes.ndim != 2 or changes.shape[1] != len(self._answers):
            raise CalibrationError(f"changes of the shape {changes.shape}; (n, {len(self._answers)}) is expected")
        changes = changes[:, self._answers]
        finite_mask: Mask = np.asarray(np.isfinite(changes).all(axis=1))
        changes = np.where(finite_mask[:, None], changes, 0.0)
        correlation = unit_rows(changes) @ self._bank.T
        place = self._registration.to_press_frame_mm(
            self._model.step_mm * interpolate_most_alike(self._model.node, correlation)
        )
        misfit, unlike_mask = self._misfit(changes, self._templates[correlation.argmax(axis=1)])
        flags = np.where(finite_mask, 0, int(Flag.UNREADABLE))
        flags |= np.where(unlike_mask | (not self._registration.trusted), int(Flag.NOT_AS_MODELLED), 0)
        covariance = self._model.variance_mm2 * np.eye(2) + self._registration.covariance_mm2(place)
        covariance *= self._model.widening
        return Places(np.where(finite_mask[:, None], place, np.nan), covariance, misfit, np.ones_like(misfit), flags)

    def _misfit(self, changes: Array, templates: Array) -> tuple[Array, Mask]:
        """Residual (n,) of the best templates over the allowed one, and whether it clearly exceeds it."""
        length = np.maximum((templates**2).sum(axis=1), np.finfo(np.float64).tiny)
        gain = (changes * templates).sum(axis=1) ** 2 / length
        residual_square = np.maximum((changes**2).sum(axis=1) - gain, 0.0)
        noise = self._model.noise**2
        freedom = templates.shape[1] - _UNKNOWNS if noise else 0
        unlike_mask = (
            deviates_from_model(gain, residual_square, freedom)
            if not noise
            else deviates_from_model(gain / noise, residual_square / noise, freedom)
        )
        allowed = np.maximum(ALLOWANCE * gain, np.finfo(np.float64).tiny)
        return np.maximum(residual_square - noise * freedom, 0.0) / allowed, unlike_mask


def with_variance(model: ModelledPlace, error_mm: Array, quantiles: Array) -> ModelledPlace:
    """Return a model whose regions cover the errors (n, 2) of the presses used to register its sheet.

    Parameters
    ----------
    quantiles : (2,) quantiles of dᵀΣ⁻¹d for regions of 68 and 95 %.
    """
    squares = (error_mm**2).sum(axis=1) * len(error_mm) / (len(error_mm) - _POSE / 2)
    variance = max(float(squares.mean()) / 2, np.finfo(np.float64).tiny)
    needed_quantiles = np.array([quantile(squares / variance, level) for level in LEVELS])
    return replace(model, variance_mm2=variance, widening=float(np.max(needed_quantiles / quantiles)))


def unit_rows(rows: Array) -> Array:
    """Rows (…, m), compressed and of unit length."""
    compressed = np.sign(rows) * np.abs(rows) ** _COMPRESSION
    length = np.linalg.norm(compressed, axis=-1, keepdims=True)
    unit: Array = compressed / np.maximum(length, np.finfo(np.float64).tiny)
    return unit


def log_likelihood(alike: Array) -> Array:
    """Log likelihood of presses by the cosines of their readings and a template, up to a constant."""
    positive = np.clip(alike, 0.0, _MOST_ALIKE)
    return -_INDEPENDENT / 2 * np.log1p(-(positive**2))


def log_likelihood_slopes(alike: Array) -> tuple[Array, Array]:
    """First and second derivative of :func:`log_likelihood`."""
    inside_mask = (alike > 0) & (alike < _MOST_ALIKE)
    unexplained = 1 - np.clip(alike, 0.0, _MOST_ALIKE) ** 2
    first, second = _INDEPENDENT * alike / unexplained, _INDEPENDENT * (2 - unexplained) / unexplained**2
    return np.where(inside_mask, first, 0.0), np.where(inside_mask, second, 0.0)


def interpolate_most_alike(node: Indices, alike: Array) -> Array:
    """Most likely place (n, 2) of each press in steps of a lattice, interpolated by parabolas.

    Parameters
    ----------
    node : (k, 2) columns and rows of the lattice.
    alike : (n, k) cosines of readings and templates.
    """
    lowest_node = node.min(axis=0) - 1
    number = np.full(node.max(axis=0) - lowest_node + 2, -1)
    number[tuple((node - lowest_node).T)] = np.arange(len(node))
    best, press = alike.argmax(axis=1), np.arange(len(alike))
    place: Array = node[best].astype(np.float64)
    middle = log_likelihood(alike[press, best])
    for axis, step in enumerate(np.eye(2, dtype=np.int64)):
        neighbours = [number[tuple((node[best] - lowest_node + side * step).T)] for side in (-1, 1)]
        below, above = (log_likelihood(alike[press, neighbour]) for neighbour in neighbours)
        curvature = below + above - 2 * middle
        interpolated_mask = (neighbours[0] >= 0) & (neighbours[1] >= 0) & (curvature < 0)
        move = np.where(interpolated_mask, (below - above) / np.where(curvature < 0, 2 * curvature, -1.0), 0.0)
        place[:, axis] += np.clip(move, -0.5, 0.5)
    return place
