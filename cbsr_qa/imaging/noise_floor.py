"""The noise floor of a run's images, and its subtraction before masking."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError


def noise_floor(images: NDArray[np.float64]) -> float:
    """Return the largest value that noise alone put anywhere into the unloaded images.

    Per element the largest |value| over the images, then the maximum over the elements (paper, section 3.3.2).

    Parameters
    ----------
    images : (k, e) float64, k ≥ 1 images of the rested, unloaded sheet, relative.

    Returns
    -------
    float ≥ 0, relative.

    Raises
    ------
    NumericsError
        If there is no image, or a value is not finite.
    """
    if images.ndim != 2 or images.size == 0:
        raise NumericsError(
            f"the noise floor needs unloaded images of shape (k, e); found {images.shape}",
            remedy="record at least one frame of the rested sheet before the first press",
        )
    if not np.isfinite(images).all():
        raise NumericsError("an unloaded image holds a value that is not a finite number")
    return float(np.abs(images).max())


def floored(values: NDArray[np.float64], floor: float) -> NDArray[np.float64]:
    """Subtract the noise floor, for masks and blobs only: amplitudes are taken from un-subtracted images.

    Parameters
    ----------
    values : (…, e) float64, response-signed.
    floor : ≥ 0, same unit.

    Returns
    -------
    float64 of the same shape, ≥ 0: zero below the floor (and for every negative value), value − floor above it.

    Raises
    ------
    NumericsError
        If the floor is negative or not finite.
    """
    if not 0 <= floor < float("inf"):
        raise NumericsError(f"the noise floor is {floor}; it must be a finite number of at least 0")
    cleared: NDArray[np.float64] = np.maximum(values - floor, 0.0)
    return cleared
