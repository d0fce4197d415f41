"""Wrong electrode order: exchanged cables, and measuring electrodes numbered differently from driving ones.

The other mistakes show in the registration itself: a reversed numbering as a mirrored sheet, a numbering with another
start as a rotation.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.held_out import evenly
from cbsr_qa.calibration.place.modelled import log_likelihood
from cbsr_qa.calibration.place.pairs import measures_at_driven
from cbsr_qa.calibration.presses.likeness import alikeness, answering_side
from cbsr_qa.calibration.presses.registration import Registered, maximise_over_turns, register_presses
from cbsr_qa.calibration.presses.weak_loads import ModelledSheet
from cbsr_qa.domain.numbers import Array, Indices

#: Presses used to try exchanges, exchanges that are registered again, and exchanges searched for.
_TRIED, _REGISTERED, _MOST_EXCHANGES = 60, 3, 2
#: Presses used to register other numberings of the measuring electrodes.
_FEW: Final = 30
#: Most electrodes for trying exchanges, whose number grows as the square.
_MOST_ELECTRODES: Final = 64
#: Standard errors, and share of the signal left unexplained, by which another order must be better.
_CLEAR, _LESS_LEFT = 4.0, 0.85


#: Share of the signal that another numbering must explain: among many, one explains a little of any sheet.
_LEAST_SIGNAL: Final = 0.3
#: Difference of log likelihoods below which they are equal.
_ALIKE: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ElectrodeOrder:
    """The order that explains presses best.

    Parameters
    ----------
    registered : registration with that order.
    pairs : (m, 4) pairs as they are wired.
    findings : differences from the pattern, in words.
    """

    registered: Registered
    pairs: Indices
    findings: tuple[str, ...] = ()


def find_electrode_order(
    sheet: ModelledSheet, pairs: Indices, changes: Array, place_mm: Array, *, radius_stated: bool
) -> ElectrodeOrder:
    """Register a sheet and find electrodes connected differently from the pattern.

    Parameters and errors as for :func:`~cbsr_qa.calibration.presses.registration.register_presses`.
    """
    order = ElectrodeOrder(register_presses(sheet, pairs, changes, place_mm, radius_stated=radius_stated), pairs)
    order = _try_other_numbering(sheet, order, changes, place_mm, radius_stated=radius_stated) or order
    for _ in range(_MOST_EXCHANGES):
        exchanged = _find_exchange(sheet, order, changes, place_mm, radius_stated=radius_stated)
        if exchanged is None:
            break
        order = exchanged
    return order


def _find_exchange(
    sheet: ModelledSheet, order: ElectrodeOrder, changes: Array, place_mm: Array, *, radius_stated: bool
) -> ElectrodeOrder | None:
    """The best single exchange of two electrodes, if it explains the presses clearly better."""
    count = sheet.electrode_count
    chosen_presses = np.flatnonzero(sheet.clear(order.registered.places))
    if count > _MOST_ELECTRODES or not len(chosen_presses):
        return None
    chosen_presses = chosen_presses[evenly(len(chosen_presses), _TRIED)]
    evidence_of = _Evidence(sheet, order.registered, changes, chosen_presses)
    evidence_before = evidence_of(order.pairs).sum()
    exchanges = list(combinations(np.unique(order.pairs).tolist(), 2))  # one that is in no pair shows in no reading
    evidence = [evidence_of(_swap(order.pairs, pair)).sum() for pair in exchanges]
    for number in np.argsort(evidence)[::-1][:_REGISTERED]:
        pair = exchanges[number]
        if evidence[number] <= evidence_before:
            break
        pairs = _swap(order.pairs, pair)
        registered = register_presses(sheet, pairs, changes, place_mm, radius_stated=radius_stated)
        if _is_clearly_better(sheet, order, registered, pairs, changes):
            exchange_words = f"electrodes {pair[0]} and {pair[1]} seem to be exchanged"
            finding = f"{exchange_words}: {_share_words(order.registered, registered)}"
            return ElectrodeOrder(registered, pairs, (*order.findings, finding))
    return None


def _try_other_numbering(
    sheet: ModelledSheet, order: ElectrodeOrder, changes: Array, place_mm: Array, *, radius_stated: bool
) -> ElectrodeOrder | None:
    """Measuring electrodes numbered from another start or in reverse, if presses are then likelier.

    On a sheet as modelled no other numbering comes near the right one, so no further margin is needed: nine presses
    already decide.
    """
    if _leaves_out_driven(order.pairs):
        return None
    sample, near = evenly(len(changes), _FEW), order.registered.registration
    likelihood_before = maximise_over_turns(sheet, order.pairs, changes[sample], place_mm[sample], near)
    numberings = list(_numberings(order.pairs, sheet.electrode_count))
    values = [maximise_over_turns(sheet, pairs, changes[sample], place_mm[sample], near) for pairs, _ in numberings]
    if max(values) <= likelihood_before:
        return None
    # With opposite drive, half a turn of the measuring electrodes equals the other polarity.
    pairs, numbering_words = next(
        numbering for numbering, value in zip(numberings, values, strict=True) if value > max(values) - _ALIKE
    )
    registered = register_presses(sheet, pairs, changes, place_mm, radius_stated=radius_stated)
    registration, likelier = registered.registration, registered.likelihood > order.registered.likelihood + _ALIKE
    if not (registration.trusted and registration.signal_share > _LEAST_SIGNAL and likelier):
        return None
    return ElectrodeOrder(registered, pairs, (f"{numbering_words}: {_share_words(order.registered, registered)}",))


def _leaves_out_driven(pairs: Indices) -> bool:
    """Whether a pattern measures with every pair that is clear of the driven electrodes, and with no other.

    Then driving and measuring electrodes are numbered alike: by another numbering it would measure at driven ones.
    """
    drives, measures = (np.unique(columns, axis=0) for columns in (pairs[:, :2], pairs[:, 2:]))
    at_driven = (drives[:, None, :, None] == measures[None, :, None, :]).any(axis=(2, 3))
    is_distinct = len(np.unique(pairs, axis=0)) == np.count_nonzero(~at_driven)
    return bool(at_driven.any()) and is_distinct and not measures_at_driven(pairs).any()


def _numberings(pairs: Indices, count: int) -> Iterator[tuple[Indices, str]]:
    for reverse in (False, True):
        for shift in sorted(range(count), key=lambda k: min(k, count - k)):
            if not shift and not reverse:
                continue
            measured = ((-pairs[:, 2:] if reverse else pairs[:, 2:]) + shift) % count
            way = "the other way round, " if reverse else ""
            finding = f"measuring electrodes seem to be numbered {way}from electrode {shift} of the driving ones"
            yield np.column_stack([pairs[:, :2], measured]), finding


def _swap(pairs: Indices, exchange: tuple[int, int]) -> Indices:
    first, second = exchange
    return np.where(pairs == first, second, np.where(pairs == second, first, pairs))


class _Evidence:
    """Log likelihoods of some presses at their registered places, for assumed pairs of their readings."""

    def __init__(self, sheet: ModelledSheet, registered: Registered, changes: Array, chosen: Indices) -> None:
        self._sheet = sheet
        self._loads = sheet.loads(registered.places[chosen])
        self._changes = registered.sign * changes[chosen]

    def __call__(self, pairs: Indices) -> Array:
        answers = answering_side(self._sheet, pairs, self._changes).answers
        correlation = alikeness(self._changes[:, answers], self._loads.readings(pairs[answers]))
        return log_likelihood(correlation)


def _is_clearly_better(
    sheet: ModelledSheet, order: ElectrodeOrder, other: Registered, pairs: Indices, changes: Array
) -> bool:
    before, after = order.registered.registration, other.registration
    if not after.trusted or 1 - after.signal_share > _LESS_LEFT * (1 - before.signal_share):
        return False
    inside_mask = sheet.clear(order.registered.places) & sheet.clear(other.places)
    chosen_presses = np.flatnonzero(inside_mask)[evenly(int(inside_mask.sum()), _TRIED)]
    gain = _Evidence(sheet, other, changes, chosen_presses)(pairs)
    gain = gain - _Evidence(sheet, order.registered, changes, chosen_presses)(order.pairs)
    spread = float(gain.std(ddof=1)) if len(gain) > 1 else np.inf
    return bool(gain.mean() > _CLEAR * spread / np.sqrt(len(gain)))


def _share_words(before: Registered, after: Registered) -> str:
    shares = (before.registration.signal_share, after.registration.signal_share)
    return f"the modelled sheet then explains {shares[1]:.0%} of the changes instead of {shares[0]:.0%}"
