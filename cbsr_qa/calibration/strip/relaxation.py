"""Relaxation of a strip's press cycles: settling by strain and direction, kernels of a unit step (paper 2.2.2)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.optimize import brentq

from cbsr_qa.calibration.fits.common_relaxation import (
    CommonRelaxation,
    TimedValues,
    common_settling_time,
    fit_common_relaxation,
)
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.fits.settling import window_s
from cbsr_qa.domain.numbers import Array, finite_numbers
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.results.characterisation import StrainSettling
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationKernel
from cbsr_qa.domain.sensor.sensor_type import MeasuredKernel, Relaxation, StripRelaxation

#: Readings that begin later than this many time constants do not determine an exponential's amplitude.
_MAX_START_RATIO: Final = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class DirectedTrace:
    """Response to one step, for settling times and kernels.

    Parameters
    ----------
    strain : strain of the cycle.
    trace : times from the end of the ramp, and values from the level before the press.
    step : steady change the step makes: of the press, or minus that for its release; for stress the steady value.
    amplitudes : (k,) amplitudes of the exponentials of its direction.
    ramp_s : duration of the step.
    """

    strain: float
    trace: TimedValues
    step: float
    amplitudes: Array
    ramp_s: float


def settlings(
    signal: str, loading: bool, traces: Sequence[DirectedTrace], settings: CharacterisationSettings
) -> tuple[StrainSettling, ...]:
    """Settling of each strain's cycles by one fit, then of all strains."""
    if not traces:
        return ()
    strains: list[float | None] = [*sorted({trace.strain for trace in traces}), None]
    groups = [(strain, [trace for trace in traces if strain in (None, trace.strain)]) for strain in strains]
    return tuple(_settling(signal, loading, strain, members, settings) for strain, members in groups)


def _settling(
    signal: str,
    loading: bool,
    strain: float | None,
    members: Sequence[DirectedTrace],
    settings: CharacterisationSettings,
) -> StrainSettling:
    traces = [member.trace for member in members]
    fitted = fit_common_relaxation(traces)
    settling, stderr_s = common_settling_time(
        fitted,
        window_s=max(window_s(time_s) for time_s, _ in traces),
        tolerance=settings.settling_tolerance,
        band=settings.settling_band,
        loaded_change=None if loading else -float(np.mean([member.step for member in members])),
        start_s=0.0 if loading else min(float(time_s[0]) for time_s, _ in traces if len(time_s)),
    )
    time_s, values = mean_trace(traces)
    return StrainSettling(
        signal, loading, strain, fitted.fit, settling, stderr_s, time_s, values, fitted.traces or len(traces)
    )


def mean_trace(traces: Sequence[TimedValues]) -> TimedValues:
    """Mean of traces with equal sampling, up to the shortest. NumericsError if one is not finite."""
    shortest = min((len(values) for _, values in traces), default=0)
    times = np.array([time_s[-shortest:] for time_s, _ in traces]) if shortest else np.zeros((1, 0))
    values = np.array([values_of[-shortest:] for _, values_of in traces]) if shortest else np.zeros((1, 0))
    return times.mean(axis=0), finite_numbers(values, "values of traces").mean(axis=0)


