"""Pose of a sheet in the frame of its labelled presses: rotation, mirror, scale and shift by maximum likelihood.

Each press gives a likelihood map over the modelled sheet. The similarity maximises the likelihood of all presses
together: found on a lattice of similarities, then refined. Standard errors are by bootstrap over the presses.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.held_out import evenly
from cbsr_qa.calibration.presses.likeness import Likeness, alikeness, answering_side
from cbsr_qa.calibration.presses.pose import ROTATIONS, Pose, PoseSearch, to_complex
from cbsr_qa.calibration.presses.weak_loads import ModelledSheet
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.results.press_calibration import SheetRegistration

#: Largest numbers of presses for the search, and for the share of the signal; evenly spread over all.
_REFINED: Final = 300
#: Fewest different places that determine a similarity and its errors.
FEWEST_PLACES: Final = 4
#: Ratio of the second to the first singular value of places below which they lie on a line.
_LINE: Final = 0.02
#: Shares of the spread of places and of the readings' changes that a trusted modelled sheet must explain, and log
#: likelihood by which its mirror image must be less likely.
_LEAST_SHARE: Final = 0.5
_LEAST_SIGNAL: Final = 0.15
_LEAST_EVIDENCE: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """A registration with its basis.

    Parameters
    ----------
    registration : the similarity.
    sign : factor of changes for the sign of a rise of conductance.
    places : (n, 2) places of all presses on the sheet, in radii.
    likelihood : log likelihood of the presses used in the refinement.
    findings : sentences on the readings.
    """

    registration: SheetRegistration
    sign: int
    places: Array
    likelihood: float
    findings: tuple[str, ...]


def register_presses(
    sheet: ModelledSheet, pairs: Indices, changes: Array, place_mm: Array, *, radius_stated: bool
) -> Registered:
    """Register a sheet to its labelled presses.

    Parameters
    ----------
    sheet : modelled sheet; without a stated radius its own radius does not matter.
    pairs : (m, 4) source, sink, plus and minus of the readings.
    changes : (n, m) changes of the readings by each press, in any unit.
    place_mm : (n, 2) labels of the presses.
    radius_stated : True if the sheet's radius is known and the scale estimated; False to estimate the radius at a
        scale of 1.

    Raises
    ------
    NumericsError
        If the places do not determine a similarity: too few, all at one place, or all on a line.
    """
    check_places(place_mm)
    side = answering_side(sheet, pairs, changes)
    pairs, changes = pairs[side.answers], changes[:, side.answers]
    stated_mm = sheet.radius_mm if radius_stated else None
    chosen_presses = evenly(len(changes), _REFINED)
    search = PoseSearch(place_mm[chosen_presses], stated_mm)
    likeness = {sign: Likeness(sheet, pairs, sign * changes[chosen_presses]) for sign in (1, -1)}
    cases = [(sign, mirrored) for sign in likeness for mirrored in (False, True)]
    best = {case: search.best(likeness[case[0]], mirrored=case[1]) for case in cases}
    sign, mirrored = max(best, key=lambda case: best[case][1])
    pose, value = best[sign, mirrored]
    label_places = pose.to_labels(likeness[sign].best_places())
    places = pose.places(to_complex(place_mm))
    # Share of the spread of places that the estimate explains, by medians of squared distances.
    spread = np.abs(search.labelled - np.median(search.labelled.real) - 1j * np.median(search.labelled.imag))
    place_share = 1 - float(np.median(np.abs(label_places - search.labelled) ** 2) / np.median(spread**2))
    registration = _registration(
        pose,
        search.errors(likeness[sign], pose),
        stated_mm,
        place_share=place_share,
        signal_share=_signal_share(sheet, pairs, sign * changes, places),
        evidence=value - max(best[other, not mirrored][1] for other in likeness),
    )
    return Registered(registration, sign, places, value, (side.words,) if side.words else ())


def maximise_over_turns(
    sheet: ModelledSheet, pairs: Indices, changes: Array, place_mm: Array, near: SheetRegistration
) -> float:
    """Largest log likelihood of presses with the centre and size of a registration, over all rotations and mirrors.

    Parameters and errors as for :func:`register_presses`.
    """
    side = answering_side(sheet, pairs, changes)
    size = np.log(near.radius_mm * near.scale)
    turned_places = (to_complex(place_mm) - complex(*near.shift_mm)) * np.exp(-size - 1j * ROTATIONS)[:, None]
    values = []
    for sign in (1, -1):
        likeness = Likeness(sheet, pairs[side.answers], sign * changes[:, side.answers])
        for places in (turned_places, turned_places.conj()):
            values.append(
                float(likeness.approximate(np.stack([places.real, places.imag], axis=-1)).sum(axis=1).max())
            )
    return max(values)


def check_places(place_mm: Array) -> None:
    """Check that labelled places (n, 2) determine a similarity; NumericsError if not."""
    different = np.unique(place_mm, axis=0)
    if len(different) == 1:
        raise NumericsError(
            f"all {len(place_mm)} presses are at one place, ({different[0, 0]:zg}, {different[0, 1]:zg}) mm",
            remedy="press at places all over the sheet",
        )
    if len(different) < FEWEST_PLACES:
        raise NumericsError(
            f"presses at {len(different)} different places do not determine how the sheet lies",
            remedy=f"press at {FEWEST_PLACES} places or more, better nine",
        )
    singular = np.linalg.svd(different - different.mean(axis=0), compute_uv=False)
    if singular[1] < _LINE * singular[0]:
        raise NumericsError(
            "all presses are on one line: they do not show whether the sheet is mirrored",
            remedy="press at places to both sides of the line too",
        )


def _registration(
    pose: Pose, errors: Array, stated_mm: float | None, *, place_share: float, signal_share: float, evidence: float
) -> SheetRegistration:
    x, y, angle, log_size = pose.numbers.tolist()
    size, size_error = float(np.exp(log_size)), float(np.exp(log_size) * errors[3])
    why = _doubts(place_share, signal_share, evidence)
    return SheetRegistration(
        rotation_deg=float((np.degrees(angle) + 180) % 360 - 180),
        rotation_stderr_deg=float(np.degrees(errors[2])),
        mirrored=pose.mirrored,
        scale=1.0 if stated_mm is None else size / stated_mm,
        scale_stderr=0.0 if stated_mm is None else size_error / stated_mm,
        shift_mm=(x, y),
        shift_stderr_mm=(float(errors[0]), float(errors[1])),
        radius_mm=size if stated_mm is None else stated_mm,
        radius_stderr_mm=size_error if stated_mm is None else 0.0,
        place_share=place_share,
        signal_share=signal_share,
        trusted=not why,
        why=why,
    )


def _doubts(place_share: float, signal_share: float, evidence: float) -> str:
    """Why the modelled sheet does not determine this one's pose; empty if it does."""
    if place_share < _LEAST_SHARE:
        return (
            f"the modelled sheet explains {max(place_share, 0.0):.0%} of the spread of the presses' places,"
            f" {_LEAST_SHARE:.0%} is needed: this sheet is not what the sensor type describes"
        )
    if signal_share < _LEAST_SIGNAL:
        return (
            f"the modelled sheet explains {signal_share:.0%} of the readings' changes; {_LEAST_SIGNAL:.0%} is needed:"
            " this sheet is not what the sensor type describes"
        )
    if evidence < _LEAST_EVIDENCE:
        return (
            f"the mirrored sheet is nearly as likely: its log likelihood is lower by {evidence:.2g}, and"
            f" {_LEAST_EVIDENCE:g} is needed"
        )
    return ""


def _signal_share(sheet: ModelledSheet, pairs: Indices, changes: Array, places: Array) -> float:
    """Share of the changes' energy explained by a load at its place, median over the presses on the sheet."""
    inside_mask = sheet.clear(places)
    if not inside_mask.any():
        return 0.0
    chosen_presses = np.flatnonzero(inside_mask)[evenly(int(inside_mask.sum()), _REFINED)]
    correlation = alikeness(changes[chosen_presses], sheet.loads(places[chosen_presses]).readings(pairs))
    return float(np.median(np.maximum(correlation, 0.0) ** 2))
