"""Responses to one step each, taken apart: what earlier presses left still fades while a later one is held.

A press cycle is over before the material has relaxed: sixty seconds after a release of the shipped material 6 % of
the change are left, and fade through the next hold. Fitted as it is, that hold settles too early and too low. Linear
viscoelasticity (Boltzmann superposition) says what to take away: the exponentials that were fitted to earlier steps,
continued. Each step's fit depends on those before it, so that fits and what is carried over are found in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate.common_relaxation import CommonRelaxation, TimedValues, fit_common_relaxation
from cbsr_qa.domain.numbers import finite_numbers

Array = NDArray[np.float64]

_PASSES: Final = 4
_CONVERGED: Final = 3e-3  # relative change of time constants; a third of their standard error at best


@dataclass(frozen=True, slots=True, eq=False)
class StepTrace:
    """What was read after one step.

    Parameters
    ----------
    start_s : end of the ramp, on the run's clock.
    loading : whether the head pressed harder.
    time_s, values : (n,) float64, from the end of the ramp.
    skipped : first samples that count for nothing (an unloading spike).
    """

    start_s: float
    loading: bool
    time_s: Array
    values: Array
    skipped: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class SeparatedSteps:
    """Steps, each without what earlier ones left.

    Parameters
    ----------
    traces : (time_s, values) of each as given, without what was carried over and without skipped samples.
    levels, level_stderr : (n,) where each is going: its level after all has relaxed.
    amplitudes : of each, one for each time constant of its direction, at the end of its ramp.
    common : the relaxation of each direction (True: loading) that is there.
    """

    traces: tuple[TimedValues, ...]
    levels: Array
    level_stderr: Array
    amplitudes: tuple[Array, ...]
    common: dict[bool, CommonRelaxation]


def separate_steps(steps: Sequence[StepTrace]) -> SeparatedSteps:
    """Fit every step with its own level and amplitudes, and with the time constants all steps of its direction share.

    Parameters
    ----------
    steps : in the order of their times; together they cover what happened.

    Returns
    -------
    SeparatedSteps. Where a direction carries no exponential a step's level is the mean of its last quarter.

    Raises
    ------
    NumericsError
        As of :func:`~cbsr_qa.calibrate.common_relaxation.fit_common_relaxation`.
    """
    traces: tuple[TimedValues, ...] = tuple((s.time_s[s.skipped :], s.values[s.skipped :]) for s in steps)
    common = _fitted(steps, traces)
    for _ in range(_PASSES):
        traces = _without_carried(steps, constants_of(common))
        found = _fitted(steps, traces)
        settled = _alike(common, found)
        common = found
        if settled:
            break
    return separated_with(steps, common, constants_of(common))


def separated_with(
    steps: Sequence[StepTrace], common: dict[bool, CommonRelaxation], constants_s: dict[bool, Array]
) -> SeparatedSteps:
    """Separate steps with given time constants of each direction: what an error of theirs does to the levels."""
    traces = _without_carried(steps, constants_s)
    fits = [fit_step(trace, constants_s[step.loading]) for step, trace in zip(steps, traces, strict=True)]
    return SeparatedSteps(
        traces,
        np.array([coefficients[0] for coefficients, _ in fits]),
        np.array([stderr for _, stderr in fits]),
        tuple(coefficients[1:] for coefficients, _ in fits),
        common,
    )


def shifted_constants(common: dict[bool, CommonRelaxation]) -> list[dict[bool, Array]]:
    """Time constants moved by one standard error along each of their independent directions.

    Returns
    -------
    One set for each time constant there is. Sums of squares over them propagate the constants' covariance.
    """
    plain = constants_of(common)
    moved = []
    for loading, one in common.items():
        count = len(plain[loading])
        block = one.covariance[1 + count :, 1 + count :]
        size, direction = np.linalg.eigh(block) if count else (np.zeros(0), np.zeros((0, 0)))
        for k in range(count):
            shift = np.sqrt(max(float(size[k]), 0.0)) * direction[:, k]
            moved.append({**plain, loading: plain[loading] * np.exp(np.clip(shift, -0.5, 0.5))})
    return moved


def constants_of(common: dict[bool, CommonRelaxation]) -> dict[bool, Array]:
    """Time constants of each direction, none where it is not there [s]."""
    nothing: dict[bool, Array] = {True: np.zeros(0), False: np.zeros(0)}
    return nothing | {loading: np.array(one.fit.time_constants_s) for loading, one in common.items()}


def _fitted(steps: Sequence[StepTrace], traces: Sequence[TimedValues]) -> dict[bool, CommonRelaxation]:
    by_direction = {
        loading: [trace for step, trace in zip(steps, traces, strict=True) if step.loading is loading]
        for loading in (True, False)
    }
    return {loading: fit_common_relaxation(members) for loading, members in by_direction.items() if members}


def _without_carried(steps: Sequence[StepTrace], constants_s: dict[bool, Array]) -> tuple[TimedValues, ...]:
    """Walk through the steps in time, fit each, and carry what it leaves to the next ones."""
    every_s = np.concatenate([constants_s[True], constants_s[False]])
    carried = np.zeros(len(every_s))
    before_s = steps[0].start_s if steps else 0.0
    traces: list[TimedValues] = []
    for step in steps:
        carried = carried * np.exp(-(step.start_s - before_s) / every_s)
        before_s = step.start_s
        time_s = step.time_s[step.skipped :]
        values = step.values[step.skipped :] - np.exp(-time_s[:, None] / every_s) @ carried
        traces.append((time_s, values))
        own = constants_s[step.loading]
        place = slice(0, len(own)) if step.loading else slice(len(every_s) - len(own), None)
        carried[place] += fit_step((time_s, values), own)[0][1:]
    return tuple(traces)


def fit_step(trace: TimedValues, constants_s: Array) -> tuple[Array, float]:
    """Level and amplitudes (1 + k,) of one trace with known time constants (k,), and the level's standard error.

    Without a time constant, or with too few points, the level is the mean of the trace's last quarter.

    Raises
    ------
    NumericsError
        If a time or value is not finite.
    """
    time_s, values = (finite_numbers(part, "times or values of a step") for part in trace)
    if not len(constants_s) or len(values) < len(constants_s) + 2:
        last = values[-max(len(values) // 4, 1) :]
        spread = float(last.std(ddof=1)) if len(last) > 1 else 0.0
        level = float(last.mean()) if len(last) else 0.0
        return np.concatenate([[level], np.zeros(len(constants_s))]), spread / max(len(last), 1) ** 0.5
    design = np.column_stack([np.ones_like(time_s), np.exp(-time_s[:, None] / constants_s)])
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ values
    residual = values - design @ coefficients
    variance = float(residual @ residual) / (len(values) - design.shape[1])
    return coefficients, float(np.sqrt(variance * (inverse[0] @ inverse[0])))


def _alike(before: dict[bool, CommonRelaxation], after: dict[bool, CommonRelaxation]) -> bool:
    one, other = constants_of(before), constants_of(after)
    return all(
        len(one[way]) == len(other[way]) and np.allclose(one[way], other[way], rtol=_CONVERGED)
        for way in (True, False)
    )
