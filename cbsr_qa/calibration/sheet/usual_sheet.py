"""Which places to press before anything is known of a sheet, and how far each press gets: a usual sheet's variance.

The logarithm of a usual sheet's response has an unknown mean and varies by 20 % over 0.4 radii (Gaussian); single
loads scatter by 1 %. Both are chosen by us. The variance that presses leave does not depend on what they measure, so
that their order can be stated before a run (the greedy design of Krause, Singh & Guestrin 2008, JMLR 9, 235).
"""

from typing import Final

import numpy as np

from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.domain.numbers import Array

USUAL_DEVIATION: Final = 0.2
USUAL_LENGTH: Final = 0.4
USUAL_SCATTER: Final = 0.01
#: Variance of the mean, of which nothing is known.
_UNKNOWN: Final = 4.0


def order_presses(
    candidates_mm: Array, targets_mm: Array, count: int, *, pressed_mm: Array, radius_mm: float
) -> tuple[list[int], Array]:
    """Choose presses one by one, each where it reduces the mean variance at the targets most.

    Parameters
    ----------
    candidates_mm, targets_mm : (n, 2) and (t, 2) places.
    count : number of presses, at most n; each candidate is pressed once.
    pressed_mm : (p, 2) places that were pressed before, may be empty.
    radius_mm : radius of the sheet.

    Returns
    -------
    Indices of the candidates in order, and the mean variance (count,) of the logarithm at the targets after each.
    """
    every = np.vstack([candidates_mm, targets_mm, pressed_mm.reshape(-1, 2)])
    n, end = len(candidates_mm), len(candidates_mm) + len(targets_mm)
    correlation = compute_covariance(every, every, USUAL_LENGTH * radius_mm, smooth=True)
    covariance = USUAL_DEVIATION**2 * correlation + _UNKNOWN
    for number in range(end, len(every)):
        covariance = _press(covariance, number)
    chosen: list[int] = []
    left = []
    for _ in range(count):
        gain = (covariance[:n, n:end] ** 2).sum(axis=1) / (np.diag(covariance)[:n] + USUAL_SCATTER**2)
        gain[chosen] = -1.0
        # Rounded, so that mirror images are told apart by their number and not by the last bits.
        chosen.append(int(np.argmax(np.round(gain / gain.max(), 9))))
        covariance = _press(covariance, chosen[-1])
        left.append(float(np.diag(covariance)[n:end].mean()))
    return chosen, np.array(left)


def _press(covariance: Array, number: int) -> Array:
    column = covariance[:, number]
    pressed: Array = covariance - np.outer(column, column) / (covariance[number, number] + USUAL_SCATTER**2)
    return pressed
