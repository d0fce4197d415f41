"""Effects of converter and board: steps, range, offset, carry-over, order of readings, lost rows, printed logs."""

from collections.abc import Iterator
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import Dump, Moment, PluginOptions, Problem, ReadingFlag, RefusedError, SceneSetting, Transcript
from cbsr_qa.simulate.effect import Positive, SceneEffect, check_at_most
from cbsr_qa.simulate.streams import RandomStream
from cbsr_qa.system.clock import TICK_S
from cbsr_qa_plugins.effects.readings import ReadingEffect

#: Effects on readings before they are converted.
BEFORE_CONVERSION: Final = (
    "voltmeter-input",
    "measurement-noise",
    "electrode-noise",
    "johnson-noise",
    "mains-hum",
    "reading-memory",
    "reading-offset",
)


class Quantisation(ReadingEffect):
    """Every reading is rounded to the nearest step of a converter.

    A step is 2 × range / 2^bits.

    Parameters
    ----------
    range_V : readings from −range to +range are converted.
    bits : resolution of the converter.
    """

    class Options(PluginOptions):
        range_V: Positive
        bits: Annotated[int, Field(ge=4, le=32)]

    after: tuple[str, ...] = BEFORE_CONVERSION
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._step_V: float = 2 * self.options.range_V / 2**self.options.bits

    def read(self, moment: Moment, voltages: Array) -> Array:
        return self._step_V * np.round(voltages / self._step_V)


class ConverterSaturation(SceneEffect):
    """Readings beyond the converter's range are clipped to it and flagged as saturated.

    Parameters
    ----------
    range_V : readings are limited to −range to +range.
    """

    class Options(PluginOptions):
        range_V: Positive

    after: tuple[str, ...] = BEFORE_CONVERSION
    perturbs = "voltages"
    options: Options

    def apply(self, moment: Moment) -> None:
        if moment.voltages is not None and moment.flags is not None:
            range_V = self.options.range_V
            beyond = np.abs(moment.voltages) >= range_V
            moment.voltages = np.clip(moment.voltages, -range_V, range_V)
            moment.flags |= np.where(beyond, np.uint8(ReadingFlag.SATURATED), np.uint8(0))


class ReadingOffset(ReadingEffect):
    """The converter has an offset: a constant is added to every reading.

    Parameters
    ----------
    offset_V : added to every reading.
    """

    class Options(PluginOptions):
        offset_V: Annotated[float, Field(ge=-1e3, le=1e3)]

    after: tuple[str, ...] = ("voltmeter-input",)
    options: Options

    def read(self, moment: Moment, voltages: Array) -> Array:
        return voltages + self.options.offset_V


class ReadingMemory(ReadingEffect):
    """Each reading keeps a share of the one before it, because multiplexer and converter do not settle.

    s[n] = (1 − m) x[n] + m s[n−1]. A frame begins with the memory of its own last reading, as if the frame before had
    been the same, so frames do not depend on each other. If no reading differs by more than d from that of the frame
    before, the error of reading n (from 0) is at most m^(n + 1) d.

    Parameters
    ----------
    share : m; recordings of the authors' board show 0.11 to 0.14.
    inner : which pair steps faster, ``"measure"`` or ``"drive"``. By default the order of ``time-skew``, which it
        may not contradict, or ``"measure"`` without that effect.
    """

    class Options(PluginOptions):
        share: Annotated[float, Field(ge=0, le=0.9)]
        inner: Literal["measure", "drive"] | None = None

    after: tuple[str, ...] = ("voltmeter-input",)
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._shares: Array | None = None

    def read(self, moment: Moment, voltages: Array) -> Array:
        turned = self._order(moment) == "drive"
        frame = voltages.T if turned else voltages
        mixed = (self._mixing_matrix(frame.size) @ frame.ravel()).reshape(frame.shape)
        return mixed.T if turned else mixed

    def _order(self, moment: Moment) -> str:
        at_s = moment.reading_offsets_s
        if at_s is None or min(at_s.shape) < 2:
            return self.options.inner or "measure"
        told = "drive" if at_s[1, 0] < at_s[0, 1] else "measure"
        if self.options.inner not in (told, None) and at_s[1, 0] != at_s[0, 1]:
            raise RefusedError(
                f"reading-memory has inner = {self.options.inner!r}, while time-skew steps the {told!r} pair faster",
                remedy="give both the same inner, or leave it out of reading-memory",
            )
        return told if at_s[1, 0] != at_s[0, 1] else self.options.inner or "measure"

    def _mixing_matrix(self, count: int) -> Array:
        """Shares of the readings x in the readings s, (n, n): the inverse of 1 − m (one back, the first the last)."""
        if self._shares is None or len(self._shares) != count:
            share, back = self.options.share, np.subtract.outer(np.arange(count), np.arange(count)) % count
            self._shares = (1 - share) * share**back / (1 - share**count)
        return self._shares


