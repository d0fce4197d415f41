"""Preparation of a recording for imaging: bad channels masked, offsets and carry-over removed, spikes replaced."""

from dataclasses import dataclass, replace

import numpy as np

from cbsr_qa.analysis.defects.channels import ChannelFaults, describe_dead_rows, find_dead_rows, find_faults
from cbsr_qa.analysis.defects.contacts import describe_open, find_opening, open_electrodes
from cbsr_qa.analysis.defects.drives import DeadDrive, find_dead_drives
from cbsr_qa.analysis.defects.noise import channel_noise
from cbsr_qa.analysis.defects.offsets import find_offsets, offset_words, subtract_offsets
from cbsr_qa.analysis.defects.spikes import remove_spikes
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.carry_over import (
    CarryOver,
    correct_carry_over,
    estimate_carry_over,
    offset_of,
    reciprocity_error,
    scan_order,
)
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, Recording, ScanKind, VoltageUnit
from cbsr_qa.domain.results.findings import ChannelReport
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern, find_shared_electrode

#: One electrode that loses contact differs from loads by its change; several at once by the parts without them.
_PARTS, _PART_FRAMES = 4, 8
_MOST_LISTED = 6  #: channels named in a remark


@dataclass(frozen=True, slots=True, eq=False)
class ReadyReadings:
    """Usable readings of a recording, with its instrument faults removed.

    Parameters
    ----------
    block : frames, sudden offsets taken out, carry-over too where ``corrected``, spikes replaced.
    reference : (drives, measures) mean of the reference frames, treated alike; None without any.
    faults : faults of the raw frames.
    used : (drives, measures) bool, sound readings that touch no driven electrode.
    carry_over : estimate, or None.
    corrected : whether it was removed from ``block``.
    error : reciprocity error of ``block``; None for one-row scans.
    offset : whether the readings include an unknown offset, see :func:`has_offset`.
    offsets : frame and size of every sudden offset of all readings.
    dead_drives, open_electrodes : left out.
    open_since : when those opened, in words; empty from the beginning.
    clipped : (drives, measures) bool, saturated readings that would be used otherwise.
    limited : drive pairs of which all readings are; of their one electrode the lead is open.
    limited_since : when that began, in words; empty from the beginning.
    spikes, spiky_frames : number of readings that were replaced, and of their frames, see :func:`remove_spikes`.
    """

    block: FrameBlock
    reference: Array | None
    faults: ChannelFaults
    used: Mask
    clipped: Mask
    carry_over: CarryOver | None
    corrected: bool
    error: float | None
    offset: bool
    offsets: tuple[tuple[int, float], ...] = ()
    dead_drives: tuple[DeadDrive, ...] = ()
    open_electrodes: tuple[int, ...] = ()
    spikes: int = 0
    spiky_frames: int = 0
    open_since: str = ""
    limited: tuple[tuple[int, int], ...] = ()
    limited_since: str = ""

    def remarks(self) -> list[str]:
        """Describe corrections of readings, and channels that failed during the recording."""
        remarks = offset_words(self.offsets, self.block.time_s, self.block.unit.value)
        if self.open_electrodes:
            remarks.append(f"{describe_open(self.open_electrodes, self.open_since)}; these readings were left out")
        remarks += [dead.words(self.block.unit.value) for dead in self.dead_drives]
        if self.spikes:
            remarks.append(
                f"glitches: {self.spikes} of the readings (in {self.spiky_frames} of the frames) jumped for about a"
                " frame, and their reciprocals did not; they were replaced by their neighbours in time"
            )
        if self.clipped.any() and not self.faults.all_saturated:
            remarks.append(f"{self._describe_clipped()}; they were left out")
        stuck = np.where(self.faults.saturated, -1, self.faults.stuck_from)
        dead_rows = find_dead_rows(stuck == 0, ~self.faults.saturated & ~self.faults.missing)
        if dead_rows:
            remarks.append(f"{describe_dead_rows(dead_rows)}; they were left out")
            stuck[list(dead_rows)] = -1
        if (stuck == 0).any():
            remarks.append(
                f"stuck: channels {_list_channels(stuck == 0)} never change, or hardly; they were left out"
            )
        if (stuck > 0).any():
            first = float(self.block.time_s[int(stuck[stuck > 0].min())])
            remarks.append(f"stuck after {first:.1f} s: channels {_list_channels(stuck > 0)}; they were left out")
        return remarks

    def _describe_clipped(self) -> str:
        electrode = find_shared_electrode(self.limited)
        if electrode is None:
            return f"saturated: channels {_list_channels(self.clipped)} stand at an end"
        pairs = ", ".join(f"{source}–{sink}" for source, sink in self.limited)
        since = f" since {self.limited_since}" if self.limited_since else ""
        return (
            f"electrode {electrode} may be open{since}: all readings driven through electrodes {pairs} stand at an"
            f" end ({int(self.clipped.sum())} are saturated); check its pin"
        )

    def noise_use(self) -> Mask:
        """Readings for the noise estimate: the used ones, or without any, all that are not bad."""
        use = self.used if self.used.any() else ~self.faults.bad
        return use if use.any() else np.ones_like(use)


