"""Electrode pairs in any order: repeats averaged, and the readings of one pattern found in another."""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.patterns import DrivePattern

#: Reversed pairs of the same reading: order of source, sink, plus and minus, and its sign.
_POLARITIES = (((0, 1, 2, 3), 1), ((0, 1, 3, 2), -1), ((1, 0, 2, 3), -1), ((1, 0, 3, 2), 1))
#: Number of missing pairs named in a refusal.
_MOST_NAMED = 5


@dataclass(frozen=True, slots=True, eq=False)
class DistinctPairs:
    """The readings of a table with repeats averaged.

    Parameters
    ----------
    pairs : (m, 4) source, sink, plus and minus, each once, in order of first occurrence.
    repeats : (m,) number of averaged columns; the noise variance is inverse to it.
    merging : (columns, m) maps rows of the table to rows of distinct readings.
    """

    pairs: Indices
    repeats: Indices
    merging: Array

    @classmethod
    def from_pairs(cls, pairs: Indices) -> "DistinctPairs":
        """Return the distinct ones of pairs (columns, 4); a reversed pair differs, since a front end may rectify."""
        _, first_columns, pair_index = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first_columns)
        rank = np.argsort(order)[pair_index.ravel()]
        repeats = np.bincount(rank)
        merging = np.zeros((len(pairs), len(order)))
        merging[np.arange(len(pairs)), rank] = 1 / repeats[rank]
        return cls(pairs[first_columns[order]], repeats, merging)

    def name_readings(self, columns: tuple[str, ...]) -> tuple[str, ...]:
        """Return the name of each reading's first column."""
        return tuple(columns[column] for column in np.argmax(self.merging > 0, axis=0).tolist())

    @classmethod
    def from_pattern(cls, pattern: DrivePattern) -> "DistinctPairs":
        """Return the pairs of the usable readings of a frame, in its order."""
        return cls.from_pairs(
            np.array([(*pattern.drive[d], *pattern.measure[m]) for d, m in np.argwhere(pattern.usable())])
        )


def measures_at_driven(pairs: Indices) -> Mask:
    """Mask (m,) of pairs (m, 4) that measure at an electrode that they drive."""
    at_driven: Mask = (pairs[:, :2, None] == pairs[:, None, 2:]).any(axis=(1, 2))
    return at_driven


def match_readings(wanted: Indices, given: Indices) -> Array:
    """Return the matrix (k, m) from rows of distinct readings (…, k) to those of a calibration.

    A reading is taken from the same pair, or from one with the measured, the driven or both pairs reversed, with the
    corresponding sign; no two are taken from one pair, since a front end may respond to one polarity only. Order and
    repeats of the columns do not matter.

    Parameters
    ----------
    wanted : (m, 4) pairs of the calibration.
    given : (k, 4) distinct pairs that were read.

    Raises
    ------
    CalibrationError
        If a pair is missing, naming it.
    """
    column_by_pair = {tuple(pair): column for column, pair in enumerate(given.tolist())}
    selection = np.zeros((len(given), len(wanted)))
    unmatched = dict(enumerate(map(tuple, wanted.tolist())))
    for order, sign in _POLARITIES:
        for reading, pair in list(unmatched.items()):
            column = column_by_pair.pop(tuple(pair[k] for k in order), None)
            if column is not None:
                selection[column, reading] = sign
                del unmatched[reading]
    missing_pairs = [",".join(map(str, pair)) for pair in unmatched.values()]
    if missing_pairs:
        pair_list = ", ".join(missing_pairs[:_MOST_NAMED]) + (", …" if len(missing_pairs) > _MOST_NAMED else "")
        raise CalibrationError(
            f"{len(missing_pairs)} of the {len(wanted)} readings that were calibrated are not in the pattern"
            f" (source,sink,plus,minus): {pair_list}",
            remedy="read every pair that was calibrated; order and polarity do not matter",
        )
    return selection
