"""Readings that a fault spoils in single presses and frames. Numpy alone.

Changes by a press are a small part of a reading. A pair that stops driving or measuring, or an electrode that loses
contact, changes its readings by many times as much; an offset moves most readings to one side.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.domain.goodness import ALLOWANCE
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.rules import FEWEST_OF_PAIR

#: Level of a group's changes that is compared: a front end that rectifies leaves half of a pair's readings alone.
_LEVEL: Final = 0.75
#: A group is faulty if that level is above so many ceilings, and above 3 × 6 times that of the other readings. Groups
#: of 2500 presses of two real skins stay below 3.2; an open electrode of a simulated sheet is at 60.
_FAULTY: Final = 6.0
_BESIDE: Final = 3.0
#: Least share of spikes among a group's readings for which the group is named as faulty.
_SPIKY_GROUP: Final = 1 / 3
#: Largest share of faulty readings of a press or frame that is used.
MOST_FAULTY: Final = 0.5


class FaultyGroups:
    """Finds readings of faulty pairs and electrodes.

    Parameters
    ----------
    pairs : (m, 4) source, sink, plus and minus of each reading.
    """

    def __init__(self, pairs: Indices) -> None:
        groups = [((pairs == electrode).any(axis=1), Flag.OPEN_ELECTRODE) for electrode in np.unique(pairs)]
        for ends in (np.sort(pairs[:, :2], axis=1), np.sort(pairs[:, 2:], axis=1)):
            groups += [((ends == pair).all(axis=1), Flag.DEAD_PAIR) for pair in np.unique(ends, axis=0)]
        groups = [(group, flag) for group, flag in groups if FEWEST_OF_PAIR <= group.sum() < len(pairs)]
        self._groups: list[tuple[Mask, int]] = [(group, int(flag)) for group, flag in groups]

    def __call__(self, changes: Array, ceiling: Array, missing: Mask, spikes: Mask) -> tuple[Mask, Indices]:
        """Find faulty readings (n, m) of changes, and flags (n,) of :class:`Flag`.

        Parameters
        ----------
        ceiling : (m,) above which changes by presses hardly are; zero for readings that are not used.
        missing, spikes : (n, m) readings that are not known, and those that were found to be spikes.
        """
        missing = missing | spikes
        offset = _offset(np.where(missing, 0.0, changes), ceiling)
        sizes = np.where(missing | (ceiling <= 0), 0.0, np.abs(changes) / np.where(ceiling > 0, ceiling, 1.0))
        faulty_mask: Mask = offset[:, None] & ~missing & (ceiling > 0)
        flags: Indices = np.where(offset, int(Flag.OFFSET), 0).astype(np.int64)
        for group, flag in self._groups:
            flags |= np.where(spikes[:, group].mean(axis=1) >= _SPIKY_GROUP, flag, 0)
        for frame in np.flatnonzero((sizes.max(axis=1, initial=0.0) > _FAULTY) & ~offset).tolist():
            kept_mask = ~missing[frame] & (ceiling > 0)
            while worst := self._worst(sizes[frame], kept_mask):
                kept_mask &= ~worst[0]
                faulty_mask[frame] |= worst[0] & ~missing[frame]
                flags[frame] |= worst[1]
        return faulty_mask, flags

    def _worst(self, sizes: Array, kept: Mask) -> tuple[Mask, int] | None:
        """The group that is farthest off in one frame, if any is: the first of groups that are alike."""
        largest_excess, worst_group = _FAULTY, None
        for group, flag in self._groups:
            group_mask, other_mask = kept & group, kept & ~group
            if group_mask.sum() < FEWEST_OF_PAIR or not other_mask.any():
                continue
            excess = float(np.quantile(sizes[group_mask], _LEVEL))
            excess /= max(_BESIDE * float(np.quantile(sizes[other_mask], _LEVEL)), 1.0)
            if excess > largest_excess:
                largest_excess, worst_group = excess, (group, flag)
        return worst_group


def _offset(changes: Array, ceiling: Array) -> Mask:
    """Mask (n,) of frames with changes beyond the ceilings (m,) in half of the used readings, all to one side."""
    if not (ceiling > 0).any():
        return np.zeros(len(changes), dtype=np.bool_)
    relative = changes[:, ceiling > 0] / ceiling[ceiling > 0]
    return np.asarray(np.abs(np.median(relative, axis=1)) > 1)


#: Readings of an electrode are noise in a press if they miss what other presses let expect by so many times as much
#: as the others of the press, each in its usual error, and there are so many presses. Sound presses of two simulated
#: sheets stay below 6.3, those with noise of 20 median changes are above 15.
_NOISY: Final = 7.0
_FEWEST: Final = 30
_MAD_TO_SIGMA: Final = 1.4826
#: Beside an electrode its readings change so steeply that other presses do not let expect them. They are sound if the
#: modelled sheet, where it explains the others of the press, misses them by less than this share of as much: of 72
#: sound electrodes that were above the limit on simulated sheets 69 are below this share, of 207 faulty ones none.
_EXPLAINED: Final = 0.5
#: Number of electrodes in presses, of those expected to change as much or more, whose median excess is usual.
_ALIKE: Final = 30

Modelled = Callable[[Indices], Array]


def noisy_readings(pairs: Indices, features: Array, errors: Array, missing: Mask, modelled: Modelled) -> Mask:
    """Find readings (n, m) of the one electrode of a press, if any, whose readings are noise there.

    Where the modelled sheet explains the other readings of the press, it decides too. Elsewhere readings must also
    miss by as many times what is usual for electrodes whose readings are expected to change as much.

    Parameters
    ----------
    pairs : (m, 4) source, sink, plus and minus.
    features, errors : (n, m) features of presses, and their difference from what the others let expect. A press whose
        size noise raises has all its features reduced, so what is expected is scaled to the other electrodes'
        readings.
    missing : (n, m) readings that are not known, whose features tell nothing.
    modelled : returns the features (k, m) that the modelled sheet lets expect of presses (k,); NaN if it does not.
    """
    usual_error = _MAD_TO_SIGMA * np.median(np.abs(errors), axis=0)
    used_mask, noisy_mask = usual_error > 0, np.zeros(features.shape, dtype=np.bool_)
    of_electrodes = [used_mask & (pairs == electrode).any(axis=1) for electrode in np.unique(pairs)]
    groups = [mask for mask in of_electrodes if FEWEST_OF_PAIR <= mask.sum() < used_mask.sum()]
    if len(features) < _FEWEST or not groups:
        return noisy_mask
    weights = np.where(used_mask, 1 / np.where(used_mask, usual_error, 1.0), 0.0)
    scaled, expected = (np.where(missing, 0.0, values * weights) for values in (features, features - errors))
    missed, others_missed, size = np.empty((3, len(features), len(groups)))
    for number, group_mask in enumerate(groups):
        missed[:, number], others_missed[:, number], _ = _misses(scaled, expected, group_mask, used_mask)
        size[:, number] = np.sqrt((expected[:, group_mask] ** 2).mean(axis=1))
    excess = missed / np.maximum(others_missed, 1.0)
    usual_excess = _usual_excess(excess, size)
    presses = np.flatnonzero((excess > _NOISY).any(axis=1))
    by_model = np.where(missing[presses], 0.0, modelled(presses) * weights)
    for press, row in zip(presses.tolist(), by_model, strict=True):
        for number in np.argsort(excess[press]).tolist():  # the largest excess decides last
            model_missed, _, explains = _misses(scaled[[press]], row[None], groups[number], used_mask)
            limit = _NOISY if explains[0] else _NOISY * max(1.0, usual_excess[press, number])
            sound = bool(explains[0] and model_missed[0] <= _EXPLAINED * missed[press, number])
            if excess[press, number] > limit and not sound:
                noisy_mask[press] = groups[number]
    return noisy_mask


def _usual_excess(excess: Array, size: Array) -> Array:
    """Median (n, k) of the excesses (n, k) of electrodes in presses that are expected to change as much or more."""
    order = np.argsort(size, axis=None)
    medians = np.median(sliding_window_view(excess.ravel()[order], min(_ALIKE, excess.size)), axis=1)
    usual = np.full(excess.size, medians[-1])
    usual[order[: len(medians)]] = medians
    return usual.reshape(excess.shape)


def _misses(features: Array, expected: Array, group: Mask, used: Mask) -> tuple[Array, Array, Mask]:
    """Root mean squares (n,) by which a group's readings and the others miss what is expected, scaled to the others.

    The third result tells whether what is expected explains the others.
    """
    others = used & ~group
    power = np.maximum((expected[:, others] ** 2).sum(axis=1), np.finfo(float).tiny)
    scale = (features[:, others] * expected[:, others]).sum(axis=1) / power
    squares = (features - scale[:, None] * expected) ** 2
    explains = squares[:, others].sum(axis=1) <= ALLOWANCE * scale**2 * power  # not if they are NaN
    return np.sqrt(squares[:, group].mean(axis=1)), np.sqrt(squares[:, others].mean(axis=1)), explains
