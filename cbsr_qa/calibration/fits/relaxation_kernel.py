"""Kernel of a sensor's relaxation, learned from the loads of a calibration run (empirical Bayes)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.common_relaxation import CommonRelaxation, TimedValues, fit_common_relaxation
from cbsr_qa.calibration.fits.relaxation import check_trace, exponentials
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationKernel

#: Candidate relative scatters, uniform a priori up to 1.
_SCATTERS: Final = np.linspace(0.0, 1.0, 61) ** 2
#: Residual degrees of freedom from which a load's own noise is used instead of the pooled one.
_OWN_NOISE: Final = 8
#: Lower bound of a value's noise, as a share of its load, to keep covariances invertible.
_LEAST_NOISE: Final = 1e-6
#: Number of times the exponentials are expanded about new time constants.
_ROUNDS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class KernelTrace:
    """A load to learn from.

    Parameters
    ----------
    time_s, values : (n,) times and values of the trace.
    ramp_s : duration of the ramp before the trace.
    released : released change D of an unloading; None for a loading.
    """

    time_s: Array
    values: Array
    ramp_s: float
    released: float | None


def _estimate_shared_kernel(
    traces: Sequence[KernelTrace],
    weights: Array,
    time_constants_s: Array,
    prior_stderr: Array,
    *,
    frame_s: float,
    noise: Sequence[float] | None,
    start_s: float,
) -> RelaxationKernel:
    """Estimate the mean kernel of all loads and the scatter of their weights about it.

    Load i is Aᵢ (1 + Σ wᵢ e^(−t/τ)) or Rᵢ + Dᵢ Σ wᵢ e^(−t/τ), with wᵢ ~ N(w, s² w²) independently. Aᵢ or Rᵢ are
    integrated out under a flat prior; w and log τ are found by Gauss–Newton at every s of a grid, which is weighted
    by the restricted likelihood. The scatter's covariance uses the estimated sizes of loads.

    Parameters
    ----------
    weights, time_constants_s : (k,) initial values.
    prior_stderr : (2 k,) standard deviations of the weak normal prior of (w, log τ) about them; 0 keeps one fixed.
    noise : standard deviation of a value of each load; None to estimate it from the residuals.
    start_s : start of the kernel.
    """
    mean = start = np.concatenate([weights, np.log(time_constants_s)])
    free_mask = prior_stderr > 0
    precision = 1 / prior_stderr[free_mask] ** 2
    for _ in range(_ROUNDS):
        reduced = _Reduced(traces, mean, frame_s, noise)
        steps, inverse, likelihood = reduced.search_scatter(free_mask, precision, (start - mean)[free_mask])
        mean = mean.copy()
        mean[free_mask] += likelihood @ steps
    deviation = steps - likelihood @ steps
    covariance = np.zeros((len(mean), len(mean)))
    covariance[np.ix_(free_mask, free_mask)] = (
        np.einsum("g,gij->ij", likelihood, inverse) + (likelihood[:, None] * deviation).T @ deviation
    )
    scatter, freedom = _as_variance(likelihood)
    count = len(weights)
    # Time constants that began close together may have changed places.
    time_order = np.argsort(mean[count:], kind="stable")
    parameter_order = np.concatenate([time_order, count + time_order])
    return RelaxationKernel(
        loading=traces[0].released is None,
        weights=mean[time_order],
        time_constants_s=np.exp(mean[count + time_order]),
        covariance=covariance[np.ix_(parameter_order, parameter_order)],
        scatter=scatter * np.abs(mean[time_order]),
        scatter_freedom=freedom,
        loads=len(traces),
        start_s=start_s,
    )


class _Reduced:
    """Every load projected on the few dimensions in which kernels near the present one differ.

    Parameters
    ----------
    mean : (2 k,) w and log τ to expand about.
    """

    def __init__(
        self, traces: Sequence[KernelTrace], mean: Array, frame_s: float, noise: Sequence[float] | None
    ) -> None:
        count = len(mean) // 2
        self.weights = mean[:count]
        loads = [_project_trace(trace, self.weights, np.exp(mean[count:]), frame_s) for trace in traces]
        self.data, self.level, self.parts, self.slopes, self.size = (
            np.array(row) for row in zip(*(load[:5] for load in loads), strict=True)
        )
        squares, spare = (np.array(row, dtype=np.float64) for row in zip(*(load[5:] for load in loads), strict=True))
        pooled = squares.sum() / max(float(spare.sum()), 1.0)
        residual_variance = np.where(spare >= _OWN_NOISE, squares / np.maximum(spare, 1), pooled)
        noise_variance = residual_variance if noise is None else np.asarray(noise, dtype=np.float64) ** 2
        least = (_LEAST_NOISE * self.size) ** 2 + np.finfo(np.float64).tiny
        self.variance = np.maximum(noise_variance, least)

    def search_scatter(self, free: Mask, precision: Array, back: Array) -> tuple[Array, Array, Array]:
        """Steps (g, f), covariances (g, f, f) and likelihoods (g,) at each relative scatter of the grid.

        ``back`` leads from the present mean to the prior's.
        """
        slopes = self.slopes[:, :, free] * self.size[:, None, None]
        spread = self.parts * (self.size[:, None] * self.weights)[:, None, :]
        outer = spread @ spread.transpose(0, 2, 1)
        identity = np.eye(self.data.shape[1]) * self.variance[:, None, None]
        covariance = identity + _SCATTERS[:, None, None, None] ** 2 * outer
        inverse = np.linalg.inv(covariance)
        level = np.einsum("gnij,nj->gni", inverse, self.level)
        weight = np.einsum("gni,ni->gn", level, self.level)
        across = inverse - level[..., :, None] * level[..., None, :] / weight[..., None, None]
        projected_data = np.einsum("gnij,nj->gni", across, self.data)
        information = np.einsum("nia,gnij,njb->gab", slopes, across, slopes, optimize=True) + np.diag(precision)
        pull = np.einsum("nia,gni->ga", slopes, projected_data) + precision * back
        posterior = np.linalg.inv(information)
        steps = np.einsum("gab,gb->ga", posterior, pull)
        explained = np.einsum("ga,ga->g", pull, steps)
        chi_squared = np.einsum("gni,ni->g", projected_data, self.data) - explained
        volume = np.linalg.slogdet(covariance)[1].sum(axis=1) + np.log(weight).sum(axis=1)
        log_likelihood = -0.5 * (chi_squared + volume + np.linalg.slogdet(information)[1])
        likelihood = np.exp(log_likelihood - log_likelihood.max()) * np.gradient(_SCATTERS)
        return steps, posterior, likelihood / likelihood.sum()


def _project_trace(
    trace: KernelTrace, weights: Array, time_constants_s: Array, frame_s: float
) -> tuple[Array, Array, Array, Array, float, float, int]:
    """Coordinates of values, level, exponentials and slopes; the size; residual, and its degrees of freedom."""
    decays, log_slopes = exponentials(trace.time_s, time_constants_s, ramp_s=trace.ramp_s, frame_s=frame_s)
    relaxing = decays @ weights
    level = np.ones_like(relaxing) if trace.released is not None else 1 + relaxing
    columns = np.column_stack([level, decays, weights * log_slopes])
    basis = np.linalg.svd(columns, full_matrices=False)[0]
    data = basis.T @ trace.values
    residual = trace.values - basis @ data
    size = float(trace.values @ level / (level @ level)) if trace.released is None else trace.released
    if trace.released is not None:
        data = data - basis.T @ (trace.released * relaxing)
    coordinates = basis.T @ columns
    count = len(weights)
    freedom = max(len(trace.values) - columns.shape[1], 0)
    decays, slopes = coordinates[:, 1 : 1 + count], coordinates[:, 1:]
    return data, coordinates[:, 0], decays, slopes, size, float(residual @ residual), freedom


def _as_variance(likely: Array) -> tuple[float, float]:
    """Scaled inverse χ² law with the mean and variance of s²: root of its scale, and degrees of freedom."""
    square = _SCATTERS**2
    mean = float(likely @ square)
    spread = max(float(likely @ (square - mean) ** 2), 1e-9 * mean**2)
    freedom = 4 + 2 * mean**2 / spread
    return float(np.sqrt(mean * (freedom - 2) / freedom)), freedom


_MIN_VALUES: Final = 6
#: Standard deviations of the weak priors: of a weight, a logarithm of a time constant, and the weight of an
#: exponential that may be hidden in the traces.
_WEIGHT, _LOG_TIME, _HIDDEN = 1.0, 1.0, 0.3
#: Least mean of all sizes, over their root mean square, for the mean to represent them.
_ONE_SIGN: Final = 0.1
#: Ratio of time constants between a hidden exponential and the visible one.
_HIDDEN_RATIO: Final = 5.0


def learn_kernel(
    traces: Sequence[TimedValues],
    *,
    ramp_s: float | Sequence[float] = 0.0,
    frame_s: float = 0.0,
    released: Sequence[float] | None = None,
    start_s: float = 0.0,
    noise: Sequence[float] | None = None,
) -> RelaxationKernel:
    """Learn a sensor's relaxation from the loads of a calibration run, and the scatter between loads.

    Time constants begin at those of ``fit_common_relaxation``; weights, time constants
    and the scatter of the weights between loads then follow from the restricted likelihood of all loads (empirical
    Bayes). The scatter is relative, the same for all weights, and uniform a priori from 0 to 1. A single load does
    not determine it, and predictions from its kernel are correspondingly uncertain.

    NumericsError if numbers of loads differ, a number is not finite, or time stamps repeat or step back.

    Parameters
    ----------
    traces : (times (n,) [s] from the end of the ramp, values (n,)) of each load; traces of fewer than 6 values are
        left out. Any unit: weights are relative.
    ramp_s : duration of the head's movement before; the kernel is that of a step.
    frame_s : averaging time of a value; 0 for instantaneous ones.
    released : change reversed by each release, for unloadings; None for loadings.
    start_s : earlier values are left out (an unloading spike, see
        :func:`~cbsr_qa.calibration.fits.settling.relaxation_start`).
    noise : standard deviation of a value, for each load; None to estimate it from the residuals.

    Returns
    -------
    RelaxationKernel; unusable, with the reason ``why``, if the traces drift or show no time constant.
    """
    loads, unit = _scale_loads(_loads(traces, ramp_s, released, start_s))
    usable = [index for index, load in enumerate(loads) if len(load.time_s) >= _MIN_VALUES]
    used_loads = [loads[index] for index in usable]
    common = fit_common_relaxation([(load.time_s, load.values) for load in used_loads])
    if released is None:
        stands_out = abs(common.fit.offset) > 5 * common.fit.offset_stderr
    else:
        stands_out = any(load.released for load in used_loads)
    why = "" if stands_out else "no load stands out of its noise"
    if common.fit.status in (FitStatus.REJECTED, FitStatus.DRIFTING):
        why = common.fit.why
    if why:
        none = np.zeros(0)
        return RelaxationKernel(
            released is None, none, none, np.zeros((0, 0)), none, 1.0, len(used_loads), start_s, why
        )
    weights, time_constants_s, prior = _beginning(used_loads, common, frame_s)
    used_noise = None if noise is None else [noise[index] * unit for index in usable]
    return _estimate_shared_kernel(
        used_loads, weights, time_constants_s, prior, frame_s=frame_s, noise=used_noise, start_s=start_s
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
        times, numbers = check_trace(time_s, values)
        counts = times >= start_s
        loads.append(KernelTrace(times[counts], numbers[counts], ramp, change))
    return loads


def _scale_loads(loads: list[KernelTrace]) -> tuple[list[KernelTrace], float]:
    """Loads in a unit in which the largest is about one, and that unit: a power of two, to avoid rounding."""
    largest = max((float(np.abs(load.values).max(initial=0.0)) for load in loads), default=0.0)
    unit = float(np.ldexp(1.0, -int(np.frexp(largest)[1])))
    scaled = [
        replace(load, values=load.values * unit, released=None if load.released is None else load.released * unit)
        for load in loads
    ]
    return scaled, unit


def _beginning(loads: Sequence[KernelTrace], common: CommonRelaxation, frame_s: float) -> tuple[Array, Array, Array]:
    """Weights, time constants and the standard deviations of their weak priors."""
    window_s = max(float(load.time_s[-1]) for load in loads)
    visible_s = np.array(common.fit.time_constants_s)
    sizes = np.array([common.fit.offset if load.released is None else load.released for load in loads])
    amplitudes = np.array(common.fit.amplitudes)
    if abs(sizes.mean()) > _ONE_SIGN * np.sqrt((sizes**2).mean()):
        relative = amplitudes / sizes.mean()
    else:  # releases of both signs, whose mean is meaningless
        relative = common.shares * float(common.scales @ sizes / (sizes @ sizes)) if len(visible_s) else amplitudes
    ramp_s = float(np.mean([load.ramp_s for load in loads]))
    weights = np.zeros(len(visible_s))
    if len(visible_s):
        start, _ = exponentials(np.zeros(1), visible_s, ramp_s=ramp_s, frame_s=frame_s)
        weights = relative / start[0]
    if len(visible_s) == 2:
        return weights, visible_s, np.array([_WEIGHT, _WEIGHT, _LOG_TIME, _LOG_TIME])
    if len(visible_s) == 1:
        both_s = np.array([visible_s[0] / _HIDDEN_RATIO, visible_s[0]])
        return np.array([0.0, weights[0]]), both_s, np.array([_HIDDEN, _WEIGHT, 0.0, _LOG_TIME])
    both_s = window_s / np.array([3 * _HIDDEN_RATIO, 3.0])
    return np.zeros(2), both_s, np.array([_HIDDEN, _HIDDEN, 0.0, 0.0])
