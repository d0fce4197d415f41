"""What a station's table says of an ERT board, and what the board's counts are by it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.readings import FrameBlock, ReadingFlag, VoltageUnit, correct_carry_over
from cbsr_qa.plugin import StationContext
from cbsr_qa_plugins.hardware._board_stream import BINARY_FRAME, PAIRS, Counts, scan_order
from cbsr_qa_plugins.hardware._options import InstrumentTable

_KEYS: Final = (
    "address",
    "format",
    "frame_period_s",
    "baud",
    "signed",
    "zero_counts",
    "range_counts",
    "order",
    "first_reading",
    "current_mA",
    "memory_share",
)
_BINARY_BAUD: Final = 1_400_000
_UNSIGNED, _SIGNED = (0, 2**16 - 1), (-(2**15), 2**15 - 1)
_SHAPE: Final = (PAIRS, PAIRS)
_BITS_A_BYTE: Final = 10  # with start and stop bit


@dataclass(frozen=True, slots=True, eq=False)
class BoardSettings:
    """The table of a board, checked.

    Parameters
    ----------
    address, baud, format : of its line.
    period_s : time of a frame [s].
    limits : lowest and highest count that can be sent.
    ends : counts at which a reading is saturated.
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
    def of(cls, context: StationContext, driver: str) -> Self:
        """Read the table; ConfigError where something in it is wrong, or the sensor type is none of this board."""
        table, who = InstrumentTable(context, driver, _KEYS), f"instrument {context.role!r} ({driver})"
        _check_sensor(context, who)
        format_ = table.choice("format", ("binary", "ascii"), "binary")
        address = table.text("address", remedy="give it the port, or usb:VID:PID of the board")
        baud = _baud(table, format_)
        limits = _limits(table, format_, who)
        order = table.choice("order", ("measure", "drive"), "measure")
        return cls(
            address=address,
            baud=baud,
            format=format_,
            period_s=_period(table, format_, baud, who),
            limits=limits,
            ends=_ends(table, limits, who),
            zero=table.number("zero_counts", 0),
            order=scan_order(order, table.whole("first_reading", 0, at_least=0, at_most=255)),
            current_A=1e-3 * table.number("current_mA", at_least=1e-6) if table.has("current_mA") else None,
            memory_share=table.number("memory_share", 0.0, at_least=0.0, at_most=0.5),
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


def _baud(table: InstrumentTable, format_: str) -> int:
    if format_ == "binary":
        return table.whole("baud", _BINARY_BAUD, at_least=9600, at_most=12_000_000)
    return table.whole("baud", at_least=9600, at_most=12_000_000)


def _period(table: InstrumentTable, format_: str, baud: int, who: str) -> float:
    """Return how long a frame takes; a line that cannot send it in that time is refused."""
    period_s = table.number("frame_period_s", at_least=1e-3, at_most=60.0)
    least_s = BINARY_FRAME * _BITS_A_BYTE / baud
    if format_ == "binary" and period_s < least_s:
        raise ConfigError(
            f"{who}: frame_period_s is {period_s:g}, but {BINARY_FRAME} bytes at {baud} baud take {least_s:.3g} s",
            remedy="mend frame_period_s or baud",
        )
    return period_s


def _limits(table: InstrumentTable, format_: str, who: str) -> tuple[int, int]:
    """Return the counts that can be sent at all."""
    signed = table.flag("signed", False)
    if signed and format_ == "binary":
        raise ConfigError(
            f"{who}: signed is true, but binary counts are unsigned",
            remedy="leave it out; zero_counts says which count is 0 V",
        )
    return _SIGNED if signed else _UNSIGNED


def _ends(table: InstrumentTable, limits: tuple[int, int], who: str) -> tuple[int, int]:
    """Return the ends of the converter's range."""
    low, high = table.numbers("range_counts", 2, limits)
    if not limits[0] <= low < high <= limits[1]:
        raise ConfigError(
            f"{who}: range_counts is [{low:g}, {high:g}]",
            remedy=f"it is the lowest and the highest count of a 16-bit converter, within {list(limits)}",
        )
    return int(low), int(high)
