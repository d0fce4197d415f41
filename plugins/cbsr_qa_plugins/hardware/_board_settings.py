"""What a station's table says of an ERT board, and what the board's counts are by it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.readings import FrameBlock, ReadingFlag, VoltageUnit, correct_carry_over
from cbsr_qa.plugin import Array, PluginOptions, Problem, StationContext
from cbsr_qa_plugins.hardware._board_stream import BINARY_FRAME, PAIRS, Counts, scan_order
from cbsr_qa_plugins.hardware._options import Port

_BINARY_BAUD: Final = 1_400_000
_UNSIGNED, _SIGNED = (0, 2**16 - 1), (-(2**15), 2**15 - 1)
_SHAPE: Final = (PAIRS, PAIRS)
_BITS_A_BYTE: Final = 10  # with start and stop bit


class BoardOptions(PluginOptions):
    """Options of a board's table."""

    address: Port
    format: Literal["binary", "ascii"] = "binary"
    frame_period_s: Annotated[float, Field(ge=1e-3, le=60)]
    baud: Annotated[int, Field(ge=9600, le=12_000_000)] | None = None
    signed: bool = False
    zero_counts: float = 0.0
    range_counts: Annotated[tuple[float, float], Array] | None = None
    order: Literal["measure", "drive"] = "measure"
    first_reading: Annotated[int, Field(ge=0, le=255)] = 0
    current_mA: Annotated[float, Field(ge=1e-6)] | None = None
    memory_share: Annotated[float, Field(ge=0, le=0.5)] = 0.0

    @property
    def speed(self) -> int | None:
        """Baud; there is no default for text."""
        return _BINARY_BAUD if self.baud is None and self.format == "binary" else self.baud

    @property
    def limits(self) -> tuple[int, int]:
        """Lowest and highest count that can be sent at all."""
        return _SIGNED if self.signed else _UNSIGNED

    @property
    def ends(self) -> tuple[int, int]:
        """Ends of the converter's range."""
        low, high = self.range_counts or self.limits
        return int(low), int(high)

    def problems(self) -> Iterator[Problem]:
        """What the line can send, and what a converter can count."""
        if self.speed is None:
            yield Problem(("baud",), "is missing", "it must be that of the board's text")
        elif self.format == "binary" and self.frame_period_s < (least_s := BINARY_FRAME * _BITS_A_BYTE / self.speed):
            what = f"is {self.frame_period_s:g}, but {BINARY_FRAME} bytes at {self.speed} baud take {least_s:.3g} s"
            yield Problem(("frame_period_s",), what, "correct frame_period_s or baud")
        if self.signed and self.format == "binary":
            what = "is true, but binary counts are unsigned"
            yield Problem(("signed",), what, "leave it out; zero_counts says which count is 0 V")
        low, high = self.range_counts or self.limits
        if not self.limits[0] <= low < high <= self.limits[1]:
            allowed = f"the lowest and the highest count of a 16-bit converter, within {list(self.limits)}"
            yield Problem(("range_counts",), f"is [{low:g}, {high:g}]", f"it must be {allowed}")


@dataclass(frozen=True, slots=True, eq=False)
class BoardSettings:
    """The table of a board, checked.

    Parameters
    ----------
    period_s : time of a frame [s].
    zero : the count of 0 V.
    order : (256,) int64, see :func:`~cbsr_qa_plugins.hardware._board_stream.scan_order`.
    current_A : None where it is not stated.
    memory_share : of the reading before, taken out of each; 0 for none.
    """

    address: str
    baud: int
    format: str
    period_s: float
    limits: tuple[int, int]
    ends: tuple[int, int]
    zero: float
    order: NDArray[np.int64]
    current_A: float | None
    memory_share: float

    @classmethod
    def of(cls, context: StationContext, options: BoardOptions, driver: str) -> Self:
        """Take them from a table; ConfigError where the sensor type is none of this board."""
        _check_sensor(context, f"instrument {context.role!r} ({driver})")
        assert options.speed is not None
        return cls(
            address=options.address,
            baud=options.speed,
            format=options.format,
            period_s=options.frame_period_s,
            limits=options.limits,
            ends=options.ends,
            zero=options.zero_counts,
            order=scan_order(options.order, options.first_reading),
            current_A=None if options.current_mA is None else 1e-3 * options.current_mA,
            memory_share=options.memory_share,
        )

    @property
    def text(self) -> bool:
        """Whether the board sends text."""
        return self.format == "ascii"

    def block(self, ends_s: Sequence[float], sent: Sequence[Counts]) -> FrameBlock:
        """Return frames in canonical order.

        Parameters
        ----------
        ends_s : when each of them was over, on the station's clock.
        sent : (16, 16) counts each, in the order of the stream.
        """
        counts = self._canonical(np.array(sent, dtype=np.float64))
        flags = np.zeros(counts.shape, dtype=np.uint8)
        flags[(counts <= self.ends[0]) | (counts >= self.ends[1])] = ReadingFlag.SATURATED
        values = counts - self.zero
        if self.memory_share:
            values = correct_carry_over(values, self.memory_share, self.order)
        times_s = np.array(ends_s) - self.period_s / 2
        # The board reads one after the other: the n-th of 256 in the middle of the n-th part of the frame.
        offsets = np.empty(counts[0].size)
        offsets[self.order] = (np.arange(counts[0].size) + 0.5) / counts[0].size - 0.5
        own_s = times_s[:, None, None] + self.period_s * offsets.reshape(_SHAPE)
        return FrameBlock(times_s, values, flags, VoltageUnit.COUNT, self.current_A, own_s)

    def _canonical(self, sent: NDArray[Any]) -> NDArray[np.float64]:
        frames = np.empty((len(sent), PAIRS * PAIRS))
        frames[:, self.order] = sent.reshape(len(sent), -1)
        return frames.reshape(-1, *_SHAPE)


def _check_sensor(context: StationContext, who: str) -> None:
    rows, columns = context.sensor_type.pattern.shape
    if (rows, columns) != _SHAPE:
        raise ConfigError(
            f"{who} sends 16 x 16 readings; sensor type {context.sensor_type.name!r} has {rows} x {columns}",
            remedy="use a sensor type of 16 drive and 16 measure pairs, or another driver",
        )
