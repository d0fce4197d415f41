"""Uninformative readings: spikes, constant ones, and those of faulty pairs and electrodes."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cbsr_qa.calibration.force.faults import FaultFinder
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.place.faulty import MOST_FAULTY, FaultyGroups
from cbsr_qa.calibration.place.features import SPIKY, safe_ceilings, spikes_among
from cbsr_qa.calibration.presses.odd_units import (
    OTHERS_LET_EXPECT,
    describe_other_unit,
    find_odd_readings,
    find_odd_rows,
)
from cbsr_qa.domain.numbers import Array, Indices, Mask

#: Least number of presses for judging electrodes: with fewer, neighbours are too far apart to read alike.
_FEWEST: Final = 30
#: A dead electrode's readings follow the place by less than this share of the median electrode's. In 60 draws of 30
#: presses of two real skins no electrode falls below 0.46, and with readings replaced by noise nine of ten are below
#: 0.4.
_LEAST: Final = 0.4
#: If the median electrode follows by less, single electrodes are not judged.
_FOLLOWS: Final = 0.3
_NEIGHBOURS: Final = 3
#: Exponent that reduces the range of readings, as in the features for learning places.
_EXPONENT: Final = 0.7
_MOST_NAMED: Final = 5
#: Share of readings at one end of their range from which they are clipped, if so many times fewer are at the next
#: value: coarse readings have ends too, that most of them do not reach.
_CLIPPED, _TIMES_NEXT = 0.01, 10
#: Largest share of presses in which a reading may be faulty and still tell something of the place in the others.
_MOSTLY: Final = 0.5
#: Readings, relative to their range, that are equal but for rounding.
_ROUNDING: Final = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class DeadReadings:
    """Readings that tell nothing of the place.

    Parameters
    ----------
    dead : (n, m) uninformative readings.
    findings : remarks on them for a person.
    left_out : (n,) reason why a press is left out; empty for others.
    """

    dead: Mask
    findings: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


def find_dead_readings(
    pairs: Indices,
    changes: Array,
    place_mm: Array,
    rest: Array | None = None,
    noise: Array | None = None,
    columns: tuple[str, ...] = (),
) -> DeadReadings:
    """Find spikes, other units, faults of single presses, constant readings, and electrodes that ignore the place.

    Parameters
    ----------
    pairs : (m, 4) source, sink, plus and minus.
    changes : (n, m) changes of the readings by presses at places (n, 2).
    rest, noise : (m,) readings of the unloaded sheet and their noise, where the readings are whole frames.
    columns : (m,) names of the readings in their table; without them they are named by their pairs.
    """
    odd_rows = dict(find_odd_rows(changes))
    changes = np.where(np.isin(np.arange(len(changes)), list(odd_rows))[:, None], 0.0, changes)
    odd_readings = list(find_odd_readings(changes))
    faulty_mask, flags, spike_mask = _faulty(pairs, changes, rest, noise)
    for row, reading, _ in odd_readings:
        faulty_mask[row, reading], spike_mask[row, reading] = False, True
    constant_mask = np.ptp(changes, axis=0) == 0
    changes = np.where(spike_mask | faulty_mask, 0.0, changes)
    followed_share = _share_of_neighbours(changes, place_mm) if len(changes) >= _FEWEST else np.ones(len(pairs))
    followed_share[constant_mask] = 0.0
    followed_share[faulty_mask.mean(axis=0) > _MOSTLY] = 0.0
    dead_mask, findings = np.zeros(len(pairs), dtype=np.bool_), []
    mask_by_electrode = {int(electrode): (pairs == electrode).any(axis=1) for electrode in np.unique(pairs)}
    while not dead_mask.all():  # worst first: its neighbours' readings involve it too
        shares_by_electrode = {
            electrode: followed_share[electrode_mask & ~dead_mask]
            for electrode, electrode_mask in mask_by_electrode.items()
            if (electrode_mask & ~dead_mask).any()
        }
        mean_by_electrode = {electrode: float(np.mean(shares)) for electrode, shares in shares_by_electrode.items()}
        worst, median_share = (
            min(mean_by_electrode, key=lambda electrode: mean_by_electrode[electrode]),
            float(np.median(list(mean_by_electrode.values()))),
        )
        if not (mean_by_electrode[worst] < _LEAST * median_share and median_share > _FOLLOWS):
            break
        electrode_mask = mask_by_electrode[worst]
        reason = "never change" if constant_mask[electrode_mask].all() else "do not follow the place of the press"
        findings.append(
            f"electrode {worst} is dead: its {int(electrode_mask.sum())} readings {reason}, and are left out"
        )
        dead_mask |= electrode_mask
    constant_mask &= ~dead_mask
    dead_mask |= constant_mask
    if constant_mask.any():
        pair_list = "; ".join(",".join(map(str, pair)) for pair in pairs[constant_mask][:_MOST_NAMED].tolist())
        ellipsis = "; …" if constant_mask.sum() > _MOST_NAMED else ""
        findings.append(
            f"{int(constant_mask.sum())} of {len(pairs)} readings never change, and are left out"
            f" (source,sink,plus,minus): {pair_list}{ellipsis}"
        )
    spike_mask &= ~dead_mask
    if spike_mask.mean() > SPIKY:
        row, reading = np.argwhere(spike_mask)[0].tolist()
        findings.append(
            f"{spike_mask.mean():.1%} of the readings are spikes, and are left out; the first is in row {row + 1},"
            f" {_name_reading(pairs, columns, reading)}"
        )
    findings += [
        f"row {row + 1}, {_name_reading(pairs, columns, reading)}: {describe_other_unit(ratio, OTHERS_LET_EXPECT)};"
        " it is left out, the others of the press are used"
        for row, reading, ratio in odd_readings[:_MOST_NAMED]
        if not dead_mask[reading]
    ]
    further_mask = faulty_mask & ~dead_mask
    lost_mask = further_mask.sum(axis=1) > MOST_FAULTY * (~dead_mask).sum()
    reasons = [_fault_words(flag) if row else "" for row, flag in zip(lost_mask, flags.tolist(), strict=True)]
    for row, ratio in odd_rows.items():
        lost_mask[row] = True
        reasons[row] = f"its readings are {describe_other_unit(ratio, 'those of the others')}"
    affected = np.flatnonzero(further_mask.any(axis=1) & ~lost_mask)
    if affected.size:
        findings.append(
            f"presses with faulty readings, which are left out: {affected.size}; the first is row"
            f" {affected[0] + 1}: {_fault_words(int(flags[affected[0]]))}"
        )
    return DeadReadings(dead_mask | spike_mask | faulty_mask | lost_mask[:, None], tuple(findings), tuple(reasons))


def _faulty(pairs: Indices, changes: Array, rest: Array | None, noise: Array | None) -> tuple[Mask, Indices, Mask]:
    """Readings (n, m) that faults spoil in single presses, flags (n,), and spikes (n, m)."""
    faulty_mask, flags = np.zeros(changes.shape, dtype=np.bool_), np.zeros(len(changes), dtype=np.int64)
    if rest is not None:
        frame_faults = FaultFinder(pairs, rest, np.zeros(len(rest)) if noise is None else noise)(rest + changes)
        faulty_mask, flags = frame_faults.left_out, frame_faults.flags
    changes = np.where(faulty_mask, 0.0, changes)
    spike_mask = spikes_among(changes)
    ceiling, lost_mask = safe_ceilings(np.where(spike_mask, 0.0, changes)), faulty_mask | spike_mask
    # Spikes are left out here: they have their own words.
    group_faults, flags_of = FaultyGroups(pairs)(changes, ceiling, lost_mask, np.zeros_like(lost_mask))
    return faulty_mask | group_faults, flags | flags_of, spike_mask


def _name_reading(pairs: Indices, columns: tuple[str, ...], reading: int) -> str:
    return f"column {columns[reading]}" if columns else f"pair {','.join(map(str, pairs[reading].tolist()))}"


def _fault_words(flags: int) -> str:
    words_by_flag = {
        Flag.DEAD_PAIR: "a pair hardly drives or measures",
        Flag.OPEN_ELECTRODE: "nothing comes through an electrode",
        Flag.SATURATED: "readings stand at one extreme value",
        Flag.OFFSET: "one offset is added to all readings",
    }
    return "; ".join(why for flag, why in words_by_flag.items() if flag & flags)


def estimate_clipped_share(changes: Array, rest: Array | None) -> float:
    """Share of readings at an end of their range that the front end cuts off; 0 where it does not seem to.

    Parameters
    ----------
    changes, rest : (n, m) changes by presses, and (m,) readings of the unloaded sheet, for whole frames. Zero is no
        such end: front ends that rectify give it.
    """
    frames = changes if rest is None else changes + rest
    frames = frames[:, np.ptp(changes, axis=0) > 0]
    step = _ROUNDING * max(float(np.abs(frames).max(initial=0.0)), np.finfo(float).tiny)
    values, counts = np.unique(np.round(frames / step), return_counts=True)
    if len(values) < 3:
        return 0.0
    ends = [(values[0], counts[0], counts[1]), (values[-1], counts[-1], counts[-2])]
    cut = [count for value, count, next_count in ends if value and count > _TIMES_NEXT * next_count]
    return float(sum(count for count in cut if count > _CLIPPED * frames.size)) / frames.size


def _share_of_neighbours(changes: Array, place_mm: Array) -> Array:
    """Share (m,) of each reading's variance that neighbouring presses have in common; about 0 for noise.

    One less the ratio of von Neumann (1941) with neighbours in place instead of time, for frames of equal size.
    """
    roots = np.sign(changes) * np.abs(changes) ** _EXPONENT
    size = np.median(np.abs(roots), axis=1, keepdims=True)
    roots = roots / np.where(size > 0, size, 1.0)
    nearest = np.asarray(cKDTree(place_mm).query(place_mm, k=_NEIGHBOURS + 1)[1])[:, 1:]
    difference = ((roots[:, None] - roots[nearest]) ** 2).mean(axis=(0, 1))
    followed: Array = 1 - difference / np.maximum(2 * roots.var(axis=0), np.finfo(float).tiny)
    return followed
