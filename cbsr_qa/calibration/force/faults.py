"""Faults of a front end in single frames, found against the unloaded sheet. Numpy alone.

A load changes each reading of a pair of electrodes by a different part of it. A pair without current, or
without contact, reads a fraction of all its readings; a clipped front end gives several readings one and the same
extreme value.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.rules import DEAD_SLOPE, DEAD_SPREAD, FEWEST_OF_PAIR, SILENT_SPREAD, SOUND_SLOPE

#: Largest noise of a pair that is judged, as a share of the spread of its unloaded readings; and largest spread of a
#: silent pair, in units of the noise.
_CLEAR: Final = 0.1
_NOISY: Final = 2.0
#: Fewest readings with one extreme value that count as clipped, and their least range at rest, in units of the noise.
_CLIPPED: Final = 3
_APART: Final = 6.0
#: Largest share of dead pairs in a frame of this sensor.
_MOST: Final = 0.75
#: Largest share of lost readings of a frame that is read.
_MOST_MISSING: Final = 0.5
#: Limit of readings, in the largest unloaded one: larger ones belong to no pair's spread, and squares may overflow.
_LARGEST: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class FrameFaults:
    """Faults of n frames of m readings.

    Parameters
    ----------
    left_out : (n, m) bool, readings that say nothing of the sheet.
    flags : (n,) values of :class:`Flag`: ``DEAD_PAIR``, ``OPEN_ELECTRODE``, ``SATURATED`` and ``MISSING``.
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
        pair_groups: list[tuple[Mask, Indices, bool]] = []
        silent_spreads: list[float] = []
        for drives, columns in ((True, pairs[:, :2]), (False, pairs[:, 2:])):
            ends = np.sort(columns, axis=1)
            for pair in np.unique(ends, axis=0):
                members = (ends == pair).all(axis=1)
                spread, pair_noise = float(reference[members].std()), float(np.sqrt((noise[members] ** 2).mean()))
                if members.sum() >= FEWEST_OF_PAIR and pair_noise < _CLEAR * spread:
                    pair_groups.append((members, pair, drives))
                    silent_spreads.append(max(SILENT_SPREAD, _NOISY * pair_noise / spread))
        self._silent = np.array(silent_spreads)
        self._members: Mask = np.array([members for members, _, _ in pair_groups], dtype=np.bool_).reshape(
            -1, len(pairs)
        )
        self._electrodes: Indices = np.array([pair for _, pair, _ in pair_groups], dtype=np.int64).reshape(-1, 2)
        self._drives: Mask = np.array([drives for *_, drives in pair_groups], dtype=np.bool_)
        self._member: Array = self._members.T.astype(np.float64)

    def __call__(self, readings: Array) -> FrameFaults:
        """Find the faults of frames (n, m); in frames that lost most readings, those that are not finite count."""
        missing_mask: Mask = ~np.isfinite(readings)
        readings = np.where(missing_mask, self._reference, readings)
        clipped_mask = self._find_clipped(readings)
        missing_mask &= (missing_mask.mean(axis=1) <= _MOST_MISSING)[:, None]
        left_out: Mask = clipped_mask | missing_mask
        flags: Indices = np.where(clipped_mask.any(axis=1), int(Flag.SATURATED), 0).astype(np.int64)
        flags |= np.where(missing_mask.any(axis=1), int(Flag.MISSING), 0)
        if len(self._members):
            slope, spread = self._following(readings, (~left_out).astype(np.float64))
            for frame in np.flatnonzero(((slope < DEAD_SLOPE) & (spread < DEAD_SPREAD)).any(axis=1)).tolist():
                dead, flag = self._dead(readings[frame], left_out[frame])
                left_out[frame] |= dead
                flags[frame] |= flag
        return FrameFaults(left_out, flags)

    def _find_clipped(self, readings: Array) -> Mask:
        """Mask (n, m) of readings at one extreme value. A pair with all of its readings there is silent."""
        clipped_mask = np.zeros(readings.shape, dtype=np.bool_)
        for extreme in (readings.max(axis=1), readings.min(axis=1)):
            extreme_mask = readings == extreme[:, None]
            for frame in np.flatnonzero(extreme_mask.sum(axis=1) >= _CLIPPED).tolist():
                frame_mask = extreme_mask[frame]
                frame_mask &= ~self._members[(self._members <= frame_mask).all(axis=1)].any(axis=0)
                if (
                    frame_mask.sum() >= _CLIPPED
                    and np.ptp(self._reference[frame_mask]) > _APART * self._noise[frame_mask].max()
                ):
                    clipped_mask[frame] |= frame_mask
        return clipped_mask

    def _following(self, readings: Array, kept: Array) -> tuple[Array, Array]:
        """Slope (n, pairs) of each pair's readings against the unloaded ones, and the ratio of their spreads.

        Parameters
        ----------
        readings, kept : (n, m) readings, and 1 for those that count, 0 for others. Pairs without enough follow
            exactly.
        """
        largest = _LARGEST * float(np.abs(self._reference).max())
        centred = np.clip(readings - np.median(readings, axis=1, keepdims=True), -largest, largest) * kept
        expected = self._reference * kept
        count = kept @ self._member
        divisor = np.maximum(count, 1.0)
        mean, mean_expected = centred @ self._member / divisor, expected @ self._member / divisor
        power = np.maximum(expected**2 @ self._member / divisor - mean_expected**2, np.finfo(np.float64).tiny)
        slope = ((centred * expected) @ self._member / divisor - mean * mean_expected) / power
        spread = np.sqrt(np.maximum(centred**2 @ self._member / divisor - mean**2, 0.0) / power)
        enough_mask = count >= FEWEST_OF_PAIR
        return np.where(enough_mask, slope, 1.0), np.where(enough_mask, spread, 1.0)

    def _dead(self, readings: Array, lost: Mask) -> tuple[Mask, int]:
        """Readings (m,) to be left out of a frame because of their pairs, and its flags.

        A dead pair takes readings from all others that it drives or measures with: the worst is taken out first.
        """
        kept_weight = (~lost[None]).astype(np.float64)
        slope, spread = (column[0] for column in self._following(readings[None], kept_weight))
        silent_mask: Mask = np.asarray((slope < DEAD_SLOPE) & (spread < self._silent))
        dead_mask = silent_mask.copy()
        while True:
            kept_weight[0] = ~(lost | self._members[dead_mask].any(axis=0))
            slope, spread = (column[0] for column in self._following(readings[None], kept_weight))
            further_mask = ~dead_mask & (slope < DEAD_SLOPE) & (spread < DEAD_SPREAD)
            if not further_mask.any():
                break
            dead_mask[np.where(further_mask, slope, np.inf).argmin()] = True
        if dead_mask.mean() > _MOST or np.median(slope[~dead_mask]) < SOUND_SLOPE:
            return np.zeros(len(readings), dtype=np.bool_), 0
        return kept_weight[0] == 0, self._flags(dead_mask, silent_mask)

    def _flags(self, dead: Mask, silent: Mask) -> int:
        """Flags of dead and silent pairs.

        An electrode is open if nothing comes through any pair that it drives, and those are two, or it measures with
        none either.
        """
        explained_mask = np.zeros_like(dead)
        for electrode in np.unique(self._electrodes[silent & self._drives]):
            touching_mask = (self._electrodes == electrode).any(axis=1)
            driving_mask = touching_mask & self._drives
            if silent[driving_mask].all() and (driving_mask.sum() > 1 or silent[touching_mask].all()):
                explained_mask |= touching_mask
        return int(Flag.OPEN_ELECTRODE) * bool(explained_mask.any()) | int(Flag.DEAD_PAIR) * bool(
            (dead & ~explained_mask).any()
        )
