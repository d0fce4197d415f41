"""Loads tracked over a stream of frames: place, force, start, and residues."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import hypot, sqrt
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.force.inverse import NO_FORCE, Flag, range_flags
from cbsr_qa.calibration.force.template_matching import Matches, add_scatter
from cbsr_qa.calibration.runtime.fewer_readings import offset_between
from cbsr_qa.calibration.runtime.head_forces import HeadForces
from cbsr_qa.calibration.runtime.track import KEPT, Track, patience_s
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array

#: Number of frames in a row without a residue after which the residue is discarded.
_FORGOTTEN: Final = 4
#: Least share of the explained energy that indicates another load: moving heads, and residues without a track, leave
#: more than the steady calibration loads.
_LEAST_SHARE: Final = 0.04


class LoadState(StrEnum):
    """State of a tracked load."""

    LOADING = "loading"  #: pressed, and still settling: its force is a prediction
    STEADY = "steady"  #: pressed for as long as the calibration's loads
    UNLOADING = "unloading"  #: released, and decaying
    RESIDUE = "residue"  #: released so long ago that the material has settled; the rest decays slowly


@dataclass(frozen=True, slots=True, eq=False)
class TrackedLoad:
    """One load at one moment.

    Parameters
    ----------
    number : number of the load since the stream began, from 1.
    since_s : time of the press, or of the release once released.
    place_mm, place_stderr_mm : place, and its error, root mean square over two axes.
    force_N, stderr_N : force of a pressing load after the calibrated hold, and its error. 0 ± 0 once released.
    left_N : force equivalent to the residue of a released load; else 0. NaN, flagged OUTSIDE, at an impossible
        place.
    settled_in_s : time until what is still to come of a press is less than the error of one frame, or what is left
        of a released load no longer shows; 0 from then on. NaN for a residue that does not fade with the material.
    flags : values of :class:`~cbsr_qa.calibration.force.inverse.Flag`; UNSETTLED until then.
    shared_stderr_N : part of ``stderr_N`` that all forces of the calibration share.
    """

    number: int
    state: LoadState
    since_s: float
    place_mm: tuple[float, float]
    place_stderr_mm: float
    force_N: float
    stderr_N: float
    left_N: float
    settled_in_s: float
    flags: Flag
    shared_stderr_N: float

    @property
    def scatter_N(self) -> float:
        """The other part of ``stderr_N``."""
        return sqrt(max(self.stderr_N**2 - self.shared_stderr_N**2, 0.0))


class ForceStream:
    """Tracks the loads on one sensor.

    CalibrationError if ``most`` is not at least 1.

    Parameters
    ----------
    calibration : calibration of the sensor.
    most : largest number of loads and residues tracked at once.

    Attributes
    ----------
    flags : flags of the last frame as a whole; OFFSET in the frame in which all readings moved by one offset.
    """

    def __init__(self, calibration: HeadForces, *, most: int = 12) -> None:
        if not (isinstance(most, int) and most >= 1):
            raise CalibrationError(f"a stream cannot follow {most} loads", remedy="follow at least 1")
        self._calibration = self._usable = calibration
        self._filter = calibration.filter
        self._model = calibration.model
        self._before: tuple[HeadForces | None, Array] = (None, np.zeros(0))
        self._moved = False
        self.flags = Flag(0)
        self._most = most
        self._tracks: list[Track] = []
        self._count = 0
        self._time_s = -np.inf
        self._frame_s, self._since_last_s = 0.0, np.inf
        self._late = True
        self._last: list[Array] = []

    def update(self, time_s: float, frame: ArrayLike) -> tuple[TrackedLoad, ...]:
        """Process the next frame.

        Parameters
        ----------
        time_s : time of the frame's middle, on any clock that advances [s].
        frame : (drives, measures) voltages [V].

        Returns
        -------
        All loads and residues, in order of their appearance, with the frame's flags. Those of the previous frame if
        this one cannot be read or is from another sensor.

        Raises
        ------
        CalibrationError
            If the frame does not have this sensor's shape, or its time is not finite or not later than the last.
        """
        if not (isinstance(time_s, int | float | np.integer | np.floating) and np.isfinite(time_s)):
            raise CalibrationError(f"a frame of {time_s!r} s: its time must be a finite number of seconds")
        if not time_s > self._time_s:
            raise CalibrationError(f"a frame of {time_s} s follows one of {self._time_s} s: time must go forward")
        voltages = self._calibration.voltages(frame, None)
        if len(voltages) != 1:
            raise CalibrationError(f"{len(voltages)} frames were given at once; a stream takes one after the other")
        if np.isfinite(self._time_s):
            # A station pauses between loads: the frame time is at most the shortest interval so far.
            self._since_last_s = time_s - self._time_s
            self._frame_s = min(self._frame_s or np.inf, self._since_last_s)
        self._late = not self._since_last_s < patience_s(self._model)
        self._time_s = time_s
        (usable, _, left_out), *_ = self._calibration.sound_parts(voltages)
        changes, bad = usable.changes_of(voltages)
        self.flags = Flag(int(left_out[0] | bad[0]))
        if not self.flags & NO_FORCE:
            self._follow(self._rows(usable, changes))
        return tuple(self._report(track, self.flags) for track in self._tracks)

    def _rows(self, usable: HeadForces, changes: Array) -> Array:
        """Rows (r,) of the usable readings of a frame, less an offset on all of them if there was one."""
        (last_usable, last_changes), self._before = self._before, (usable, changes)
        jumped = last_usable is usable and bool(offset_between(usable.model, changes - last_changes)[0])
        if jumped or not (self._moved or self._tracks or not usable.moved(changes)[0]):
            self.flags |= Flag.OFFSET
            self._moved = True
        usable = usable.level() if self._moved else usable
        if usable is not self._usable:
            self._usable, self._filter, self._model, self._last = usable, usable.filter, usable.model, []
            for track in self._tracks:
                track.template = np.nan_to_num(self._filter.template(track.place_mm[None])[0])
        rows: Array = changes[0] @ usable.model.merging.T
        return rows

    def _follow(self, rows: Array) -> None:
        match = self._place_anew(rows)
        while len(self._tracks) < self._most and self._begin(match):
            match = self._filter.search(self._explain(rows)[None])
        self._place(rows)
        for track in self._tracks:
            track.advance(self._time_s, self._frame_s, self._since_last_s, self._model)
        self._tracks = [track for track in self._tracks if track.unseen < _FORGOTTEN]
        self._last = [*self._last[-(KEPT - 1) :], self._residual(rows)]

    def _explain(self, rows: Array) -> Array:
        """Strengths of all tracks by least squares, with predictions for released ones; returns the residual."""
        if not self._tracks:
            return rows
        bank = np.array([track.template for track in self._tracks])
        expected = np.array([track.expected for track in self._tracks])
        precision = np.array([track.precision for track in self._tracks])
        information = bank @ bank.T + np.diag(precision)
        covariance = np.linalg.inv(information)
        strength = covariance @ (bank @ rows + precision * expected)
        for track, value, variance in zip(self._tracks, strength, np.diag(covariance), strict=True):
            track.strength, track.noise = float(value), float(np.sqrt(variance))
        return self._residual(rows)

    def _residual(self, rows: Array) -> Array:
        residual = rows.copy()
        for track in self._tracks:
            residual -= track.strength * track.template
        return residual

    def _place_anew(self, rows: Array) -> Matches:
        """Move a load whose first frame, of a moving head, gave another place; return what is in the residual.

        Otherwise the residual of the wrong place would be a second load. It is moved only if no second load remains,
        so that two successive heads stay two.
        """
        residual = self._explain(rows)
        residual_match = self._filter.search(residual[None])
        if not self._shows_another(residual_match):
            return residual_match
        for track in self._tracks:
            if not track.fresh:
                continue
            place, template, strength = track.place_mm, track.template, track.strength
            match = self._filter.search((residual + strength * template)[None])
            new_template = self._filter.template(match.place_mm)[0]
            if np.isfinite(new_template).all():
                track.move(match.place_mm[0], new_template, self._base(new_template))
                next_match = self._filter.search(self._explain(rows)[None])
                if not self._shows_another(next_match):
                    return next_match
                track.move(place, template, self._base(template))
                self._explain(rows)
        return residual_match

    def _shows_another(self, match: Matches) -> bool:
        """Whether the residual of a frame is more than noise, and more than a template's error."""
        gain = float(match.gain[0])
        explained = sum(track.strength**2 * float(track.template @ track.template) for track in self._tracks)
        share = max(self._model.misfit, _LEAST_SHARE)
        return gain >= self._model.threshold**2 and gain >= share * explained

    def _base(self, template: Array) -> float:
        if not self._last:
            return 0.0
        return float(np.mean([template @ last for last in self._last], axis=0) / (template @ template))

    def _begin(self, match: Matches) -> bool:
        """Begin a track if what is in the residual is another load; return whether it did."""
        sign = self._calibration.sign
        if not self._shows_another(match) or float(match.strength[0]) * sign < 0:
            return False
        pressing = [track for track in self._tracks if track.pressing]
        nearest_mm = min((track.distance_mm(match.place_mm[0]) for track in pressing), default=np.inf)
        if nearest_mm < self._calibration.issued.indenter.radius_mm:
            return False
        template = self._filter.template(match.place_mm)[0]
        if not np.isfinite(template).all():
            return False
        self._count += 1
        since_s = self._time_s - self._frame_s / 2
        track = Track(self._count, match.place_mm[0], template, since_s, self._base(template), sign)
        if self._late:
            track.start_unknown()
        self._tracks.append(track)
        return True

    def _place(self, rows: Array) -> None:
        for track in self._tracks:
            if not track.pressing:
                continue
            load_rows = self._residual(rows) + track.strength * track.template - track.base_now * track.template
            match = self._filter.search(load_rows[None])
            if track.distance_mm(match.place_mm[0]) < self._calibration.issued.indenter.diameter_mm:
                track.add_place(match.place_mm[0], match.covariance[0, 1:, 1:])
                template = self._filter.template(track.place_mm[None])[0]
                if np.isfinite(template).all():
                    track.template = template

    def _report(self, track: Track, bad: Flag) -> TrackedLoad:
        pressing = track.pressing
        value, variance = track.steady(self._model) if pressing else (track.strength, track.noise**2)
        match, noise_match = self._matches(track, value, (variance, track.noise**2))
        force, stderr = self._calibration.inverse.force(match)
        flags = bad
        if not np.isfinite(force[0]):
            flags |= Flag.OUTSIDE
        if pressing:
            flags |= Flag(int(range_flags(force, stderr, match.place_mm, self._calibration.issued.validity)[0]))
        share = (
            float(self._calibration.inverse.force(noise_match)[1][0] / abs(force[0]))
            if np.isfinite(force[0]) and force[0]
            else 1.0
        )
        settled_in_s = track.time_to_settle_s(self._model, share)
        if settled_in_s != 0:
            flags |= Flag.UNSETTLED
        shared_N = float(self._calibration.shared_error.stderr_N(force)[0]) if pressing else 0.0
        return TrackedLoad(
            number=track.number,
            state=LoadState(track.state),
            since_s=track.since_s,
            place_mm=(float(track.place_mm[0]), float(track.place_mm[1])),
            place_stderr_mm=float(np.sqrt(np.trace(match.covariance[0, 1:, 1:]) / 2)),
            force_N=float(force[0]) if pressing else 0.0,
            stderr_N=hypot(float(stderr[0]), shared_N) if pressing else 0.0,
            shared_stderr_N=shared_N,
            left_N=0.0 if pressing else float(force[0]),
            settled_in_s=settled_in_s,
            flags=flags,
        )

    def _matches(self, track: Track, value: float, variances: Sequence[float]) -> Iterator[Matches]:
        """The track's strength, of each variance, and place; a template beside it is as much too strong or weak."""
        slope = self._filter.size_slope(track.place_mm[None])
        shared = -value * track.place_covariance @ slope[0]
        for variance in variances:
            covariance = np.empty((1, 3, 3))
            covariance[0, 0, 0] = variance - value * float(shared @ slope[0])
            covariance[0, 0, 1:] = covariance[0, 1:, 0] = shared
            covariance[0, 1:, 1:] = track.place_covariance
            match = Matches(track.place_mm[None], np.array([value]), covariance, np.zeros(1), np.zeros(1))
            yield add_scatter(match, slope, self._model.place_scatter_mm)
