"""Distribution of a force by random numbers (JCGM 101), where a budget alone may not do. Numpy alone."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from cbsr_qa.calibration.uncertainty.force_point import Entry, ForcePoint
from cbsr_qa.calibration.uncertainty.inputs import ForceInput
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.expanded_force import Budget, MonteCarlo

#: Number of trials: the ends of an interval of 95 % are then known to 1 % of its half width.
TRIALS: Final = 40_000
_SEED: Final = 101
#: Least shift by second-order terms, of the standard uncertainty, for a model to count as bent.
_BENT: Final = 0.05
#: Largest share of the variance by one error that is not normal for a sum to count as normal.
_DOMINATES: Final = 0.5
#: Degrees of freedom below which an error is clearly not normal: k of 10 is 14 % above that of infinitely many.
_FEW: Final = 10


def simulate_force(point: ForcePoint, inputs: Sequence[ForceInput], budget: Budget) -> MonteCarlo | None:
    """Return the distribution of a force; None where the law of propagation is enough."""
    why = _describe_bend(point, inputs, budget)
    if not why:
        return None
    random = np.random.default_rng(_SEED)
    errors: dict[Entry, Array] = {}
    for item in inputs:
        if item.uncertainty:
            drawn = item.sign * item.uncertainty * draw_errors(item, random, TRIALS)
            errors[item.entry] = errors.get(item.entry, 0.0) + drawn
    low_N, high_N = np.quantile(point.force_with(errors), [0.025, 0.975]).tolist()
    return MonteCarlo(TRIALS, low_N, high_N, why)


def draw_errors(item: ForceInput, random: np.random.Generator, count: int) -> Array:
    """Draw errors (count,) in units of their standard uncertainty: rectangular, normal, or t (JCGM 101, 6.4)."""
    if item.rectangular:
        return random.uniform(-np.sqrt(3), np.sqrt(3), count)
    return random.standard_normal(count) if np.isinf(item.dof) else random.standard_t(item.dof, count)


def _describe_bend(point: ForcePoint, inputs: Sequence[ForceInput], budget: Budget) -> str:
    shift_N = sum(abs(point.bend(item.entry)) * item.uncertainty**2 / 2 for item in inputs)
    if shift_N > _BENT * budget.standard_uncertainty:
        return f"terms of second order shift the force by over {_BENT:.0%} of its standard uncertainty"
    rectangular = {item.name for item in inputs if item.rectangular}
    for component in budget.components:
        if component.share > _DOMINATES and (component.name in rectangular or component.dof < _FEW):
            how = "is rectangular" if component.name in rectangular else f"has {component.dof:.0f} degrees of freedom"
            return f"{component.name} {how}, and has over half of the variance"
    return ""
