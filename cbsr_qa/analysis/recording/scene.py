"""Search for loads in a recording of a sheet."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.contacts import Suspect, suspects_of
from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA, channel_noise
from cbsr_qa.analysis.defects.rectifying import answering_changes, answering_levels
from cbsr_qa.analysis.recording.changes import nearest_step
from cbsr_qa.analysis.recording.events import Found, NoLoads, Press, find_initial_loads, search
from cbsr_qa.analysis.recording.images import Sighting, frames_around, nearest_frames
from cbsr_qa.analysis.recording.imaging import (
    Sheet,
    UnitModel,
    difference_model,
    plain_model,
    problem_for,
    sheet_for,
    unit_model,
    usable_volts,
)
from cbsr_qa.analysis.recording.places import Matcher, Place, find_places, fit_loads, matcher, robust_directions
from cbsr_qa.analysis.recording.ready import ReadyReadings
from cbsr_qa.analysis.recording.tank import Object, find_in_rows, find_moving, find_still, fit_tank, reciprocal_noise
from cbsr_qa.analysis.recording.traces import difference, noise_energy
from cbsr_qa.calibration.presses.frame_tables import find_odd_sizes
from cbsr_qa.calibration.presses.odd_units import describe_other_unit
from cbsr_qa.domain.goodness import Goodness
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.answering import AnsweringSide
from cbsr_qa.domain.readings.frames import Recording
from cbsr_qa.domain.sensor.sensor_type import SensorType

#: Faster recordings are averaged to about this rate before detection; presses are slower.
_DETECTION_RATE_HZ = 8.0
FEWEST_FRAMES = 8  #: fewer frames cannot distinguish a press from noise
_MAX_LISTED_CHANGES = 5  #: changes named in a reason
_MAX_SUSPECT_CONTACTS = 4  #: maximum number of repeated searches without a suspect's readings
_SAME_CHANGE_S = 1.0  #: changes this close in time are one
_FIRST_BALL = 0.1  #: initial radius of a ball in a tank, of the tank's
_BALL_ROUNDS = 3  #: iterations over places and sizes of balls
_PER_LOAD = 3  #: numbers that are fitted for a load: its place and size
_FEWEST_LOADS = 3  #: fewer do not tell the usual size of loads
_BELOW_NOISE = 1 / 8  #: of the noise of a reading; noise is not that small in a whole row
_MOST_ODD_ROWS = 5  #: rows that are named
_LEAST_LEFT = 0.5  #: searches are repeated only while this share of the readings remains


@dataclass(frozen=True, slots=True)
class Searched:
    """Result of a search for loads.

    Parameters
    ----------
    scene : scene in which they were found, without the readings of suspect contacts; None if nothing was searched.
    why : why there is no event, or which changes were not events.
    remarks : notes on the recording for a reader.
    suspect_electrodes : electrodes whose readings were left out.
    """

    sightings: tuple[Sighting, ...]
    why: str
    remarks: tuple[str, ...] = ()
    suspect_electrodes: tuple[int, ...] = ()
    scene: "RecordedScene | None" = None


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScene:
    """A recording with its model, ready to be searched.

    Parameters
    ----------
    readings : (n, m). remarks : why some were left out. named : whether lengths may be given in millimetres.
    """

    recording: Recording
    ready: ReadyReadings
    sheet: Sheet
    model: UnitModel
    readings: Array
    named: bool
    remarks: tuple[str, ...] = ()

    @classmethod
    def from_recording(
        cls,
        recording: Recording,
        ready: ReadyReadings,
        sensor_type: SensorType,
        *,
        named: bool,
    ) -> Self:
        """Prepare the model of a recording.

        Parameters
        ----------
        named : whether a user named the sensor type.
        """
        block, used_mask = ready.block, ready.used
        if recording.differences:
            sheet = sheet_for(sensor_type, used_mask)
            side = answering_changes(block.voltages[:, used_mask], sheet.patterns, sheet.problem.reference)
            if side is not None and side.words:
                used_mask = used_mask.copy()
                used_mask[used_mask] = side.answers
                sheet = sheet_for(sensor_type, used_mask)
            readings, remarks = block.voltages[:, used_mask], _describe_side(side)
            return cls(recording, ready, sheet, difference_model(readings, sheet.problem), readings, named, remarks)
        frame = np.median(block.voltages, axis=0) if ready.reference is None else ready.reference
        modelled = problem_for(sensor_type, used_mask).reference
        side = None if recording.magnitudes_only else answering_levels(frame[used_mask], modelled)
        if side is not None and side.words:
            used_mask = used_mask.copy()
            used_mask[used_mask] = side.answers
        if not ready.offset:
            noise = None
            if ready.reference is None:
                readings_by_frame = block.voltages.reshape(len(block), -1)
                noise = channel_noise(readings_by_frame, counts=False).reshape(frame.shape)
            used_mask = usable_volts(frame, used_mask, noise)
        sheet = sheet_for(sensor_type, used_mask)
        model = unit_model(frame[used_mask], sheet.problem, offset=ready.offset)
        return cls(recording, ready, sheet, model, block.voltages[:, used_mask], named, _describe_side(side))

    def drop_readings(self, readings: NDArray[np.bool_]) -> Self:
        """Return the scene without some readings, (m,) bool."""
        keep = ~readings
        used_mask = self.sheet.problem.used.copy()
        used_mask[used_mask] = keep
        sheet = sheet_for(self.sheet.problem.sensor_type, used_mask)
        model = UnitModel(self.model.reference[keep], self.model.gain[keep], self.model.nuisance[keep])
        return replace(self, sheet=sheet, model=model, readings=self.readings[:, keep])

    def objects(self, rate_hz: float | None) -> Searched:
        """Search relative to the reference."""
        changes = self.model.changes(self.readings)
        if not changes.any():
            return Searched((), "the frames equal the reference: nothing has changed")
        problem = self.sheet.problem
        sigma: float | Array = reciprocal_noise(changes, problem.used, problem.sensor_type.pattern)
        if not sigma or (self.recording.rows and len(changes) >= FEWEST_FRAMES):
            sigma = self._estimate_noise(changes)
        remarks: tuple[str, ...]
        if self.recording.rows and self.recording.still:
            white, match = self._match_changes(self.sheet, changes, sigma)
            objects, reason = find_in_rows(white, match)
            remarks = _name_odd_rows(white, [row.peak for row in objects])
        elif len(changes) > 1:
            objects, reason = find_moving(*self._match_changes(self.sheet, changes, sigma))
            remarks = ()
        else:
            objects, reason, remarks = self._search_still(changes, sigma)
            objects = self._correct_directions(objects)
        sightings = tuple(
            self._make_object_sighting(moving_object, changes, timed=rate_hz is not None) for moving_object in objects
        )
        return Searched(sightings, reason, (*self.remarks, *remarks), scene=self)

    def _estimate_noise(self, changes: Array) -> Array:
        """Noise of each reading (m,): what the best loads leave of all frames; of few frames one noise for all."""
        white, match = self._match_changes(self.sheet, changes, 1.0)
        left = np.empty_like(white)
        for row, change in enumerate(white):
            places, _ = find_places(change, match)
            freedom = max(len(change) - 1 - _PER_LOAD * len(places), 1)
            left[row] = (change - fit_loads(change, match, places)) * np.sqrt(len(change) / freedom)
        if len(changes) < FEWEST_FRAMES:
            return np.full(changes.shape[1], np.median(np.sqrt(np.mean(left**2, axis=1))))
        sigma: Array = MAD_TO_SIGMA * np.median(np.abs(left), axis=0)
        return np.maximum(sigma, 0.5 * float(np.median(sigma)))

    def _match_changes(self, sheet: Sheet, changes: Array, sigma: float | Array) -> tuple[Array, Matcher]:
        match = matcher(sheet.patterns, sheet.places, np.broadcast_to(sigma, changes.shape[1]), self.model.nuisance)
        return match.whiten(changes), match

    def _search_still(self, changes: Array, sigma: float | Array) -> tuple[tuple[Object, ...], str, tuple[str, ...]]:
        """Search a still image; in a tank, with the patterns of balls as large as those found."""
        white, match = self._match_changes(self.sheet, changes, sigma)
        objects, reason = find_still(white[0], match)
        tank = None
        if objects and not self.named and not self.ready.offset:
            tank = fit_tank(self.model.reference, self.sheet.problem)
        if tank is None:
            return objects, reason, ()
        ball, conducts, on_sheet = _FIRST_BALL, objects[0].place.score > 0, objects
        for _ in range(_BALL_ROUNDS):
            sheet = tank.sheet(self.sheet, ball=ball, conducts=conducts)
            white, match = self._match_changes(sheet, changes, sigma)
            objects, _ = find_still(white[0], match)
            if not objects:
                return on_sheet, reason, ()
            ball, conducts = tank.ball_of(objects, sheet, changes[0])
        remark = (
            f"the reference frame decays like that of a tank {tank.depth:.2f} radii deep, not like a sheet's:"
            f" places are those of balls in it, of {ball:.2f} radii or more"
        )
        return objects, reason, (remark,)

    def _correct_directions(self, objects: tuple[Object, ...]) -> tuple[Object, ...]:
        """Take the directions of still objects from a robust fit in one scale, where the tank follows the model."""
        plain = None if self.ready.offset or not objects else plain_model(self.model.reference, self.sheet.problem)
        if plain is None:
            return objects
        match = matcher(self.sheet.patterns, self.sheet.places, np.ones(len(plain.gain)), plain.nuisance)
        places = robust_directions(
            tuple(still_object.place for still_object in objects), plain.changes(self.readings)[0], match
        )
        return tuple(
            replace(still_object, place=place, track=((0, place),))
            for still_object, place in zip(objects, places, strict=True)
        )

    def presses(self, rate_hz: float | None) -> Searched:
        """Search for presses, each relative to the frames before it.

        Readings that share one contact and changed together are left out, and the others searched again.
        """
        scene, remarks, times, electrodes = self, list[str](), list[float](), set[int]()
        for _ in range(_MAX_SUSPECT_CONTACTS):
            searched, suspects = scene._search(rate_hz)
            bad_mask = np.zeros(scene.readings.shape[1], dtype=bool)
            for time_s, suspect in suspects:
                bad_mask |= suspect.readings
                # With carry-over, the rest of the same change does not indicate a further contact.
                if any(abs(time_s - known_time_s) < _SAME_CHANGE_S for known_time_s in times):
                    continue
                times.append(time_s)
                electrodes |= set(suspect.electrodes)
                remarks.append(
                    f"{suspect.name}: its readings changed together at {time_s:.1f} s: a contact or cable fault,"
                    " not a load; they were left out"
                )
            readings_left = scene.readings.shape[1] - int(bad_mask.sum())
            if not bad_mask.any() or readings_left < _LEAST_LEFT * self.readings.shape[1]:
                break
            scene = scene.drop_readings(bad_mask)
        reason = searched.why or (
            "" if searched.sightings else "no change is a load: " + "; ".join([*remarks, *searched.remarks])
        )
        return replace(
            searched,
            why=reason,
            remarks=(*self.remarks, *remarks, *searched.remarks),
            suspect_electrodes=tuple(sorted(electrodes)),
        )

    def _search(self, rate_hz: float | None) -> tuple[Searched, list[tuple[float, Suspect]]]:
        """Search once: events found, and contacts that changed."""
        times, readings = self._downsample(rate_hz)
        changes = self.model.changes(readings)
        sigma = channel_noise(readings, counts=self.ready.offset) * np.abs(self.model.gain)
        sigma = np.maximum(sigma, 0.5 * float(np.median(sigma)))
        match = matcher(self.sheet.patterns, self.sheet.places, sigma, self.model.nuisance)
        white = match.whiten(changes)
        result, detected_changes = search(white, match, self._build_no_loads(match))
        presses, unclear = find_initial_loads(result.presses, len(white))
        seen_loads = []
        for press in presses:
            change = difference(white, press.before, press.held)
            variance = noise_energy(white, press.before, press.held) / white.shape[1]
            goodness = Goodness.from_fit(change, fit_loads(change, match, press.places), match.sigma, variance)
            seen_loads += [
                self._make_press_sighting(press, place, times, readings, changes, goodness) for place in press.places
            ]
        sightings = tuple(sorted(seen_loads, key=lambda load: load.start_s))
        remarks = (*_describe_gains(result, times), *_describe_signs(sightings, unclear, times))
        suspects = [(float(times[frame]), suspect) for frame, suspect in result.suspects]
        if detected_changes:
            reason = _describe_rejected(result, times)
        else:
            step, needed = nearest_step(white @ match.patterns)
            largest = f"the largest step is {step:.1f} times its noise, {needed:.1f} is needed"
            reason = f"nothing stands out of the noise: {largest}"
        if not (reason or sightings or remarks):
            change_times = ", ".join(
                f"{times[change.frame]:.1f} s" for change in detected_changes[:_MAX_LISTED_CHANGES]
            )
            reason = f"the changes (at {change_times}) only return to the initial state: no load is applied"
        return Searched(sightings, reason, remarks, scene=self), suspects

    def _build_no_loads(self, match: Matcher) -> NoLoads:
        problem = self.sheet.problem
        frame = self.model.reference * self.model.gain
        white_frame = match.whiten(frame[None])[0]
        # If a common gain is the nuisance itself, only its rounding remains.
        if float(np.linalg.norm(white_frame)) < 1e-6 * float(np.linalg.norm(frame / match.sigma)):
            white_frame = np.zeros_like(white_frame)
        return NoLoads(white_frame, suspects_of(problem.sensor_type.pattern, problem.used))

    def _downsample(self, rate_hz: float | None) -> tuple[Array, Array]:
        """Average fast recordings down to the rate of detection: times and readings."""
        times, readings = self.ready.block.time_s, self.readings
        group = max(1, round((rate_hz or 0.0) / _DETECTION_RATE_HZ))
        whole_groups_end = len(times) // group * group
        if group == 1 or whole_groups_end // group < FEWEST_FRAMES:
            return times, readings
        means = readings[:whole_groups_end].reshape(-1, group, readings.shape[1]).mean(axis=1)
        return times[:whole_groups_end].reshape(-1, group).mean(axis=1), means

    def _make_press_sighting(
        self, press: Press, place: Place, times: Array, readings: Array, changes: Array, goodness: Goodness
    ) -> Sighting:
        index = np.arange(len(times))
        start, end = (float(np.interp(frame, index, times)) for frame in (press.start, press.end))
        return Sighting(
            start,
            float(times[press.peak]),
            end,
            place,
            press.score,
            changes[press.held].mean(axis=0) - changes[press.before].mean(axis=0),
            *frames_around(changes, press.before, press.held),
            readings[press.before].mean(axis=0),
            goodness,
        )

    def _make_object_sighting(self, seen: Object, changes: Array, *, timed: bool) -> Sighting:
        times = self.ready.block.time_s
        track = tuple((float(times[k]), place.x, place.y) for k, place in seen.track)
        frames, peak_index = nearest_frames(changes, seen.peak) if timed else (changes[seen.peak][None], 0)
        return Sighting(
            float(times[seen.first]),
            float(times[seen.peak]),
            float(times[seen.last]),
            seen.place,
            seen.score,
            changes[seen.peak],
            frames,
            slice(peak_index, peak_index + 1),
            self.model.reference,
            seen.goodness,
            track if len(track) > 1 else (),
        )


def _name_odd_rows(white: Array, loaded: list[int]) -> tuple[str, ...]:
    """Name rows (n, m) that are as if in another unit: of the loaded ones, and those far below the noise."""
    rows = np.unique(loaded).astype(np.int64)
    sizes = np.sqrt(np.mean(white**2, axis=1))
    odd = (
        [
            (int(rows[row]), f"its readings are {describe_other_unit(ratio, 'those of the other loads')}")
            for row, ratio in find_odd_sizes(white[rows])
        ]
        if len(rows) >= _FEWEST_LOADS
        else []
    )
    quiet = np.flatnonzero((sizes > 0) & (sizes < _BELOW_NOISE)) if len(white) >= FEWEST_FRAMES else ()
    odd += [
        (int(row), "its changes are far below the noise of the others, as if in another unit or averaged")
        for row in quiet
    ]
    return tuple(f"row {row + 1}: {words}" for row, words in odd[:_MOST_ODD_ROWS])


def _describe_side(side: AnsweringSide | None) -> tuple[str, ...]:
    return (f"{side.words}; they were left out",) if side is not None and side.words else ()


def _describe_rejected(searched: Found, times: Array) -> str:
    reasons = [f"a change at {times[frame]:.1f} s is not an event: {why}" for frame, why in sorted(searched.rejected)]
    more = f"; and {len(reasons) - _MAX_LISTED_CHANGES} more like these" if len(reasons) > _MAX_LISTED_CHANGES else ""
    return "; ".join(reasons[:_MAX_LISTED_CHANGES]) + more


def _describe_gains(searched: Found, times: Array) -> list[str]:
    """Report moments at which all readings changed in proportion."""
    return [
        f"all readings changed in proportion, by {share:+.1%}, at {times[frame]:.1f} s: a gain or the drive current,"
        " not a load"
        for frame, share in searched.gains
    ]


def _describe_signs(sightings: tuple[Sighting, ...], unclear: list[Press], times: Array) -> list[str]:
    """Describe ambiguities in the signs of the loads."""
    remarks = []
    if len({load.sign for load in sightings}) > 1:
        listed = ", ".join(f"{load.start_s:.1f} s {'more' if load.sign > 0 else 'less'}" for load in sightings)
        remarks.append(
            f"the loads disagree about the sign (conducts {listed}): one sheet responds with one sign, so one"
            " of them may be a release or another disturbance"
        )
    for press in unclear:
        change_s = float(np.interp(press.start, np.arange(len(times)), times))
        conducts_less = press.places[0].score > 0
        remarks.append(
            f"the change at {change_s:.1f} s is never reversed: it may be the release of a load held from the"
            f" start, which then conducts {'less' if conducts_less else 'more'}"
        )
    return remarks
