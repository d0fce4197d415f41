"""Blocks of frames and samples as rows, and back with their digest checked."""

from typing import Any

import numpy as np

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.store.arrays import digest, packed, packed_flags, unpacked, unpacked_flags
from cbsr_qa.store.run_tables import FrameBlockRow, SampleBlockRow


def frame_values(block: FrameBlock) -> dict[str, Any]:
    """Return the columns of a block of frames, keys of the place left out."""
    frames, drives, measures = block.voltages.shape
    own = None if block.reading_time_s is None else packed(block.reading_time_s)
    parts = packed(block.time_s), packed(block.voltages), packed_flags(block.flags), own or b""
    return {
        "frames": frames,
        "drives": drives,
        "measures": measures,
        "unit": str(block.unit),
        "current_a": block.current_A,
        "first_s": block.time_s[0],
        "last_s": block.time_s[-1],
        "time_s": parts[0],
        "voltages": parts[1],
        "flags": parts[2],
        "reading_time_s": own,
        "sha256": digest(_frame_header(block.voltages.shape, str(block.unit), block.current_A), parts),
    }


def frame_block(row: FrameBlockRow) -> FrameBlock:
    """Return the block of a row.

    Raises
    ------
    StoreError
        If what is stored is not what was measured: the digest or a length does not fit.
    """
    shape = row.frames, row.drives, row.measures
    parts = row.time_s, row.voltages, row.flags, row.reading_time_s or b""
    if digest(_frame_header(shape, row.unit, row.current_a), parts) != row.sha256:
        raise _damaged("frame", row.run, row.phase, row.block)
    return FrameBlock(
        unpacked(row.time_s, shape[:1]),
        unpacked(row.voltages, shape),
        unpacked_flags(row.flags, shape),
        VoltageUnit(row.unit),
        row.current_a,
        None if row.reading_time_s is None else unpacked(row.reading_time_s, shape),
    )


def sample_values(block: SampleBlock) -> dict[str, Any]:
    """Return the columns of a block of samples, keys of the place left out.

    Raises
    ------
    StoreError
        If a sample is not a finite number.
    """
    if not (np.isfinite(block.values).all() and np.isfinite(block.time_s).all()):
        raise StoreError(f"a sample of {block.channel} is not a finite number and is not stored")
    parts = packed(block.time_s), packed(block.values)
    return {
        "channel": block.channel,
        "unit": block.unit,
        "samples": len(block),
        "time_s": parts[0],
        "sample_values": parts[1],
        "sha256": digest(f"{block.channel}|{block.unit}|{len(block)}", parts),
    }


def sample_block(row: SampleBlockRow) -> SampleBlock:
    """Return the block of a row; StoreError as for :func:`frame_block`."""
    if digest(f"{row.channel}|{row.unit}|{row.samples}", (row.time_s, row.sample_values)) != row.sha256:
        raise _damaged("sample", row.run, row.phase, row.block)
    shape = (row.samples,)
    return SampleBlock(row.channel, row.unit, unpacked(row.time_s, shape), unpacked(row.sample_values, shape))


def _frame_header(shape: tuple[int, ...], unit: str, current_A: float | None) -> str:
    # repr of a float is exact: the digest covers the current to the last bit.
    return f"{'x'.join(map(str, shape))}|{unit}|{None if current_A is None else float(current_A)!r}"


def _damaged(what: str, run: str, phase: int, block: int) -> StoreError:
    return StoreError(
        f"{what} block {block} of phase {phase} of run {run} is not what was measured: its digest does not fit",
        remedy="restore the database from a copy; this run is not analysed",
    )