def unit_kernel(common: CommonRelaxation | None, traces: Sequence[DirectedTrace], source: str) -> Relaxation | None:
    """Kernel of a unit step, from readings after ramps.

    With the step response 1 + Σ w e^(−t/τ) a ramp of length T leaves w (τ/T)(1 − e^(−T/τ)) e^(−t/τ) after its end:
    amplitudes are divided by that, and by the step, over all cycles by least squares. A single exponential is written
    as two, the first with zero weight.
    """
    if common is None or common.fit.status not in (FitStatus.TWO, FitStatus.ONE, FitStatus.FLAT):
        return None
    constants_s = common.fit.time_constants_s
    if not constants_s:
        return Relaxation((0.0, 0.0), (1.0, 10.0), f"{source}; no relaxation stands out of the noise")
    errors = " and ".join(f"{stderr:.2g} s" for stderr in common.fit.time_constant_stderr_s)
    source += f"; standard errors of the time constants {errors}"
    weights = []
    for k, tau_s in enumerate(constants_s):
        ramps = [trace.ramp_s / tau_s for trace in traces]
        averages = [float(-np.expm1(-ramp) / ramp) if ramp > 0 else 1.0 for ramp in ramps]
        expected = np.array([trace.step * average for trace, average in zip(traces, averages, strict=True)])
        amplitudes = np.array([trace.amplitudes[k] for trace in traces])
        weights.append(float(expected @ amplitudes / max(float(expected @ expected), 1e-300)))
    late_s = float(np.median([trace.trace[0][0] for trace in traces]))
    if len(weights) == 2 and late_s > _MAX_START_RATIO * constants_s[0]:
        source += f"; a faster part, over before the first reading at {late_s:.2g} s, is left out"
        weights[0] = 0.0
    if len(weights) == 1:
        source_words = f"{source}; one exponential, the first has no weight"
        return Relaxation((0.0, weights[0]), (constants_s[0] / 10, constants_s[0]), source_words)
    return Relaxation((weights[0], weights[1]), (constants_s[0], constants_s[1]), source)


#: Number of steps in the search for a settling time.
_STEPS: Final = 2000
#: Share of a standard error for differences.
_SMALL: Final = 0.1


def strip_relaxation(
    loading: Sequence[DirectedTrace], unloading: Sequence[DirectedTrace], source: str
) -> StripRelaxation | None:
    """Learn the kernels of a unit step from press cycles, as those of a sheet are learned from its loads.

    One estimator for both (``learn_kernel``), so that later comparisons show the
    material and not the method. A possible hidden exponential is included with its uncertainty.

    Returns
    -------
    StripRelaxation; None if neither direction has a significant relaxation.
    """
    kernels = _kernel(loading, True), _kernel(unloading, False)
    if not any(kernels):
        return None
    strains = [trace.strain for trace in loading or unloading]
    return StripRelaxation(*kernels, len(loading or unloading), min(strains), max(strains), source)


def _kernel(traces: Sequence[DirectedTrace], loading: bool) -> MeasuredKernel | None:
    if not traces:
        return None
    start_s = 0.0 if loading else float(np.median([trace.trace[0][0] for trace in traces]))
    kernel = learn_kernel(
        [trace.trace for trace in traces],
        ramp_s=[trace.ramp_s for trace in traces],
        released=None if loading else [-trace.step for trace in traces],
        start_s=start_s,
    )
    if kernel.why:
        return None
    return MeasuredKernel(
        weights=tuple(kernel.weights.tolist()),
        time_constants_s=tuple(kernel.time_constants_s.tolist()),
        covariance=tuple(tuple(row) for row in kernel.covariance.tolist()),
        start_s=max(start_s, float(np.median([trace.trace[0][0] for trace in traces]))),
        window_s=max(float(trace.trace[0][-1]) for trace in traces),
    )


