"""Faulty channels of a block of frames: saturated, stuck, missing or disconnected."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA, channel_noise
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, ScanKind, VoltageUnit

#: A channel is at a rail if this share of its readings is exactly there, and flagged if this share is flagged.
_AT_RAIL = 0.5
_FLAGGED = 0.01
#: A channel is stuck if this share of its readings equals one value while the others vary.
_CONSTANT = 0.98
#: Probability of a run of repeats, given how often the channel repeats by chance, below which it is stuck.
_FALSE_RUNS = 1e-4
_LEAST_REPEATS = 0.05
#: Share of repeats above which a run of them proves nothing.
_SELDOM = 0.25
_MIN_FRAMES = 8
#: A channel of counts hardly varies if its noise is below this share of the usual in its row and its column.
_HARDLY = 0.05
#: Largest share of the previous reading in a clipped reading, and how well the channels must agree on it.
_LARGEST_MEMORY = 0.25
_MEMORY_SPREAD = 0.03
#: Range of all readings [counts] up to which nothing is connected.
_SILENT_COUNTS = 2.0
#: Channels are at one level if their means scatter by at most this many standard errors of them.
_LEVEL_ERRORS = 2.0
#: They stand there if all readings are within this share of the level; two levels are so many standard errors apart.
_NARROW, _FAR_APART = 0.01, 30.0
#: Fewest channels of a full scan with several levels: a sheet's readings fall with distance.
_FEWEST_CHANNELS = 49
_CONVERTER_ENDS = (2**16 - 1, -(2**15))
#: A ceiling: at least this share of the pairs is at it, and no reading exceeds it by so many times the noise.
_CEILING_SHARE = 0.25
_CEILING_SIGMA = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFaults:
    """Faults by channel, each (drives, measures) bool.

    Parameters
    ----------
    saturated : readings at the end of the converter's range, or with the source at its limit.
    stuck : readings that hardly ever change, stop changing, or repeat for longer than noise explains.
    missing : readings that were not recorded.
    not_connected : whether no reading differs from any other.
    frozen : whether several frames are all the same: the board repeats itself.
    stuck_from : (drives, measures) int64, first frame of the stretch in which a channel is stuck; −1 otherwise.
    """

    saturated: Mask
    stuck: Mask
    missing: Mask
    not_connected: bool
    frozen: bool
    stuck_from: NDArray[np.int64]

    @property
    def bad(self) -> Mask:
        """Readings excluded from imaging."""
        return self.saturated | self.stuck | self.missing

    @property
    def all_saturated(self) -> bool:
        """Return whether every recorded reading is saturated."""
        return bool(self.saturated.any() and (self.saturated | self.missing).all())


def find_faults(block: FrameBlock, scan: ScanKind) -> ChannelFaults:
    """Detect faults in a block of frames.

    Parameters
    ----------
    block : (n, drives, measures), raw, with carry-over.
    """
    missing_mask = (block.flags & ReadingFlag.MISSING.value != 0).mean(axis=0) > _AT_RAIL
    present = block.voltages[:, ~missing_mask]
    silent = _SILENT_COUNTS if block.unit is VoltageUnit.COUNT else 0.0
    levels = _count_levels(block, missing_mask)
    not_connected = present.size == 0 or float(np.ptp(present)) <= silent or levels == 1
    at_end = False
    if not_connected and present.size > 0 and block.unit is VoltageUnit.COUNT:
        # Silent counts at an end of 16 bits; 0 and 32 767, the middle, are readings without input.
        low, high = float(present.min()) - _SILENT_COUNTS, float(present.max()) + _SILENT_COUNTS
        at_end = any(low <= end <= high for end in _CONVERTER_ENDS)
    not_connected = not_connected and not at_end
    flagged = block.flags & (ReadingFlag.SATURATED | ReadingFlag.COMPLIANCE).value != 0
    saturated = (flagged.mean(axis=0) > _FLAGGED) | at_end | (levels == 2 and not not_connected)
    is_frozen = len(block) >= _MIN_FRAMES and bool((block.voltages == block.voltages[0]).all())
    if not (not_connected or at_end or is_frozen):
        saturated |= _find_rail_clipping(block, missing_mask)
        if scan is ScanKind.DRIVEN_PAIRS:
            saturated |= _find_ceiling_clipping(block.voltages)
    stuck_from = np.where(missing_mask, -1, _find_first_stuck_frames(block))
    return ChannelFaults(
        saturated & ~missing_mask, stuck_from >= 0, missing_mask, not_connected, is_frozen, stuck_from
    )


def _count_levels(block: FrameBlock, missing: Mask) -> int:
    """Number of levels at which all channels stand, 1 or 2; 0 if there are more, as on a sheet, or none can be told.

    Two are both ends of a range, or no readings of a sheet. Symmetric patterns with other measure than drive pairs
    may have two by themselves.
    """
    drives, measures = missing.shape
    present = block.voltages[:, ~missing]
    if drives not in (1, measures) or len(block) < _MIN_FRAMES or not present.shape[1]:
        return 0
    ends = (float(present.min()), float(present.max()))
    if present.shape[1] > 1 and ends[0] < ends[1] and np.isin(present, ends).all():
        return 2
    if present.shape[1] < _FEWEST_CHANNELS:
        return 0
    means = np.sort(present.mean(axis=0))
    error = float(np.median(channel_noise(present, counts=block.unit is VoltageUnit.COUNT))) / np.sqrt(len(block))
    if means.std() <= _LEVEL_ERRORS * error:
        return 1 if ends[1] - ends[0] <= _NARROW * max(map(abs, ends)) else 0
    gap = int(np.argmax(np.diff(means))) + 1
    is_apart = means[gap] - means[gap - 1] > _FAR_APART * error and 1 < gap < len(means) - 1
    return 2 if is_apart and max(means[:gap].std(), means[gap:].std()) <= _LEVEL_ERRORS * error else 0


def _find_rail_clipping(block: FrameBlock, missing: Mask) -> Mask:
    voltages = np.where(missing, np.median(block.voltages), block.voltages)
    clipped = np.zeros(missing.shape, dtype=bool)
    if len(voltages) < _MIN_FRAMES:
        return clipped
    for rail in (float(voltages.min()), float(voltages.max())):
        exact = (voltages == rail).mean(axis=0) >= _AT_RAIL
        if exact.any():
            at_rail = exact | _remembering_rail(np.median(voltages, axis=0), rail)
            # A single channel that never changes is stuck, and makes an extreme of any value.
            is_constant = (voltages[:, at_rail] == rail).mean() >= _CONSTANT
            if at_rail.sum() > 1 or _is_converter_end(rail) or not is_constant:
                clipped |= at_rail
    return clipped


def _is_converter_end(rail: float) -> bool:
    """Whether a value is an end of a converter's range of at least 8 bits, or zero."""
    bits = np.log2(abs(rail) + (rail > 0)) if rail else 0.0
    return rail in (0.0, -(2**15 - 1)) or (bits >= 8 and float(bits).is_integer())


