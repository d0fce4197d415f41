"""Covariance of a weak load's estimate, where the Fisher matrix at the estimate is too good to be true.

At d′ of 10 to 30 a place is known to millimetres, over which the sheet's sensitivity changes: an estimate that
happens to lie nearer to an electrode than the load has a Fisher matrix that promises too much. Averaging the inverse
over places one standard error to each side takes most of it out. What is left at second order falls as 1/d′².
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.reconstruct.load_fit import Fits, LoadFitter

Array = NDArray[np.float64]

#: d′ above which a place is known so well that the sheet does not change over it.
SURE: Final = 30.0
#: Variance of the place beyond the bound, times d′², as simulated at d′ = 10 to 20 (benchmarks/load_estimate.py).
_BEYOND: Final = 8.0


def spread_covariance(fitter: LoadFitter, fits: Fits, detectability: Array, *, square: bool) -> Array:
    """Average the covariance over the places it allows; that of loads held by an electrode is large enough.

    Parameters
    ----------
    fits : of n loads. detectability : (n,) their d′.
    square : whether the square was fitted.

    Returns
    -------
    (n, 4, 4).
    """
    covariance = fits.covariance
    place = covariance[:, :2, :2]
    size, axes = np.linalg.eigh(place)
    follow = covariance[:, :, :2] @ np.linalg.inv(place)  # how the other unknowns move with the place
    total = covariance.copy()
    for axis in range(2):
        step = np.sqrt(np.maximum(size[:, axis], 0))[:, None] * axes[:, :, axis]
        for side in (-1, 1):
            aim = fits.parameters + side * (follow @ step[..., None])[..., 0]
            beside, _, placed = fitter.bounded(aim, square=square)
            beside[~placed] = fits.parameters[~placed]
            total += fitter.covariance(beside, square=square)
    mean = np.where(fits.held[:, None, None], covariance, total / 5)
    beyond = np.sqrt(1 + _BEYOND / detectability**2)[:, None] ** np.array([1, 1, 0, 0])
    spread: Array = mean * beyond[:, :, None] * beyond[:, None]
    return spread