@dataclass(frozen=True, slots=True, eq=False)
class KernelCurve:
    """c + Σ wᵢ e^(−t/τᵢ) with its error: one that :mod:`~cbsr_qa.calibration.fits.agreement` compares.

    Parameters
    ----------
    weights, time_constants_s : (k,) weights and their time constants; weights are relative to the steady (or the
        released) change.
    covariance : (2 k, 2 k) covariance of (w, log τ).
    start_s, window_s : ends of the known time.
    level : c, the final value: 1 after a press, 0 after a release.
    """

    weights: Array
    time_constants_s: Array
    covariance: Array
    start_s: float
    window_s: float
    level: float = 0.0

    @classmethod
    def from_sheet(cls, kernel: RelaxationKernel, start_s: float, window_s: float) -> Self:
        start_s = max(kernel.start_s, start_s)
        level = float(kernel.loading)
        return cls(kernel.weights, kernel.time_constants_s, kernel.covariance, start_s, window_s, level)

    @classmethod
    def from_press(cls, strip: MeasuredKernel) -> Self:
        """Return the expected response of a sheet after a press."""
        weights, time_constants_s = np.array(strip.weights), np.array(strip.time_constants_s)
        return cls(weights, time_constants_s, np.array(strip.covariance), strip.start_s, strip.window_s, 1.0)

    @classmethod
    def from_release(cls, loading: MeasuredKernel, unloading: MeasuredKernel, hold_s: float) -> Self:
        """Return the expected response of a sheet after a hold of given length, over the change at its end.

        A strip's weights are relative to its steady change, which no hold quite reaches, and its creep continues
        after the release (Boltzmann superposition): with w, τ of the press and T the hold, the change at its end is N
        = 1 + Σ w e^(−T/τ) and the decay is (Σ w′ e^(−t/τ′) + Σ w e^(−(T + t)/τ)) / N.
        """
        unloading_count, loading_count = len(unloading.weights), len(loading.weights)
        size = 2 * (unloading_count + loading_count)
        values = np.concatenate(
            [
                unloading.weights,
                np.log(unloading.time_constants_s),
                loading.weights,
                np.log(loading.time_constants_s),
            ]
        )
        covariance = np.zeros((size, size))
        covariance[: 2 * unloading_count, : 2 * unloading_count] = unloading.covariance
        covariance[2 * unloading_count :, 2 * unloading_count :] = loading.covariance

        def convert_release(of: Array) -> Array:
            own_weights, log_own, held_weights, log_held = np.split(
                of, [unloading_count, 2 * unloading_count, 2 * unloading_count + loading_count]
            )
            remaining_weights = held_weights * np.exp(-hold_s / np.exp(log_held))
            return np.concatenate(
                [
                    own_weights / (1 + remaining_weights.sum()),
                    remaining_weights / (1 + remaining_weights.sum()),
                    log_own,
                    log_held,
                ]
            )

        weights_and_logs, jacobian = (
            convert_release(values),
            _jacobian(convert_release, values, np.sqrt(np.diag(covariance))),
        )
        return cls(
            weights_and_logs[: unloading_count + loading_count],
            np.exp(weights_and_logs[unloading_count + loading_count :]),
            jacobian @ covariance @ jacobian.T,
            unloading.start_s,
            unloading.window_s,
        )

    @property
    def why_not(self) -> str:
        """Empty: a kernel can always be compared."""
        return ""

    def relative(self, time_s: Array) -> tuple[Array, Array]:
        """Return the curve and its variance, (n,) each."""
        decays = np.exp(-time_s[:, None] / self.time_constants_s)
        gradient = np.column_stack([decays, decays * self.weights * time_s[:, None] / self.time_constants_s])
        variance: Array = np.einsum("ti,ij,tj->t", gradient, self.covariance, gradient)
        return self.level + decays @ self.weights, np.maximum(variance, 0.0)

    def settling_time(self, tolerance: float) -> tuple[float, float] | None:
        """Return the last time outside ± ``tolerance`` of the change, and its standard error [s]."""
        time_s = np.linspace(self.start_s, self.window_s, _STEPS)
        outside = np.flatnonzero(np.abs(self._evaluate(time_s)) > tolerance)
        if not len(outside) or outside[-1] == _STEPS - 1:
            return None
        sign = np.sign(self._evaluate(time_s[outside[-1] : outside[-1] + 1])[0])
        settled_s = float(
            brentq(
                lambda at: sign * self._evaluate(np.array([at]))[0] - tolerance,
                *time_s[outside[-1] : outside[-1] + 2],
            )
        )
        slope = float((np.exp(-settled_s / self.time_constants_s) * self.weights / self.time_constants_s).sum())
        stderr = float(np.sqrt(self.relative(np.array([settled_s]))[1][0]))
        return (settled_s, stderr / abs(slope)) if slope and stderr else None

    def _evaluate(self, time_s: Array) -> Array:
        return np.exp(-time_s[:, None] / self.time_constants_s) @ self.weights


def _jacobian(function: Callable[[Array], Array], at: Array, stderr: Array) -> Array:
    steps = np.where(stderr > 0, _SMALL * stderr, _SMALL * _SMALL)
    columns = [
        (function(at + step) - function(at - step)) / (2 * step[index]) for index, step in enumerate(np.diag(steps))
    ]
    return np.column_stack(columns)
