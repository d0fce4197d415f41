"""Percentage masks."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError

# Two roundings stand between a value that was meant to lie on the threshold and the threshold computed here.
_TIE: Final = 4 * np.finfo(np.float64).eps


def percentage_mask(values: NDArray[np.float64], fraction: float) -> NDArray[np.bool_]:
    """Keep the elements that reach a fraction of the image's maximum.

    Values on the threshold are kept, ties to within rounding included; zero and negative values never survive,
    so that an image without a positive element keeps nothing.

    Parameters
    ----------
    values : (e,) float64, response-signed, noise floor subtracted.
    fraction : p in (0, 1].

    Returns
    -------
    (e,) bool.

    Raises
    ------
    NumericsError
        If the fraction is outside (0, 1] or a value is not finite.
    """
    kept: NDArray[np.bool_] = (values > 0) & (values >= threshold(values, fraction))
    return kept


def threshold(values: NDArray[np.float64], fraction: float) -> float:
    """Return what a value must reach to survive: the fraction of the maximum, less rounding; 0 if none is positive.

    Raises
    ------
    NumericsError
        If the fraction is outside (0, 1] or a value is not finite.
    """
    if not 0 < fraction <= 1:
        raise NumericsError(f"a mask of {fraction:g} is outside (0, 1]", remedy="give it as a fraction, e.g. 0.85")
    if not np.isfinite(values).all():
        raise NumericsError(
            "an image that is to be masked holds a value that is not a finite number",
            remedy="leave readings that are not finite out of the image",
        )
    return fraction * float(values.max(initial=0.0)) * (1 - _TIE)
