"""The unloaded sheet of a run: its frames, reference frame, usable readings, and the weight of each reading."""

from dataclasses import dataclass, replace
from datetime import timedelta

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.channels import describe_dead_rows, find_dead_rows, find_faults
from cbsr_qa.analysis.defects.contacts import describe_open, find_opening, open_electrodes
from cbsr_qa.analysis.defects.drives import find_dead_drives
from cbsr_qa.analysis.defects.noise import channel_noise
from cbsr_qa.analysis.defects.offsets import find_offsets, offset_words, subtract_offsets
from cbsr_qa.analysis.defects.rectifying import answering_levels
from cbsr_qa.analysis.defects.spikes import remove_spikes
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock, ScanKind, join_frames
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.readings import reading_noise
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.system.clock import write_local_time

#: Largest share of a frame's imaged readings that may be flagged; above it the whole frame is left out.
_MAX_FLAGGED_SHARE = 0.25
#: Largest share of frames that flags may still affect after channels were left out.
_MAX_AFFECTED_SHARE = 0.01
#: Most readings that a warning names.
_MAX_NAMED_READINGS = 6
#: A reading that got stuck during a run has the same value in this many frames at its end.
_STILL_FRAMES = 8


def find_unloaded_frames(record: RunRecord) -> FrameBlock:
    """Return the frames of the rested sheet: from the run's first ``MarkUnloaded`` to the press that follows.

    NumericsError if the run has none.
    """
    for phase in record.phases:
        frames = _select_unloaded(phase)
        if frames is not None and len(frames):
            return frames
    raise NumericsError(
        f"run {record.identity.run} has no frames of the unloaded sheet",
        remedy="start the recipe with a sequence that rests and takes unloaded frames, such as noise-figure",
    )


def split_unloaded(frames: FrameBlock, noise_floor_frames: int) -> tuple[FrameBlock, FrameBlock]:
    """Split unloaded frames into those of the noise floor (the first ones, as in the paper) and of the reference.

    NumericsError if no frame is left for the reference.
    """
    if len(frames) <= noise_floor_frames:
        raise NumericsError(
            f"{len(frames)} unloaded frames are too few: the noise floor needs {noise_floor_frames}, the reference at"
            " least one more",
            remedy="take more unloaded frames, or lower analysis.noise_floor_frames in the recipe",
        )
    return frames.select(slice(0, noise_floor_frames)), frames.select(slice(noise_floor_frames, None))


@dataclass(frozen=True, slots=True, eq=False)
class UsableData:
    """Usable frames and readings of a run.

    Parameters
    ----------
    record : the run without lost frames; its offsets are subtracted, its spikes replaced by their neighbours in time.
    corrected : the same corrections in the run with all its frames.
    readings : (drives, measures) bool, fit for imaging in every remaining frame.
    warnings : a sentence for every kind of reading or frame left out, beyond those of the pattern.
    """

    record: RunRecord
    corrected: RunRecord
    readings: NDArray[np.bool_]
    warnings: tuple[str, ...]


