"""Frames in, places out: a learned place in use. Needs numpy alone."""

from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.faults import FrameFaults
from cbsr_qa.calibration.force.inverse import LEFT_OUT, Flag
from cbsr_qa.calibration.place.faulty import MOST_FAULTY, FaultyGroups
from cbsr_qa.calibration.place.features import (
    LEAST_LIKENESS,
    compute_squared_distances,
    features_of,
    more_than_spikes,
    size_factors,
    spikes_in,
    strengths,
)
from cbsr_qa.calibration.place.held_out import evenly
from cbsr_qa.calibration.place.mixture import mix_places
from cbsr_qa.calibration.place.modelled import ModelledEstimator
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.calibration.place.process import locate
from cbsr_qa.calibration.place.templates import fill_missing, interpolate_at_places, likeness, match, predict_features
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_place import LearnedPlace

_AT_ONCE: Final = 256  # frames at a time, to limit memory
#: Number of presses that tell what lost readings cost, and of sets of lost readings whose cost is kept.
_PRESSES: Final = 100
_KEPT: Final = 32
#: The modelled sheet is not trusted beyond the presses if it misses them by more than the spacing of neighbouring
#: presses, a quarter of their reach, and by more than so many times as much as what was learned. Of 32 simulated
#: sheets it is not trusted on ten: the six elliptic ones, the three that conduct three times better along one
#: direction, and one of three uneven ones.
_MISSED_REACH: Final = 0.25
_MISSED_TIMES: Final = 10.0
#: The modelled sheet's place is not used for frames with one of these flags: it is compared with all readings.
_NOT_MODELLED: Final = int(Flag.NOT_DETECTED | Flag.UNREADABLE | Flag.MISSING | Flag.OFFSET) | LEFT_OUT
#: Value of dᵀΣ⁻¹d that holds 68 % of a normal distribution over two axes.
_NORMAL_68: Final = float(-2 * np.log(1 - 0.68))


