"""A sensor's relaxation kernel, learned from the loads of a calibration run."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate._kernel_basis import exponentials
from cbsr_qa.calibrate._kernel_prior import KernelTrace, shared_kernel
from cbsr_qa.calibrate.common_relaxation import CommonRelaxation, TimedValues, fit_common_relaxation
from cbsr_qa.calibrate.relaxation import checked_trace
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.relaxation import FitStatus, RelaxationKernel

Array = NDArray[np.float64]

_FEWEST: Final = 6
#: Standard deviations of the weak priors: of a weight, a logarithm of a time constant, and the weight of an
#: exponential that the traces do not show but may hide.
_WEIGHT, _LOG_TIME, _HIDDEN = 1.0, 1.0, 0.3
#: Share of their root mean square that the mean of all sizes must be of to stand for them.
_ONE_SIGN: Final = 0.1
#: How far a hidden exponential lies from the one that is seen.
_APART: Final = 5.0


def learn_kernel(
    traces: Sequence[TimedValues],
    *,
    ramp_s: float | Sequence[float] = 0.0,
    frame_s: float = 0.0,
    released: Sequence[float] | None = None,
    start_s: float = 0.0,
    noise: Sequence[float] | None = None,
) -> RelaxationKernel:
    """Learn from the loads of a calibration run how the sensor relaxes, and how alike its loads do.

    Time constants begin at those of :func:`~cbsr_qa.calibrate.common_relaxation.fit_common_relaxation`; weights, time
    constants and the scatter of the weights between loads then follow from the restricted likelihood of all loads
    (empirical Bayes). The scatter is relative and one for all weights; before anything is seen, every scatter from 0
    to 1 is as likely. One load says nothing about it, and predictions from its kernel are as uncertain as that.

    An exponential that chance may have made is not claimed, but may be there: beside a single one, or none, further
    ones are carried with a weight near zero and the uncertainty that the traces leave them.

    Parameters
    ----------
    traces : (times (n,) [s] from the end of the ramp, values (n,)) of each load; those of fewer than 6 values are
        left out. Any unit: weights are relative.
    ramp_s : how long the head moved before; the kernel is that of a step.
    frame_s : length over which a value averages; 0 for one that is of its time.
    released : the change that each release took away, for unloadings; None for loadings.
    start_s : values before are left out (an unloading spike, see
        :func:`~cbsr_qa.calibrate.unloading.relaxation_start`).
    noise : standard deviation of a value, for each load; None to take it from what the kernel leaves.

    Returns
    -------
    RelaxationKernel; with ``why``, and of no use, where the traces drift or show no time constant.

    Raises
    ------
    NumericsError
        If numbers of loads differ, a number is not finite, or time stamps repeat or step back.
    """
    loads, unit = _scaled(_loads(traces, ramp_s, released, start_s))
    told = [index for index, load in enumerate(loads) if len(load.time_s) >= _FEWEST]
    used = [loads[index] for index in told]
    common = fit_common_relaxation([(load.time_s, load.values) for load in used])
    why = common.fit.why if common.fit.status in (FitStatus.REJECTED, FitStatus.DRIFTING) else ""
    if not why and not _stands_out(used, common):
        why = "no load stands out of its noise"
    if why:
        return _no_kernel(released is None, len(used), start_s, why)
    weights, time_constants_s, prior = _beginning(used, common, frame_s)
    own = None if noise is None else [noise[index] * unit for index in told]
    found = shared_kernel(used, weights, time_constants_s, prior, frame_s=frame_s, noise=own)
    return RelaxationKernel(
        loading=released is None,
        weights=found.weights,
        time_constants_s=found.time_constants_s,
        covariance=found.covariance,
        scatter=found.relative_scatter * np.abs(found.weights),
        scatter_freedom=found.freedom,
        loads=len(used),
        start_s=start_s,
    )


def _loads(
    traces: Sequence[TimedValues], ramp_s: float | Sequence[float], released: Sequence[float] | None, start_s: float
) -> list[KernelTrace]:
    ramps = [float(ramp_s)] * len(traces) if isinstance(ramp_s, int | float) else list(ramp_s)
    changes: list[float | None] = [None] * len(traces) if released is None else list(released)
    if len(ramps) != len(traces) or len(changes) != len(traces):
        raise NumericsError(f"{len(traces)} traces with {len(ramps)} ramps and {len(changes)} released changes")
    loads = []
    for (time_s, values), ramp, change in zip(traces, ramps, changes, strict=True):
        if not (np.isfinite(ramp) and ramp >= 0 and (change is None or np.isfinite(change))):
            raise NumericsError(f"a ramp of {ramp} s, or a released change of {change}, is no finite number")
        times, taken = checked_trace(time_s, values)
        counts = times >= start_s
        loads.append(KernelTrace(times[counts], taken[counts], ramp, change))
    return loads


def _scaled(loads: list[KernelTrace]) -> tuple[list[KernelTrace], float]:
    """Loads in a unit in which the largest is about one, and that unit: a power of two, so that nothing rounds.

    Weights are relative, and covariances of large numbers would not fit into doubles.
    """
    largest = max((float(np.abs(load.values).max(initial=0.0)) for load in loads), default=0.0)
    unit = float(np.ldexp(1.0, -int(np.frexp(largest)[1])))
    scaled = [
        replace(load, values=load.values * unit, released=None if load.released is None else load.released * unit)
        for load in loads
    ]
    return scaled, unit


def _stands_out(loads: Sequence[KernelTrace], common: CommonRelaxation) -> bool:
    """Whether what relaxations are relative to is clear of zero."""
    if loads[0].released is not None:
        return any(load.released for load in loads)
    return abs(common.fit.offset) > 5 * common.fit.offset_stderr


def _beginning(loads: Sequence[KernelTrace], common: CommonRelaxation, frame_s: float) -> tuple[Array, Array, Array]:
    """Weights, time constants and the standard deviations of their weak priors."""
    window_s = max(float(load.time_s[-1]) for load in loads)
    seen = np.array(common.fit.time_constants_s)
    sizes = np.array([common.fit.offset if load.released is None else load.released for load in loads])
    amplitudes = np.array(common.fit.amplitudes)
    if abs(sizes.mean()) > _ONE_SIGN * np.sqrt((sizes**2).mean()):
        relative = amplitudes / sizes.mean()
    else:  # releases of both signs, whose mean says nothing
        relative = common.shares * float(common.scales @ sizes / (sizes @ sizes)) if len(seen) else amplitudes
    ramp_s = float(np.mean([load.ramp_s for load in loads]))
    weights = np.zeros(len(seen))
    if len(seen):
        start, _ = exponentials(np.zeros(1), seen, ramp_s=ramp_s, frame_s=frame_s)
        weights = relative / start[0]
    if len(seen) == 2:
        return weights, seen, np.array([_WEIGHT, _WEIGHT, _LOG_TIME, _LOG_TIME])
    if len(seen) == 1:
        both = np.array([seen[0] / _APART, seen[0]])
        return np.array([0.0, weights[0]]), both, np.array([_HIDDEN, _WEIGHT, 0.0, _LOG_TIME])
    both = window_s / np.array([3 * _APART, 3.0])
    return np.zeros(2), both, np.array([_HIDDEN, _HIDDEN, 0.0, 0.0])


def _no_kernel(loading: bool, loads: int, start_s: float, why: str) -> RelaxationKernel:
    none = np.zeros(0)
    return RelaxationKernel(loading, none, none, np.zeros((0, 0)), none, 1.0, loads, start_s, why)
