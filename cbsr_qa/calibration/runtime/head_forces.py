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
    map_tables,
    nothing_together,
    range_flags,
)
from cbsr_qa.calibration.force.multi_load import HeadCounter, Heads
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter, add_scatter
from cbsr_qa.calibration.runtime.fewer_readings import BY_OFFSET, LEAST_OFFSET
from cbsr_qa.calibration.runtime.frames import SensorFrames
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.goodness import unlike_model
from cbsr_qa.domain.numbers import Array, Indices, Mask, real_numbers
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import ForceModel
from cbsr_qa.domain.results.learned_place import LearnedPlace

if TYPE_CHECKING:
    from cbsr_qa.calibration.runtime.pressed_place import PressedPlace

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
        self._size_error = SizeError(model, self.issued.indenter.radius_mm)
        # It was learned from all readings.
        learned = self.issued.place if model is self.issued.force else None
        self._pressed = None if learned is None else _make_pressed_place(learned.learned, model)
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
        parts = []
        for usable, which, flags in self.sound_parts(voltages):
            changes, bad = usable.changes_of(voltages[which])
            there = places if places is None or places.ndim == 1 else places[which]
            parts.append((which, usable._force(changes, bad | flags, there, head)))
        return join_forces(parts)

    def _force(self, changes: Array, bad: Indices, places: Array | None, head: Indenter) -> Forces:
        finder, rows = self._filter(head), changes @ self._merging
        matches = finder.search(rows) if places is None else finder.match_at(rows, places)
        moved = self.moved(changes, matches, head)
        if moved.any():
            parts = []
            for usable, flag, which in ((self, 0, ~moved), (self.level(), int(Flag.OFFSET), moved)):
                there = places if places is None or places.ndim == 1 else places[which]
                forces = usable._force(changes[which], bad[which] | flag, there, head)
                parts.append((np.flatnonzero(which), forces))
            return join_forces(parts)
        others = self._others(rows, matches, finder)
        if places is None:
            found = finder.ambiguous(rows, matches) if self._fewer else matches
            modelled = add_scatter(found, finder.size_slope(found.place_mm), self.model.place_scatter_mm)
            learned = None if finder is not self.filter else self._pressed  # it was learned with the calibrating head
            matches = modelled if learned is None else learned(rows, matches, modelled, finder)
        return self._forces(self._scale_to_area(matches, head), bad, others, head, searched=places is None)

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
        frames, indenter, current_A : as for :meth:`force`; all heads are equal.
        at_most : most heads searched for.

        Raises
        ------
        CalibrationError, NumericsError
            As for :meth:`force`, and if ``at_most`` is below 1.
        """
        if not (isinstance(at_most, int) and at_most >= 1):
            raise CalibrationError(f"{at_most} heads cannot be searched for", remedy="look for at least 1")
        voltages = self.voltages(frames, current_A)
        head = self.issued.indenter if indenter is None else indenter
        found: dict[int, SeveralForces] = {}
        for usable, which, flags in self.sound_parts(voltages):
            changes, bad = usable.changes_of(voltages[which])
            found |= dict(zip(which.tolist(), usable._several(changes, bad | flags, at_most, head), strict=True))
        return tuple(found[frame] for frame in range(len(voltages)))

    def _several(self, changes: Array, bad: Indices, at_most: int, head: Indenter) -> list[SeveralForces]:
        finder, rows = self._filter(head), changes @ self._merging
        matches = finder.search(rows)
        least = self.model.threshold**2
        several = finder.match_beside(rows, matches.place_mm, matches.strength)[0] >= _SUSPICIOUS * least
        moved = self.moved(changes, matches, head)
        counter = HeadCounter(
            finder, threshold=self.model.threshold, misfit=self.model.misfit, diameter_mm=head.diameter_mm
        )
        several_forces = []
        for frame, flag in enumerate(bad.tolist()):
            if flag & NO_FORCE:
                one = nothing_together(np.nan, np.nan, Flag(flag))
            elif moved[frame]:
                alone = slice(frame, frame + 1)
                one = self.level()._several(changes[alone], bad[alone] | int(Flag.OFFSET), at_most, head)[0]
            elif matches.gain[frame] < least and not several[frame]:
                one = nothing_together(0.0, self.least_force_N, Flag.NOT_DETECTED)
            else:
                most = at_most if several[frame] else 1
                heads, further = counter.heads(rows[frame], matches.place_mm[frame], most)
                one = self._together(heads, further if several[frame] else 0.0, finder, head)
            several_forces.append(replace(one, flags=one.flags | Flag(flag)))
        return several_forces

    def _together(
        self, heads: Heads | None, unexplained: float, finder: TemplateFilter, head: Indenter
    ) -> SeveralForces:
        if heads is None:
            return nothing_together(0.0, self.least_force_N, Flag.NOT_DETECTED)
        error = self._size_error(self._size(head), heads.place_mm)
        heads = heads.add_scatter(finder.size_slope(heads.place_mm), self.model.place_scatter_mm).unsure(error)
        return forces_together(
            heads.times(self.issued.indenter.area_mm2 / head.area_mm2),
            unexplained,
            self._inverse(head),
            self.issued.validity,
            nearest_mm=_NEAREST * head.diameter_mm,
            sign=self.sign,
            other_head=error > LARGEST,
        )

    def moved(self, changes: Array, matches: Matches | None = None, head: Indenter | None = None) -> Mask:
        """Which frames (n,) leave of one head what one offset on all readings, and little else, explains."""
        head = head or self.issued.indenter
        matches = matches or self._filter(head).search(changes @ self._merging)
        moved = np.zeros(len(changes), dtype=np.bool_)
        freedom, left = len(self._merging.T), matches.energy - matches.gain
        noticed = np.flatnonzero(unlike_model(matches.gain, left, freedom, self.model.misfit))
        if self._level is not self and len(noticed):
            level = self.level()
            again = level._filter(head).search(changes[noticed] @ level._merging)
            rest = np.maximum(again.energy - again.gain - freedom, 0.0)
            by_offset = left[noticed] - freedom - rest
            moved[noticed] = by_offset > np.maximum(BY_OFFSET * (left[noticed] - freedom), LEAST_OFFSET)
        return moved

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

    def _others(self, rows: Array, matches: Matches, finder: TemplateFilter) -> Array:
        """Strength (n,) of further heads relative to the found one; 0 for a single head."""
        others = np.zeros(len(rows))
        left, gain = matches.energy - matches.gain, matches.gain
        freedom = self.model.templates.shape[1]
        looked = np.flatnonzero((left > freedom + self.model.misfit * gain) & (gain >= self.model.threshold**2))
        if len(looked):
            place, strength, gain_there = matches.place_mm[looked], matches.strength[looked], gain[looked]
            further, there = finder.match_beside(rows[looked], place, strength)
            ratio = np.abs(there) / np.maximum(np.abs(strength), np.finfo(np.float64).tiny)
            clear = further >= self.model.threshold**2 + self.model.misfit * gain_there
            others[looked] = np.where(clear & (ratio > _LEFT_BEHIND), ratio, 0.0)
        # Part that no template explains beyond noise, relative to the first head's.
        unlike = unlike_model(gain, left, freedom, max(self.model.misfit, _UNLIKE))
        share = np.sqrt(np.maximum(left - freedom, 0.0) / np.maximum(gain, 1.0))
        return np.where(unlike, np.maximum(others, share), others)

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
        usable = bad & NO_FORCE == 0
        flags = np.where(usable, self._flags(matches, detectability, searched=searched) | bad, bad)
        silent = (flags & int(Flag.NOT_DETECTED)) != 0
        if searched:
            # An undetected load may be where the sheet responds least.
            force[silent], stderr[silent] = 0.0, self.least_force_N
        loaded = ~silent & usable
        several = loaded & (others > 0)
        stderr = np.where(several, np.hypot(stderr, np.abs(force) * others), stderr)
        flags |= several * int(Flag.MORE_THAN_ONE)
        flags |= loaded * range_flags(force, stderr, matches.place_mm, self.issued.validity)
        flags |= (loaded & (error > LARGEST)) * int(Flag.OTHER_HEAD)
        force[~usable] = np.nan
        stderr[~usable] = np.nan
        place = (matches.covariance[:, 1, 1] + matches.covariance[:, 2, 2]) / 2
        place_stderr = np.sqrt(np.where(place >= 0, place, np.nan))
        where = matches.place_mm
        if searched:  # searched in vain in an unusable frame
            where[~usable] = np.nan
            place_stderr[~usable] = np.nan
        return Forces(force, stderr, where, place_stderr, detectability, flags)

    def _least_force_N(self) -> float:
        model = self.model
        places = model.lattice.places_mm()[model.node.ravel() >= 0]
        near = model.fits & (np.hypot(*places.T) <= self.issued.validity.radius_mm)
        where = near if near.any() else model.fits
        return float(np.nanmax(least_force_N(self.inverse, np.exp(model.log_size[where]), places[where])))

    def _flags(self, matches: Matches, detectability: Array, *, searched: bool) -> Indices:
        level = self.model.threshold if searched else _CLEAR
        there = detectability >= level
        flags: Indices = (detectability < level) * int(Flag.NOT_DETECTED)
        flags |= np.isnan(detectability) * int(Flag.OUTSIDE)  # no head is possible there
        flags |= (there & (matches.strength * self.sign < 0)) * int(Flag.WRONG_SIGN)
        return flags


def _make_pressed_place(learned: LearnedPlace, model: ForceModel) -> "PressedPlace":
    # Here because it imports for a second, and few calibrations have a learned place.
    from cbsr_qa.calibration.runtime.pressed_place import PressedPlace

    return PressedPlace(learned, model.merging)
