"""Frames of voltages, and samples of other channels, as instruments deliver them.

Also recordings that any rig wrote to a file.
"""

from dataclasses import dataclass
from enum import IntFlag, StrEnum
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError, RowProblem
from cbsr_qa.domain.numbers import Array, check_encodable
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.sensor.electrodes import Electrodes

#: Largest magnitude of a reading, a sample or a current in its unit. Squares and their sums stay finite; every
#: converter's counts and every instrument's volts, newtons and amperes are far below it.
LARGEST_VALUE: Final = 1e15
#: Smallest drive current that is not zero [A]: readings are divided by it.
SMALLEST_CURRENT_A: Final = 1e-15


class VoltageUnit(StrEnum):
    """Unit of the readings. Counts are not converted: an unknown scale is not guessed."""

    VOLT = "V"
    COUNT = "count"
    TABLE = "units"  #: those of a table, which does not state any


class ReadingFlag(IntFlag):
    """Known faults of a single reading."""

    NONE = 0
    SATURATED = 1  #: at the end of the converter's range
    COMPLIANCE = 2  #: the source was at its voltage limit
    MISSING = 4  #: not recorded; the voltage stored is 0


#: Flags of readings that carry no information about a sheet.
UNUSABLE: Final = ReadingFlag.SATURATED | ReadingFlag.COMPLIANCE | ReadingFlag.MISSING


@dataclass(frozen=True, slots=True, eq=False)
class FrameBlock:
    """Consecutive frames in canonical order (row = drive pair, column = measure pair).

    Parameters
    ----------
    time_s : (n,) float64, the middle of each frame [s] on the run's or the recording's clock.
    voltages : (n, drives, measures) float64 in ``unit``.
    flags : (n, drives, measures) uint8 of :class:`ReadingFlag`.
    unit : unit of the voltages.
    current_A : drive current [A]; None where the recording does not state it.
    reading_time_s : (n, drives, measures) float64, each reading's own time [s]; None where not recorded.

    Raises
    ------
    RefusedError
        If the shapes disagree, a voltage is not finite (a missing reading is flagged, never NaN), or a voltage or
        the current is beyond :data:`LARGEST_VALUE`; the first such reading is named.
    """

    time_s: Array
    voltages: Array
    flags: NDArray[np.uint8]
    unit: VoltageUnit
    current_A: float | None
    reading_time_s: Array | None = None

    def __post_init__(self) -> None:
        if self.voltages.ndim != 3 or self.voltages.shape[0] != self.time_s.shape[0]:
            raise RefusedError(f"{self.time_s.shape[0]} times do not match voltages of shape {self.voltages.shape}")
        if self.flags.shape != self.voltages.shape:
            raise RefusedError(f"flags {self.flags.shape} do not match voltages {self.voltages.shape}")
        self._check_sizes()

    def _check_sizes(self) -> None:
        sizes = np.abs(self.voltages)
        if not sizes.max(initial=0.0) <= LARGEST_VALUE:  # nor is that of NaN
            if not np.isfinite(self.voltages).all():
                raise RefusedError(
                    "a frame holds a voltage that is not a finite number", remedy="flag it as missing instead"
                )
            frame, drive, measure = np.argwhere(sizes > LARGEST_VALUE)[0].tolist()
            raise RefusedError(
                f"frame {frame}, drive pair {drive}, measure pair {measure} (all from 0) reads"
                f" {self.voltages[frame, drive, measure]!s} {self.unit.value}; readings are at most"
                f" {LARGEST_VALUE:g} {self.unit.value}",
                remedy="flag it as missing, or record it again",
            )
        size_A = abs(self.current_A or 0.0)
        if size_A and not SMALLEST_CURRENT_A <= size_A <= LARGEST_VALUE:
            raise RefusedError(
                f"the drive current is {self.current_A:g} A; allowed: {SMALLEST_CURRENT_A:g} to {LARGEST_VALUE:g} A"
            )

    def __len__(self) -> int:
        return int(self.time_s.shape[0])

    def select(self, which: NDArray[np.bool_] | slice) -> Self:
        reading_times = None if self.reading_time_s is None else self.reading_time_s[which]
        return type(self)(
            self.time_s[which], self.voltages[which], self.flags[which], self.unit, self.current_A, reading_times
        )

    def select_interval(self, start_s: float, end_s: float) -> Self:
        """Return the frames with start_s ≤ time < end_s."""
        return self.select((self.time_s >= start_s) & (self.time_s < end_s))


