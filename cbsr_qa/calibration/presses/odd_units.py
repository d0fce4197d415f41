"""Changes of readings in another unit than the rest of their table: whole rows, and single readings."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array

#: Ratio of sizes from which units differ: prefixes are 1000 apart, forces of presses hardly more than 30.
_OTHER_UNIT: Final = 30.0
#: The same of smaller rows: weak presses are no other unit.
_OTHER_UNIT_BELOW: Final = 200.0
#: Least ratio of a single reading to all others of its row. Beside an electrode several readings are large together:
#: of 5000 presses of two real skins none has a ratio above 5.5, and those not with one above 30 to the usual.
_ALONE: Final = 6.0
_USUAL: Final = 0.9
OTHERS_LET_EXPECT: Final = "the other readings let expect"


def describe_other_unit(ratio: float, others: str) -> str:
    """Return how many times as large something is as others, in words; of ratios two digits are known."""
    return f"about {float(f'{ratio:.2g}'):g} times as large as {others}, as if in another unit"


def find_odd_rows(changes: Array) -> Iterator[tuple[int, float]]:
    """Yield rows of changes (n, m) by presses in another unit than most: their index, and how many times as large.

    Rows are compared by the median distance of their readings from their middle, which neither an offset on all
    readings nor a faulty electrode raises.
    """
    middles = np.median(changes, axis=1, keepdims=True)
    spreads = np.median(np.abs(changes - middles), axis=1)
    usual = float(np.median(spreads))
    if usual > 0:
        is_small = (spreads > 0) & (spreads <= usual / _OTHER_UNIT_BELOW)
        for row in np.flatnonzero((spreads >= _OTHER_UNIT * usual) | is_small).tolist():
            yield row, float(spreads[row]) / usual


def find_odd_readings(changes: Array) -> Iterator[tuple[int, int, float]]:
    """Yield single readings of changes (n, m) in a larger unit: row, column, and how many times as large as expected.

    Such a reading exceeds what is usual in its column and its row by far, and every other reading of its row.
    """
    sizes = np.abs(changes)
    if len(sizes) < 2 or sizes.shape[1] < 2:
        return
    usual = np.minimum(np.quantile(sizes, _USUAL, axis=0), np.sort(sizes, axis=0)[-2])
    relative = sizes / np.where(usual > 0, usual, np.inf)
    ordered = np.sort(relative, axis=1)
    of_row = np.maximum(np.quantile(relative, _USUAL, axis=1), 1.0)
    odd = (ordered[:, -1] >= _OTHER_UNIT * of_row) & (ordered[:, -1] >= _ALONE * np.maximum(ordered[:, -2], 1.0))
    for row in np.flatnonzero(odd).tolist():
        column = int(np.argmax(relative[row]))
        yield row, column, float(relative[row, column] / max(np.median(relative[row]), 1 / _OTHER_UNIT))
