"""One relaxation for all loads of a run, since traces of one material share its time constants."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.joint import JointExponentials, TimedValues, fit_joint
from cbsr_qa.calibration.fits.relaxation import check_trace
from cbsr_qa.calibration.fits.separable import LOG_ERROR, SEPARATION, SIGNIFICANCE, chance_of_gain
from cbsr_qa.calibration.fits.settling import settling_time
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, SettlingTime

__all__ = ["CommonRelaxation", "TimedValues", "common_settling_time", "fit_common_relaxation"]

#: Fewest points of a trace with information on its shape.
_MIN_POINTS: Final = 5


@dataclass(frozen=True, slots=True, eq=False)
class CommonRelaxation:
    """Common relaxation of the traces of one signal and direction.

    Parameters
    ----------
    fit : fit of the mean trace; time constants and shares of the amplitudes are those of every trace.
    offsets, scales : (traces,) offset and scale of each trace: Gᵢ(t) = offsetᵢ + scaleᵢ (share₁ e^(−t/τ₁) + share₂
        e^(−t/τ₂)); empty without a curve.
    shares : (k,) shares of the exponentials; they add to 1.
    covariance : (1 + 2 k, 1 + 2 k) covariance of the mean trace's offset, amplitudes and log τ.
    traces : number of traces used.
    """

    fit: RelaxationFit
    offsets: Array
    scales: Array
    shares: Array
    covariance: Array
    traces: int


def fit_common_relaxation(traces: Sequence[TimedValues]) -> CommonRelaxation:
    """Fit Gᵢ(t) = cᵢ + sᵢ g(t) to all traces at once, g = w e^(−t/τ₁) + (1 − w) e^(−t/τ₂) the same for all.

    The second exponential is kept if an F test corrected for the residuals' autocorrelation finds it significant at 1
    %, the time constants differ by a factor of 2, and the slow one is determined (standard error of log τ₂ below 0.5,
    not at a bound). The fast one need not be determined, only significant, as settling depends on the slow one.
    Otherwise one exponential is kept, with the reason in ``fit.why``. The paper fits each load by itself.

    NumericsError for traces that :func:`~cbsr_qa.calibration.fits.relaxation.fit_relaxation` refuses.

    Parameters
    ----------
    traces : (times (n,) [s] strictly rising, values (n,)) of each load, any unit, times from the end of the ramp;
        traces of fewer than 5 points are left out.

    Returns
    -------
    CommonRelaxation, whose ``fit.status`` is TWO, ONE, FLAT (no significant relaxation), DRIFTING (slower than the
    traces are long) or REJECTED (no trace, or no time constant is determined).
    """
    used_traces = [check_trace(*trace) for trace in traces if len(trace[0]) >= _MIN_POINTS]
    if not used_traces:
        return _refuse_curve(FitStatus.REJECTED, used_traces, f"no trace of at least {_MIN_POINTS} points")
    level = np.concatenate([values - values.mean() for _, values in used_traces])
    rounding = 8 * float(np.finfo(np.float64).eps) * max(float(np.abs(values).max()) for _, values in used_traces)
    if np.abs(level).max() <= rounding:
        return _refuse_curve(FitStatus.FLAT, used_traces, "no relaxation: the traces are constant")
    shortest_s = min(float(np.median(np.diff(time_s))) for time_s, _ in used_traces) / 2
    bounds_s = (shortest_s, 10 * max(float(time_s[-1] - time_s[0]) for time_s, _ in used_traces))
    lowest, highest = np.log(bounds_s)
    starts = [[log_tau] for log_tau in np.linspace(lowest, highest, 6)[1:-1]]
    single = fit_joint(used_traces, starts, bounds_s)
    is_small = float(single.residual @ single.residual) > 0.5 * float(level @ level)
    if (
        is_small
        and chance_of_gain(level, single.residual, _count_parameters(used_traces, 1), len(used_traces) + 1)
        > SIGNIFICANCE
    ):
        return _refuse_curve(FitStatus.FLAT, used_traces, "no relaxation stands out of the noise")
    # The single time constant lies between the two.
    between, ratios = float(np.log(single.time_constants_s[0])), ((5.0, 1.4), (3.0, 2.0), (1.5, 8.0))
    starts = [[between - np.log(below), between + np.log(above), 0.4] for below, above in ratios]
    two = fit_joint(used_traces, starts, bounds_s)
    why = _explain_single(single, two, bounds_s, _count_parameters(used_traces, 3), rounding)
    return _accept_fit(single if why else two, used_traces, bounds_s, why)


def common_settling_time(
    common: CommonRelaxation,
    *,
    window_s: float,
    tolerance: float = 0.15,
    band: str = "steady",
    loaded_change: float | None = None,
    start_s: float = 0.0,
) -> tuple[SettlingTime, float | None]:
    """Return the settling time of the mean trace and its standard error [s], or None without a plain number.

    Parameters are those of :func:`~cbsr_qa.calibration.fits.settling.settling_time`: ``loaded_change`` the mean over
    unloadings, ``window_s`` of the longest trace.
    """
    settled = partial(
        settling_time,
        window_s=window_s,
        tolerance=tolerance,
        band=band,
        loaded_change=loaded_change,
        start_s=start_s,
    )
    settling = settled(common.fit)
    if settling.value_s is None or settling.censored or not len(common.shares):
        return settling, None
    gradient = np.array([_slope(common, index, settled) for index in range(len(common.covariance))])
    return settling, float(np.sqrt(max(gradient @ common.covariance @ gradient, 0.0)))


def _slope(common: CommonRelaxation, index: int, settled: "partial[SettlingTime]") -> float:
    """Central difference of the settling time over a tenth of a parameter's standard error to each side."""
    step = 0.1 * float(np.sqrt(common.covariance[index, index]))
    if step == 0:
        return 0.0
    upper_s, lower_s = (settled(_shift_parameter(common.fit, index, sign * step)).value_s for sign in (1, -1))
    return 0.0 if upper_s is None or lower_s is None else (upper_s - lower_s) / (2 * step)


