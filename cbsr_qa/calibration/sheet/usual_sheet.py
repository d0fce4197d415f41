"""Which places to press before anything is known of a sheet, and how far each press gets: a usual sheet's variance.

The logarithm of a usual sheet's response has an unknown mean and varies by 20 % over 0.4 radii, with a Gaussian
covariance or Matérn 5/2, which are as likely; single loads scatter by 1 %. All of that is chosen by us. The variance
that presses leave does not depend on what they measure, so that their order can be stated before a run (greedy, as in
Krause, Singh & Guestrin 2008, JMLR 9, 235).
"""

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Final

import numpy as np

from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.domain.numbers import Array, Indices

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
    presses = choose_presses(
        covariances,
        np.full(2, 0.5),
        np.full(2, USUAL_SCATTER**2),
        np.arange(n),
        np.arange(n, end),
        pressed=range(end, len(every)),
    )
    chosen, after = zip(*islice(presses, count), strict=True)
    return list(chosen), np.array([np.diagonal(left, axis1=1, axis2=2).mean() for left in after])


def choose_presses(
    covariances: Array,
    weights: Array,
    scatter: Array,
    candidates: Indices,
    targets: Indices,
    *,
    pressed: Iterable[int] = (),
    first: Iterable[int] = (),
) -> Iterator[tuple[int, Array]]:
    """Yield presses one by one, each where it reduces the mean variance at the targets most.

    Parameters
    ----------
    covariances : (m, n, n) of the logarithm of the response at all places, of each member of a mixture.
    weights, scatter : (m,) weights of the members, and variances of single loads.
    candidates, targets : which of the places may be pressed, once each, and which shall be known.
    pressed : places that were pressed before.
    first : candidates to press before any is chosen.

    Yields
    ------
    The candidate's number among all places, and the covariances (m, t, t) at the targets after its press.
    """
    for number in pressed:
        covariances = _press(covariances, number, scatter)
    forced, left = list(first), candidates.tolist()
    while left:
        if forced:
            number = forced.pop(0)
        else:
            pressed_variance = np.diagonal(covariances, axis1=1, axis2=2)[:, left] + scatter[:, None]
            reduced = (covariances[:, np.array(left)[:, None], targets] ** 2).sum(axis=2) / pressed_variance
            gain = weights @ reduced
            # Rounded, so that mirror images are told apart by their number and not by the last bits.
            number = left[int(np.argmax(np.round(gain / gain.max(), 9)))]
        left.remove(number)
        covariances = _press(covariances, number, scatter)
        yield number, covariances[:, targets[:, None], targets]


def _press(covariances: Array, number: int, scatter: Array) -> Array:
    column = covariances[:, :, number]
    variance = covariances[:, number, number] + scatter
    pressed: Array = covariances - column[:, :, None] * column[:, None, :] / variance[:, None, None]
    return pressed
