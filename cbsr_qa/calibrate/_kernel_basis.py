"""Exponentials of a relaxation as frames see them: after a ramp instead of a step, averaged over a frame."""

from math import factorial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError

Array = NDArray[np.float64]

#: Half a frame over a time constant, above which e^x soon is no number.
_LONGEST: Final = 500.0


def exponentials(
    time_s: Array, time_constants_s: Array, *, ramp_s: float | Array = 0.0, frame_s: float = 0.0
) -> tuple[Array, Array]:
    """Return e^(−t/τ) as seen, and its derivatives with respect to log τ.

    A linear ramp of length T answers with ∫ e^(−(t + s)/τ) ds/T over 0 … T, that is e^(−t/τ) (1 − e^(−T/τ)) τ/T at t
    after its end. The mean over a frame of length P about its middle is sinh(x)/x times that, x = P/2τ.

    Parameters
    ----------
    time_s : (...,) from the end of the ramp.
    time_constants_s : (k,).
    ramp_s : of the ramp, broadcast against ``time_s``.
    frame_s : P; 0 for values of the frame's middle.

    Returns
    -------
    (..., k) each.
    """
    late = np.asarray(time_s, dtype=np.float64)[..., None] / time_constants_s
    factor, slope = seen_share(time_constants_s, ramp_s=ramp_s, frame_s=frame_s)
    values = np.exp(-late) * factor
    return values, values * (late - slope)


def seen_share(time_constants_s: Array, *, ramp_s: float | Array = 0.0, frame_s: float = 0.0) -> tuple[Array, Array]:
    """What ramp and frame multiply e^(−t/τ) with, and minus its logarithm's derivative by log τ, (..., k).

    Raises
    ------
    NumericsError
        If a frame lasts a thousand time constants: its mean is that of its first instant alone.
    """
    long = np.asarray(ramp_s, dtype=np.float64)[..., None] / time_constants_s
    half = frame_s / 2 / time_constants_s
    if (half > _LONGEST).any():
        raise NumericsError(
            f"a frame of {frame_s:g} s says nothing about a time constant of {np.min(time_constants_s):.3g} s",
            remedy="leave out what is so much faster than a frame",
        )
    ramp, ramp_slope = _mean_decay(long)
    frame, frame_slope = _mean_about(half)
    # d/d log τ of f(c/τ) is −x f'(x).
    return ramp * frame, long * ramp_slope / ramp + half * frame_slope / frame


def _mean_decay(x: Array) -> tuple[Array, Array]:
    """(1 − e^(−x))/x and its derivative."""
    small = x < _SERIES
    safe = np.where(small, 1.0, x)
    value = -np.expm1(-safe) / safe
    slope = (np.exp(-safe) - value) / safe
    return np.where(small, _power_series(_DECAY, x), value), np.where(small, _power_series(_DECAY_SLOPE, x), slope)


def _mean_about(x: Array) -> tuple[Array, Array]:
    """The mean of e^s over −x … x, sinh(x)/x, and its derivative."""
    small = x < _SERIES
    safe = np.where(small, 1.0, x)
    value = np.sinh(safe) / safe
    slope = (np.cosh(safe) - value) / safe
    return np.where(small, _power_series(_ABOUT, x), value), np.where(small, _power_series(_ABOUT_SLOPE, x), slope)


def _power_series(coefficients: Array, x: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(np.minimum(x, _SERIES), coefficients), dtype=np.float64)


#: Below, the derivatives are differences of nearly equal numbers, and Taylor's series is taken instead.
_SERIES: Final = 0.5
_TERMS: Final = 16  # 0.5¹⁶/16! is rounding
_DECAY: Final = np.array([(-1) ** k / factorial(k + 1) for k in range(_TERMS)])
_ABOUT: Final = np.array([(1 - k % 2) / factorial(k + 1) for k in range(_TERMS)])
_DECAY_SLOPE: Final = np.polynomial.polynomial.polyder(_DECAY)
_ABOUT_SLOPE: Final = np.polynomial.polynomial.polyder(_ABOUT)
