"""Faults of a front end in single frames, found against the unloaded sheet. Numpy alone.

A load changes the readings of a pair of electrodes by a part of them, each by another. A pair without current, or
without contact, reads a fraction of all its readings; a clipped front end gives several readings one and the same
extreme value.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.rules import DEAD_SLOPE, DEAD_SPREAD, FEWEST_OF_PAIR, SILENT_SPREAD, SOUND_SLOPE

#: A pair is judged if noise is at most this share of the spread of its unloaded readings; and a silent one may spread
#: by so many times the noise.
_CLEAR: Final = 0.1
_NOISY: Final = 2.0
#: Readings with one extreme value are clipped, if so many are that differ by so many times their noise at rest.
_CLIPPED: Final = 3
_APART: Final = 6.0
#: With a larger share of dead pairs a frame is not of this sensor.
_MOST: Final = 0.75
#: A frame that lost a larger share of its readings is not read.
_MOST_MISSING: Final = 0.5
#: Larger readings than this, in the largest unloaded one, are of no pair's spread, and their squares may overflow.
_LARGEST: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class FrameFaults:
    """Faults of n frames of m readings.

    Parameters
    ----------
    left_out : (n, m) bool, readings that say nothing of the sheet.
    flags : (n,) of :class:`Flag`: ``DEAD_PAIR``, ``OPEN_ELECTRODE``, ``SATURATED`` and ``MISSING``.
    """

    left_out: Mask
    flags: Indices


class FaultFinder:
    """Finds pairs that hardly drive or measure, electrodes without contact, and clipped readings.

    Parameters
    ----------
    pairs : (m, 4) source, sink, plus and minus of each reading.
    reference : (m,) readings of the unloaded sheet.
    noise : (m,) standard deviation of each.
    """

    def __init__(self, pairs: Indices, reference: Array, noise: Array) -> None:
        self._reference, self._noise = reference, noise
        found: list[tuple[Mask, Indices, bool]] = []
        silent: list[float] = []
        for drives, columns in ((True, pairs[:, :2]), (False, pairs[:, 2:])):
            ends = np.sort(columns, axis=1)
            for pair in np.unique(ends, axis=0):
                members = (ends == pair).all(axis=1)
                spread, loud = float(reference[members].std()), float(np.sqrt((noise[members] ** 2).mean()))
                if members.sum() >= FEWEST_OF_PAIR and loud < _CLEAR * spread:
                    found.append((members, pair, drives))
                    silent.append(max(SILENT_SPREAD, _NOISY * loud / spread))
        self._silent = np.array(silent)
        self._members: Mask = np.array([members for members, _, _ in found], dtype=np.bool_).reshape(-1, len(pairs))
        self._electrodes: Indices = np.array([pair for _, pair, _ in found], dtype=np.int64).reshape(-1, 2)
        self._drives: Mask = np.array([drives for *_, drives in found], dtype=np.bool_)
        self._member: Array = self._members.T.astype(np.float64)

    def __call__(self, readings: Array) -> FrameFaults:
        """Find the faults of frames (n, m); in frames that lost most readings, those that are not finite count."""
        missing: Mask = ~np.isfinite(readings)
        readings = np.where(missing, self._reference, readings)
        clipped = self._find_clipped(readings)
        missing &= (missing.mean(axis=1) <= _MOST_MISSING)[:, None]
        left_out: Mask = clipped | missing
        flags: Indices = np.where(clipped.any(axis=1), int(Flag.SATURATED), 0).astype(np.int64)
        flags |= np.where(missing.any(axis=1), int(Flag.MISSING), 0)
        if len(self._members):
            slope, spread = self._following(readings, (~left_out).astype(np.float64))
            for frame in np.flatnonzero(((slope < DEAD_SLOPE) & (spread < DEAD_SPREAD)).any(axis=1)).tolist():
                dead, flag = self._dead(readings[frame], left_out[frame])
                left_out[frame] |= dead
                flags[frame] |= flag
        return FrameFaults(left_out, flags)

    def _find_clipped(self, readings: Array) -> Mask:
        """Which readings (n, m) stand at one extreme value. A pair that does so with all of its own is silent."""
        clipped = np.zeros(readings.shape, dtype=np.bool_)
        for extreme in (readings.max(axis=1), readings.min(axis=1)):
            at = readings == extreme[:, None]
            for frame in np.flatnonzero(at.sum(axis=1) >= _CLIPPED).tolist():
                there = at[frame]
                there &= ~self._members[(self._members <= there).all(axis=1)].any(axis=0)
                if there.sum() >= _CLIPPED and np.ptp(self._reference[there]) > _APART * self._noise[there].max():
                    clipped[frame] |= there
        return clipped

    def _following(self, readings: Array, kept: Array) -> tuple[Array, Array]:
        """How readings of each pair follow the unloaded ones: slope (n, pairs), and their spread over that of those.

        Parameters
        ----------
        readings, kept : (n, m), and 1 for those that count, 0 for others. Pairs without enough follow exactly.
        """
        largest = _LARGEST * float(np.abs(self._reference).max())
        about = np.clip(readings - np.median(readings, axis=1, keepdims=True), -largest, largest) * kept
        expected = self._reference * kept
        count = kept @ self._member
        each = np.maximum(count, 1.0)
        mean, mean_expected = about @ self._member / each, expected @ self._member / each
        power = np.maximum(expected**2 @ self._member / each - mean_expected**2, np.finfo(np.float64).tiny)
        slope = ((about * expected) @ self._member / each - mean * mean_expected) / power
        spread = np.sqrt(np.maximum(about**2 @ self._member / each - mean**2, 0.0) / power)
        enough = count >= FEWEST_OF_PAIR
        return np.where(enough, slope, 1.0), np.where(enough, spread, 1.0)

    def _dead(self, readings: Array, lost: Mask) -> tuple[Mask, int]:
        """Readings (m,) to be left out of a frame because of their pairs, and its flags.

        A dead pair takes readings from all others that it drives or measures with: the worst is taken out first.
        """
        kept = (~lost[None]).astype(np.float64)
        slope, spread = (each[0] for each in self._following(readings[None], kept))
        silent: Mask = np.asarray((slope < DEAD_SLOPE) & (spread < self._silent))
        dead = silent.copy()
        while True:
            kept[0] = ~(lost | self._members[dead].any(axis=0))
            slope, spread = (each[0] for each in self._following(readings[None], kept))
            further = ~dead & (slope < DEAD_SLOPE) & (spread < DEAD_SPREAD)
            if not further.any():
                break
            dead[np.where(further, slope, np.inf).argmin()] = True
        if dead.mean() > _MOST or np.median(slope[~dead]) < SOUND_SLOPE:
            return np.zeros(len(readings), dtype=np.bool_), 0
        return kept[0] == 0, self._flags(dead, silent)

    def _flags(self, dead: Mask, silent: Mask) -> int:
        """Flags of dead and silent pairs.

        An electrode is open if nothing comes through any pair that it drives, and those are two, or it measures with
        none either.
        """
        explained = np.zeros_like(dead)
        for electrode in np.unique(self._electrodes[silent & self._drives]):
            touching = (self._electrodes == electrode).any(axis=1)
            driving = touching & self._drives
            if silent[driving].all() and (driving.sum() > 1 or silent[touching].all()):
                explained |= touching
        return int(Flag.OPEN_ELECTRODE) * bool(explained.any()) | int(Flag.DEAD_PAIR) * bool(
            (dead & ~explained).any()
        )
