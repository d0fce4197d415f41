"""Frames in, places out: a learned place in use. Needs numpy alone."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.features import features_of, spikes_in, squared_distances
from cbsr_qa.calibration.place.mixture import mixed
from cbsr_qa.calibration.place.process import located
from cbsr_qa.calibration.place.templates import match
from cbsr_qa.calibration.runtime import Flag
from cbsr_qa.domain import Array, CalibrationError, Indices, Mask
from cbsr_qa.domain.results import LearnedPlace

_AT_ONCE: Final = 256  # frames; what is held beside them stays small


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where n frames are pressed, in the frame of the presses that were learned from.

    Parameters
    ----------
    place_mm : (n, 2); NaN where a reading is missing.
    covariance_mm2 : (n, 2, 2) Σ; the region of 68 % is all d with dᵀΣ⁻¹d at most ``q68`` of the estimator.
    misfit : (n,) squared misfit per reading over what a touch like those learned from has at most.
    flags : (n,) of :class:`~cbsr_qa.calibration.Flag`.
    """

    place_mm: Array
    covariance_mm2: Array
    misfit: Array
    flags: Indices

    @property
    def in_model(self) -> Mask:
        """Whether each frame (n,) is one touch like those learned from."""
        beside = int(Flag.NOT_DETECTED | Flag.MORE_THAN_ONE | Flag.UNREADABLE)
        inside: Mask = (self.flags & beside) == 0
        return inside


class PlaceEstimator:
    """Locates touches with what was learned from presses.

    Attributes
    ----------
    q68, q95 : of dᵀΣ⁻¹d; see :class:`Places`.
    """

    def __init__(self, model: LearnedPlace) -> None:
        self._model = model
        self.q68, self.q95 = model.mixture.quantiles.tolist()

    def __call__(self, changes: Array) -> Places:
        """Locate the touches of changes (n, m) of the learned readings, in their unit.

        Raises
        ------
        CalibrationError
            If they are of another number of readings.
        """
        readings = len(self._model.scaling.ceiling)
        if changes.ndim != 2 or changes.shape[1] != readings:
            raise CalibrationError(f"changes of the shape {changes.shape}; (n, {readings}) is expected")
        parts = [self._located(changes[first : first + _AT_ONCE]) for first in range(0, len(changes), _AT_ONCE)]
        if not parts:
            parts = [self._located(np.zeros((0, readings)))]
        return Places(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _located(self, changes: Array) -> tuple[Array, Array, Array, Indices]:
        model = self._model
        used = model.scaling.ceiling > 0
        whole: Mask = np.asarray(np.isfinite(changes[:, used]).all(axis=1))
        sound = whole[:, None] & used & ~spikes_in(changes, model.scaling.ceiling)
        changes = np.where(sound, changes, 0.0)
        features = features_of(changes, model.scaling)
        second, covariance, misfit = match(model.templates, features)
        place, covariance = mixed(model.mixture, located(model.process, model.turns, features), second, covariance)
        flags = np.where(whole, 0, int(Flag.UNREADABLE))
        flags |= np.where(np.sqrt((changes**2).mean(axis=1)) < model.least_size, int(Flag.NOT_DETECTED), 0)
        flags |= np.where(misfit > model.misfit, int(Flag.MORE_THAN_ONE), 0)
        nearest = np.sqrt(squared_distances(place, model.process.places_mm).min(axis=1, initial=np.inf))
        flags |= np.where(nearest > model.reach_mm, int(Flag.OUTSIDE), 0)
        place = np.where(whole[:, None], place @ model.axes + model.centre_mm, np.nan)
        turned = model.axes.T @ covariance @ model.axes
        return place, turned, misfit / model.misfit, flags