def _remembering_rail(level: Array, rail: float) -> Mask:
    """Channels clipped at a rail that show a share of the reading before them: level = rail + m (previous − rail).

    It is sought among readings at the same distance from the driven pair, which only have m in common.
    """
    rows, columns = level.shape
    clipped = np.zeros(level.shape, dtype=bool)
    if rows != columns:
        return clipped
    previous = np.roll(level.ravel(), 1).reshape(level.shape)
    k = np.arange(rows)
    # A single far reading at a rail does not explain the large ones: one of those must be there too.
    if not any((level[k, (k + distance) % rows] == rail).any() for distance in (-1, 0, 1)):
        return clipped
    for distance in (-1, 0, 1):
        row_and_channel = k, (k + distance) % rows
        share = (level[row_and_channel] - rail) / np.where(
            previous[row_and_channel] == rail, np.inf, previous[row_and_channel] - rail
        )
        middle = float(np.median(share))
        is_near = np.abs(share - middle) <= _MEMORY_SPREAD
        if 0 < middle <= _LARGEST_MEMORY and is_near.mean() >= 0.75:
            clipped[row_and_channel] |= is_near
    return clipped


def _find_ceiling_clipping(voltages: Array) -> Mask:
    """Pairs clipped at a common level that no reading exceeds: the source's voltage limit.

    Use it only for one-row scans, where symmetry does not cause equal levels.
    """
    rows = voltages[:, 0, :]
    level = np.median(rows, axis=0)
    sigma = np.maximum(MAD_TO_SIGMA * np.median(np.abs(rows - level), axis=0), 1e-12)
    top = float(np.median(np.sort(level)[-3:]))
    noise = float(np.median(sigma[level >= top - np.ptp(level) / 2]))
    together = np.abs(level - top) <= 2 * noise
    if together.mean() < _CEILING_SHARE or float(rows.max()) > top + _CEILING_SIGMA * noise:
        return np.zeros(voltages.shape[1:], dtype=bool)
    # Pairs that have not quite settled at the ceiling (they follow a low reading) are at it as well.
    return (top - level <= max(_CEILING_SIGMA * 2 * noise, 0.002 * abs(top)))[None]