def usable_data(record: RunRecord) -> UsableData:
    """Exclude unusable readings, or the few frames in which they are unusable.

    A mostly flagged frame is lost, so that one bad frame costs neither the run nor its readings in all others. Of the
    remaining flags, channels are left out first, worst first, until at most 1 % of the frames are affected; then
    those frames are left out. So a channel that saturates throughout a press is left out, and a watchdog dump in
    one frame costs that frame. The rest is judged as in recordings: stuck readings, electrodes without contact and
    dead drives are left out, offsets on all readings taken out, spikes replaced. A reading that never changes while
    others do is stuck in a noiseless simulation too; if nothing changes at all (a sheet without load) no reading is.
    """
    frames = join_frames([phase.frames for phase in record.phases if phase.frames is not None])
    pattern = record.sensor_type.pattern.usable()
    flagged = ((frames.flags & UNUSABLE) != 0) & pattern
    lost_mask = flagged.sum(axis=(1, 2)) > _MAX_FLAGGED_SHARE * pattern.sum()
    left_out_mask = _choose_flagged_channels(flagged[~lost_mask])
    lost_mask |= (flagged & ~left_out_mask).any(axis=(1, 2))
    kept_frames = frames.select(~lost_mask)
    stuck_mask = _find_stuck_readings(kept_frames, pattern) & pattern & ~left_out_mask
    silent, silent_remarks = _find_silent_readings(record, kept_frames, pattern & ~left_out_mask & ~stuck_mask)
    readings = pattern & ~left_out_mask & ~stuck_mask & ~silent
    voltages, offsets = _remove_offsets(kept_frames.voltages, readings)
    spikes = np.zeros(voltages.shape, dtype=bool)
    if record.sensor_type.pattern.drive == record.sensor_type.pattern.measure:
        voltages, spikes = remove_spikes(voltages, readings, counts=False)
    dead_rows = find_dead_rows(stuck_mask, pattern)
    remarks = [describe_dead_rows(dead_rows)] if dead_rows else []
    stuck_mask[list(dead_rows)] = False
    remarks += [
        f"{int(channels.sum())} readings are excluded from all images because they are {why}:"
        f" {name_readings(channels)}"
        for channels, why in (
            (left_out_mask, "saturated or missing in many frames"),
            (stuck_mask, "stuck at one value"),
        )
        if channels.any()
    ]
    remarks += [*silent_remarks, *offset_words(offsets, kept_frames.time_s, kept_frames.unit.value)]
    if spikes.any():
        spiky = int(spikes.any(axis=(1, 2)).sum())
        remarks.append(
            f"{int(spikes.sum())} readings in {spiky} frames jumped and their reciprocals did not: they were replaced"
            " by their neighbours in time"
        )
    if lost_mask.any():
        remarks.append(f"{int(lost_mask.sum())} of {len(frames)} frames are excluded: they have missing readings")
    corrected = record
    if offsets or spikes.any():
        all_voltages = frames.voltages.copy()
        all_voltages[~lost_mask] = voltages
        corrected = _replace_voltages(record, all_voltages, frames.time_s[:0])
    if offsets or spikes.any() or lost_mask.any():
        record = _replace_voltages(record, voltages, frames.time_s[lost_mask])
    return UsableData(record, corrected, readings, tuple(remarks))


