"""Separated responses to single steps: residues of earlier presses still decay while a later one is held.

A press cycle ends before the material has relaxed: sixty seconds after a release of the shipped material 6 % of the
change remain, and decay through the next hold. Without correction, that hold seems to settle too early and too low.
By linear viscoelasticity (Boltzmann superposition) the continued exponentials of earlier steps are subtracted. Each
step's fit depends on those before it, so fits and corrections are iterated.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.common_relaxation import CommonRelaxation, TimedValues, fit_common_relaxation
from cbsr_qa.calibration.fits.creep_fit import FROM_S
from cbsr_qa.calibration.fits.settling import relaxation_start
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, finite_numbers
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.results.observation import Trace
from cbsr_qa.domain.results.relaxation import FitStatus

_PASSES: Final = 4
_CONVERGED: Final = 3e-3  # relative change of time constants; a third of their standard error at best


@dataclass(frozen=True, slots=True, eq=False)
class StepTrace:
    """Readings after one step.

    Parameters
    ----------
    start_s : end of the ramp, on the run's clock.
    loading : True if the head pressed harder.
    time_s, values : (n,) float64 times and values, from the end of the ramp.
    skipped : number of ignored first samples (an unloading spike).
    """

    start_s: float
    loading: bool
    time_s: Array
    values: Array
    skipped: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class SeparatedSteps:
    """Steps, each without residues of earlier ones.

    Parameters
    ----------
    traces : (time_s, values) of each step, without residues and without skipped samples.
    levels, level_stderr : (n,) final level of each after relaxation.
    amplitudes : amplitudes of each step at the end of its ramp, one for each time constant of its direction.
    common : the relaxation of each existing direction (True: loading).
    """

    traces: tuple[TimedValues, ...]
    levels: Array
    level_stderr: Array
    amplitudes: tuple[Array, ...]
    common: dict[bool, CommonRelaxation]


def separate_steps(steps: Sequence[StepTrace]) -> SeparatedSteps:
    """Fit every step with its own level and amplitudes, and common time constants of its direction.

    NumericsError as for :func:`~cbsr_qa.calibration.fits.common_relaxation.fit_common_relaxation`.

    Parameters
    ----------
    steps : steps in order of time; together they cover the whole history.

    Returns
    -------
    SeparatedSteps. If a direction has no exponential, a step's level is the mean of its last quarter.
    """
    traces: tuple[TimedValues, ...] = tuple((s.time_s[s.skipped :], s.values[s.skipped :]) for s in steps)
    common_fits = _fit_directions(steps, traces)
    for _ in range(_PASSES):
        traces = _subtract_residues(steps, constants_of(common_fits))
        refitted = _fit_directions(steps, traces)
        settled = _alike(common_fits, refitted)
        common_fits = refitted
        if settled:
            break
    return separate_with_constants(steps, common_fits, constants_of(common_fits))


def separate_with_constants(
    steps: Sequence[StepTrace], common: dict[bool, CommonRelaxation], constants_s: dict[bool, Array]
) -> SeparatedSteps:
    """Separate steps with given time constants of each direction, e.g. for the effect of errors on the levels."""
    traces = _subtract_residues(steps, constants_s)
    fits = [fit_step(trace, constants_s[step.loading]) for step, trace in zip(steps, traces, strict=True)]
    return SeparatedSteps(
        traces,
        np.array([coefficients[0] for coefficients, _ in fits]),
        np.array([stderr for _, stderr in fits]),
        tuple(coefficients[1:] for coefficients, _ in fits),
        common,
    )


def shift_constants(common: dict[bool, CommonRelaxation]) -> list[dict[bool, Array]]:
    """Move time constants by one standard error along each of their independent directions, one set each."""
    constants = constants_of(common)
    shifted_constants = []
    for loading, fit in common.items():
        count = len(constants[loading])
        block = fit.covariance[1 + count :, 1 + count :]
        size, direction = np.linalg.eigh(block) if count else (np.zeros(0), np.zeros((0, 0)))
        for k in range(count):
            shift = np.sqrt(max(float(size[k]), 0.0)) * direction[:, k]
            shifted_constants.append({**constants, loading: constants[loading] * np.exp(np.clip(shift, -0.5, 0.5))})
    return shifted_constants


def constants_of(common: dict[bool, CommonRelaxation]) -> dict[bool, Array]:
    """Time constants of each direction, empty if it does not exist [s]."""
    nothing: dict[bool, Array] = {True: np.zeros(0), False: np.zeros(0)}
    return nothing | {loading: np.array(fit.fit.time_constants_s) for loading, fit in common.items()}


def _fit_directions(steps: Sequence[StepTrace], traces: Sequence[TimedValues]) -> dict[bool, CommonRelaxation]:
    by_direction = {
        loading: [trace for step, trace in zip(steps, traces, strict=True) if step.loading is loading]
        for loading in (True, False)
    }
    return {loading: fit_common_relaxation(members) for loading, members in by_direction.items() if members}


def _subtract_residues(steps: Sequence[StepTrace], constants_s: dict[bool, Array]) -> tuple[TimedValues, ...]:
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
        own_constants_s = constants_s[step.loading]
        place = slice(0, len(own_constants_s)) if step.loading else slice(len(every_s) - len(own_constants_s), None)
        carried[place] += fit_step((time_s, values), own_constants_s)[0][1:]
    return tuple(traces)


def fit_step(trace: TimedValues, constants_s: Array) -> tuple[Array, float]:
    """Level and amplitudes (1 + k,) of one trace with known time constants (k,), and the level's standard error.

    Without a time constant, or with too few points, the level is the mean of the trace's last quarter.

    NumericsError if a time or value is not finite.
    """
    time_s, values = (finite_numbers(numbers, "times or values of a step") for numbers in trace)
    if not len(constants_s) or len(values) < len(constants_s) + 2:
        last_quarter = values[-max(len(values) // 4, 1) :]
        spread = float(last_quarter.std(ddof=1)) if len(last_quarter) > 1 else 0.0
        level = float(last_quarter.mean()) if len(last_quarter) else 0.0
        return np.concatenate([[level], np.zeros(len(constants_s))]), spread / max(len(last_quarter), 1) ** 0.5
    design = np.column_stack([np.ones_like(time_s), np.exp(-time_s[:, None] / constants_s)])
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ values
    residual = values - design @ coefficients
    variance = float(residual @ residual) / (len(values) - design.shape[1])
    return coefficients, float(np.sqrt(variance * (inverse[0] @ inverse[0])))


def _alike(before: dict[bool, CommonRelaxation], after: dict[bool, CommonRelaxation]) -> bool:
    earlier, other = constants_of(before), constants_of(after)
    return all(
        len(earlier[way]) == len(other[way]) and np.allclose(earlier[way], other[way], rtol=_CONVERGED)
        for way in (True, False)
    )


#: Fewest values of a hold that determine a level, an amplitude and a scatter.
_FEWEST: Final = 6
#: Largest number of values of a hold; longer holds are averaged into so many, since load cells sample fast.
_MOST: Final = 60
#: Default time constant, as a share of the hold, if noise hides it: a hidden relaxation decays neither at once nor
#: beyond the hold, and its amplitude stays free.
_UNSEEN: Final = 1 / 3


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """A quantity at every strain of some loops.

    Parameters
    ----------
    values : (loops, strains) float64, in the quantity's unit.
    errors : (causes, loops, strains) effect of one standard error of each independent cause.
    """

    values: Array
    errors: Array


def levels_read(loops: Sequence[LoadRecord], trace: Trace, last_s: float, noise: float | None = None) -> Levels:
    """Mean of the last seconds of every hold.

    NumericsError if there is no value in the end of a hold, or a value is not finite.

    Parameters
    ----------
    last_s : averaging time before the end of a hold.
    noise : standard deviation of a value; None to estimate it from the averaged values.
    """
    _check_finite(trace)
    values, errors = [], []
    for loop in loops:
        for hold in loop.held:
            last_values = trace.values[(trace.time_s >= hold.end_s - last_s) & (trace.time_s < hold.end_s)]
            if not len(last_values):
                raise NumericsError(f"nothing was read in the last {last_s:.3g} s of a hold")
            spread = (float(last_values.std(ddof=1)) if len(last_values) > 1 else 0.0) if noise is None else noise
            values.append(float(last_values.mean()))
            errors.append(spread / len(last_values) ** 0.5)
    return Levels(np.reshape(values, (len(loops), -1)), _make_diagonal(np.reshape(errors, (len(loops), -1))))


def _check_finite(trace: Trace) -> None:
    finite_numbers(trace.time_s, f"times of the {trace.name}")
    finite_numbers(trace.values, f"values of the {trace.name}")


def estimate_levels(loops: Sequence[LoadRecord], trace: Trace, *, rests: bool) -> Levels:
    """Final level of every hold of some loops, without residues of earlier steps.

    Frames of the first ``FROM_S`` after a step are ignored, since a fast exponential
    hidden by noise would bend the slow one. Without a significant time constant that of the other direction is used,
    or a third of the hold.

    Parameters
    ----------
    loops : loops in order of time, pressed at one place.
    trace : trace on the run's clock.
    rests : True if the trace continues after the release (a stress does not).

    Raises
    ------
    NumericsError
        If holds are too short, the quantity drifts more slowly than they are long, or a value is not finite.
    """
    _check_finite(trace)
    steps = list(_steps(loops, trace, rests))
    shortest = min(len(step.time_s) - step.skipped for step in steps)
    if shortest < _FEWEST:
        raise NumericsError(
            f"a strain was held for {shortest} values beyond its first {FROM_S:g} s: too few to tell creep from",
            remedy="hold each strain longer; 60 s and more",
        )
    separated = separate_steps(steps)
    for loading, relaxation in separated.common.items():
        if relaxation.fit.status is FitStatus.DRIFTING:
            way = "up" if loading else "down"
            raise NumericsError(
                f"creep cannot be separated from hysteresis: on the way {way} the"
                f" {trace.name} is {relaxation.fit.why}",
                remedy="hold each strain longer",
            )
    held_s = float(np.median([step.time_s[-1] for step in steps]))
    fitted_constants = constants_of(separated.common)
    unseen = np.array([_UNSEEN * held_s])
    constants = {
        way: next((c for c in (fitted_constants[way], fitted_constants[not way]) if len(c)), unseen)
        for way in (True, False)
    }
    final_steps = separate_with_constants(steps, separated.common, constants)
    shifted_steps = [
        separate_with_constants(
            steps,
            separated.common,
            {way: shifted[way] if len(fitted_constants[way]) else constants[way] for way in shifted},
        )
        for shifted in shift_constants(separated.common)
    ]
    width = len(loops[0].held)
    own_stderr = _shape_levels(final_steps.level_stderr, len(loops), width)
    shifts = [
        _shape_levels(shifted.levels - final_steps.levels, len(loops), width)[None] for shifted in shifted_steps
    ]
    return Levels(
        _shape_levels(final_steps.levels, len(loops), width), np.concatenate([_make_diagonal(own_stderr), *shifts])
    )


def _steps(loops: Sequence[LoadRecord], trace: Trace, rests: bool) -> Iterator[StepTrace]:
    for loop in loops:
        strain_before = 0.0
        for hold in loop.held:
            yield _step(trace, hold.start_s, hold.end_s, loading=hold.strain > strain_before)
            strain_before = hold.strain
        if rests:
            step = _step(trace, loop.unloaded_s, loop.rest_end_s, loading=False)
            start = max(step.skipped, relaxation_start(step.values))
            if len(step.time_s) - start >= _FEWEST:
                yield StepTrace(step.start_s, False, step.time_s, step.values, start)


def _step(trace: Trace, start_s: float, end_s: float, *, loading: bool) -> StepTrace:
    inside_mask = (trace.time_s >= start_s) & (trace.time_s < end_s)
    time_s, values = trace.time_s[inside_mask] - start_s, trace.values[inside_mask]
    if len(time_s) > _MOST:
        parts = np.array_split(np.arange(len(time_s)), _MOST)
        time_s, values = (np.array([samples[part].mean() for part in parts]) for samples in (time_s, values))
    return StepTrace(start_s, loading, time_s, values, int((time_s < FROM_S).sum()))


def _shape_levels(levels: Array, loops: int, width: int) -> Array:
    return levels.reshape(loops, -1)[:, :width]


def _make_diagonal(stderr: Array) -> Array:
    return np.diag(stderr.ravel()).reshape(stderr.size, *stderr.shape)
