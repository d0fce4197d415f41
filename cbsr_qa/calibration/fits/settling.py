"""Settling times of fitted relaxations, their restricted means, and the start of a relaxation after a spike."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import brentq

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, finite_numbers
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, SettlingTime

_BANDS: Final = ("steady", "step")


def settling_time(
    fit: RelaxationFit,
    *,
    window_s: float,
    tolerance: float = 0.15,
    band: str = "steady",
    loaded_change: float | None = None,
    start_s: float = 0.0,
) -> SettlingTime:
    """Return the last time at which the fitted curve leaves the band about its steady level a₀.

    NumericsError if window or tolerance is not positive, or the band is unknown.

    Parameters
    ----------
    fit : fit of a change from before the load; t = 0 is the end of the ramp.
    window_s : observed time from t = 0 [s].
    tolerance : half width of the band as a fraction (the paper's 15 %).
    band : ``"steady"``: of the steady change from before the load, as in the paper; ``"step"``: of G(0) − a₀.
    loaded_change : the steady change under load. Given for an unloading, which ends near zero change: the band is
        relative to it, since a band relative to the end would vanish. The fitted curve must also be in the band about
        zero at the window's end, since a short trace of a slow return seems to end elsewhere.
    start_s : start of the fit (after an unloading spike); earlier the trace counts as unsettled.

    Returns
    -------
    SettlingTime: 0 if the trace is inside the band from t = 0 (or ``start_s``) on; the window's length and
    ``censored`` if it is not inside at the window's end, or still drifting; no value if the fit was rejected or there
    is no band.
    """
    if not window_s > 0 or not tolerance > 0:
        raise NumericsError(f"a window of {window_s} s and a tolerance of {tolerance} must be positive")
    if band not in _BANDS:
        raise NumericsError(f"settling band {band!r} is unknown", remedy=f"use {' or '.join(map(repr, _BANDS))}")
    if fit.status is FitStatus.REJECTED:
        return SettlingTime(None, False, 0.0, f"the relaxation fit was rejected: {fit.why}")
    steady = fit.offset if loaded_change is None else loaded_change
    half_width = tolerance * abs(_deviation(fit, start_s) if band == "step" else steady)
    why_late = _explain_late(fit, half_width, window_s, None if loaded_change is None else (loaded_change, tolerance))
    if why_late:
        return SettlingTime(window_s, True, half_width, why_late)
    if fit.status is FitStatus.FLAT:
        return SettlingTime(start_s, False, half_width, "inside the band from the start")
    if half_width == 0:
        return SettlingTime(None, False, 0.0, "there is no steady change to which the band could be relative")
    last = _find_last_outside(fit, half_width, start_s, window_s)
    return SettlingTime(last, False, half_width, "" if last > start_s else "inside the band from the start")


def window_s(time_s: Array) -> float:
    """Return the length of an observed window: half a sample beyond the middle of the last one."""
    if len(time_s) < 2:
        return float(time_s.max(initial=1.0))
    return float(time_s[-1] + np.median(np.diff(time_s)) / 2)


def estimate_restricted_mean(times_s: Sequence[float], censored: Sequence[bool]) -> tuple[float, float]:
    """Mean and standard deviation of times, some of them censored (Kaplan & Meier 1958).

    The survival curve is integrated up to the longest observed time, so with censored times, which count as at least
    their window, the mean is a lower bound.

    NumericsError if there is no time, one is negative or not finite, or the lengths differ.

    Returns
    -------
    (mean, deviation) [s]; without censoring exactly the sample mean and the population standard deviation.
    """
    if len(times_s) == 0 or len(times_s) != len(censored) or min(times_s) < 0:
        raise NumericsError(f"{len(times_s)} settling times with {len(censored)} marks have no mean")
    time = finite_numbers(times_s, "settling times")
    settled = ~np.asarray(censored, dtype=np.bool_)
    edges = np.unique(time)
    share, alive = np.empty(len(edges)), 1.0
    for index, edge in enumerate(edges):
        share[index] = alive * float(((time == edge) & settled).sum()) / int((time >= edge).sum())
        alive -= share[index]
    share[-1] += alive  # survivors of the longest time count as that
    # About the shortest and then about the mean, so that a small spread of long times keeps its digits.
    elapsed_s = edges - edges[0]
    mean = float(share @ elapsed_s)
    return float(edges[0]) + mean, float(np.sqrt(share @ (elapsed_s - mean) ** 2))


def _explain_late(
    fit: RelaxationFit, half_width: float, window_s: float, unloading: tuple[float, float] | None
) -> str:
    """Why a trace has not settled by its window's end; empty if it has."""
    if fit.status is FitStatus.DRIFTING:
        return fit.why
    message = f"not settled within {window_s:.4g} s"
    if unloading is not None:
        change, tolerance = unloading
        remaining_change = abs(fit.offset + _deviation(fit, window_s))
        if remaining_change > tolerance * abs(change) > 0:
            return f"{message}: {remaining_change / abs(change):.0%} of the change under load is left"
    return message if abs(_deviation(fit, window_s)) > half_width > 0 else ""


def _deviation(fit: RelaxationFit, time_s: float) -> float:
    return float(sum(a * np.exp(-time_s / tau) for a, tau in zip(fit.amplitudes, fit.time_constants_s, strict=True)))


def _find_last_outside(fit: RelaxationFit, half_width: float, start_s: float, end_s: float) -> float:
    """Last time in [start, end] outside the band, or start; the end is known to be inside.

    Between its zero and its extremum (at most one of each) the deviation's size is monotone: each root is bracketed.
    """

    def excess(time_s: float) -> float:
        return abs(_deviation(fit, time_s)) - half_width

    inside_s = end_s
    for edge in [*sorted((t for t in _turning_points(fit) if start_s < t < end_s), reverse=True), start_s]:
        if excess(edge) > 0:
            return float(brentq(excess, edge, inside_s, xtol=1e-12, rtol=1e-12))
        inside_s = edge
    return start_s


def _turning_points(fit: RelaxationFit) -> list[float]:
    """Times where the deviation is zero or extreme."""
    if len(fit.amplitudes) < 2 or fit.amplitudes[0] * fit.amplitudes[1] >= 0:
        return []
    (fast_amplitude, slow_amplitude), (fast_s, slow_s) = fit.amplitudes, fit.time_constants_s
    if fast_s == slow_s:
        return []  # a single exponential after all
    # Difference of the time constants, not of the rates: exact for nearly equal ones.
    per_rate = fast_s * slow_s / (slow_s - fast_s)
    return [
        float(np.log(-fast_amplitude / slow_amplitude) * per_rate),
        float(np.log(-fast_amplitude * slow_s / (slow_amplitude * fast_s)) * per_rate),
    ]


#: A deviation counts if it is this many noise standard deviations, or this share of the largest, from the end level.
_CLEAR: Final = 4.0
_SHARE: Final = 0.05


def relaxation_start(values: Array) -> int:
    """Return the index of the first sample after the unloading spike's peak; 0 without a spike (paper 3.1.2).

    NumericsError if a value is not finite.
    """
    values = finite_numbers(values, "values behind a release")
    count = len(values)
    if count < 4:
        return 0
    deviation = values - np.median(values[-(count // 4) :])
    early_deviation = deviation[: (count + 1) // 2]
    # Differences of neighbours show the noise and hardly the relaxation; the spike does not affect their median.
    noise = 1.4826 * float(np.median(np.abs(np.diff(deviation[count // 2 :])))) / np.sqrt(2)
    clear_mask = np.abs(early_deviation) > max(_CLEAR * noise, _SHARE * float(np.abs(early_deviation).max()))
    if not clear_mask.any():
        return 0
    signs = np.where(clear_mask, np.sign(early_deviation), 0)
    last = signs[np.flatnonzero(clear_mask)[-1]]
    opposite = np.flatnonzero(signs == -last)
    begin = int(opposite[-1]) + 1 if opposite.size else 0
    peak = begin + int(np.argmax(np.abs(early_deviation[begin:])))
    return 0 if peak == 0 else peak + 1
