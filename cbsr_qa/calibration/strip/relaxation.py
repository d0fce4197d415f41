"""Relaxation of a strip's press cycles: settling by strain and direction, kernels of a unit step (paper 2.2.2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

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
from cbsr_qa.domain.results.relaxation import FitStatus
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
