"""Places of one head by what a run's presses taught, for frames like these presses."""

from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.results.learned_place import LearnedPlace

#: Of dᵀΣ⁻¹d that holds 68.27 % of a normal distribution over two axes.
_ONE_SIGMA: Final = -2 * np.log(1 - 0.6827)


def row_readings(rows: Array, merging: Array) -> Array:
    """Readings [V] of rows (n, r) of unit noise: reciprocal ones averaged.

    Parameters
    ----------
    merging : (r, m) [1/V] as in :class:`~cbsr_qa.domain.results.calibration.ForceModel`.
    """
    readings: Array = rows / np.abs(merging).sum(axis=1)
    return readings


class PressedPlace:
    """Locates single heads by a learned place.

    Parameters
    ----------
    learned : place, of the readings of the rows (:func:`row_readings`).
    merging : of the rows.
    """

    def __init__(self, learned: LearnedPlace, merging: Array) -> None:
        self._locate, self._merging = PlaceEstimator(learned), merging

    def __call__(self, rows: Array, found: Matches, modelled: Matches, finder: TemplateFilter) -> Matches:
        """Matches of rows (n, r): at the learned place if the frame is like the presses, else those by the model.

        A frame is not if it has no load, readings unlike those of one press (noisy, or of two heads), or a place
        beyond the presses.

        Parameters
        ----------
        found : by the templates of the model, with the noise of the rows alone.
        modelled : the same with the scatter of the model's places.
        """
        there = np.flatnonzero(found.gain >= finder.threshold**2)
        places = self._locate(row_readings(rows[there], self._merging))
        at = finder.match_at(rows[there], places.place_mm)
        like: Mask = places.in_model & ((places.flags & int(Flag.OUTSIDE)) == 0) & np.isfinite(at.strength)
        spread = self._locate.q68 / _ONE_SIGMA * places.covariance_mm2 + found.covariance[there, 1:, 1:]
        # A head misplaced to where changes are larger seems weaker.
        towards = np.empty((len(there), 3, 2))
        towards[:, 0], towards[:, 1:] = -at.strength[:, None] * finder.size_slope(places.place_mm), np.eye(2)
        covariance = at.covariance + towards @ spread @ towards.transpose(0, 2, 1)
        better = {"place_mm": places.place_mm, "strength": at.strength, "covariance": covariance}
        changed: dict[str, Array] = {}
        for name, values in better.items():
            changed[name] = getattr(modelled, name).copy()
            changed[name][there[like]] = values[like]
        return replace(modelled, **changed)