@dataclass(frozen=True, slots=True, eq=False)
class SampleBlock:
    """Samples of one scalar channel: force, position, temperature.

    Parameters
    ----------
    channel : e.g. ``"force"``; a load cell's compression is positive.
    unit : e.g. ``"N"``.
    time_s, values : (n,) float64 on the same clock as the frames.

    Raises
    ------
    RefusedError
        If the shapes disagree, channel or unit cannot be encoded, or a time or value is beyond :data:`LARGEST_VALUE`.
    """

    channel: str
    unit: str
    time_s: Array
    values: Array

    def __post_init__(self) -> None:
        if self.time_s.shape != self.values.shape or self.time_s.ndim != 1:
            raise RefusedError(f"channel {self.channel}: {self.time_s.shape} times for {self.values.shape} values")
        check_encodable(f"channel {self.channel!r}", self.channel, self.unit)
        for noun, unit, column in (("time", "s", self.time_s), ("value", self.unit, self.values)):
            too_large = np.abs(column) > LARGEST_VALUE
            if too_large.any():
                first = int(too_large.argmax())
                raise RefusedError(
                    f"channel {self.channel}: the {noun} of sample {first} (from 0) is"
                    f" {column[first]!s} {unit}; at most {LARGEST_VALUE:g} {unit} is allowed"
                )

    def __len__(self) -> int:
        return int(self.time_s.shape[0])

    def select_interval(self, start_s: float, end_s: float) -> Self:
        """Return the samples with start_s ≤ time < end_s."""
        inside_mask = (self.time_s >= start_s) & (self.time_s < end_s)
        return type(self)(self.channel, self.unit, self.time_s[inside_mask], self.values[inside_mask])


def join_frames(blocks: list[FrameBlock]) -> FrameBlock:
    """Concatenate blocks of equal unit and current.

    Raises
    ------
    RefusedError
        If there are none, or they differ in unit, shape or current.
    """
    if not blocks:
        raise RefusedError("no frames to join")
    if len({(b.unit, b.current_A, b.voltages.shape[1:]) for b in blocks}) > 1:
        raise RefusedError("blocks of frames differ in unit, drive current or shape")
    reading_times = [b.reading_time_s for b in blocks if b.reading_time_s is not None]
    return FrameBlock(
        np.concatenate([b.time_s for b in blocks]),
        np.concatenate([b.voltages for b in blocks]),
        np.concatenate([b.flags for b in blocks]),
        blocks[0].unit,
        blocks[0].current_A,
        np.concatenate(reading_times) if len(reading_times) == len(blocks) else None,
    )


def join_samples(blocks: list[SampleBlock]) -> SampleBlock:
    """Concatenate sample blocks of one channel.

    Raises
    ------
    RefusedError
        If there are none, or they differ in channel or unit.
    """
    if len({(b.channel, b.unit) for b in blocks}) != 1:
        raise RefusedError("sample blocks can be joined only if channel and unit are the same")
    return SampleBlock(
        blocks[0].channel,
        blocks[0].unit,
        np.concatenate([b.time_s for b in blocks]),
        np.concatenate([b.values for b in blocks]),
    )


class ScanKind(StrEnum):
    """Scan type of a recording: what one frame covers."""

    FULL = "full"  #: every drive pair against every measure pair
    DRIVEN_PAIRS = "driven_pairs"  #: one row: the voltage across each pair while that pair is driven


@dataclass(frozen=True, slots=True)
class Recording:
    """The content of a recording, before any analysis.

    Parameters
    ----------
    path, format, dataset : its origin; ``dataset`` is empty if a file holds only one.
    scan : what a frame covers. For ``DRIVEN_PAIRS`` blocks have shape (n, 1, pairs).
    frames : the complete frames; times count from the first, on the board's clock where there is one.
    reference : frames of the unloaded domain recorded apart (tank data); None if the recording holds its own.
    still : True for single or averaged images, which have no frame rate.
    magnitudes_only : readings are absolute values (the sign must be restored from the pattern's geometry).
    samples : force and other channels; may be empty.
    loads : presses the recording documents (our own exports); may be empty.
    problems : rows left out or noteworthy, by line.
    clock : clock that the times are from: ``"board"``, ``"computer"``, ``"given"`` (with an array),
        ``"station"`` (our own runs),
        ``"documented"`` (a rate the data's authors state; the file holds no times) or ``"none"``.
    layout : documented electrode numbering, or their places; None if unknown.
    sensor_type, serial : name of the sensor type, and serial number of the sensor, if stated.
    notes : facts for a reader, in words.
    frames_dropped : incomplete frames within the file; those cut by its beginning and end do not count.
    simulated : simulated parts in words; empty for a real rig.
    rows : True if frames are rows of a table, which does not tell in which order their readings were taken.
    differences : True if the readings are changes from the unloaded sheet.
    """

    path: Path
    format: str
    dataset: str
    scan: ScanKind
    frames: FrameBlock
    reference: FrameBlock | None = None
    still: bool = False
    magnitudes_only: bool = False
    clock: str = "none"
    samples: tuple[SampleBlock, ...] = ()
    loads: tuple[LoadRecord, ...] = ()
    problems: tuple[RowProblem, ...] = ()
    layout: Electrodes | None = None
    sensor_type: str | None = None
    notes: tuple[str, ...] = ()
    frames_dropped: int = 0
    simulated: tuple[str, ...] = ()
    rows: bool = False
    differences: bool = False
    serial: str | None = None

    @property
    def rows_rejected(self) -> int:
        return sum(problem.rejected for problem in self.problems)


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What a user may state about a recording.

    Parameters
    ----------
    dataset : one of several data sets in a file; None to take the only one.
    reference : a file (and data set within it) holding the unloaded domain. The analysis reads it by its own format;
        a format only ignores a reference it would find itself.
    """

    dataset: str | None = None
    reference: tuple[Path, str | None] | None = None
