"""A recording played back as a bench: what was measured once, to a run that believes it measures now."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.domain.plan import steps as kinematics
from cbsr_qa.plugin import (
    FrameBlock,
    InstrumentIdentity,
    NoMoreFramesError,
    PluginError,
    PluginOptions,
    Recording,
    RecordingError,
    SampleBlock,
    ScanKind,
    StationContext,
    driver,
)
from cbsr_qa_plugins.hardware._driver import RIG_MOTION, DriverBase, Text, config_error

_DRIVER: Final = "replayed-recording"


class ReplayOptions(PluginOptions):
    file: Text
    format: Text | None = None
    dataset: Text | None = None
    channel: Text = "force"
    start_s: float | None = None


@driver(_DRIVER, ReplayOptions)
def open_replay(context: StationContext, options: ReplayOptions) -> "ReplayedRecording":
    """Play a recording as frame source, sampler of one of its channels, and a head that only takes the time to move.

    Options of its table
    --------------------
    file : file of the recording.
    format : its format; by default recognised from the file.
    dataset : which data set, if the file holds several.
    channel : channel of its samples.
    start_s : time in the recording at which it starts to play; by default its beginning, or its first frame where
        frames alone are wanted (``cbsr-qa stream``).

    Raises
    ------
    ConfigError
        If an option is wrong, the file cannot be read, or its frames are none of the station's sensor type.
    """
    return ReplayedRecording(context, options)


class ReplayedRecording(DriverBase):
    """Plays a recording on the station's clock, from the moment it is opened.

    Recorded time passes as the station's does, whatever the station does meanwhile. A frame is delivered when the
    station's clock is at its end, and counts if its middle was still to come when it was asked for; those that nobody
    asked for are passed over, as on a board that never stops. Samples come at their recorded times. The head moves
    nothing: it takes the time that the station's motion says.
    """

    def __init__(self, context: StationContext, options: ReplayOptions) -> None:
        self._motion = context.motion or RIG_MOTION
        self._recording = recording = _read(context, options)
        super().__init__(context, _DRIVER, str(recording.path))
        _check_frames(recording, context)
        self._channel = options.channel
        self._samples = next((block for block in recording.samples if block.channel == self._channel), None)
        self._period_s = float(np.median(np.diff(recording.frames.time_s)))
        begins_s = [float(recording.frames.time_s[0]) - self._period_s / 2]
        if context.motion is not None:  # a station has the samples too
            begins_s += [float(block.time_s[0]) for block in recording.samples if len(block)]
        start_s = min(begins_s) if options.start_s is None else options.start_s
        #: What is added to the recording's time to get the station's.
        self._shift_s = context.clock.now() - context.resumed_at_s - start_s
        self._place = (0.0, 0.0)
        self._depth_mm: float | None = None
        self._speed_mm_s = self._motion.press_speed_mm_s

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Report that nothing is measured, and which recording is played."""
        recording = self._recording
        origin = f"; itself of {'; '.join(recording.simulated)}" if recording.simulated else ""
        dataset = f", data set {recording.dataset}" if recording.dataset else ""
        model = f"replay of {recording.path.name} ({recording.format}{dataset}){origin}"
        return self._build_identity(model, simulated=True)

    def safe_state(self) -> None:
        """Count the head as up; nothing moves."""
        self._depth_mm = None

    # --- frame source ---

    @property
    def frame_period_s(self) -> float:
        """Median time from one frame to the next [s]."""
        return self._period_s

    def acquire(self, count: int) -> FrameBlock:
        """Deliver the next frames of which at least half is still to come.

        NoMoreFramesError if the recording ends before; it is not to be tried again.
        """
        frames = self._recording.frames
        self._check_count(count)
        first = int(np.searchsorted(frames.time_s, self._clock.now() - self._shift_s))
        if first + count > len(frames):
            raise self._over(len(frames) - first, count)
        block = frames.select(slice(first, first + count))
        end_s = float(block.time_s[-1]) + self._period_s / 2 + self._shift_s
        self._clock.sleep(end_s - self._clock.now())
        own = None if block.reading_time_s is None else block.reading_time_s + self._shift_s
        return replace(block, time_s=block.time_s + self._shift_s, reading_time_s=own)

    def _over(self, remaining: int, asked: int) -> NoMoreFramesError:
        played_s = self._clock.now() - self._shift_s
        frame_count, end_s = len(self._recording.frames), float(self._recording.frames.time_s[-1])
        return NoMoreFramesError(
            self._role,
            self._address,
            f"the recording is over: at {played_s:.4g} s of it {remaining} of {frame_count} frames are left,"
            f" {asked} asked for; the last is at {end_s:.4g} s",
            remedy="use a recipe that takes no longer than what was recorded",
        )

    # --- sampler ---

    @property
    def channel(self) -> str:
        """Name of the channel that is played. ConfigError if the recording does not hold it."""
        return self._require_samples().channel

    @property
    def unit(self) -> str:
        return self._require_samples().unit

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return what was recorded after a time of the station's clock, up to now."""
        block = self._require_samples()
        times_s = block.time_s + self._shift_s
        which = (times_s > time_s) & (times_s <= self._clock.now())
        return SampleBlock(block.channel, block.unit, times_s[which], block.values[which])

    def _require_samples(self) -> SampleBlock:
        if self._samples is None:
            name = self._recording.path.name
            channels = ", ".join(block.channel for block in self._recording.samples) or "none"
            remedy = f"channels it holds: {channels}; take that role out of 'provides', or replay another recording"
            raise config_error(self._context, _DRIVER, f": {name} holds no channel {self._channel!r}", remedy)
        return self._samples

    # --- force applicator ---

    def home(self) -> None:
        """Take the time of the way up and to the sheet's centre, as the simulated bench does."""
        self.move_to(0.0, 0.0)

    def find_surface(self, x_mm: float, y_mm: float) -> float:
        """Take the time of a search, and find the nominal surface."""
        self.move_to(x_mm, y_mm)
        self._clock.sleep(kinematics.surface_search_s(self._motion))
        return self._motion.hover_mm

    def move_to(self, x_mm: float, y_mm: float) -> None:
        self.release()
        self._clock.sleep(kinematics.travel_s(self._motion, math.dist(self._place, (x_mm, y_mm))))
        self._place = (x_mm, y_mm)

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Take the time of a stroke down, or from one depth to another."""
        motion = replace(self._motion, press_speed_mm_s=speed_mm_s)
        if self._depth_mm is None:
            self._clock.sleep(kinematics.stroke_s(motion, depth_mm))
        else:
            self._clock.sleep(kinematics.ease_s(motion, self._depth_mm, depth_mm))
        self._depth_mm, self._speed_mm_s = depth_mm, speed_mm_s

    def release(self) -> None:
        """Take the time of a stroke up, if the head counts as down."""
        if self._depth_mm is not None:
            motion = replace(self._motion, press_speed_mm_s=self._speed_mm_s)
            self._clock.sleep(kinematics.stroke_s(motion, self._depth_mm))
            self._depth_mm = None


def _read(context: StationContext, options: ReplayOptions) -> Recording:
    if context.read_recording is None:
        raise config_error(context, _DRIVER, " was given no way to read recordings", "open it by a station file")
    try:
        return context.read_recording(Path(options.file).expanduser(), options.format, options.dataset)
    except (RecordingError, PluginError) as error:
        raise config_error(context, _DRIVER, f": {error.reason}", error.remedy) from error


def _check_frames(recording: Recording, context: StationContext) -> None:
    """Refuse a recording whose frames are not those of a run."""
    name, sensor_type = recording.path.name, context.sensor_type
    (rows, columns), played = sensor_type.pattern.shape, recording.frames.voltages.shape[1:]
    problem = ""
    if recording.sensor_type not in (None, sensor_type.name):
        problem = f": {name} is of sensor type {recording.sensor_type!r}, not {sensor_type.name!r}"
        remedy = "replay a recording of this sensor type, or name the sensor type that was recorded"
    elif recording.scan is not ScanKind.FULL or played != (rows, columns):
        problem = f": frames of {name} have {played[0]} x {played[1]} readings;"
        problem += f" sensor type {sensor_type.name!r} has {rows} x {columns}"
        remedy = "give the station the sensor type that was recorded"
    elif recording.still or len(recording.frames) < 2:
        problem = f": {name} holds {len(recording.frames)} frames"
        problem += " whose times say nothing" if recording.still else ""
        remedy = "only a recording over time can be played on a clock"
    if problem:
        raise config_error(context, _DRIVER, problem, remedy)
