"""Offsets: the same change on all readings, for example by an amplifier or a reference voltage.

No load causes one: its pattern differs from reading to reading, as does a change of gain.
"""

import numpy as np

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA
from cbsr_qa.domain.numbers import Array

_STAY_FRAMES = 8  #: at most so many frames on either side determine an offset
_SUDDEN = 6.0  #: the typical reading jumps by so many times the noise of such jumps
_UNEVEN = 0.2  #: beyond noise, readings agree on the offset within this share of it
_SIZEABLE = 1.0  #: times the noise of one reading: smaller offsets do not matter
_MEDIAN_NOISE = 1.2533  #: standard error of a median over that of a mean


def find_offsets(readings: Array, sigma: Array) -> tuple[tuple[int, float], ...]:
    """Find sudden changes that are the same offset on all readings.

    Parameters
    ----------
    readings : (n, m). sigma : (m,) noise of each, of :func:`channel_noise`.

    Returns
    -------
    First frame with each offset, and its size in the readings' unit.
    """
    if len(readings) < 2 or not readings.shape[1]:
        return ()
    jumps = np.median(np.diff(readings, axis=0), axis=1)
    noise = float(np.median(sigma))
    usual = MAD_TO_SIGMA * float(np.median(np.abs(jumps - np.median(jumps))))
    jump_frames = np.flatnonzero(np.abs(jumps) > max(_SUDDEN * usual, _SIZEABLE * noise / 2)) + 1
    offsets: list[tuple[int, float]] = []
    last_frame = 0
    for frame in jump_frames.tolist():
        # An offset in the middle of a frame shows in two frames, and counts once.
        later_jumps = jump_frames[jump_frames > frame + 1]
        end_frame = min(frame + _STAY_FRAMES, int(later_jumps[0]) if len(later_jumps) else len(readings))
        begin = max(frame - _STAY_FRAMES, last_frame)
        if offsets and frame - last_frame < 2 and end_frame - frame > 1:
            continue
        size, uneven = _common(readings[begin:frame], readings[frame:end_frame], sigma)
        if abs(size) > _SIZEABLE * noise and uneven < _UNEVEN * abs(size):
            offsets.append((frame, size))
            last_frame = frame
    return tuple(offsets)


def _common(before: Array, after: Array, sigma: Array) -> tuple[float, float]:
    """Typical change of all readings, and their disagreement about it beyond noise."""
    change = np.median(after, axis=0) - np.median(before, axis=0)
    size = float(np.median(change))
    spread = MAD_TO_SIGMA * float(np.median(np.abs(change - size)))
    noise = _MEDIAN_NOISE * float(np.median(sigma)) * np.sqrt(1 / len(before) + 1 / len(after))
    return size, float(np.sqrt(max(spread**2 - noise**2, 0.0)))


def offset_words(offsets: tuple[tuple[int, float], ...], time_s: Array, unit: str) -> list[str]:
    """Name sudden offsets with their times (n,) of the frames; nothing without any."""
    listed = ", ".join(f"{size:+.3g} {unit} at {time_s[frame]:.1f} s" for frame, size in offsets)
    sentence = f"all readings changed by one offset, not by a load: {listed}; it was taken out"
    return [sentence] if offsets else []


def subtract_offsets(voltages: Array, offsets: tuple[tuple[int, float], ...]) -> Array:
    """Take offsets out of (n, drives, measures) readings, relative to the first frame."""
    offset_by_frame = np.zeros(len(voltages))
    for frame, size in offsets:
        offset_by_frame[frame:] += size
    return voltages - offset_by_frame[:, None, None]
