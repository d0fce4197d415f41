"""Rows out of step: whether labels in another order of rows fit the readings better.

Readings and labels belong together by their rows. If a row is lost in one table, or one is reversed, a press gets
the place of another, and the sheet cannot be learned. The place of each press is predicted from the others by
regression on the likeness of their readings (Gaussian process, leave-one-out residuals [K⁻¹y]_i/[K⁻¹]_ii; Rasmussen &
Williams 2006, section 5.4.2). The kernel knows the readings alone, so that one inverse serves every order of labels.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices

#: Row shifts that are tried.
_SHIFTS: Final = (1, -1, 2, -2, 3, -3)
#: Widths of the kernel that are tried, in 1 − cos of the angle between readings.
_WIDTHS: Final = (0.03, 0.1, 0.3)
#: Variances of the noise that are tried, relative to the variance of the places.
_NOISES: Final = (0.01, 0.1)
#: Largest number of presses that are used from the start, and from the end, of a session.
_MAX_PRESSES: Final = 250
#: An order of rows is reported if its error is at most this share of the error as labelled, and of that of guessing.
_MAX_ERROR_SHARE: Final = 0.75
#: Least number of presses before and after a row that is taken for lost.
_MIN_BESIDE: Final = 3


@dataclass(frozen=True, slots=True)
class RowOrder:
    """An order of the labels' rows that fits the readings better.

    Parameters
    ----------
    words : what seems to have happened, and what to do.
    gain_mm : decrease of the mean error of a press's place, predicted from the other presses.
    """

    words: str
    gain_mm: float


def guess_error(place_mm: Array) -> float:
    """Return the mean distance [mm] of places (n, 2) from their median: the error of guessing."""
    return float(np.linalg.norm(place_mm - np.median(place_mm, axis=0), axis=1).mean())


def find_row_order(changes: Array, place_mm: Array, *, row_shift: int = 0) -> RowOrder | None:
    """Find an order of rows in which readings (n, m) and places (n, 2) fit clearly better; None without one.

    Tried are shifts by one to three rows, a row that one of the tables lacks, anywhere, and the reverse order. Rows
    without a change count for the order only.

    Parameters
    ----------
    row_shift : shift that was applied to these rows; the advice is the whole shift of the tables.
    """
    rows = np.arange(len(changes))
    if len(rows) > 2 * _MAX_PRESSES:
        rows = np.concatenate([rows[:_MAX_PRESSES], rows[-_MAX_PRESSES:]])
    is_pressed = np.any(changes[rows] != 0, axis=1)
    inverses = [*_invert_kernels(changes[rows])]

    def measure_error(order: Indices) -> float:
        """Return the mean leave-one-out error [mm] of places in this order, for the best kernel."""
        places = place_mm[order[rows] % len(place_mm)]
        centred = places - places.mean(axis=0)
        return min(
            float(np.linalg.norm((inverse @ centred) / np.diagonal(inverse)[:, None], axis=1)[is_pressed].mean())
            for inverse in inverses
        )

    labelled_error_mm = measure_error(np.arange(len(changes)))
    words, best_error_mm = min(
        ((words, measure_error(order)) for words, order in _list_orders(len(changes), rows, row_shift)),
        key=lambda candidate: candidate[1],
    )
    if best_error_mm > _MAX_ERROR_SHARE * min(labelled_error_mm, guess_error(place_mm)):
        return None
    return RowOrder(
        f"readings and places seem to be out of step: {words}; a press is then missed by {best_error_mm:.3g} mm"
        f" instead of {labelled_error_mm:.3g} mm",
        labelled_error_mm - best_error_mm,
    )


def _invert_kernels(changes: Array) -> Iterator[Array]:
    """Yield K⁻¹ (n, n) of readings (n, m), of several widths and levels of noise."""
    sizes = np.linalg.norm(changes, axis=1, keepdims=True)
    directions = changes / np.where(sizes > 0, sizes, 1.0)
    distances = np.maximum(1.0 - directions @ directions.T, 0.0)
    for width in _WIDTHS:
        for noise in _NOISES:
            kernel = np.exp(-distances / width) + noise * np.eye(len(changes))
            yield np.asarray(np.linalg.inv(kernel), dtype=np.float64)


def _list_orders(count: int, rows: Indices, row_shift: int) -> Iterator[tuple[str, Indices]]:
    """Yield orders of the labels' rows, each with its meaning in words.

    An order is the row (n,) of the label of each press; rows beyond either end continue at the other.
    """
    numbers = np.arange(count)
    for shift in _SHIFTS:
        side = "below" if shift > 0 else "above"
        rows_text = "row" if abs(shift) == 1 else "rows"
        whole_shift = shift + row_shift
        advice = f"give --row-shift {whole_shift}" if whole_shift else "leave --row-shift out"
        yield f"places stand {abs(shift)} {rows_text} {side} their readings ({advice})", numbers + shift
    yield "one of the tables is in the reverse order", numbers[::-1]
    for before, row in zip(rows[_MIN_BESIDE - 1 :].tolist(), rows[_MIN_BESIDE:-_MIN_BESIDE].tolist(), strict=False):
        from_row = numbers >= row
        which = f"about row {row + 1}" if row == before + 1 else f"a row from {before + 2} to {row + 1}"
        stand = "and those below stand one row too high: add"
        yield f"the place of {which} is missing, {stand} it, or leave its readings out", numbers - from_row
        yield f"the readings of {which} are missing, {stand} them, or leave its place out", numbers + from_row