class PlaceEstimator:
    """Locates touches with a model learned from presses.

    Parameters
    ----------
    model : model learned from the presses.
    modelled : model of the sheet, used for touches beyond the presses that it explains and ``model`` does not.
    pairs : (m, 4) source, sink, plus and minus of the readings, to find faulty pairs and electrodes.
    held_out_mm : mean error of presses left out, if known. ``modelled`` is not used if it misses the presses by many
        times as much.

    Attributes
    ----------
    q68, q95 : quantiles of dᵀΣ⁻¹d; see :class:`Places`.
    """

    def __init__(
        self,
        model: LearnedPlace,
        modelled: ModelledEstimator | None = None,
        pairs: Indices | None = None,
        held_out_mm: float | None = None,
    ) -> None:
        self._groups = None if pairs is None else FaultyGroups(pairs)
        self._model, self._modelled = model, modelled
        if modelled is not None and held_out_mm is not None:
            most_mm = max(_MISSED_REACH * model.reach_mm, _MISSED_TIMES * held_out_mm)
            self._modelled = modelled if modelled.error_mm <= most_mm else None
        self._kept: dict[bytes, tuple[Array, float]] = {}
        self._expected = predict_features(model.templates)
        self.q68, self.q95 = model.mixture.quantiles.tolist()

    def __call__(self, changes: Array, faults: FrameFaults | None = None) -> Places:
        """Locate the touches of changes (n, m) of the learned readings, in their unit.

        Readings that are not finite, spikes and readings of faulty groups are replaced by the values that the others
        predict, and flagged; frames with more than half of their readings lost are UNREADABLE.

        Parameters
        ----------
        faults : found in the whole frames, whose readings are left out too.

        CalibrationError if the number of readings differs.
        """
        readings = len(self._model.scaling.ceiling)
        if changes.ndim != 2 or changes.shape[1] != readings:
            raise CalibrationError(f"changes of the shape {changes.shape}; (n, {readings}) is expected")
        if faults is None:
            faults = FrameFaults(np.zeros(changes.shape, dtype=np.bool_), np.zeros(len(changes), dtype=np.int64))
        starts = range(0, max(len(changes), 1), _AT_ONCE)
        several = [slice(first, first + _AT_ONCE) for first in starts]
        parts = [self._locate(changes[batch], faults.left_out[batch], faults.flags[batch]) for batch in several]
        places = Places(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        return places if self._modelled is None else self._fill_beyond(places, self._modelled(changes))

    def _fill_beyond(self, places: Places, modelled: Places) -> Places:
        """Use the modelled sheet for touches that it explains beyond the presses, and the learned places do not."""
        learned_mask = places.in_model & ((places.flags & int(Flag.OUTSIDE)) == 0)
        unfit_mask = (places.flags & _NOT_MODELLED) != 0
        modelled_mask = modelled.in_model & self._outside(modelled.place_mm) & ~learned_mask & ~unfit_mask
        flags = np.where(modelled_mask, places.flags & ~int(Flag.MORE_THAN_ONE) | int(Flag.OUTSIDE), places.flags)
        place = np.where(modelled_mask[:, None], modelled.place_mm, places.place_mm)
        covariance = np.where(modelled_mask[:, None, None], modelled.covariance_mm2, places.covariance_mm2)
        misfit = np.where(modelled_mask, modelled.misfit, places.misfit)
        return replace(places, place_mm=place, covariance_mm2=covariance, misfit=misfit, flags=flags)

    def _outside(self, place_mm: Array) -> Mask:
        """Mask (n,) of places (n, 2), in the frame of the presses, that are far from all presses."""
        model = self._model
        centred_mm = (place_mm - model.centre_mm) @ model.axes.T
        nearest = np.sqrt(compute_squared_distances(centred_mm, model.process.places_mm).min(axis=1, initial=np.inf))
        return np.asarray(nearest > model.reach_mm)

    def _locate(
        self, changes: Array, left_out: Mask, faults: Indices
    ) -> tuple[Array, Array, Array, Array, Indices, Array]:
        model = self._model
        used_mask = model.scaling.ceiling > 0
        lost_mask, remarks = self._find_lost(changes, left_out)
        readable_mask: Mask = np.asarray(lost_mask[:, used_mask].mean(axis=1) <= MOST_FAULTY)
        lost_mask &= readable_mask[:, None]
        changes = np.where(readable_mask[:, None] & used_mask & ~lost_mask, changes, 0.0)
        features = features_of(changes, model.scaling)
        heavy_loss_mask = more_than_spikes(lost_mask, used_mask)
        spiky_mask, size_ratio = lost_mask.any(axis=1) & ~heavy_loss_mask, np.ones(len(features))
        features[spiky_mask] = fill_missing(
            model.templates, self._expected, features[spiky_mask], lost_mask[spiky_mask]
        )
        features[heavy_loss_mask], size_ratio[heavy_loss_mask] = self._replace_lost(
            features[heavy_loss_mask], lost_mask[heavy_loss_mask]
        )
        place, covariance, misfit = self._mix(features)
        log_strength_error = np.zeros(len(features))
        for frame in np.flatnonzero(heavy_loss_mask).tolist():
            extra_covariance, log_strength_error[frame] = self._unsure(lost_mask[frame])
            covariance[frame] += extra_covariance
        size = np.sqrt((changes**2).sum(axis=1) / (~lost_mask).sum(axis=1))
        touch_flags = np.where(size < model.least_size, int(Flag.NOT_DETECTED), 0)
        touch_flags |= np.where(misfit > model.misfit, int(Flag.MORE_THAN_ONE), 0)
        touch_likeness = interpolate_at_places(model.templates.grid_mm, likeness(self._expected, features), place)
        place = place @ model.axes + model.centre_mm
        touch_flags |= np.where(self._outside(place), int(Flag.OUTSIDE), 0)
        flags = faults | remarks | np.where(readable_mask, touch_flags, int(Flag.UNREADABLE))
        place = np.where(readable_mask[:, None], place, np.nan)
        turned = model.axes.T @ covariance @ model.axes
        strength = strengths(changes, touch_likeness / size_ratio, model.scaling)
        return place, turned, misfit / model.misfit, strength, flags, log_strength_error

    def _unsure(self, lost: Mask) -> tuple[Array, float]:
        """Uncertainty that a frame gains without some readings (m,).

        From presses that were learned from, found without these readings, and with them: the covariance (2, 2) of
        the place, and the standard deviation of the logarithm of the strength.
        """
        key = lost.tobytes()
        if key not in self._kept:
            while len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            process, scaling = self._model.process, self._model.scaling
            full_features = process.features[evenly(len(process.features), _PRESSES)]
            known_features = np.where(lost, 0.0, full_features)
            # A frame without these readings is divided by the size of its known ones.
            known_size_ratio = size_factors(known_features, full_features, scaling)
            filled_features, filled_size_ratio = self._replace_lost(
                known_features / known_size_ratio[:, None], np.tile(lost, (len(full_features), 1))
            )
            (filled_place, filled_likeness), (full_place, full_likeness) = (
                self._match(features) for features in (filled_features, full_features)
            )
            displacement = filled_place - full_place
            log_strength_error = (
                np.log(filled_likeness * known_size_ratio / (filled_size_ratio * full_likeness)) / scaling.exponent
            )
            covariance = displacement.T @ displacement / len(displacement) * (_NORMAL_68 / self.q68)
            self._kept[key] = covariance, float(np.sqrt((log_strength_error**2).mean()))
        return self._kept[key]

    def _match(self, features: Array) -> tuple[Array, Array]:
        """Places (n, 2) about the centre, and the likeness (n,) to the templates there."""
        place, grid_likeness = self._mix(features)[0], likeness(self._expected, features)
        return place, np.maximum(
            interpolate_at_places(self._model.templates.grid_mm, grid_likeness, place), LEAST_LIKENESS
        )

    def _replace_lost(self, features: Array, lost: Mask) -> tuple[Array, Array]:
        """Features (n, m) whose lost ones are replaced, and the factors (n,) that bring them to their new size."""
        known_features = np.where(lost, 0.0, features)
        filled_features = fill_missing(self._model.templates, self._expected, known_features, lost)
        factor = size_factors(known_features, filled_features, self._model.scaling)
        return filled_features * factor[:, None], factor

    def _mix(self, features: Array) -> tuple[Array, Array, Array]:
        """Places (n, 2) about the centre, their covariances and misfits."""
        model = self._model
        second, covariance, misfit = match(model.templates, features)
        first = locate(model.process, model.turns, features)
        return (*mix_places(model.mixture, first, second, covariance), misfit)

    def _find_lost(self, changes: Array, left_out: Mask) -> tuple[Mask, Indices]:
        """Readings (n, m) of frames that say nothing, and flags (n,); ``left_out`` is (n, m)."""
        ceiling = self._model.scaling.ceiling
        missing_mask: Mask = (ceiling > 0) & ~np.isfinite(changes)
        flags: Indices = np.where(missing_mask.any(axis=1), int(Flag.MISSING), 0).astype(np.int64)
        lost_mask: Mask = missing_mask | ((ceiling > 0) & left_out)
        changes = np.where(lost_mask | ~np.isfinite(changes), 0.0, changes)
        spike_mask: Mask = (ceiling > 0) & spikes_in(changes, ceiling)
        flags |= np.where(spike_mask.any(axis=1), int(Flag.SPIKE), 0)
        if self._groups is not None:
            faulty_mask, faults = self._groups(changes, ceiling, lost_mask, spike_mask)
            lost_mask, flags = lost_mask | faulty_mask, flags | faults
        return lost_mask | spike_mask, flags
