"""A recording on its sheet, searched for loads."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_changes import find_changes, largest_score, threshold_for
from cbsr_qa.analysis.recording_events import Press, find_presses
from cbsr_qa.analysis.recording_imaging import (
    Sheet,
    UnitModel,
    plain_model,
    sheet_for,
    unit_model,
    usable_volts,
)
from cbsr_qa.analysis.recording_noise import channel_noise
from cbsr_qa.analysis.recording_objects import Object, find_moving, find_still, reciprocal_noise
from cbsr_qa.analysis.recording_places import Place, matcher, robust_directions
from cbsr_qa.analysis.recording_ready import ReadyReadings
from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.image import Image
from cbsr_qa.domain.load_events import LoadEvent
from cbsr_qa.domain.reconstruction import LinearReconstruction
from cbsr_qa.domain.recording import Recording
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.interfaces import Reconstruction

Array = NDArray[np.float64]

#: Faster recordings are averaged to about this rate before presses are looked for; nobody presses faster.
_DETECTION_RATE_HZ = 8.0
FEWEST_FRAMES = 8  #: fewer cannot tell a press from noise


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScene:
    """A recording on its sheet, ready to be searched."""

    recording: Recording
    ready: ReadyReadings
    sheet: Sheet
    linear: LinearReconstruction
    model: UnitModel
    readings: Array  # (n, m)
    named: bool

    @classmethod
    def of(
        cls,
        recording: Recording,
        ready: ReadyReadings,
        sensor_type: SensorType,
        reconstruction: Reconstruction,
        *,
        named: bool,
    ) -> Self:
        """Put a recording on its sheet.

        Parameters
        ----------
        named : whether a user named the sensor type, so that lengths may be given in millimetres.

        Raises
        ------
        NumericsError
            If too few readings are left, or they do not follow the model.
        """
        block, used = ready.block, ready.used
        frame = np.median(block.voltages, axis=0) if ready.reference is None else ready.reference
        if not ready.offset:
            noise = None
            if ready.reference is None:
                flat = block.voltages.reshape(len(block), -1)
                noise = channel_noise(flat, counts=False).reshape(frame.shape)
            used = usable_volts(frame, used, noise)
        sheet = sheet_for(sensor_type, used)
        model = unit_model(frame[used], sheet.problem, offset=ready.offset)
        linear = reconstruction.prepare(sheet.problem)
        return cls(recording, ready, sheet, linear, model, block.voltages[:, used], named)

    def objects(self) -> tuple[tuple[LoadEvent, ...], str]:
        """Search against the reference."""
        changes = self.model.changes(self.readings)
        sigma = reciprocal_noise(changes, self.sheet.problem.used)
        if sigma == 0:
            return (), "the frames equal the reference: nothing has changed"
        match = matcher(self.sheet.patterns, self.sheet.places, np.full(changes.shape[1], sigma), self.model.nuisance)
        white = match.whiten(changes)
        found, why = find_still(white[0], match) if len(white) == 1 else find_moving(white, match)
        if found and len(white) == 1:
            found = self._turned(found)
        return tuple(self._object_event(one, changes) for one in found), why

    def _turned(self, found: tuple[Object, ...]) -> tuple[Object, ...]:
        """Take the directions of still objects from a robust fit in one scale, where the tank follows the model."""
        plain = None if self.ready.offset else plain_model(self.model.reference, self.sheet.problem)
        if plain is None:
            return found
        match = matcher(self.sheet.patterns, self.sheet.places, np.ones(len(plain.gain)), plain.nuisance)
        places = robust_directions(tuple(one.place for one in found), plain.changes(self.readings)[0], match)
        return tuple(replace(one, place=place, track=((0, place),)) for one, place in zip(found, places, strict=True))

    def presses(self, rate_hz: float | None) -> tuple[tuple[LoadEvent, ...], str]:
        """Search for presses, each against the frames before it."""
        times, readings = self._slowed(rate_hz)
        changes = self.model.changes(readings)
        sigma = channel_noise(readings, counts=self.ready.offset) * np.abs(self.model.gain)
        sigma = np.maximum(sigma, 0.5 * float(np.median(sigma)))
        match = matcher(self.sheet.patterns, self.sheet.places, sigma, self.model.nuisance)
        white = match.whiten(changes)
        scores = white @ match.patterns
        steps = find_changes(scores)
        if not steps:
            return (), (
                f"nothing stands out of the noise: the largest step is {largest_score(scores):.1f} times its noise,"
                f" {threshold_for(len(times), 2):.1f} is needed"
            )
        found = find_presses(white, match, steps)
        events = [
            self._press_event(press, place, times, changes) for press in found.presses for place in press.places
        ]
        said = [f"a change at {times[frame]:.1f} s is no event: {why}" for frame, why in found.rejected]
        return tuple(sorted(events, key=lambda event: event.start_s)), "; ".join(said)

    def _slowed(self, rate_hz: float | None) -> tuple[Array, Array]:
        """Average fast recordings down to the rate of detection: times and readings."""
        times, readings = self.ready.block.time_s, self.readings
        group = max(1, round((rate_hz or 0.0) / _DETECTION_RATE_HZ))
        whole = len(times) // group * group
        if group == 1 or whole // group < FEWEST_FRAMES:
            return times, readings
        means = readings[:whole].reshape(-1, group, readings.shape[1]).mean(axis=1)
        return times[:whole].reshape(-1, group).mean(axis=1), means

    def _press_event(self, press: Press, place: Place, times: Array, changes: Array) -> LoadEvent:
        index = np.arange(len(times))
        start, end = (float(np.interp(at, index, times)) for at in (press.start, press.end))
        change = changes[press.held].mean(axis=0) - changes[press.before].mean(axis=0)
        return self._event(start, float(times[press.peak]), end, place, press.score, change)

    def _object_event(self, found: Object, changes: Array) -> LoadEvent:
        times = self.ready.block.time_s
        event = self._event(
            float(times[found.first]),
            float(times[found.peak]),
            float(times[found.last]),
            found.place,
            found.score,
            changes[found.peak],
        )
        if len(found.track) == 1:
            return event
        return replace(event, track=tuple((float(times[k]), place.x, place.y) for k, place in found.track))

    def _event(
        self, start_s: float, peak_s: float, end_s: float, place: Place, score: float, change: Array
    ) -> LoadEvent:
        radius = self.sheet.radius_mm
        return LoadEvent(
            start_s=start_s,
            peak_s=min(max(peak_s, start_s), end_s),
            end_s=end_s,
            x_over_R=place.x,
            y_over_R=place.y,
            electrode=self.sheet.layout.electrode_at(place.x, place.y),
            sign=1 if place.score > 0 else -1,
            snr=score,
            image=Image(self.sheet.problem.mesh, self.linear.images(change[None])[0]),
            x_mm=place.x * radius if self.named else None,
            y_mm=place.y * radius if self.named else None,
            force_N=_peak_force(self.recording.samples, start_s, end_s),
        )


def _peak_force(samples: tuple[SampleBlock, ...], start_s: float, end_s: float) -> float | None:
    force = next((block for block in samples if block.channel == "force"), None)
    if force is None:
        return None
    during = force.values[(force.time_s >= start_s) & (force.time_s <= end_s)]
    return float(during.max()) if during.size else None
