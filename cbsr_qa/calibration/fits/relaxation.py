"""Fit of one or two exponentials to a relaxation (paper Eq 3), and exponentials after ramps, averaged over frames."""

from math import factorial
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.separable import (
    LOG_ERROR,
    SEPARATION,
    SIGNIFICANCE,
    Exponentials,
    chance_of_gain,
    fit_exponentials,
)
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit

#: Half a frame over a time constant, above which e^x would soon overflow.
_MAX_HALF_FRAME_RATIO: Final = 500.0


def exponentials(
    time_s: Array, time_constants_s: Array, *, ramp_s: float | Array = 0.0, frame_s: float = 0.0
) -> tuple[Array, Array]:
    """Return the observed e^(−t/τ), and its derivatives with respect to log τ.

    The response to a linear ramp of length T is ∫ e^(−(t + s)/τ) ds/T over 0 … T, that is e^(−t/τ) (1 − e^(−T/τ)) τ/T
    at t after its end. The mean over a frame of length P about its middle is sinh(x)/x times that, x = P/2τ.

    Parameters
    ----------
    time_s : (...,) times from the end of the ramp.
    time_constants_s : (k,) time constants.
    ramp_s : T, broadcast with ``time_s``.
    frame_s : P; 0 for values of the frame's middle.
    """
    lateness = np.asarray(time_s, dtype=np.float64)[..., None] / time_constants_s
    factor, slope = observable_share(time_constants_s, ramp_s=ramp_s, frame_s=frame_s)
    values = np.exp(-lateness) * factor
    return values, values * (lateness - slope)


def observable_share(
    time_constants_s: Array, *, ramp_s: float | Array = 0.0, frame_s: float = 0.0
) -> tuple[Array, Array]:
    """Factor of e^(−t/τ) by ramp and frame, and minus its logarithm's derivative by log τ, (..., k).

    NumericsError if a frame lasts a thousand time constants: its mean is that of its first instant alone.
    """
    ramp_ratio = np.asarray(ramp_s, dtype=np.float64)[..., None] / time_constants_s
    frame_ratio = frame_s / 2 / time_constants_s
    if (frame_ratio > _MAX_HALF_FRAME_RATIO).any():
        raise NumericsError(
            f"a frame of {frame_s:g} s says nothing about a time constant of {np.min(time_constants_s):.3g} s",
            remedy="leave out what is so much faster than a frame",
        )
    ramp, ramp_slope = _mean_decay(ramp_ratio)
    frame, frame_slope = _mean_about(frame_ratio)
    # d/d log τ of f(c/τ) is −x f'(x).
    return ramp * frame, ramp_ratio * ramp_slope / ramp + frame_ratio * frame_slope / frame


def _mean_decay(x: Array) -> tuple[Array, Array]:
    small_mask = x < _SERIES
    safe = np.where(small_mask, 1.0, x)
    value = -np.expm1(-safe) / safe
    slope = (np.exp(-safe) - value) / safe
    return np.where(small_mask, _power_series(_DECAY, x), value), np.where(
        small_mask, _power_series(_DECAY_SLOPE, x), slope
    )


def _mean_about(x: Array) -> tuple[Array, Array]:
    small_mask = x < _SERIES
    safe = np.where(small_mask, 1.0, x)
    value = np.sinh(safe) / safe
    slope = (np.cosh(safe) - value) / safe
    return np.where(small_mask, _power_series(_ABOUT, x), value), np.where(
        small_mask, _power_series(_ABOUT_SLOPE, x), slope
    )


def _power_series(coefficients: Array, x: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(np.minimum(x, _SERIES), coefficients), dtype=np.float64)


#: Number below which Taylor's series is used, as the derivatives are differences of nearly equal numbers.
_SERIES: Final = 0.5
_TERMS: Final = 16  # 0.5¹⁶/16! is rounding
_DECAY: Final = np.array([(-1) ** k / factorial(k + 1) for k in range(_TERMS)])
_ABOUT: Final = np.array([(1 - k % 2) / factorial(k + 1) for k in range(_TERMS)])
_DECAY_SLOPE: Final = np.polynomial.polynomial.polyder(_DECAY)
_ABOUT_SLOPE: Final = np.polynomial.polynomial.polyder(_ABOUT)


