"""The unloaded sheet of a run: its frames, its reference, its usable readings."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.frames import FrameBlock, ReadingFlag, join_frames
from cbsr_qa.domain.run import PhaseRecord, RunRecord

_UNUSABLE = ReadingFlag.SATURATED | ReadingFlag.COMPLIANCE | ReadingFlag.MISSING


def unloaded_frames(record: RunRecord) -> FrameBlock:
    """Frames of the rested sheet: from the run's first ``MarkUnloaded`` to the press that follows.

    Raises
    ------
    NumericsError
        If the run has none.
    """
    for phase in record.phases:
        frames = _unloaded_of(phase)
        if frames is not None and len(frames):
            return frames
    raise NumericsError(
        f"run {record.identity.run} has no frames of the unloaded sheet",
        remedy="begin the recipe with a sequence that rests and takes unloaded frames, such as noise-figure",
    )


def split_unloaded(frames: FrameBlock, noise_floor_frames: int) -> tuple[FrameBlock, FrameBlock]:
    """Split unloaded frames into those of the noise floor (the first ones, as in the paper) and the reference.

    Raises
    ------
    NumericsError
        If no frame would be left for the reference.
    """
    if len(frames) <= noise_floor_frames:
        raise NumericsError(
            f"{len(frames)} unloaded frames are too few: {noise_floor_frames} set the noise floor and at least one"
            " more is the reference",
            remedy="take more unloaded frames, or lower analysis.noise_floor_frames in the recipe",
        )
    return frames.select(slice(0, noise_floor_frames)), frames.select(slice(noise_floor_frames, None))


def usable_readings(record: RunRecord) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Readings fit for imaging: no driven electrode in them, never flagged, and not stuck.

    A reading that never changes while others do is stuck; where nothing changes at all (a noiseless simulated
    sheet nobody presses) no reading is.

    Returns
    -------
    (drives, measures) bool, and a sentence for every kind of reading left out beyond the pattern's own.
    """
    frames = join_frames([phase.frames for phase in record.phases if phase.frames is not None])
    pattern = record.sensor_type.pattern.usable()
    flagged = ((frames.flags & _UNUSABLE) != 0).any(axis=0) & pattern
    constant = np.ptp(frames.voltages, axis=0) == 0
    stuck = constant & pattern & ~flagged if not constant[pattern].all() else np.zeros_like(pattern)
    words = [
        f"{int(left_out.sum())} readings are left out of every image because they are {why}: {_named(left_out)}"
        for left_out, why in ((flagged, "saturated or missing in some frame"), (stuck, "stuck at one value"))
        if left_out.any()
    ]
    return pattern & ~flagged & ~stuck, tuple(words)


def _unloaded_of(phase: PhaseRecord) -> FrameBlock | None:
    if phase.frames is None or phase.unloaded_from_s is None:
        return None
    presses = [load.press_start_s for load in phase.loads if load.press_start_s >= phase.unloaded_from_s]
    return phase.frames.between(phase.unloaded_from_s, min(presses, default=phase.ended_s))


def _named(readings: NDArray[np.bool_], most: int = 6) -> str:
    pairs = [f"drive {drive} measure {measure}" for drive, measure in np.argwhere(readings)[:most]]
    more = int(readings.sum()) - len(pairs)
    return ", ".join(pairs) + (f" and {more} more" if more else "")
