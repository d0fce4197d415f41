"""Options of an ERT board, and what the board's counts are by them."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from cbsr_qa.plugin import (
    Array,
    FrameBlock,
    PluginOptions,
    Problem,
    ReadingFlag,
    StationContext,
    VoltageUnit,
    correct_carry_over,
)
from cbsr_qa_plugins.hardware._board_stream import BOARDS, Counts, binary_frame_bytes, stream_order
from cbsr_qa_plugins.hardware._driver import Port, config_error

_BINARY_BAUD: Final = 1_400_000
_UNSIGNED, _SIGNED = (0, 2**16 - 1), (-(2**15), 2**15 - 1)
_BITS_A_BYTE: Final = 10  # with start and stop bit
_CORRECT_HASTE: Final = "correct frame_period_s or baud"


class BoardOptions(PluginOptions):
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
        elif (problem := self.find_haste(BOARDS[0])) is not None:
            yield Problem(("frame_period_s",), problem, _CORRECT_HASTE)
        if self.signed and self.format == "binary":
            problem = "is true, but binary counts are unsigned"
            yield Problem(("signed",), problem, "leave it out; zero_counts says which count is 0 V")
        low, high = self.range_counts or self.limits
        if not self.limits[0] <= low < high <= self.limits[1]:
            allowed = f"the lowest and the highest count of a 16-bit converter, within {list(self.limits)}"
            yield Problem(("range_counts",), f"is [{low:g}, {high:g}]", f"it must be {allowed}")

    def find_haste(self, pairs: int) -> str | None:
        """Return what is wrong with a period in which the line cannot send a binary frame; None if it can."""
        if self.format != "binary" or self.speed is None:
            return None
        count = binary_frame_bytes(pairs)
        least_s = count * _BITS_A_BYTE / self.speed
        if self.frame_period_s >= least_s:
            return None
        return f"is {self.frame_period_s:g}, but {count} bytes at {self.speed} baud take {least_s:.3g} s"

    def block(self, ends_s: Sequence[float], sent: Sequence[Counts]) -> FrameBlock:
        """Return frames in canonical order.

        Parameters
        ----------
        ends_s : when each of them was over, on the station's clock.
        sent : (pairs, pairs) counts each, in the order of the stream.
        """
        shape = sent[0].shape
        order = stream_order(len(sent[0]), self.order, self.first_reading)
        flat = np.empty((len(sent), order.size))
        flat[:, order] = np.reshape(sent, (len(sent), -1))
        counts = flat.reshape(-1, *shape)
        low, high = self.ends
        flags = np.zeros(counts.shape, dtype=np.uint8)
        flags[(counts <= low) | (counts >= high)] = ReadingFlag.SATURATED
        values = counts - self.zero_counts
        if self.memory_share:
            values = correct_carry_over(values, self.memory_share, order)
        times_s = np.array(ends_s) - self.frame_period_s / 2
        # The board reads one after the other: the n-th of all in the middle of the n-th part of the frame.
        offsets = np.empty(order.size)
        offsets[order] = (np.arange(order.size) + 0.5) / order.size - 0.5
        own_s = times_s[:, None, None] + self.frame_period_s * offsets.reshape(shape)
        current_A = None if self.current_mA is None else 1e-3 * self.current_mA
        return FrameBlock(times_s, values, flags, VoltageUnit.COUNT, current_A, own_s)


def count_pairs(context: StationContext, driver: str, options: BoardOptions) -> int:
    """Return the pairs of the board: as many as the sensor type has.

    ConfigError if no board has so many, or a frame of so many takes longer to send than its period.
    """
    rows, columns = context.sensor_type.pattern.shape
    if rows != columns or rows not in BOARDS:
        boards = " or ".join(f"{pairs} x {pairs}" for pairs in BOARDS)
        problem = f" sends {boards} readings; sensor type {context.sensor_type.name!r} has {rows} x {columns}"
        remedy = "use a sensor type with as many drive and measure pairs as the board, or another driver"
        raise config_error(context, driver, problem, remedy)
    if (haste := options.find_haste(rows)) is not None:
        raise config_error(context, driver, f": frame_period_s {haste}", _CORRECT_HASTE)
    return rows
