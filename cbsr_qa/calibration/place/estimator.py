"""Frames in, places out: a learned place in use. Needs numpy alone."""

from typing import Final

import numpy as np

from cbsr_qa.calibration.place.features import features_of, spikes_in, squared_distances, strengths
from cbsr_qa.calibration.place.mixture import mixed
from cbsr_qa.calibration.place.modelled import ModelledEstimator
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.calibration.place.process import located
from cbsr_qa.calibration.place.templates import at_places, expected_features, filled, likeness, match
from cbsr_qa.calibration.runtime import Flag
from cbsr_qa.domain import Array, CalibrationError, Indices, Mask
from cbsr_qa.domain.results import LearnedPlace

_AT_ONCE: Final = 256  # frames at a time, to limit memory


class PlaceEstimator:
    """Locates touches with a model learned from presses.

    Parameters
    ----------
    model : as learned.
    modelled : used where it explains a touch beyond the presses.

    Attributes
    ----------
    q68, q95 : of dᵀΣ⁻¹d; see :class:`Places`.
    """

    def __init__(self, model: LearnedPlace, modelled: ModelledEstimator | None = None) -> None:
        self._model, self._modelled = model, modelled
        self._expected = expected_features(model.templates)
        self.q68, self.q95 = model.mixture.quantiles.tolist()

    def __call__(self, changes: Array) -> Places:
        """Locate the touches of changes (n, m) of the learned readings, in their unit.

        CalibrationError if the number of readings differs.
        """
        readings = len(self._model.scaling.ceiling)
        if changes.ndim != 2 or changes.shape[1] != readings:
            raise CalibrationError(f"changes of the shape {changes.shape}; (n, {readings}) is expected")
        parts = [self._located(changes[first : first + _AT_ONCE]) for first in range(0, len(changes), _AT_ONCE)]
        if not parts:
            parts = [self._located(np.zeros((0, readings)))]
        places = Places(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        return places if self._modelled is None else self._beyond(places, self._modelled(changes))

    def _beyond(self, places: Places, modelled: Places) -> Places:
        """Use the modelled sheet for touches that it explains and that lie beyond the presses."""
        beyond = modelled.in_model & self._outside(modelled.place_mm)
        silent = (places.flags & int(Flag.NOT_DETECTED | Flag.UNREADABLE)) != 0
        taken = beyond & ~silent
        flags = np.where(taken, int(Flag.OUTSIDE), places.flags)
        place = np.where(taken[:, None], modelled.place_mm, places.place_mm)
        covariance = np.where(taken[:, None, None], modelled.covariance_mm2, places.covariance_mm2)
        return Places(place, covariance, np.where(taken, modelled.misfit, places.misfit), places.strength, flags)

    def _outside(self, place_mm: Array) -> Mask:
        """Which places (n, 2) in the frame of the presses are far from all of them."""
        model = self._model
        about = (place_mm - model.centre_mm) @ model.axes.T
        nearest = np.sqrt(squared_distances(about, model.process.places_mm).min(axis=1, initial=np.inf))
        outside: Mask = np.asarray(nearest > model.reach_mm)
        return outside

    def _located(self, changes: Array) -> tuple[Array, Array, Array, Array, Indices]:
        model = self._model
        used = model.scaling.ceiling > 0
        whole: Mask = np.asarray(np.isfinite(changes[:, used]).all(axis=1))
        spikes = whole[:, None] & used & spikes_in(changes, model.scaling.ceiling)
        changes = np.where(whole[:, None] & used & ~spikes, changes, 0.0)
        features = features_of(changes, model.scaling)
        spiky = spikes.any(axis=1)
        features[spiky] = filled(model.templates, features[spiky], spikes[spiky])
        second, covariance, misfit = match(model.templates, features)
        place, covariance = mixed(model.mixture, located(model.process, model.turns, features), second, covariance)
        flags = np.where(whole, 0, int(Flag.UNREADABLE))
        flags |= np.where(np.sqrt((changes**2).mean(axis=1)) < model.least_size, int(Flag.NOT_DETECTED), 0)
        flags |= np.where(misfit > model.misfit, int(Flag.MORE_THAN_ONE), 0)
        like = at_places(model.templates.grid_mm, likeness(self._expected, features), place)
        place = place @ model.axes + model.centre_mm
        flags |= np.where(self._outside(place), int(Flag.OUTSIDE), 0)
        place = np.where(whole[:, None], place, np.nan)
        turned = model.axes.T @ covariance @ model.axes
        return place, turned, misfit / model.misfit, strengths(changes, like, model.scaling), flags
