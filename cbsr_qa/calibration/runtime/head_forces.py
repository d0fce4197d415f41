"""Forces of heads that press on one calibrated sensor, each in one frame. Needs only numpy and scipy."""

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.force.inverse import (
    LARGEST,
    NO_FORCE,
    Flag,
    ForceInverse,
    Forces,
    SeveralForces,
    SizeError,
    forces_together,
    join_forces,
    least_force_N,
    make_empty_frame,
    map_tables,
    range_flags,
)
from cbsr_qa.calibration.force.multi_load import HeadCounter, Heads
from cbsr_qa.calibration.force.shared_error import SharedError
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter, add_scatter
from cbsr_qa.calibration.runtime.fewer_readings import BY_OFFSET, LEAST_OFFSET
from cbsr_qa.calibration.runtime.frames import SensorFrames
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.goodness import deviates_from_model
from cbsr_qa.domain.numbers import Array, Indices, Mask, real_numbers
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import ForceModel

if TYPE_CHECKING:
    pass

#: Detectability of a load at a given place.
_CLEAR: Final = 3.0
#: Least share of a load's signal, as energy, explained by no head, for a frame to show something else.
_UNLIKE: Final = 0.04
#: A second head weaker than this share of the first is a residue: material relaxations are down to some 6 % a minute
#: after a release.
_LEFT_BEHIND: Final = 0.06
#: A frame is searched for several heads if a second one explains this share of the threshold for one.
_SUSPICIOUS: Final = 0.4
#: Least distance between two heads, of their diameter: they are soft, and estimates of places err.
_NEAREST: Final = 0.8
#: Number of heads with cached templates.
_HEADS: Final = 8