def _list_channels(channels: Mask) -> str:
    unlisted_count = int(channels.sum()) - _MOST_LISTED
    return ", ".join(f"[{i}, {j}]" for i, j in np.argwhere(channels)[:_MOST_LISTED]) + (
        f" and {unlisted_count} more" if unlisted_count > 0 else ""
    )


def _usable(recording: Recording, pattern: DrivePattern | None, missing: Mask) -> Mask:
    shape = recording.frames.voltages.shape[1:]
    if pattern is not None and recording.scan is ScanKind.FULL and pattern.shape == shape:
        return pattern.select_imaged(~missing) if recording.rows else pattern.usable()
    if recording.scan is ScanKind.DRIVEN_PAIRS or shape[0] != shape[1]:
        return np.ones(shape, dtype=bool)
    return adjacent_pattern(shape[0]).usable()


def has_offset(recording: Recording) -> bool:
    """Whether readings may have an unknown offset: counts do, volts and magnitudes do not."""
    return recording.frames.unit is VoltageUnit.COUNT and not recording.magnitudes_only


def make_ready(recording: Recording, wanted: bool | None, pattern: DrivePattern | None = None) -> ReadyReadings:
    """Detect the faults of a recording, and remove its carry-over.

    Parameters
    ----------
    wanted : whether to correct carry-over; None to correct it if that improves the readings.
    pattern : pattern of the named sensor type; None if the same adjacent pairs are driven and measured. Otherwise no
        readings are reciprocal, and checks of reciprocity are skipped.
    """
    block = recording.frames
    faults = find_faults(block, recording.scan)
    usable_mask = _usable(recording, pattern, faults.missing)
    used_mask = usable_mask & ~faults.bad
    opened: tuple[int, ...] = ()
    opening: int | None = None
    limited: list[tuple[int, int]] = []
    limiting = 0
    if recording.scan is ScanKind.FULL and used_mask.any() and not recording.differences:
        full_pattern = pattern or adjacent_pattern(used_mask.shape[0])
        opened = _find_open_electrodes(block.voltages, used_mask, full_pattern)
        opening = find_opening(block.voltages, used_mask, full_pattern, opened) if opened else None
        used_mask &= ~full_pattern.touching(opened)
        if full_pattern.shape == used_mask.shape:
            limited = full_pattern.list_silent_drives(faults.saturated, usable_mask)
            limiting = _find_limiting(block, [full_pattern.drive.index(pair) for pair in limited], usable_mask)
    imaged = recording.scan is ScanKind.FULL and (pattern is None or pattern.drive == pattern.measure)
    carry_over = None
    is_scanned = imaged and not recording.still and not recording.magnitudes_only and not faults.not_connected
    is_scanned &= bool(used_mask.any()) and not recording.differences
    is_mended = is_scanned and recording.reference is None
    offset = has_offset(recording)
    voltages, offsets = block.voltages, tuple[tuple[int, float], ...]()
    if is_mended and len(block) > 1:
        offsets = find_offsets(voltages[:, used_mask], channel_noise(voltages[:, used_mask], counts=offset))
        voltages = subtract_offsets(voltages, offsets)
    if is_scanned and not recording.rows:
        # One absurd reading must not decide the correction of the whole frame.
        calm = remove_spikes(voltages, used_mask, counts=offset)[0] if is_mended else voltages
        driven_mask = used_mask.copy()
        driven_mask[[dead.drive for dead in find_dead_drives(np.median(calm, axis=0), used_mask)]] = False
        carry_over = estimate_carry_over(replace(block, voltages=calm), driven_mask)
    correct_memory = (
        carry_over is not None
        and (carry_over.worth_correcting if wanted is None else wanted)
        and carry_over.share < 1
    )
    reference = None if recording.reference is None else recording.reference.voltages
    if correct_memory and carry_over is not None:
        order = scan_order(block)
        voltages = correct_carry_over(voltages, carry_over.share, order)
        reference = None if reference is None else correct_carry_over(reference, carry_over.share, order)
    spikes = np.zeros(voltages.shape, dtype=bool)
    if is_mended:
        voltages, spikes = remove_spikes(voltages, used_mask, counts=offset)
    dead_drives = find_dead_drives(np.median(voltages, axis=0), used_mask) if is_scanned else ()
    used_mask[[dead.drive for dead in dead_drives]] = False
    mean = voltages.mean(axis=0)
    error = (
        reciprocity_error(mean, used_mask, offset_of(mean, used_mask, counts=offset))
        if imaged and used_mask.any() and not recording.differences
        else None
    )
    return ReadyReadings(
        replace(block, voltages=voltages),
        None if reference is None else reference.mean(axis=0),
        faults,
        used_mask,
        usable_mask & faults.saturated,
        carry_over,
        bool(correct_memory),
        error,
        offset,
        offsets,
        dead_drives,
        opened,
        int(spikes.sum()),
        int(spikes.any(axis=(1, 2)).sum()),
        "" if opening is None or recording.still else f"{float(block.time_s[opening]):.1f} s",
        tuple(limited),
        "" if limiting == 0 or recording.still else f"{float(block.time_s[limiting]):.1f} s",
    )