class TimeSkew(SceneEffect):
    """The readings of a frame are taken one after the other instead of all at once.

    Reading n of N is taken at (n + ½)/N of the time spent reading, which is centred in the frame.

    Parameters
    ----------
    share : share of the frame's period that is spent reading.
    inner : which pair steps faster, ``"measure"`` (row by row) or ``"drive"`` (the rig's command multiplexer).
    """

    class Options(PluginOptions):
        share: Annotated[float, Field(ge=0, le=1)] = 1.0
        inner: Literal["measure", "drive"] = "measure"

    perturbs = "times"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        drives, measures = setting.sensor_type.pattern.shape
        count = np.arange(drives * measures, dtype=np.float64)
        along_measures = self.options.inner == "measure"
        order = count.reshape(drives, measures) if along_measures else count.reshape(measures, drives).T
        spent_s = self.options.share * setting.frame_period_s
        # In the clock's ticks: whatever rests on differences of times is then the same at any time of a run.
        self._offsets_s = TICK_S * np.rint(((order + 0.5) / order.size - 0.5) * spent_s / TICK_S)

    def apply(self, moment: Moment) -> None:
        moment.reading_offsets_s = self._offsets_s


class FrameLoss(SceneEffect):
    """With a given probability, a frame loses a run of successive rows.

    First row and length of the run are uniformly distributed; the end of the frame cuts it.

    Parameters
    ----------
    share : share of the frames that lose rows.
    most_rows : longest run, up to the rows of a frame. In the lab's recordings a broken frame lacks one to four rows.
    """

    class Options(PluginOptions):
        share: Annotated[float, Field(ge=0, le=1)]
        most_rows: Annotated[int, Field(ge=1, le=10**6)] = 4

    perturbs = "recording"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._rows = setting.sensor_type.pattern.shape[0]
        check_at_most("most_rows", self.options.most_rows, self._rows, "a frame has no more rows")
        self._stream = RandomStream(setting.seed, "frame-loss")

    def record(self, transcript: Transcript) -> None:
        for frame in range(len(transcript.lost)):
            numbers = self._stream.generator(frame)
            if numbers.random() < self.options.share:
                first = int(numbers.integers(self._rows))
                transcript.lost[frame, first : first + 1 + int(numbers.integers(self.options.most_rows))] = True


class WatchdogDump(SceneEffect):
    """The board's watchdog prints a log at regular times, during which the board takes no readings.

    A dump comes before the first row that is due after its time; rows are spread evenly over their frame. The time of
    the first dump is drawn once per seed.

    Parameters
    ----------
    period_s : time between dumps on the board's own clock; the lab's board prints one every 5.000 s.
    pause_ms : duration of printing, less than the period. Frames of the lab's board with a dump take 70 to 80 ms
        longer.
    """

    class Options(PluginOptions):
        period_s: Annotated[float, Field(ge=0.1, le=1e6)] = 5.0
        pause_ms: Annotated[float, Field(ge=0, le=10_000)] = 75.0

        def problems(self) -> Iterator[Problem]:
            if self.pause_ms / 1000 >= self.period_s:
                what = f"is {self.pause_ms!r}, which is not over before the next dump after {self.period_s:g} s"
                yield Problem(("pause_ms",), what, "take a shorter pause_ms, or a longer period_s")

    perturbs = "recording"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._pause_s = self.options.pause_ms / 1000
        self._frame_s = setting.frame_period_s
        random = RandomStream(setting.seed, "watchdog-dump").generator(0)
        self._first_s = self.options.period_s * float(random.uniform())

    def record(self, transcript: Transcript) -> None:
        frames, rows = transcript.lost.shape
        if not frames:
            return
        since_s = transcript.time_s - transcript.time_s[0]
        planned_s = (since_s[:, None] + np.arange(rows) / rows * self._frame_s).ravel()
        late_s, due_s = 0.0, self._first_s
        while (place := int(np.searchsorted(planned_s, due_s - late_s))) < frames * rows:
            frame, row = divmod(place, rows)
            transcript.dumps.append(Dump(frame, row, self._pause_s))
            late_s, due_s = late_s + self._pause_s, due_s + self.options.period_s
