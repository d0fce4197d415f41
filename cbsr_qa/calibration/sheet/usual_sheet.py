"""Which places to press before anything is known of a sheet, and how far each press gets: a usual sheet's variance.

The logarithm of a usual sheet's response has an unknown mean and varies by 20 % over 0.4 radii, with a Gaussian
covariance or Matérn 5/2, which are as likely; single loads scatter by 1 %. All of that is chosen by us. The variance
that presses leave does not depend on what they measure, so that their order can be stated before a run (greedy, as in
Krause, Singh & Guestrin 2008, JMLR 9, 235).
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
    correlations = [compute_covariance(every, every, USUAL_LENGTH * radius_mm, smooth) for smooth in (True, False)]
    covariances = USUAL_DEVIATION**2 * np.array(correlations) + _UNKNOWN
    for number in range(end, len(every)):
        covariances = _press(covariances, number)
    chosen: list[int] = []
    left = []
    for _ in range(count):
        pressed_variance = np.diagonal(covariances, axis1=1, axis2=2)[:, :n] + USUAL_SCATTER**2
        gain = ((covariances[:, :n, n:end] ** 2).sum(axis=2) / pressed_variance).sum(axis=0)
        gain[chosen] = -1.0
        # Rounded, so that mirror images are told apart by their number and not by the last bits.
        chosen.append(int(np.argmax(np.round(gain / gain.max(), 9))))
        covariances = _press(covariances, chosen[-1])
        left.append(float(np.diagonal(covariances, axis1=1, axis2=2)[:, n:end].mean()))
    return chosen, np.array(left)


def _press(covariances: Array, number: int) -> Array:
    column = covariances[:, :, number]
    variance = covariances[:, number, number] + USUAL_SCATTER**2
    pressed: Array = covariances - column[:, :, None] * column[:, None, :] / variance[:, None, None]
    return pressed