def _find_limiting(block: FrameBlock, drives: list[int], usable: Mask) -> int:
    """Return the frame from which on every usable reading of some drives is flagged; 0 if none is flagged."""
    flagged = block.flags[:, drives][:, usable[drives]] & (ReadingFlag.SATURATED | ReadingFlag.COMPLIANCE).value != 0
    whole = flagged.all(axis=1)
    return int(np.argmax(whole)) if len(drives) and whole.any() else 0


def _find_open_electrodes(voltages: Array, used: Mask, pattern: DrivePattern) -> tuple[int, ...]:
    """Electrodes without contact for most of the recording, or in a part of it if those are several."""
    most_electrodes = open_electrodes(np.median(voltages, axis=0), used, pattern)
    for part in np.array_split(voltages, _PARTS) if len(voltages) >= _PARTS * _PART_FRAMES else ():
        part_electrodes = open_electrodes(np.median(part, axis=0), used, pattern)
        if len(part_electrodes) > max(1, len(most_electrodes)):
            most_electrodes = part_electrodes
    return most_electrodes


def channel_report(recording: Recording, ready: ReadyReadings) -> ChannelReport:
    """Report the state of the channels of a recording."""
    carry_over = ready.carry_over
    return ChannelReport(
        saturated=_pairs(ready.faults.saturated),
        stuck=_pairs(ready.faults.stuck),
        not_connected=ready.faults.not_connected,
        used=int(ready.used.sum()) if ready.used.shape[0] > 1 else 0,
        snr_db=None if recording.differences else _snr_db(ready),
        reciprocity_error=carry_over.error if carry_over is not None else ready.error,
        reading_memory=carry_over.share if carry_over is not None else None,
        reciprocity_error_corrected=carry_over.error_corrected if carry_over is not None else None,
        memory_corrected=ready.corrected,
    )


def _pairs(mask: Mask) -> tuple[tuple[int, int], ...]:
    one_row = mask.shape[0] == 1
    return tuple((int(j) if one_row else int(i), int(j)) for i, j in np.argwhere(mask))


def _snr_db(ready: ReadyReadings) -> float | None:
    """Median over channels of level over noise; offsets of counts are subtracted for full scans."""
    use = ready.noise_use()
    block = ready.block
    if len(block) < 3 or ready.faults.not_connected:
        return None
    readings = block.voltages[:, use]
    level = np.median(readings, axis=0)
    if block.voltages.shape[1] > 1:
        level = level - offset_of(np.median(block.voltages, axis=0), use, counts=ready.offset)
    sigma = channel_noise(readings, counts=block.unit is VoltageUnit.COUNT)
    ratio = float(np.median(np.abs(level) / sigma))
    return 20 * float(np.log10(ratio)) if ratio > 0 else None