def _shift_parameter(fit: RelaxationFit, index: int, step: float) -> RelaxationFit:
    count = len(fit.amplitudes)
    if index == 0:
        return replace(fit, offset=fit.offset + step)
    if index <= count:
        amplitudes = [a + step * (k == index - 1) for k, a in enumerate(fit.amplitudes)]
        return replace(fit, amplitudes=tuple(amplitudes))
    taus = [tau * float(np.exp(step * (k == index - 1 - count))) for k, tau in enumerate(fit.time_constants_s)]
    return replace(fit, time_constants_s=tuple(taus))


def _count_parameters(traces: Sequence[TimedValues], shape: int) -> int:
    return 2 * len(traces) + shape


def _explain_single(
    single: JointExponentials, two: JointExponentials, bounds_s: tuple[float, float], parameters: int, rounding: float
) -> str:
    """Why the second exponential cannot be kept; empty if it can."""
    fast_s, slow_s = two.time_constants_s
    chance = chance_of_gain(single.residual, two.residual, parameters, 2)
    checks = (
        (np.abs(single.residual).max() <= rounding, "one exponential explains the traces to rounding"),
        (chance > SIGNIFICANCE, f"a second exponential explains no more than chance would (p = {chance:.2g})"),
        (slow_s < SEPARATION * fast_s, f"time constants {fast_s:.3g} s and {slow_s:.3g} s cannot be told apart"),
        (slow_s > 0.99 * bounds_s[1], f"a second time constant would lie at its bound of {bounds_s[1]:.3g} s"),
        (bool(two.log_stderr[1] > LOG_ERROR), "the data do not determine a second time constant"),
    )
    return next((why for failed, why in checks if failed), "")


def _accept_fit(
    joint: JointExponentials, traces: Sequence[TimedValues], bounds_s: tuple[float, float], why: str
) -> CommonRelaxation:
    slowest, error = float(joint.time_constants_s[-1]), float(joint.log_stderr[-1])
    if slowest > 0.99 * bounds_s[1] or (error > LOG_ERROR and slowest > bounds_s[1] / 10):
        return _refuse_curve(FitStatus.DRIFTING, traces, "still drifting: slower than the traces are long")
    if error > LOG_ERROR:
        return _refuse_curve(FitStatus.REJECTED, traces, "the data do not determine a time constant")
    centred = np.concatenate([values - values.mean() for _, values in traces])
    fit = RelaxationFit(
        status=FitStatus.TWO if len(joint.shares) == 2 else FitStatus.ONE,
        offset=float(joint.offsets.mean()),
        amplitudes=tuple(joint.amplitudes.tolist()),
        time_constants_s=tuple(joint.time_constants_s.tolist()),
        offset_stderr=float(np.sqrt(joint.mean_covariance[0, 0])),
        time_constant_stderr_s=tuple((joint.time_constants_s * joint.log_stderr).tolist()),
        r_squared=1 - float(joint.residual @ joint.residual) / float(centred @ centred),
        why=why,
    )
    return CommonRelaxation(fit, joint.offsets, joint.scales, joint.shares, joint.mean_covariance, traces=len(traces))


def _refuse_curve(status: FitStatus, traces: Sequence[TimedValues], why: str) -> CommonRelaxation:
    ends = np.array([np.median(values[-max(len(values) // 4, 1) :]) for _, values in traces])
    offset = float(ends.mean()) if len(ends) else 0.0
    stderr = float(ends.std(ddof=1) / np.sqrt(len(ends))) if len(ends) > 1 else 0.0
    empty = np.zeros(0)
    fit = RelaxationFit(status, offset, (), (), stderr, (), 0.0, why)
    return CommonRelaxation(fit, empty, empty, empty, np.zeros((0, 0)), traces=len(traces))
