"""Rectifying front ends: readings of one polarity hardly answer."""

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.answering import AnsweringSide, compare_sides

_LEAST_SIDE = 0.2  #: a front end may lose a polarity with at least this share of the readings
_LEAST_SPREAD = (
    0.02  #: readings of one side that the model spreads by less, of their size, tell nothing by their spread
)


def answering_levels(levels: Array, modelled: Array) -> AnsweringSide | None:
    """Tell by levels (m,) which modelled polarity answers; each about its own middle, which takes out an offset.

    Returns
    -------
    The side that answers; None if one polarity has too few of the readings, or they are too alike, to tell.
    """
    positive_mask = modelled > 0
    if not _LEAST_SIDE <= positive_mask.mean() <= 1 - _LEAST_SIDE:
        return None
    about = levels.astype(np.float64)
    for side in (positive_mask, ~positive_mask):
        usual = np.median(np.abs(modelled[side] - np.median(modelled[side])))
        if usual < _LEAST_SPREAD * np.median(np.abs(modelled[side])):
            return None
        about[side] = (about[side] - np.median(about[side])) / usual
    return compare_sides(np.abs(about), positive_mask)


def answering_changes(changes: Array, patterns: Array, modelled: Array) -> AnsweringSide | None:
    """Tell by changes (n, m) which modelled polarity answers, each over what loads anywhere change it by.

    Parameters
    ----------
    patterns : (m, p) changes by loads at p places. modelled : (m,) readings.

    Returns
    -------
    The side that answers; None if one polarity has too few of the readings, or nothing changes.
    """
    positive_mask = modelled > 0
    if not _LEAST_SIDE <= positive_mask.mean() <= 1 - _LEAST_SIDE or not changes.any():
        return None
    return compare_sides(np.median(np.abs(changes), axis=0) / np.linalg.norm(patterns, axis=1), positive_mask)
