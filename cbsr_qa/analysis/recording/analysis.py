"""Complete analysis of a recording: channels, carry-over, noise, presses."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from cbsr_qa.analysis.defects.noise import channel_noise, find_steps, noise_report
from cbsr_qa.analysis.recording.imaged_events import Imaged, image_events
from cbsr_qa.analysis.recording.images import Tell
from cbsr_qa.analysis.recording.imaging import nominal_disc
from cbsr_qa.analysis.recording.ready import ReadyReadings, channel_report, make_ready
from cbsr_qa.analysis.recording.repeats import average_repeats
from cbsr_qa.analysis.recording.scene import FEWEST_FRAMES, RecordedScene, Searched
from cbsr_qa.domain.errors import NumericsError, RecordingError
from cbsr_qa.domain.goodness import LEAST_EXPLAINED
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.readings.carry_over import RECIPROCITY_LIMIT
from cbsr_qa.domain.readings.frames import Recording, ScanKind, VoltageUnit
from cbsr_qa.domain.results.findings import EventImaging, LoadEvent, NoiseReport, NoiseStep, RecordingResult
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.inverse.uncertainty import masking_effect
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.system.clock import Stages

#: Default reconstruction of events.
DEFAULT_RECONSTRUCTION: Final = "gauss-newton-noser"
_MOST_NAMED: Final = 5  #: rows of a table


@dataclass(frozen=True, slots=True)
class AnalysisChoices:
    """User options for the analysis of a recording.

    Parameters
    ----------
    correct_carry_over : None to correct where the estimate is significant and makes reciprocity better.
    sensor_type : type of the sensor; None for the nominal disc, without any lengths in millimetres.
    reconstruction : name and options of the reconstruction of events, which are part of the result.
    """

    correct_carry_over: bool | None = None
    sensor_type: SensorType | None = None
    reconstruction: PluginChoice = field(default_factory=lambda: PluginChoice(DEFAULT_RECONSTRUCTION))


def analyse_recording(
    recording: Recording,
    reconstruction: Reconstruction,
    choices: AnalysisChoices | None = None,
    *,
    tell: Tell = lambda said: None,
) -> RecordingResult:
    """Analyse a recording.

    Parameters
    ----------
    reconstruction : images the events, which are detected without it.
    tell : receives the progress of slow images.

    Raises
    ------
    RecordingError
        If a single image has no reference, or the named sensor type does not fit the frames.
    NumericsError, PluginError
        If the reconstruction, which the message names, cannot image the events.
    """
    choices = choices or AnalysisChoices()
    stages = Stages()
    if choices.sensor_type is not None:
        recording, single = average_repeats(recording, choices.sensor_type)
        choices = replace(choices, sensor_type=single)
    pattern = None if choices.sensor_type is None else choices.sensor_type.pattern
    with stages.stage("channels"):
        ready = make_ready(recording, choices.correct_carry_over, pattern)
    rate_hz = frame_rate_hz(recording)
    with stages.stage("events"):
        searched = _search_loads(recording, ready, choices, rate_hz)
    with stages.stage("images"):
        imaged = Imaged((), EventImaging(choices.reconstruction))
        if searched.scene is not None and searched.sightings:
            imaged = image_events(searched.scene, searched.sightings, reconstruction, choices.reconstruction, tell)
    with stages.stage("noise"):
        noise = _noise(recording, ready, imaged.events)
    return RecordingResult(
        recording=recording,
        frame_rate_hz=rate_hz,
        channels=replace(
            channel_report(recording, ready),
            suspect_electrodes=(*ready.open_electrodes, *searched.suspect_electrodes),
        ),
        noise=noise,
        events=imaged.events,
        events_why="" if imaged.events else searched.why,
        warnings=(*_warnings(recording, ready, searched), *imaged.remarks),
        compute_s=stages.table(),
        sensor_type=choices.sensor_type,
        imaging=imaged.imaging,
    )


def frame_rate_hz(recording: Recording) -> float | None:
    """Return frames per second: from the typical step on the board's clock, from the whole length on the computer's.

    Return None for still images and files without times. Steps a tenth longer than the median (a watchdog dump in a
    frame, lost frames) are left out; a computer's steps are those of its serial buffer, so only the whole length
    counts.
    """
    times = recording.frames.time_s
    if recording.still or recording.clock == "none" or len(times) < 2 or times[-1] <= times[0]:
        return None
    if recording.clock == "computer":
        return float((len(times) - 1) / (times[-1] - times[0]))
    steps = np.diff(times)
    typical = steps[(steps < 1.1 * np.median(steps)) & (steps > 0)]
    return float(1 / typical.mean()) if typical.size else None


def _search_loads(
    recording: Recording, ready: ReadyReadings, choices: AnalysisChoices, rate_hz: float | None
) -> Searched:
    if reason := _why_no_signal(recording, ready) or _why_no_image(recording, ready):
        return Searched((), reason)
    sensor_type = choices.sensor_type or nominal_disc(recording.layout, ready.block.voltages.shape[1])
    if sensor_type.pattern.shape != ready.block.voltages.shape[1:]:
        raise RecordingError(
            f"sensor type {sensor_type.name!r} has frames of {sensor_type.pattern.shape},"
            f" {recording.path.name} has {ready.block.voltages.shape[1:]}",
            remedy="name the sensor type of the recording, or omit it",
        )
    try:
        scene = RecordedScene.from_recording(recording, ready, sensor_type, named=choices.sensor_type is not None)
    except NumericsError as error:
        return Searched((), f"no image can be made: {error.reason}")
    if recording.reference is not None or recording.differences:
        return scene.objects(rate_hz)
    return scene.presses(rate_hz)


def _why_no_signal(recording: Recording, ready: ReadyReadings) -> str:
    """Why the readings carry no signal of the sensor; empty if they do."""
    if ready.faults.not_connected:
        return "no signal: all readings are equal; nothing is connected"
    if ready.faults.all_saturated:
        return _saturation(recording)
    if ready.faults.frozen and not (recording.reference or recording.differences or recording.still):
        return f"all {len(ready.block)} frames are identical: the board (or the file) repeats one frame"
    return ""


def _why_no_image(recording: Recording, ready: ReadyReadings) -> str:
    """Why readings with a signal cannot be imaged; empty if they can."""
    if recording.scan is ScanKind.DRIVEN_PAIRS:
        return "one-row scans measure each pair only while it drives, which is not enough for an image"
    if ready.error is not None and ready.error > RECIPROCITY_LIMIT and not recording.still:
        return (
            f"no usable image: the readings are not reciprocal (error {ready.error:.2f}; a passive sheet gives 0,"
            f" unrelated numbers 1.41, the limit is {RECIPROCITY_LIMIT:g})"
        )
    if recording.reference is not None or recording.differences:
        return ""
    if len(ready.block) == 1:
        raise RecordingError(
            f"{recording.path.name} is a single image without a reference",
            remedy="give frames of the unloaded sheet with --rest FILE"
            if recording.rows
            else "name the recording of the empty tank with --reference FILE[:NAME]",
        )
    if len(ready.block) < FEWEST_FRAMES:
        return (
            f"{len(ready.block)} frames are too few to tell a press from noise; at least {FEWEST_FRAMES} are needed"
        )
    return ""


def _saturation(recording: Recording) -> str:
    """Describe the level of a recording whose readings are all saturated."""
    level, unit = np.median(recording.frames.voltages, axis=0), recording.frames.unit.value
    low, high = float(level.min()), float(level.max())
    if len(np.unique(recording.frames.voltages)) == 2:
        return (
            f"saturated: all {level.size} readings are {recording.frames.voltages.min():g} or"
            f" {recording.frames.voltages.max():g} {unit}: the ends of their range, or no readings of a sheet"
        )
    level_words = f"{high:g} {unit}" if low == high else f"{low:g} to {high:g} {unit}"
    return f"saturated: all {level.size} readings are at their ceiling ({level_words})"


def _noise(recording: Recording, ready: ReadyReadings, events: tuple[LoadEvent, ...]) -> NoiseReport:
    reading_use = ready.noise_use()
    block = recording.frames
    readings = block.voltages[:, reading_use]
    busy = tuple((event.start_s, event.end_s) for event in events)
    steps: tuple[NoiseStep, ...] = ()
    if len(block) > 1:
        sigma = channel_noise(readings, counts=block.unit is VoltageUnit.COUNT)
        steps = find_steps(block.time_s, readings, sigma)
        steps = tuple(s for s in steps if s.what == "noise" or not any(a - 1 <= s.time_s <= b + 1 for a, b in busy))
    return noise_report(block, reading_use, steps, busy, timed=not recording.still and recording.clock != "none")


def _warn_of_other_sheet(searched: Searched) -> list[str]:
    """Say that this is not the sheet that is modelled, where most events are not those of loads on it."""
    fits = [sighting.goodness for sighting in searched.sightings]
    if sum(fit.in_model for fit in fits) * 2 >= len(fits):
        return []
    share = float(np.median([fit.explained for fit in fits]))
    return [
        f"the modelled sheet explains {share:.0%} of what the readings change by, {LEAST_EXPLAINED:.0%} is needed"
        f" ({f'median of {len(fits)} events' if len(fits) > 1 else 'one event'}): this sheet is not what is modelled,"
        " and places are only those that fit best"
    ]


def _warnings(recording: Recording, ready: ReadyReadings, searched: Searched) -> tuple[str, ...]:
    remarks: list[str] = []
    if recording.rows:
        remarks += [problem.what for problem in recording.problems[:_MOST_NAMED]]
    if recording.rows_rejected > (_MOST_NAMED if recording.rows else 0):
        rows = "row was" if recording.rows_rejected == 1 else "rows were"
        remarks.append(f"{recording.rows_rejected} {rows} rejected, see the list of problems")
    carry_over = ready.carry_over
    if carry_over is not None and carry_over.worth_correcting and not ready.corrected:
        remarks.append(f"readings carry over {carry_over.share:.0%} of the previous one; not corrected, as requested")
    remarks += [*ready.remarks(), *searched.remarks, *_warn_of_other_sheet(searched)]
    if scene := searched.scene:
        effect = masking_effect(scene.sheet.problem)
        if effect is not None and effect.electrodes:
            remarks.append(effect.words(None if scene.named else scene.sheet.radius_mm))
    if searched.sightings and searched.why:
        remarks.append(searched.why)
    return tuple(remarks)
