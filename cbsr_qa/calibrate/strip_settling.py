"""Relaxation of press cycles: settling by strain and direction, and the kernels of a unit step (paper 2.2.2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate.common_relaxation import (
    CommonRelaxation,
    TimedValues,
    common_settling_time,
    fit_common_relaxation,
)
from cbsr_qa.domain.characterisation import CharacterisationSettings, StrainSettling
from cbsr_qa.domain.numbers import finite_numbers
from cbsr_qa.domain.relaxation import FitStatus
from cbsr_qa.domain.sensor import Relaxation

Array = NDArray[np.float64]

#: Readings that begin later than this many time constants do not tell what an exponential began with.
_LATE: Final = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class DirectedTrace:
    """What one step did, for settling times and kernels.

    Parameters
    ----------
    strain : of the cycle.
    trace : times from the end of the ramp, and values from the level before the press.
    step : steady change the step makes: of the press, or minus that for its release; for stress the steady value.
    amplitudes : (k,) of the exponentials of its direction.
    ramp_s : how long the step took.
    """

    strain: float
    trace: TimedValues
    step: float
    amplitudes: Array
    ramp_s: float


def settlings(
    signal: str, loading: bool, traces: Sequence[DirectedTrace], settings: CharacterisationSettings
) -> tuple[StrainSettling, ...]:
    """Settle the cycles of each strain by one fit, then those of all strains."""
    if not traces:
        return ()
    strains: list[float | None] = [*sorted({one.strain for one in traces}), None]
    groups = [(strain, [one for one in traces if strain in (None, one.strain)]) for strain in strains]
    return tuple(_settling(signal, loading, strain, members, settings) for strain, members in groups)


def _settling(
    signal: str,
    loading: bool,
    strain: float | None,
    members: Sequence[DirectedTrace],
    settings: CharacterisationSettings,
) -> StrainSettling:
    traces = [one.trace for one in members]
    fitted = fit_common_relaxation(traces)
    settling, stderr_s = common_settling_time(
        fitted,
        window_s=max(_window_s(time_s) for time_s, _ in traces),
        tolerance=settings.settling_tolerance,
        band=settings.settling_band,
        loaded_change=None if loading else -float(np.mean([one.step for one in members])),
        start_s=0.0 if loading else min(float(time_s[0]) for time_s, _ in traces if len(time_s)),
    )
    time_s, values = mean_trace(traces)
    return StrainSettling(
        signal, loading, strain, fitted.fit, settling, stderr_s, time_s, values, fitted.traces or len(traces)
    )


def mean_trace(traces: Sequence[TimedValues]) -> TimedValues:
    """Mean of traces that were sampled alike, as far as the shortest reaches. NumericsError if one is not finite."""
    shortest = min((len(values) for _, values in traces), default=0)
    times = np.array([time_s[-shortest:] for time_s, _ in traces]) if shortest else np.zeros((1, 0))
    values = np.array([one[-shortest:] for _, one in traces]) if shortest else np.zeros((1, 0))
    return times.mean(axis=0), finite_numbers(values, "values of traces").mean(axis=0)


def unit_kernel(common: CommonRelaxation | None, traces: Sequence[DirectedTrace], source: str) -> Relaxation | None:
    """Kernel of a unit step, from what was read after ramps.

    A ramp of length T answered by 1 + Σ w e^(−t/τ) leaves w (τ/T)(1 − e^(−T/τ)) e^(−t/τ) after its end: amplitudes
    are divided by that, and by the step, over all cycles by least squares. A single exponential is written as two,
    the first of no weight.

    Returns
    -------
    None where no relaxation can be told.
    """
    if common is None or common.fit.status not in (FitStatus.TWO, FitStatus.ONE, FitStatus.FLAT):
        return None
    constants_s = common.fit.time_constants_s
    if not constants_s:
        return Relaxation((0.0, 0.0), (1.0, 10.0), f"{source}; no relaxation stands out of the noise")
    errors = " and ".join(f"{stderr:.2g} s" for stderr in common.fit.time_constant_stderr_s)
    source += f"; standard errors of the time constants {errors}"
    weights = [_weight(traces, k, tau) for k, tau in enumerate(constants_s)]
    late_s = float(np.median([one.trace[0][0] for one in traces]))
    if len(weights) == 2 and late_s > _LATE * constants_s[0]:
        source += f"; a faster part, over before the first reading at {late_s:.2g} s, is left out"
        weights[0] = 0.0
    if len(weights) == 1:
        said = f"{source}; one exponential, the first has no weight"
        return Relaxation((0.0, weights[0]), (constants_s[0] / 10, constants_s[0]), said)
    return Relaxation((weights[0], weights[1]), (constants_s[0], constants_s[1]), source)


def _weight(traces: Sequence[DirectedTrace], k: int, tau_s: float) -> float:
    expected = np.array([one.step * _ramped(one.ramp_s / tau_s) for one in traces])
    found = np.array([one.amplitudes[k] for one in traces])
    return float(expected @ found / max(float(expected @ expected), 1e-300))


def _ramped(length: float) -> float:
    return float(-np.expm1(-length) / length) if length > 0 else 1.0


def _window_s(time_s: Array) -> float:
    """Length of the observed window: half a sample beyond the last one's middle."""
    if len(time_s) < 2:
        return float(time_s.max(initial=1.0))
    return float(time_s[-1] + np.median(np.diff(time_s)) / 2)
