"""Levels of a quantity at every strain of a loop: as they were read, and without what had not relaxed yet."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate.creep import FROM_S
from cbsr_qa.calibrate.superposition import (
    StepTrace,
    constants_of,
    separate_steps,
    separated_with,
    shifted_constants,
)
from cbsr_qa.calibrate.unloading import relaxation_start
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.loads import LoadRecord
from cbsr_qa.domain.numbers import finite_numbers
from cbsr_qa.domain.observation import Trace
from cbsr_qa.domain.relaxation import FitStatus

Array = NDArray[np.float64]

#: Fewest values of a hold that a level, an amplitude and a scatter can be told from.
_FEWEST: Final = 6
#: A hold of more values than this is averaged into so many: load cells sample fast.
_MOST: Final = 60
#: Time constant that is taken where none stands out of the noise, as a share of the hold: what it hides decays
#: neither at once nor beyond the hold, and its amplitude stays free.
_UNSEEN: Final = 1 / 3


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """A quantity at every strain of some loops.

    Parameters
    ----------
    values : (loops, strains) float64, in the quantity's unit.
    errors : (causes, loops, strains), what one standard error of each independent cause does to them.
    """

    values: Array
    errors: Array


def levels_read(loops: Sequence[LoadRecord], trace: Trace, last_s: float, noise: float | None = None) -> Levels:
    """Mean of the last seconds of every hold.

    Parameters
    ----------
    last_s : how long before the end of a hold is averaged.
    noise : standard deviation of a value; None to take it from the values averaged.

    Raises
    ------
    NumericsError
        If there is no value in the end of a hold, or a value is not finite.
    """
    _check_finite(trace)
    values, errors = [], []
    for loop in loops:
        for held in loop.held:
            last = trace.values[(trace.time_s >= held.end_s - last_s) & (trace.time_s < held.end_s)]
            if not len(last):
                raise NumericsError(f"nothing was read in the last {last_s:.3g} s of a hold")
            spread = (float(last.std(ddof=1)) if len(last) > 1 else 0.0) if noise is None else noise
            values.append(float(last.mean()))
            errors.append(spread / len(last) ** 0.5)
    return Levels(np.reshape(values, (len(loops), -1)), _apart(np.reshape(errors, (len(loops), -1))))


def _check_finite(trace: Trace) -> None:
    finite_numbers(trace.time_s, f"times of the {trace.name}")
    finite_numbers(trace.values, f"values of the {trace.name}")


def relaxed_levels(loops: Sequence[LoadRecord], trace: Trace, *, rests: bool) -> Levels:
    """Where every hold of some loops is going, whatever earlier steps of them still leave.

    Frames of the first :data:`~cbsr_qa.calibrate.creep.FROM_S` after a step do not count: a fast exponential that the
    noise hides would bend the slow one. Where no time constant stands out of the noise that of the other direction is
    taken, or a third of the hold.

    Parameters
    ----------
    loops : in time order, pressed one after the other at one place.
    trace : on the run's clock.
    rests : whether the trace goes on after the release (a stress does not: the head has left).

    Raises
    ------
    NumericsError
        If holds are too short to tell, the quantity drifts more slowly than they are long, or a value is not finite.
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
    for loading, common in separated.common.items():
        if common.fit.status is FitStatus.DRIFTING:
            way = "up" if loading else "down"
            raise NumericsError(
                f"creep cannot be told from hysteresis: on the way {way} the {trace.name} is {common.fit.why}",
                remedy="hold each strain longer",
            )
    held_s = float(np.median([step.time_s[-1] for step in steps]))
    known = constants_of(separated.common)
    unseen = np.array([_UNSEEN * held_s])
    constants = {way: next((c for c in (known[way], known[not way]) if len(c)), unseen) for way in (True, False)}
    plain = separated_with(steps, separated.common, constants)
    moved = [
        separated_with(steps, separated.common, {way: one[way] if len(known[way]) else constants[way] for way in one})
        for one in shifted_constants(separated.common)
    ]
    width = len(loops[0].held)
    own = _shaped(plain.level_stderr, len(loops), width)
    shifts = [_shaped(one.levels - plain.levels, len(loops), width)[None] for one in moved]
    return Levels(_shaped(plain.levels, len(loops), width), np.concatenate([_apart(own), *shifts]))


def _steps(loops: Sequence[LoadRecord], trace: Trace, rests: bool) -> Iterator[StepTrace]:
    for loop in loops:
        before = 0.0
        for held in loop.held:
            yield _step(trace, held.start_s, held.end_s, loading=held.strain > before)
            before = held.strain
        if rests:
            step = _step(trace, loop.unloaded_s, loop.rest_end_s, loading=False)
            start = max(step.skipped, relaxation_start(step.values))
            if len(step.time_s) - start >= _FEWEST:
                yield StepTrace(step.start_s, False, step.time_s, step.values, start)


def _step(trace: Trace, start_s: float, end_s: float, *, loading: bool) -> StepTrace:
    inside = (trace.time_s >= start_s) & (trace.time_s < end_s)
    time_s, values = trace.time_s[inside] - start_s, trace.values[inside]
    if len(time_s) > _MOST:
        parts = np.array_split(np.arange(len(time_s)), _MOST)
        time_s, values = (np.array([one[part].mean() for part in parts]) for one in (time_s, values))
    return StepTrace(start_s, loading, time_s, values, int((time_s < FROM_S).sum()))


def _shaped(levels: Array, loops: int, width: int) -> Array:
    """Levels of the strains, (loops, width); those of rests are left out."""
    shaped: Array = levels.reshape(loops, -1)[:, :width]
    return shaped


def _apart(stderr: Array) -> Array:
    """Standard errors (loops, strains) as causes of their own, each of one level alone."""
    causes: Array = np.diag(stderr.ravel()).reshape(stderr.size, *stderr.shape)
    return causes
