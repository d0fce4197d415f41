"""Contacts and pairs whose readings change together: faults of an electrode, not loads.

A lost, shorted or changed contact changes the readings that touch its electrode and leaves the others alone. A load
at the rim near that electrode changes the same readings most, but its pattern extends over the whole sheet.
"""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.rules import SILENT_SPREAD
from cbsr_qa.domain.sensor.patterns import DrivePattern

#: Least share of a change's energy, above noise, that lies in the readings of one electrode.
_INSIDE = 0.9
#: A load whose pattern shows at less than this share of its size in all other readings is rejected …
_SEEN_OUTSIDE = 0.5
#: … by so many standard errors.
_SIGMAS = 2.0
_LIVE = 0.75  #: quantile of the pairs that is live: with fewer than a quarter of them nothing is left to image


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """Readings that share one contact or one pair.

    Parameters
    ----------
    name : name for messages, e.g. "electrode 5".
    electrodes : electrodes with suspected contacts.
    readings : (m,) bool, of the used readings.
    """

    name: str
    electrodes: tuple[int, ...]
    readings: Mask


def open_electrodes(frame: Array, used: Mask, pattern: DrivePattern) -> tuple[int, ...]:
    """Electrodes without contact: nothing comes through any pair they drive or measure.

    Parameters
    ----------
    frame : (drives, measures), the typical one. used : same shape, sound readings that touch no driven electrode.
    """
    silent_masks = []
    for readings, usable_rows in ((frame, used), (frame.T, used.T)):
        spread = np.array(
            [
                row[row_mask].std() if row_mask.sum() > 1 else np.nan
                for row, row_mask in zip(readings, usable_rows, strict=True)
            ]
        )
        finite_mask = np.isfinite(spread)
        live = float(np.quantile(spread[finite_mask], _LIVE)) if finite_mask.any() else 0.0
        silent_masks.append(finite_mask & (spread < SILENT_SPREAD * live))
    pairs = ((pattern.drive, silent_masks[0]), (pattern.measure, silent_masks[1]))
    of_each = [
        [bool(is_silent[k]) for of_kind, is_silent in pairs for k, pair in enumerate(of_kind) if electrode in pair]
        for electrode in range(pattern.electrode_count)
    ]
    return tuple(electrode for electrode, is_silent in enumerate(of_each) if is_silent and all(is_silent))


def find_opening(voltages: Array, used: Mask, pattern: DrivePattern, opened: tuple[int, ...]) -> int | None:
    """Return the frame from which on nothing comes through some electrodes; None if that is so from the beginning.

    Parameters
    ----------
    voltages : (n, drives, measures). used : as of :func:`open_electrodes`.
    opened : electrodes without contact by the typical frame.
    """
    rows = [row for row in range(len(pattern.drive)) if used[row].sum() > 1]
    spread = np.array([voltages[:, row, used[row]].std(axis=1) for row in rows])
    silent = spread < SILENT_SPREAD * np.quantile(spread, _LIVE, axis=0)
    of_opened = silent[[bool(set(pattern.drive[row]) & set(opened)) for row in rows]]
    if not len(of_opened):
        return None
    # From there on the silent frames exceed the others by most: single glitches do not matter.
    excess = np.cumsum(np.where(of_opened.all(axis=0), 1, -1)[::-1])
    frame = len(voltages) - 1 - int(np.argmax(excess))
    return frame if frame > 0 and excess.max() > 0 else None


def describe_open(opened: tuple[int, ...], since: str = "") -> str:
    """Name electrodes without contact, and what to do; ``since``: when that began, empty if not known."""
    began = f" since {since}" if since else ""
    if len(opened) == 1:
        return f"electrode {opened[0]} is open{began}: nothing comes through; check its pin"
    return f"electrodes {', '.join(map(str, opened))} are open{began}: nothing comes through; check their pins"


def suspects_of(pattern: DrivePattern, used: Mask) -> tuple[Suspect, ...]:
    """List the readings that each bad contact would affect, fewest first.

    Parameters
    ----------
    used : (drives, measures) bool with m True entries.
    """
    drive, measure = np.nonzero(used)
    suspects = [Suspect(f"drive pair {k}", pair, drive == k) for k, pair in enumerate(pattern.drive)]
    suspects += [Suspect(f"measure pair {k}", pair, measure == k) for k, pair in enumerate(pattern.measure)]
    if pattern.drive == pattern.measure:
        suspects += [
            Suspect(f"pair {k} (electrodes {pair[0]} and {pair[1]})", pair, (drive == k) | (measure == k))
            for k, pair in enumerate(pattern.drive)
        ]
    for electrode in range(pattern.electrode_count):
        driven = np.array([electrode in pair for pair in pattern.drive])
        measured = np.array([electrode in pair for pair in pattern.measure])
        suspects.append(Suspect(f"electrode {electrode}", (electrode,), driven[drive] | measured[measure]))
    real_suspects = [suspect for suspect in suspects if suspect.readings.any() and not suspect.readings.all()]
    return tuple(sorted(real_suspects, key=lambda suspect: int(suspect.readings.sum())))


def suspect_in(
    change: Array, load: Array, hidden: Array, noise: float, suspects: tuple[Suspect, ...]
) -> Suspect | None:
    """Find the contact that explains a change.

    Parameters
    ----------
    change : (m,) whitened, ``hidden`` projected out.
    load : (m,) change explained by the best places, treated alike.
    hidden : (m,) whitened nuisance, unit length.
    noise : variance of each reading of the change.

    Returns
    -------
    The suspect with the fewest readings that explains the change; None where the sheet may have changed.
    """
    for suspect in suspects:
        change_inside, change_outside = _parts(change, hidden, suspect.readings)
        total = float(change_inside @ change_inside + change_outside @ change_outside) - noise * len(change)
        doubt = _SIGMAS * noise * np.sqrt(2 * len(change_outside))
        rest = float(change_outside @ change_outside) - noise * len(change_outside)
        if total <= 0 or rest > (1 - _INSIDE) * total + doubt or total < 4 * doubt:
            continue
        if not _may_be_load(load, change_outside, hidden, suspect.readings, noise):
            return suspect
    return None


def _may_be_load(load: Array, outside: Array, hidden: Array, readings: Mask, noise: float) -> bool:
    """Whether a load may explain the change: its pattern must show in readings that do not touch the contact."""
    expected_outside = _parts(load, hidden, readings)[1]
    power = float(expected_outside @ expected_outside)
    if power == 0:
        return True
    share, error = float(expected_outside @ outside) / power, float(np.sqrt(noise / power))
    return share + _SIGMAS * error > _SEEN_OUTSIDE


def _parts(change: Array, hidden: Array, readings: Mask) -> tuple[Array, Array]:
    """Split a change; the nuisance is fitted only to the readings outside, as inside it may be part of the fault."""
    outside_mask = ~readings
    power = float(hidden[outside_mask] @ hidden[outside_mask])
    share = float(hidden[outside_mask] @ change[outside_mask]) / power if power > 0 else 0.0
    return change[readings] - share * hidden[readings], change[outside_mask] - share * hidden[outside_mask]