class HeadForces(SensorFrames):
    """Turns frames of one sensor into forces, by the model of its calibration.

    CalibrationError if that has no force model.
    """

    def _compare(self, model: ForceModel) -> None:
        super()._compare(model)
        self._filters: dict[float, TemplateFilter] = {}
        self.filter: TemplateFilter = self._filter(self.issued.indenter)
        area_mm2, line = self.issued.indenter.area_mm2, self.issued.against_stress
        self.inverse = ForceInverse(model, line, area_mm2, map_tables(model))
        self.sign = float(np.sign(line.slope.value))
        self.shared_error = SharedError(self.issued.standards, self.issued.indenter)
        self._size_error = SizeError(model, self.issued.indenter.radius_mm)
        # It was learned from all readings.
        learned = self.issued.place if model is self.issued.force else None
        if learned is None:
            self._pressed = None
        else:
            # Here because it imports for a second, and few calibrations have a learned place.
            from cbsr_qa.calibration.runtime.pressed_place import PressedPlace

            self._pressed = PressedPlace(learned.learned, model.merging)
        self.least_force_N = self._least_force_N()

    def force(
        self,
        frames: ArrayLike,
        *,
        place_mm: ArrayLike | None = None,
        indenter: Indenter | None = None,
        current_A: float | None = None,
    ) -> Forces:
        """Force of one head in each frame.

        Its place is by the model of the sheet or, if the calibration has one, by the place learned from the run's
        presses, for frames like these.

        Parameters
        ----------
        frames : (n, drives, measures) or (drives, measures) [V], in the order of the sensor type's pattern. Frames
            are independent: settling and residues of earlier loads are not corrected. A masked reading counts as NaN.
        place_mm : (2,) or (n, 2) place of the head, from the sheet's centre; by default it is estimated.
        indenter : head, if not the calibrating one.
        current_A : drive current of the frames, if not the calibration's.

        Returns
        -------
        Forces of n frames; n is 1 for a single frame.

        Raises
        ------
        CalibrationError
            If the frames do not have this sensor's shape, the number of places differs, or the current is not
            positive.
        NumericsError
            If frames or places are not real numbers (complex, text).
        """
        voltages = self.voltages(frames, current_A)
        head = self.issued.indenter if indenter is None else indenter
        places = None if place_mm is None else self._places(place_mm, len(voltages))
        forces_by_part = []
        for usable, frame_indices, flags in self.sound_parts(voltages):
            changes, bad_flags = usable.changes_of(voltages[frame_indices])
            part_places = places if places is None or places.ndim == 1 else places[frame_indices]
            forces_by_part.append((frame_indices, usable._force(changes, bad_flags | flags, part_places, head)))
        return self.shared_error.add(join_forces(forces_by_part), other_head=head != self.issued.indenter)

    def _force(self, changes: Array, bad: Indices, places: Array | None, head: Indenter) -> Forces:
        finder, rows = self._filter(head), changes @ self._merging
        matches = finder.search(rows) if places is None else finder.match_at(rows, places)
        offset_mask = self.moved(changes, matches, head)
        if offset_mask.any():
            forces_by_part = []
            for usable, flag, part_mask in ((self, 0, ~offset_mask), (self.level(), int(Flag.OFFSET), offset_mask)):
                part_places = places if places is None or places.ndim == 1 else places[part_mask]
                forces = usable._force(changes[part_mask], bad[part_mask] | flag, part_places, head)
                forces_by_part.append((np.flatnonzero(part_mask), forces))
            return join_forces(forces_by_part)
        other_strength = self._measure_further_heads(rows, matches, finder)
        if places is None:
            widened = finder.ambiguous(rows, matches) if self._fewer else matches
            modelled = add_scatter(widened, finder.size_slope(widened.place_mm), self.model.place_scatter_mm)
            learned = None if finder is not self.filter else self._pressed  # it was learned with the calibrating head
            matches = modelled if learned is None else learned(rows, matches, modelled, finder)
        return self._forces(self._scale_to_area(matches, head), bad, other_strength, head, searched=places is None)

    def forces(
        self,
        frames: ArrayLike,
        *,
        at_most: int = 3,
        indenter: Indenter | None = None,
        current_A: float | None = None,
    ) -> tuple[SeveralForces, ...]:
        """Forces of all heads in each frame, fitted together (:mod:`cbsr_qa.calibration.force.multi_load`).

        Takes tens of milliseconds for a frame with several heads, a few for one with a residual to examine.

        Parameters
        ----------
        frames, indenter, current_A : arguments of :meth:`force`; all heads are equal.
        at_most : largest number of heads that are searched for.

        Raises
        ------
        CalibrationError, NumericsError
            As for :meth:`force`, and if ``at_most`` is below 1.
        """
        if not (isinstance(at_most, int) and at_most >= 1):
            raise CalibrationError(f"{at_most} heads cannot be searched for", remedy="look for at least 1")
        voltages = self.voltages(frames, current_A)
        head = self.issued.indenter if indenter is None else indenter
        forces_by_frame: dict[int, SeveralForces] = {}
        for usable, frame_indices, flags in self.sound_parts(voltages):
            changes, bad_flags = usable.changes_of(voltages[frame_indices])
            forces_by_frame |= dict(
                zip(
                    frame_indices.tolist(),
                    usable._estimate_several(changes, bad_flags | flags, at_most, head),
                    strict=True,
                )
            )
        return tuple(forces_by_frame[frame] for frame in range(len(voltages)))

    def _estimate_several(self, changes: Array, bad: Indices, at_most: int, head: Indenter) -> list[SeveralForces]:
        finder, rows = self._filter(head), changes @ self._merging
        matches = finder.search(rows)
        least_gain = self.model.threshold**2
        several_mask = finder.match_beside(rows, matches.place_mm, matches.strength)[0] >= _SUSPICIOUS * least_gain
        offset_mask = self.moved(changes, matches, head)
        counter = HeadCounter(
            finder, threshold=self.model.threshold, misfit=self.model.misfit, diameter_mm=head.diameter_mm
        )
        several_forces = []
        for frame, flag in enumerate(bad.tolist()):
            if flag & NO_FORCE:
                frame_forces = make_empty_frame(np.nan, np.nan, Flag(flag))
            elif offset_mask[frame]:
                single_frame = slice(frame, frame + 1)
                frame_forces = self.level()._estimate_several(
                    changes[single_frame], bad[single_frame] | int(Flag.OFFSET), at_most, head
                )[0]
            elif matches.gain[frame] < least_gain and not several_mask[frame]:
                frame_forces = make_empty_frame(0.0, self.least_force_N, Flag.NOT_DETECTED)
            else:
                most_heads = at_most if several_mask[frame] else 1
                heads, unexplained = counter.heads(rows[frame], matches.place_mm[frame], most_heads)
                frame_forces = self._combine_heads(heads, unexplained if several_mask[frame] else 0.0, finder, head)
            several_forces.append(replace(frame_forces, flags=frame_forces.flags | Flag(flag)))
        return several_forces

    def _combine_heads(
        self, heads: Heads | None, unexplained: float, finder: TemplateFilter, head: Indenter
    ) -> SeveralForces:
        if heads is None:
            return make_empty_frame(0.0, self.least_force_N, Flag.NOT_DETECTED)
        error = self._size_error(self._size(head), heads.place_mm)
        heads = heads.add_scatter(finder.size_slope(heads.place_mm), self.model.place_scatter_mm).unsure(error)
        together = forces_together(
            heads.times(self.issued.indenter.area_mm2 / head.area_mm2),
            unexplained,
            self._inverse(head),
            self.issued.validity,
            nearest_mm=_NEAREST * head.diameter_mm,
            sign=self.sign,
            other_head=error > LARGEST,
        )
        is_other = head != self.issued.indenter
        shared_N = self.shared_error.stderr_N(np.array([together.total_N]), other_head=is_other)
        return replace(
            together,
            loads=self.shared_error.add(together.loads, other_head=is_other),
            total_stderr_N=float(np.hypot(together.total_stderr_N, shared_N[0])),
        )

    def moved(self, changes: Array, matches: Matches | None = None, head: Indenter | None = None) -> Mask:
        """Mask (n,) of frames in which one offset on all readings explains the residual of one head."""
        head = head or self.issued.indenter
        matches = matches or self._filter(head).search(changes @ self._merging)
        offset_mask = np.zeros(len(changes), dtype=np.bool_)
        freedom, residual_energy = len(self._merging.T), matches.energy - matches.gain
        unlike_frames = np.flatnonzero(deviates_from_model(matches.gain, residual_energy, freedom, self.model.misfit))
        if self._level is not self and len(unlike_frames):
            level = self.level()
            levelled_matches = level._filter(head).search(changes[unlike_frames] @ level._merging)
            levelled_excess = np.maximum(levelled_matches.energy - levelled_matches.gain - freedom, 0.0)
            by_offset = residual_energy[unlike_frames] - freedom - levelled_excess
            offset_mask[unlike_frames] = by_offset > np.maximum(
                BY_OFFSET * (residual_energy[unlike_frames] - freedom), LEAST_OFFSET
            )
        return offset_mask

    def _filter(self, head: Indenter) -> TemplateFilter:
        size = self._size(head)
        if size not in self._filters:
            while len(self._filters) >= _HEADS:
                self._filters.pop(next(reversed(self._filters)))
            self._filters[size] = TemplateFilter(self.model, size=size)
        return self._filters[size]

    def _inverse(self, head: Indenter) -> ForceInverse:
        return replace(self.inverse, area_mm2=head.area_mm2)

    def _size(self, head: Indenter) -> float:
        return head.squared_radius_mm2 / self.issued.indenter.squared_radius_mm2

    def _scale_to_area(self, matches: Matches, head: Indenter) -> Matches:
        """Strength of another head: templates are per strength for the calibrated head's area."""
        factor = self.issued.indenter.area_mm2 / head.area_mm2
        if factor == 1:
            return matches
        scale = np.array([factor, 1, 1])
        covariance = matches.covariance * scale[:, None] * scale
        return replace(matches, strength=matches.strength * factor, covariance=covariance)

    def _places(self, place_mm: ArrayLike, count: int) -> Array:
        places = real_numbers(place_mm, "places")
        if places.shape not in ((2,), (count, 2)) or not np.isfinite(places).all():
            raise CalibrationError(
                f"places of shape {places.shape} do not fit {count} frames, or are not finite",
                remedy="give (x, y) in mm from the sheet's centre, once or for every frame",
            )
        return places

    def _measure_further_heads(self, rows: Array, matches: Matches, finder: TemplateFilter) -> Array:
        """Strength (n,) of further heads relative to the found one; 0 for a single head."""
        other_strength = np.zeros(len(rows))
        residual_energy, gain = matches.energy - matches.gain, matches.gain
        freedom = self.model.templates.shape[1]
        searched_frames = np.flatnonzero(
            (residual_energy > freedom + self.model.misfit * gain) & (gain >= self.model.threshold**2)
        )
        if len(searched_frames):
            place, strength, gain_there = (
                matches.place_mm[searched_frames],
                matches.strength[searched_frames],
                gain[searched_frames],
            )
            second_gain, second_strength = finder.match_beside(rows[searched_frames], place, strength)
            ratio = np.abs(second_strength) / np.maximum(np.abs(strength), np.finfo(np.float64).tiny)
            clear_mask = second_gain >= self.model.threshold**2 + self.model.misfit * gain_there
            other_strength[searched_frames] = np.where(clear_mask & (ratio > _LEFT_BEHIND), ratio, 0.0)
        # Part that no template explains beyond noise, relative to the first head's.
        unlike_mask = deviates_from_model(gain, residual_energy, freedom, max(self.model.misfit, _UNLIKE))
        share = np.sqrt(np.maximum(residual_energy - freedom, 0.0) / np.maximum(gain, 1.0))
        return np.where(unlike_mask, np.maximum(other_strength, share), other_strength)

    def _forces(
        self,
        matches: Matches,
        bad: Indices,
        others: Array,
        head: Indenter,
        *,
        searched: bool,
    ) -> Forces:
        error = self._size_error(self._size(head), matches.place_mm)
        matches.covariance[:, 0, 0] += (error * matches.strength) ** 2
        force, stderr = self._inverse(head).force(matches)
        detectability = np.sqrt(matches.gain)
        usable_mask = bad & NO_FORCE == 0
        flags = np.where(usable_mask, self._flags(matches, detectability, searched=searched) | bad, bad)
        silent = (flags & int(Flag.NOT_DETECTED)) != 0
        if searched:
            # An undetected load may be where the sheet responds least.
            force[silent], stderr[silent] = 0.0, self.least_force_N
        loaded = ~silent & usable_mask
        several = loaded & (others > 0)
        stderr = np.where(several, np.hypot(stderr, np.abs(force) * others), stderr)
        flags |= several * int(Flag.MORE_THAN_ONE)
        flags |= loaded * range_flags(force, stderr, matches.place_mm, self.issued.validity)
        flags |= (loaded & (error > LARGEST)) * int(Flag.OTHER_HEAD)
        force[~usable_mask] = np.nan
        stderr[~usable_mask] = np.nan
        place = (matches.covariance[:, 1, 1] + matches.covariance[:, 2, 2]) / 2
        place_stderr = np.sqrt(np.where(place >= 0, place, np.nan))
        place_mm = matches.place_mm
        if searched:  # searched in vain in an unusable frame
            place_mm[~usable_mask] = np.nan
            place_stderr[~usable_mask] = np.nan
        return Forces(force, stderr, place_mm, place_stderr, detectability, flags, np.zeros(len(force)))

    def _least_force_N(self) -> float:
        model = self.model
        places = model.lattice.places_mm()[model.node.ravel() >= 0]
        near_mask = model.fits & (np.hypot(*places.T) <= self.issued.validity.radius_mm)
        node_mask = near_mask if near_mask.any() else model.fits
        return float(np.nanmax(least_force_N(self.inverse, np.exp(model.log_size[node_mask]), places[node_mask])))

    def _flags(self, matches: Matches, detectability: Array, *, searched: bool) -> Indices:
        level = self.model.threshold if searched else _CLEAR
        detected_mask = detectability >= level
        flags: Indices = (detectability < level) * int(Flag.NOT_DETECTED)
        flags |= np.isnan(detectability) * int(Flag.OUTSIDE)  # no head is possible there
        flags |= (detected_mask & (matches.strength * self.sign < 0)) * int(Flag.WRONG_SIGN)
        return flags
