"""Places of one head, learned from a run's presses, for frames like these presses."""

from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.results.learned_place import LearnedPlace

#: Value of dᵀΣ⁻¹d that holds 68.27 % of a normal distribution over two axes.
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
    merging : (r, m) merging of readings into rows [1/V].
    """

    def __init__(self, learned: LearnedPlace, merging: Array) -> None:
        self._locate, self._merging = PlaceEstimator(learned), merging

    def __call__(self, rows: Array, found: Matches, modelled: Matches, finder: TemplateFilter) -> Matches:
        """Matches of rows (n, r): at the learned place if the frame is like the presses, else those by the model.

        A frame is unlike them if it has no load, readings unlike those of one press (noisy, or of two heads), or a
        place beyond the presses.

        Parameters
        ----------
        found : matches by the templates of the model, with the noise of the rows alone.
        modelled : the same matches with the scatter of the model's places.
        """
        detected_frames = np.flatnonzero(found.gain >= finder.threshold**2)
        places = self._locate(row_readings(rows[detected_frames], self._merging))
        learned_matches = finder.match_at(rows[detected_frames], places.place_mm)
        like_mask: Mask = (
            places.in_model & ((places.flags & int(Flag.OUTSIDE)) == 0) & np.isfinite(learned_matches.strength)
        )
        place_covariance = (
            self._locate.q68 / _ONE_SIGMA * places.covariance_mm2 + found.covariance[detected_frames, 1:, 1:]
        )
        # A head misplaced to where changes are larger seems weaker.
        directions = np.empty((len(detected_frames), 3, 2))
        directions[:, 0], directions[:, 1:] = (
            -learned_matches.strength[:, None] * finder.size_slope(places.place_mm),
            np.eye(2),
        )
        covariance = learned_matches.covariance + directions @ place_covariance @ directions.transpose(0, 2, 1)
        learned_fields = {"place_mm": places.place_mm, "strength": learned_matches.strength, "covariance": covariance}
        merged_fields: dict[str, Array] = {}
        for name, values in learned_fields.items():
            merged_fields[name] = getattr(modelled, name).copy()
            merged_fields[name][detected_frames[like_mask]] = values[like_mask]
        return replace(modelled, **merged_fields)