#: Fewest points for one and for two exponentials: their parameters and two to spare.
_MIN_POINTS: Final = {1: 5, 2: 7}
#: An amplitude must be this many of its standard errors from zero.
_CLEAR: Final = 3.0
_DRIFTING: Final = "still drifting: the trace is too short for its time constant"
#: A trace that begins after so many of its lengths has no trace of earlier relaxation.
_MAX_START_RATIO: Final = 100.0
#: Least and greatest size of values with finite, nonzero squares.
_SIZES: Final = (1e-140, 1e140)


def fit_relaxation(
    time_s: Array,
    values: Array,
    *,
    r_squared_gate: float = 0.85,
    flat_within: float = 0.0,
) -> RelaxationFit:
    """Fit G(t) = a₀ + a₁ e^(−t/τ₁) + a₂ e^(−t/τ₂), τ₁ < τ₂, and keep only what the data support.

    The second exponential is kept if all of these hold: an F test corrected for the residuals' autocorrelation finds
    it significant at 1 %, both amplitudes are 3 standard errors from zero, the time constants differ by at least a
    factor of 2, and both are determined (standard error of log τ below 0.5, not at a bound). Otherwise one
    exponential is kept and ``why`` gives the failed condition. The paper fits two throughout.

    NumericsError if shapes differ, a number is not finite, time stamps do not rise, the trace begins later than a
    hundred times its length, or its values are beyond 1e±140.

    Parameters
    ----------
    time_s : (n,) float64 [s], strictly rising, from the end of the ramp.
    values : (n,) float64, any unit; a trace shifted or scaled gives a fit shifted or scaled.
    r_squared_gate : fits that explain less of the variance are REJECTED.
    flat_within : a trace that stays within this distance of its final level (median of the last quarter) from
        the start is FLAT, in the trace's unit; a constant trace always is.

    Returns
    -------
    RelaxationFit whose status is TWO, ONE, FLAT, DRIFTING or REJECTED; the numbers of a rejected one are its best
    attempt. A drifting one is slower than its window by an unknown amount: it has no curve, and its offset is the
    level at its end. Time constants lie within half the median frame interval and ten times the window.
    """
    time_s, values = check_trace(time_s, values)
    if len(values) == 0:
        return _refuse_curve(FitStatus.REJECTED, values, 0.0, "the trace is empty")
    rounding = 4 * float(np.finfo(np.float64).eps * np.abs(values).max())
    final = float(np.median(values[-max(len(values) // 4, 1) :]))
    if np.abs(values - final).max() <= max(flat_within, 4 * rounding):
        return _refuse_curve(FitStatus.FLAT, values, rounding, "no relaxation: within the band from the start")
    if len(values) < _MIN_POINTS[1]:
        return _refuse_curve(
            FitStatus.REJECTED, values, rounding, f"{len(values)} points are too few; {_MIN_POINTS[1]} are needed"
        )
    # Amplitudes are stated at t = 0; a thirtieth of the start keeps those of a late trace (after a spike) in range.
    shortest_s = max(float(np.median(np.diff(time_s))) / 2, abs(float(time_s[0])) / 30)
    bounds_s = (shortest_s, 10 * float(time_s[-1] - time_s[0]))
    single = fit_exponentials(time_s, values, 1, bounds_s, rounding)
    if len(values) < _MIN_POINTS[2]:
        return _accept_fit(single, values, bounds_s, r_squared_gate, "too few points for a second exponential")
    two = fit_exponentials(time_s, values, 2, bounds_s, rounding)
    why = _explain_single(single, two, bounds_s, rounding)
    return _accept_fit(single if why else two, values, bounds_s, r_squared_gate, why)


def relaxation_curve(fit: RelaxationFit, time_s: Array) -> Array:
    """Evaluate a fit: (n,) float64 in the trace's unit at (n,) times from the end of the ramp [s]."""
    curve = np.full(np.shape(time_s), fit.offset)
    for amplitude, tau in zip(fit.amplitudes, fit.time_constants_s, strict=True):
        curve = curve + amplitude * np.exp(-np.asarray(time_s) / tau)
    return curve


def check_trace(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Return a trace as float64; NumericsError names the sample that makes it unusable."""
    time_s, values = np.asarray(time_s, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if time_s.ndim != 1 or time_s.shape != values.shape:
        raise NumericsError(f"a trace of {values.shape} values cannot have {time_s.shape} times")
    if not (np.isfinite(time_s).all() and np.isfinite(values).all()):
        raise NumericsError(
            "a trace holds a time or a value that is not a finite number", remedy="leave such values out"
        )
    backward = np.flatnonzero(np.diff(time_s) <= 0)
    if backward.size:
        first_backward = int(backward[0])
        raise NumericsError(
            f"time stamps repeat or step back: sample {first_backward + 1} at {time_s[first_backward + 1]:.13g} s"
            f" follows {time_s[first_backward]:.13g} s",
            remedy="drop or re-time the repeated samples before fitting",
        )
    _check_range(time_s, values)
    return time_s, values


def _check_range(time_s: Array, values: Array) -> None:
    window_s = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
    if window_s > 0 and abs(time_s[0]) > _MAX_START_RATIO * window_s:
        raise NumericsError(
            f"a trace of {window_s:.4g} s begins {time_s[0]:.6g} s after the end of the ramp: nothing is left to fit",
            remedy="count its times from the end of the ramp, not from some other beginning",
        )
    largest = float(np.abs(values).max(initial=0.0))
    if largest > 0 and not _SIZES[0] <= largest <= _SIZES[1] and (values != values[0]).any():
        raise NumericsError(
            f"a trace reaches {largest:.3g}: its square is outside the range of numbers",
            remedy="state it in another unit",
        )


def _explain_single(single: Exponentials, two: Exponentials, bounds_s: tuple[float, float], rounding: float) -> str:
    fast_s, slow_s = two.time_constants_s
    at_bound = slow_s > 0.99 * bounds_s[1] or fast_s < 1.01 * bounds_s[0]
    chance = chance_of_gain(single.residual, two.residual, 5, 2)
    checks = (
        (
            single.sum_of_squares <= len(single.residual) * rounding**2,
            "one exponential explains the trace to rounding",
        ),
        (slow_s < SEPARATION * fast_s, f"time constants {fast_s:.3g} s and {slow_s:.3g} s cannot be told apart"),
        (at_bound, f"a second time constant would lie at a bound ({bounds_s[0]:.3g} s to {bounds_s[1]:.3g} s)"),
        (bool((two.stderr[3:] > LOG_ERROR).any()), "the data do not determine a second time constant"),
        (
            bool((np.abs(two.coefficients[1:]) < _CLEAR * two.stderr[1:3]).any()),
            "one of two amplitudes is not clear of zero",
        ),
        (chance > SIGNIFICANCE, f"a second exponential explains no more than chance would (p = {chance:.2g})"),
    )
    return next((why for failed, why in checks if failed), "")


def _accept_fit(
    fit: Exponentials,
    values: Array,
    bounds_s: tuple[float, float],
    r_squared_gate: float,
    why: str,
) -> RelaxationFit:
    count = len(fit.time_constants_s)
    status = FitStatus.TWO if count == 2 else FitStatus.ONE
    centred = values - values.mean()
    r_squared = 1 - fit.sum_of_squares / float(centred @ centred)
    stderr = np.where(np.isfinite(fit.stderr), fit.stderr, np.finfo(np.float64).max)
    tau_s, window_s = float(fit.time_constants_s[0]), bounds_s[1] / 10
    if r_squared < r_squared_gate:
        status, why = FitStatus.REJECTED, f"R² {r_squared:.3f} is below {r_squared_gate:g}"
    elif count == 1 and (tau_s > 0.99 * bounds_s[1] or (tau_s > window_s and float(fit.stderr[2]) > 1.0)):
        return _refuse_curve(
            FitStatus.DRIFTING, values[-max(len(values) // 4, 1) :], 0.0, _DRIFTING, r_squared=r_squared
        )
    elif count == 1 and fit.stderr[2] > 1.0:
        status, why = FitStatus.REJECTED, "the data do not determine a time constant"
    return RelaxationFit(
        status=status,
        offset=float(fit.coefficients[0]),
        amplitudes=tuple(fit.coefficients[1:].tolist()),
        time_constants_s=tuple(fit.time_constants_s.tolist()),
        offset_stderr=float(stderr[0]),
        time_constant_stderr_s=tuple(
            np.minimum(fit.time_constants_s * stderr[1 + count :], np.finfo(np.float64).max).tolist()
        ),
        r_squared=r_squared,
        why=why,
    )


def _refuse_curve(
    status: FitStatus, values: Array, rounding: float, why: str, *, r_squared: float = 0.0
) -> RelaxationFit:
    offset = float(values.mean()) if len(values) else 0.0
    spread = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
    return RelaxationFit(status, offset, (), (), max(spread, rounding), (), r_squared, why)