def _find_stuck_readings(kept: FrameBlock, pattern: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return readings, (drives, measures) bool, that never change, or stop changing before the run ends."""
    if not len(kept):
        return np.zeros_like(pattern)
    constant = np.ptp(kept.voltages, axis=0) == 0
    constant_mask = constant if not constant[pattern].all() else np.zeros_like(pattern)
    # A reading that varies again is kept. If it had no noise for a while, it gets the weight of a typical reading.
    ends_still = np.ptp(kept.voltages[-_STILL_FRAMES:], axis=0) == 0
    stuck: NDArray[np.bool_] = constant_mask | (find_faults(kept, ScanKind.FULL).stuck & ends_still)
    return stuck


def _find_silent_readings(
    record: RunRecord, kept: FrameBlock, sound: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], list[str]]:
    """Return readings (drives, measures) of electrodes without contact and of dead drives, and remarks on them."""
    if not len(kept):
        return np.zeros_like(sound), []
    pattern, frame = record.sensor_type.pattern, np.median(kept.voltages, axis=0)
    opened = open_electrodes(frame, sound, pattern)
    silent_mask = pattern.touching(opened)
    remarks = []
    if opened:
        opening = find_opening(kept.voltages, sound, pattern, opened)
        remarks = [
            describe_open(opened, "" if opening is None else _name_moment(record, float(kept.time_s[opening])))
        ]
    if pattern.drive == pattern.measure:
        dead = find_dead_drives(frame, sound & ~silent_mask)
        silent_mask[[dead_drive.drive for dead_drive in dead]] = True
        remarks += [dead_drive.words(kept.unit.value) for dead_drive in dead]
    return silent_mask, remarks


def _name_moment(record: RunRecord, time_s: float) -> str:
    """Name a time of the run by this computer's clock, or of a simulated one by its minute."""
    if record.identity.simulated:
        return f"minute {time_s / 60:.1f} of the run"
    begun_at, begun_s = record.identity.started_at, 0.0
    for session in record.sessions:
        if session.noted_at is not None and session.started_s <= time_s:
            begun_at, begun_s = session.noted_at, session.started_s
    return write_local_time(begun_at + timedelta(seconds=time_s - begun_s))


def _remove_offsets(voltages: Array, readings: NDArray[np.bool_]) -> tuple[Array, tuple[tuple[int, float], ...]]:
    """Return voltages (n, drives, measures) without common offsets, and each offset with its first frame."""
    if len(voltages) < 2 or not readings.any():
        return voltages, ()
    used_voltages = voltages[:, readings]
    offsets = find_offsets(used_voltages, channel_noise(used_voltages, counts=False))
    return (subtract_offsets(voltages, offsets), offsets) if offsets else (voltages, ())


def drop_weak_polarity(data: UsableData, unloaded: FrameBlock, modelled: Array) -> UsableData:
    """Leave out readings of a polarity that hardly answers, of a front end that rectifies.

    Parameters
    ----------
    unloaded : frames of the unloaded sheet.
    modelled : (m,) modelled values of the usable readings.
    """
    side = answering_levels(unloaded.voltages.mean(axis=0)[data.readings], modelled)
    if side is None or not side.words:
        return data
    readings = data.readings.copy()
    readings[readings] = side.answers
    return replace(data, readings=readings, warnings=(*data.warnings, f"{side.words}; they were left out"))


def _choose_flagged_channels(flagged: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Choose channels to leave out, (drives, measures) bool, so that few of the frames (n, …) stay affected."""
    left_out_mask = np.zeros(flagged.shape[1:], dtype=np.bool_)
    allowed = max(1.0, _MAX_AFFECTED_SHARE * len(flagged))
    while (flagged & ~left_out_mask).any(axis=(1, 2)).sum() > allowed:
        counts = np.where(left_out_mask, 0, flagged.sum(axis=0))
        left_out_mask |= counts == counts.max()
    return left_out_mask


def _replace_voltages(record: RunRecord, voltages: Array, lost_time_s: Array) -> RunRecord:
    """Return the run without the frames at some times [s], and with other voltages (n, …) in the frames kept."""
    phases, first_frame = list[PhaseRecord](), 0
    for phase in record.phases:
        if phase.frames is None:
            phases.append(phase)
            continue
        frames = phase.frames.select(~np.isin(phase.frames.time_s, lost_time_s))
        end_frame = first_frame + len(frames)
        phases.append(replace(phase, frames=replace(frames, voltages=voltages[first_frame:end_frame])))
        first_frame = end_frame
    return replace(record, phases=tuple(phases))


def _select_unloaded(phase: PhaseRecord) -> FrameBlock | None:
    if phase.frames is None or phase.unloaded_from_s is None:
        return None
    loads = (*phase.loads, *phase.loops)
    press_starts_s = [load.press_start_s for load in loads if load.press_start_s >= phase.unloaded_from_s]
    return phase.frames.select_interval(phase.unloaded_from_s, min(press_starts_s, default=phase.ended_s))


def name_readings(readings: NDArray[np.bool_]) -> str:
    """Name the first few of some readings, (drives, measures) bool."""
    pairs = [f"drive {drive} measure {measure}" for drive, measure in np.argwhere(readings)[:_MAX_NAMED_READINGS]]
    more = int(readings.sum()) - len(pairs)
    return ", ".join(pairs) + (f" and {more} more" if more else "")


def check_weighing(reconstruction: Reconstruction, method: str, settings: AnalysisSettings) -> None:
    """Check that a method weights readings by their noise if the recipe asks for it.

    Parameters
    ----------
    method : its name, for the message.

    Raises
    ------
    NumericsError
        If it declares that it does not.
    """
    if settings.noise_weighting == "measured" and not getattr(reconstruction, "weighs_noise", True):
        raise NumericsError(
            f'analysis.noise_weighting is "measured", but reconstruction {method!r} weights all readings equally',
            remedy='use another method, or set analysis.noise_weighting = "equal" in the recipe',
        )


def linearise_sheet(
    data: UsableData, unloaded: FrameBlock, settings: AnalysisSettings
) -> tuple[ImagingProblem, tuple[str, ...]]:
    """Linearise a run's sheet with the noise of its readings.

    Parameters
    ----------
    unloaded : frames of the rested sheet before the first press.
    settings : whether readings are weighted by their noise in those, or equally.

    Returns
    -------
    The problem, and a warning if the noise of some readings is unknown.

    Raises
    ------
    NumericsError
        If the readings' noise cannot be estimated from those frames (:func:`reading_noise`), or too few are usable.
    """
    sensor_type, used_mask = data.record.sensor_type, data.readings
    if settings.noise_weighting == "equal":
        return imaging_problem(sensor_type, used=used_mask), ()
    noise = reading_noise(unloaded.voltages[:, used_mask], unloaded.time_s)
    problem = imaging_problem(sensor_type, used=used_mask, noise_variance=noise.variance)
    if not noise.silent.any():
        return problem, ()
    is_silent = np.zeros_like(used_mask)
    is_silent[used_mask] = noise.silent
    remark = (
        f"{int(is_silent.sum())} readings are the same in all {len(unloaded)} unloaded frames: their noise is unknown"
        f" and a typical value is used for them: {name_readings(is_silent)}"
    )
    return problem, (remark,)