def _find_first_stuck_frames(block: FrameBlock) -> NDArray[np.int64]:
    """First frame in which each channel is stuck while most others move; −1 for channels that are not."""
    n = len(block)
    begin = np.full(block.voltages.shape[1:], -1, dtype=np.int64)
    if n < _MIN_FRAMES:
        return begin
    share_at_median = (block.voltages == np.median(block.voltages, axis=0)).mean(axis=0)
    repeats = block.voltages[1:] == block.voltages[:-1]
    # Counts with less than a count of noise stay constant without being stuck: only judge where most channels move.
    if float(np.median(share_at_median)) > _SELDOM or float(np.median(repeats.mean(axis=0))) > _SELDOM:
        return begin
    longest, longest_begin = _longest_run(repeats)
    begin = np.where(longest >= _unlikely_run(repeats, longest), longest_begin, begin)
    begin[share_at_median >= _CONSTANT] = 0
    if block.unit is VoltageUnit.COUNT:
        begin[_find_nearly_silent(block.voltages)] = 0
    return begin


def _find_nearly_silent(voltages: Array) -> Mask:
    """Channels of counts that are nearly silent while others of the same drive and of the same measure pair are not.

    Noise includes rounding, so only counts that are noisy elsewhere qualify. Quiet drives or pairs are no fault.
    """
    noise = channel_noise(voltages, counts=True)
    usual = np.minimum(np.median(noise, axis=0)[None], np.median(noise, axis=1)[:, None])
    return noise < _HARDLY * np.minimum(usual, np.median(noise))


def _unlikely_run(repeats: Mask, longest: NDArray[np.int64]) -> Array:
    """Number of repeats in a row that noise alone reaches in one of ten thousand recordings.

    A channel's noise is judged by its repeats outside its longest run; quiet ones often repeat.
    """
    besides = (repeats.sum(axis=0) - longest) / np.maximum(len(repeats) - longest, 1)
    chance = np.maximum(besides, max(float(np.median(repeats.mean(axis=0))), _LEAST_REPEATS))
    needed = np.log(_FALSE_RUNS / repeats.size) / np.log(np.minimum(chance, _SELDOM))
    return np.where(chance > _SELDOM, np.inf, np.maximum(needed, _MIN_FRAMES))


def _longest_run(repeats: Mask) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    run = np.zeros(repeats.shape[1:], dtype=np.int64)
    longest, end = np.zeros_like(run), np.zeros_like(run)
    for k, repeated in enumerate(repeats):
        run = np.where(repeated, run + 1, 0)
        longer = run > longest
        longest = np.where(longer, run, longest)
        end = np.where(longer, k + 1, end)
    return longest, end - longest


def find_dead_rows(stuck: Mask, usable: Mask) -> tuple[int, ...]:
    """Return the rows of a full scan, each of one driven pair, of which every usable reading is stuck."""
    if len(usable) < 2:
        return ()
    return tuple(int(row) for row in np.flatnonzero(usable.any(axis=1) & (stuck | ~usable).all(axis=1)))


def describe_dead_rows(rows: tuple[int, ...]) -> str:
    """Name dead rows, and what to do."""
    if len(rows) == 1:
        return f"row {rows[0]} of the board is dead: its readings never change; check its channel and its leads"
    return (
        f"rows {', '.join(map(str, rows))} of the board are dead: their readings never change; check their channels"
        " and leads"
    )
