"""What the driven pairs say of the contacts, in words: which pin is open, which two touch.

A pair's resistance, source to sink, holds the sheet and both contacts. One pin that has come off raises every pair it
is part of; two that touch lower theirs.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import DrivePattern, Pair

#: Of the median pair. On the paper's sensors the largest is 1.5 times the median.
_OPEN: Final = 5.0
_POOR: Final = 2.0
_SHORT: Final = 0.2


class ContactState(StrEnum):
    """What is wrong with a contact."""

    OPEN = "open"  #: at least five times the median pair, or more than the source can drive
    POOR = "poor"  #: at least twice the median pair
    TOUCH = "touch"  #: a fifth of the median pair or less


@dataclass(frozen=True, slots=True)
class ContactFault:
    """One fault and the readings that say so.

    Parameters
    ----------
    pins : that explain it; several where the driven pairs cannot tell which of them, two for pins that touch.
    ohm : of these pairs; infinite where the source could not drive its current.
    """

    state: ContactState
    pins: tuple[int, ...]
    pairs: tuple[Pair, ...]
    ohm: tuple[float, ...]
    median_ohm: float

    def words(self) -> str:
        """Say it, e.g. ``pin 7 open: pairs 6-7 and 7-8 read 1.2 MΩ and 980 kΩ, the median pair 18.1 kΩ``."""
        if self.state is ContactState.TOUCH:
            pins = f"pins {_join_words(self.pins, 'and')} touch"
        else:
            pins = f"pin{'' if len(self.pins) == 1 else 's'} {_join_words(self.pins, 'or')} {self.state}"
        plural = len(self.pairs) > 1
        pairs = _join_words([f"{a}-{b}" for a, b in self.pairs], "and")
        # If none could be driven, one message covers all.
        readings = _join_words(
            [_format_ohm(ohm) for ohm in (self.ohm if np.isfinite(self.ohm).any() else self.ohm[:1])], "and"
        )
        text = f"{pins}: pair{'s' if plural else ''} {pairs} read{'' if plural else 's'} {readings}"
        return text + (f", the median pair {_format_ohm(self.median_ohm)}" if np.isfinite(self.median_ohm) else "")


def contact_faults(pattern: DrivePattern, drive_ohm: Array) -> tuple[ContactFault, ...]:
    """Find contacts that are open, poor, or touch.

    Open and poor pins are the fewest that explain all pairs that read too much: a pin counts only if every pair it is
    part of does. A pair that reads too much while its pins are well in others names both. Returns faults, open ones
    first. ``drive_ohm``: (drives,) resistance of each, infinite where the source could not drive its current.
    """
    known = drive_ohm[np.isfinite(drive_ohm)]
    median = float(np.median(known)) if known.size else np.inf
    high = drive_ohm >= _POOR * median if known.size else np.ones(len(drive_ohm), dtype=bool)
    faults = [_high(pattern, drive_ohm, median, pins, rows) for pins, rows in _explain_pairs(pattern.drive, high)]
    for row in np.flatnonzero(drive_ohm <= _SHORT * median) if known.size else ():
        pair = pattern.drive[row]
        faults.append(ContactFault(ContactState.TOUCH, pair, (pair,), (float(drive_ohm[row]),), median))
    order = list(ContactState)
    return tuple(sorted(faults, key=lambda fault: order.index(fault.state)))


def _high(
    pattern: DrivePattern, drive_ohm: Array, median: float, pins: tuple[int, ...], rows: list[int]
) -> ContactFault:
    ohm = tuple(float(drive_ohm[row]) for row in rows)
    state = ContactState.OPEN if max(ohm) >= _OPEN * median else ContactState.POOR
    return ContactFault(state, pins, tuple(pattern.drive[row] for row in rows), ohm, median)


def _explain_pairs(pairs: Sequence[Pair], high: NDArray[np.bool_]) -> Iterable[tuple[tuple[int, ...], list[int]]]:
    """Yield pins, and the rows of the pairs each explains, until every high pair is explained."""
    rows_of: dict[int, set[int]] = {}
    for row, pair in enumerate(pairs):
        for pin in pair:
            rows_of.setdefault(pin, set()).add(row)
    unexplained = {int(row) for row in np.flatnonzero(high)}
    bad = {pin: rows for pin, rows in rows_of.items() if rows <= unexplained}
    while unexplained:
        best = max((len(rows & unexplained) for rows in bad.values()), default=0)
        if not best:
            row = min(unexplained)
            unexplained.discard(row)
            yield tuple(sorted(pairs[row])), [row]
            continue
        chosen = min(pin for pin, rows in bad.items() if len(rows & unexplained) == best)
        explained = bad[chosen] & unexplained
        alike = tuple(sorted(pin for pin, rows in bad.items() if rows & unexplained == explained))
        yield alike, sorted(bad[chosen])
        unexplained -= explained


def _join_words(values: Sequence[object], word: str) -> str:
    *first, last = map(str, values)
    return f"{', '.join(first)} {word} {last}" if first else last


def _format_ohm(ohm: float) -> str:
    if not np.isfinite(ohm):
        return "more than the source can drive"
    for unit, size in (("MΩ", 1e6), ("kΩ", 1e3)):
        if ohm >= size:
            return f"{ohm / size:.3g} {unit}"
    return f"{ohm:.3g} Ω"
